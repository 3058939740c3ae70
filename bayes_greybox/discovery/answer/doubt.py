"""What an error of the measurement that the samples themselves show takes from the probability of an effect.

Of samples that contradict each other with a p-value p, one sensor is wrong with the probability

    P = π / (π + (1 − π) B),    B = −e p ln p   (p < 1/e),

π its prior probability and B the least odds that p leaves to sensors that are right, whatever the alternative (Sellke,
Bayarri and Berger 2001, Am. Stat. 55:62, eq. 2). The error acts on the studied rate like a force of a certain RMS; an
effect of that size or smaller may be nothing else, and one of r times that size is with the share 1/r.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Doubt:
    """One contradiction among the samples.

    Attributes:
        probability: That it is one.
        force: RMS of what it does to the studied rate, in the scale of the statistics' target.
        own: Whether the studied state itself contradicts the answer, so that it is none, whatever its size.
    """

    probability: float
    force: float
    own: bool


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


def unexplained(doubts: Sequence[Doubt]) -> float:
    """Probability that an answer without effects is none, since the studied state contradicts it.

    Args:
        doubts: Contradictions.
    """
    return 1 - math.prod((1 - doubt.probability for doubt in doubts if doubt.own), start=1.0)
