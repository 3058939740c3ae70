"""Predictions of a study's hypotheses for data to come: their terms, and the posterior of the coefficients."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from bayes_greybox.discovery.decision.probabilities import NO_GAP, RECALIBRATE, UNKNOWN_KIND
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.physics.terms import Term

from .coefficients import factor_of
from .equation_study import EquationStudy

LEAST_EXPLAINED = 0.01
"""Probability from which on an explanation is kept."""

JOINED, COMPONENTS = 32, 3
"""Largest numbers of joint explanations of several equations, and of hypotheses of one explanation."""

PREDICTING = (NO_GAP, RECALIBRATE)
"""Explanations without an effect that predict a run: an error of these sensors predicts nothing."""


@dataclass(frozen=True)
class Component:
    """One hypothesis, with a share of its explanation: terms, each in the rate of a state, and Gaussian coefficients.

    The mean is in the user's units, the covariance WᵀW with W the `root`; effects are at values of their parameters.
    """

    weight: float
    equations: tuple[str, ...]
    terms: tuple[Term, ...]
    mean: Float[np.ndarray, " n_coefficient"]
    root: Float[np.ndarray, "n_latent n_coefficient"]


@dataclass(frozen=True)
class Explained:
    """One explanation, with its name in the table of hypotheses and the noise of the rows by equation, user's units."""

    name: str
    probability: float
    slugs: tuple[str, ...] = ()
    components: tuple[Component, ...] = ()
    sigma: Mapping[str, float] = field(default_factory=dict)


def explained(study: EquationStudy) -> tuple[Explained, ...]:
    """Return the explanations of one equation from the probability `LEAST_EXPLAINED` on, likeliest first."""
    table, p, kept = study.hypotheses(), study.probabilities, []
    names = table.index.get_level_values("hypothesis")
    for name, probability in zip(names, table["probability"].to_numpy(float), strict=True):
        if probability < LEAST_EXPLAINED:
            continue
        of_name = [h for h in study.near.weighed.hypotheses if study.called(h) == name]
        # A discrepancy without a name predicts nothing; nor does a parameter whose hidden states would be others.
        able = [] if study.amendment.parameters else of_name
        able = [h for h in able if name != UNKNOWN_KIND and (p.effects(h) or p.kind_of(h) in PREDICTING)]
        effects = [study.near.column(i).effect for h in able[:1] for i in h.members]
        slugs = tuple(effect.slug for effect in effects if effect is not None)
        kept.append(Explained(str(name), float(probability), slugs, *_components(study, able)))
    return tuple(kept)


def joined(each: Mapping[str, Sequence[Explained]]) -> tuple[Explained, ...]:
    """Return the likeliest explanations of all equations together, which are independent given the data."""
    likeliest = [Explained("", 1.0, (), (Component(1.0, (), (), np.zeros(0), np.zeros((0, 0))),))]
    for equation, group in each.items():
        label = f"{equation}: " if len(each) > 1 else ""
        both = [
            Explained(
                name="; ".join(filter(None, (before.name, label + one.name))),
                probability=before.probability * one.probability,
                slugs=before.slugs + one.slugs,
                components=_together(before.components, one.components),
                sigma={**before.sigma, **one.sigma},
            )
            for before in likeliest
            for one in group
        ]
        # The likeliest of all are likely in every part.
        likeliest = sorted(both, key=lambda e: -e.probability)[:JOINED]
    return tuple(e for e in likeliest if e.probability >= LEAST_EXPLAINED * likeliest[0].probability)


def _components(study: EquationStudy, able: Sequence[Hypothesis]) -> tuple[tuple[Component, ...], dict[str, float]]:
    """Return the likeliest hypotheses of one name, each at its likeliest noise point, and the noise there."""
    columns, scale, components = study.regressors.columns, study.regressors.target_scale, []
    likeliest = sorted(able, key=lambda h: -h.log_weight)[:COMPONENTS]
    if not likeliest:
        return (), {}
    weights = np.exp([h.log_weight - likeliest[0].log_weight for h in likeliest])
    weights = weights / np.sum(weights)
    for weight, h in zip(weights, likeliest, strict=True):
        terms = [k for k, i in enumerate(h.members) if columns[i].term is not None]
        unit = np.array([scale / columns[h.members[k]].scale for k in terms])
        root = factor_of(h.covariance[np.ix_(terms, terms)]) * unit
        # As text, which a file gives back the same.
        formulas = [columns[h.members[k]].formula.plain for k in terms]
        # Slopes of parameters are those of a tangent, whose remainder is known.
        known = study.amendment.remainder if any(columns[i].parameter for i in h.members) else ()
        mean = np.array([*(unit * h.mean[terms]), *(value for _, value in known)])
        root = np.hstack([root, np.zeros((len(root), len(known)))])
        plain = tuple(replace(f, expression=f.text) for f in (*formulas, *(term for term, _ in known)))
        components.append(Component(float(weight), (study.equation,) * len(plain), plain, mean, root))
    return tuple(components), {study.equation: float(weights @ [h.noise for h in likeliest]) * scale}


def _together(parts: Sequence[Component], others: Sequence[Component]) -> tuple[Component, ...]:
    """Return the likeliest pairs of hypotheses of two equations; none if one of these predicts nothing."""
    pairs = sorted(((a, b) for a in parts for b in others), key=lambda pair: -pair[0].weight * pair[1].weight)
    pairs = pairs[:COMPONENTS]
    total = sum(a.weight * b.weight for a, b in pairs)
    return tuple(
        Component(
            weight=a.weight * b.weight / total,
            equations=a.equations + b.equations,
            terms=a.terms + b.terms,
            mean=np.append(a.mean, b.mean),
            root=np.asarray(block_diag(a.root, b.root)),
        )
        for a, b in pairs
    )
