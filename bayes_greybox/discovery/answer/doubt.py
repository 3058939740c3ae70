"""What an error of the measurement that the samples themselves show takes from the probability of an effect.

Of samples that contradict each other with a p-value p, one sensor is wrong with the probability

    P = π / (π + (1 − π) B),    B = −e p ln p   (p < 1/e),

π its prior probability and B the least odds that p leaves to sensors that are right, whatever the alternative (Sellke,
Bayarri and Berger 2001, Am. Stat. 55:62, eq. 2). The error acts on the studied rate like a force of a certain RMS; an
effect of that size or smaller may be nothing else, and one of r times that size is with the share 1/r.

Of answers without effects, each is judged by its own motion: k counts with its B_k against the error that all of them
may have in common,

    P'_k = M (1 − π) P_k B_k / ((1 − π) Σ P_j B_j + π M),    M = Σ P_j

and what is left of M is unknown. Where none is denied, P'_k is P_k.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Doubt:
    """One contradiction among the samples.

    Attributes:
        probability: That it is one.
        force: RMS of what it does to the studied rate, in the scale of the statistics' target.
        denies: The kind of answer that the studied state itself contradicts: one without effects is none then; of
            effects those no larger than the force. Empty where other samples contradict each other.
    """

    probability: float
    force: float
    denies: str = ""


def contradicted(p: float, prior: float) -> float:
    """Probability that samples contradict each other.

    Args:
        p: p-value of their agreement.
        prior: Probability before it was known.
    """
    if p <= 0:
        return 1.0
    odds = -math.e * p * math.log(p) if p < 1 / math.e else 1.0
    return prior / (prior + (1 - prior) * odds)


def artefact(doubts: Sequence[Doubt], size: float) -> float:
    """Probability that an effect is nothing but what some error of the measurement does.

    Args:
        doubts: Contradictions.
        size: RMS of the effect, in the scale of the statistics' target.
    """
    sound = 1.0
    for doubt in doubts:
        sound *= 1 - doubt.probability * (min(1.0, doubt.force / size) if size > 0 else 1.0)
    return 1 - sound


def standing(found: Mapping[str, float], doubts: Sequence[Doubt], prior: float) -> dict[str, float]:
    """Probabilities P'_k of answers without effects, in the light of what the studied state denies.

    Args:
        found: P_k by kind.
        doubts: Contradictions.
        prior: π.
    """
    odds = dict.fromkeys(found, 1.0)
    for doubt in doubts:
        if doubt.denies in odds:
            odds[doubt.denies] *= (1 / doubt.probability - 1) * prior / (1 - prior)
    mass = sum(found.values())
    if mass == 0 or all(b == 1 for b in odds.values()):
        return dict(found)
    stands = {kind: (1 - prior) * p * odds[kind] for kind, p in found.items()}
    return {kind: mass * p / (sum(stands.values()) + prior * mass) for kind, p in stands.items()}
