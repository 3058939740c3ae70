"""What each explanation of a study says of data to come: its terms, and the posterior of their coefficients.

Given values of inner parameters and which coefficients of the simulation are corrected, the coefficients are Gaussian;
an explanation is a mixture of such components.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from bayes_greybox.discovery.answer.coefficients import conditional
from bayes_greybox.discovery.answer.equation_study import EquationStudy
from bayes_greybox.discovery.answer.weighed import Weighed
from bayes_greybox.discovery.evidence.ties import ranked
from bayes_greybox.discovery.weighing.sets import LAWFUL, REST, Explanation
from bayes_greybox.discovery.weighing.worlds import World
from bayes_greybox.physics.terms import Term

from .nameless import Features, nameless
from .resampled import systematic

LEAST = 0.01
"""Probability from which on an explanation is kept."""

JOINED = 32
"""Explanations of several equations together that are told apart at most."""

COMPONENTS = 8
"""Components of an explanation, at most."""

VARIANTS = 3
"""Variants of one explanation that stand for all, at most."""

PREDICTING = ("no gap", "recalibrate")
"""Explanations without an effect whose columns say what a run would show: an error of these sensors says nothing."""


@dataclass(frozen=True)
class Component:
    """Terms, and features of what has no name, whose coefficients are Gaussian.

    Attributes:
        weight: Of the mixture.
        equations: The state whose rate each term is in.
        terms: The terms; of effects, at values of their inner parameters.
        mean: Of their coefficients, then of those of the features, user's units.
        root: W with WᵀW their covariance.
        features: Of discrepancies, by the state whose rate they are in.
    """

    weight: float
    equations: tuple[str, ...]
    terms: tuple[Term, ...]
    mean: Float[np.ndarray, " n_coefficient"]
    root: Float[np.ndarray, "n_latent n_coefficient"]
    features: Mapping[str, Features] = field(default_factory=dict)

    def places(self, equation: str) -> tuple[list[int], slice]:
        """Which coefficients belong to the rate of a state: those of terms, and those of features.

        Args:
            equation: The state.
        """
        own, end = [j for j, name in enumerate(self.equations) if name == equation], len(self.terms)
        for name, each in self.features.items():
            begin, end = end, end + len(each.kept)
            if name == equation:
                return own, slice(begin, end)
        return own, slice(end, end)

    def columns(
        self, equation: str, columns: Mapping[str, Float[np.ndarray, "*n"]], shape: tuple[int, ...]
    ) -> tuple[list[int], Float[np.ndarray, "*n n_own"]]:
        """Coefficients in the rate of a state, and what each is multiplied by.

        Args:
            equation: The state.
            columns: States and inputs.
            shape: Of these.
        """
        own, wide = self.places(equation)
        Phi = np.zeros((*shape, len(own)))
        for k, j in enumerate(own):
            Phi[..., k] = self.terms[j].evaluate(columns)
        if equation not in self.features:
            return own, Phi
        both = np.concatenate([Phi, self.features[equation].evaluate(columns)], axis=-1)
        return [*own, *range(wide.start, wide.stop)], both


@dataclass(frozen=True)
class Explained:
    """One explanation.

    Attributes:
        name: As in the study's table of hypotheses; of several equations each with its own.
        probability: Of the explanation.
        slugs: Effects that it has.
        components: The mixture; none where it does not predict anything.
        sigma: Noise standard deviation of the rows by equation, user's units.
    """

    name: str
    probability: float
    slugs: tuple[str, ...] = ()
    components: tuple[Component, ...] = ()
    sigma: Mapping[str, float] = field(default_factory=dict)


def explained(found: EquationStudy) -> tuple[Explained, ...]:
    """Explanations of one equation from the probability `LEAST` on, likeliest first.

    Args:
        found: The study of the equation.
    """
    weighed = found.finding.weighed
    table = found.hypotheses()
    names = table.index.get_level_values("hypothesis")
    kept = []
    for name, p in zip(names, table["probability"].to_numpy(float), strict=True):
        if p < LEAST:
            continue
        items = [(w, e, q) for w, e, q, _ in weighed.items if found.called(w, e) == name]
        if not items:
            # What the sensor does in an effect's place has no explanation of its own.
            kept.append(Explained(str(name), float(p)))
            continue
        kept.append(_told(str(name), float(p), weighed, items))
    return tuple(kept)


def joined(each: Mapping[str, Sequence[Explained]]) -> tuple[Explained, ...]:
    """Explanations of all equations together, which are independent given the data, likeliest first.

    Args:
        each: Explanations by equation.

    Returns:
        The likeliest, at most `JOINED`; those less likely than `LEAST` times the first are left out.
    """
    if len(each) == 1:
        return tuple(next(iter(each.values())))
    found = []
    choices: list[tuple[tuple[Explained, ...], float]] = [((), 1.0)]
    for group in each.values():
        # The likeliest of all are likely in every part.
        longer = [((*choice, e), p * e.probability) for choice, p in choices for e in group]
        choices = ranked(longer, lambda choice: math.log(choice[1]))[:JOINED]
    for choice, p in choices:
        if p < LEAST * choices[0][1]:
            continue
        name = "; ".join(f"{equation}: {e.name}" for equation, e in zip(each, choice, strict=True))
        sigma = {equation: value for e in choice for equation, value in e.sigma.items()}
        slugs = tuple(slug for e in choice for slug in e.slugs)
        found.append(Explained(name, p, slugs, _product([e.components for e in choice]), sigma))
    return tuple(ranked(found, lambda e: math.log(e.probability)))


def _told(name: str, p: float, weighed: Weighed, items: Sequence[tuple[World, Explanation, float]]) -> Explained:
    """One explanation by its likeliest variants: other suspects, another noise, f or a law beside it.

    Nothing is predicted where most of the probability is of a rest that remembers, or of a process in time.
    """
    slugs = tuple(items[0][0].evaluations.name(i) for i in items[0][1].effects)
    told = [(w, e, q) for w, e, q in items if q > 0 and _predicts(weighed, w, e)]
    if not told or 2 * sum(q for *_, q in told) < sum(q for *_, q in items):
        return Explained(name, p, slugs)
    told = _different(told)[:VARIANTS]
    total = sum(q for *_, q in told)
    components: list[Component] = []
    sigma = 0.0
    for world, e, q in told:
        parts, noise = _components(weighed, world, e)
        components += [replace(each, weight=each.weight * q / total) for each in parts]
        sigma += noise * q / total
    weights, places = systematic(np.array([c.weight for c in components]), COMPONENTS)
    kept = tuple(replace(components[i], weight=float(w)) for w, i in zip(weights, places, strict=True))
    return Explained(name, p, slugs, kept, {told[0][0].evaluations.statistics.equation: sigma})


def _different(
    items: Sequence[tuple[World, Explanation, float]],
) -> list[tuple[World, Explanation, float]]:
    """Variants, likeliest first; those that differ in values of inner parameters alone are one, with their sum.

    Each of them is weighed at one value, and the mixture that stands for all of them goes over all values.
    """
    found: dict[tuple, tuple[World, Explanation, float]] = {}
    for world, e, q in items:
        called = sorted(world.evaluations.statistics.columns[i].called for i in (*e.effects, *e.memory))
        # What is beside f has no such mixture: each value of it is a variant of its own.
        own = e.effects if e.kind == REST else tuple(called)
        key = (id(world), e.kind, e.suspects, own)
        likeliest, before = found[key][1:] if key in found else (e, 0.0)
        found[key] = (world, likeliest, before + q)
    return ranked(found.values(), lambda item: math.log(item[2]))


def _predicts(weighed: Weighed, world: World, e: Explanation) -> bool:
    return bool(e.effects) or e.kind in (REST, LAWFUL) or weighed.kind(world, e) in PREDICTING


def _components(weighed: Weighed, world: World, e: Explanation) -> tuple[list[Component], float]:
    """The mixture of one variant, and its noise standard deviation, user's units."""
    statistics = world.evaluations.statistics
    equation = statistics.equation
    if e.kind == REST:
        rests = nameless(world, e)
        found = [
            Component(f.weight, (equation,) * len(f.terms), f.terms, f.mean, f.root, {equation: f.features})
            for f in rests
        ]
        return found, sum(f.weight * f.sigma for f in rests)
    kind = weighed.kind(world, e)
    # A law that is in no catalogue is a column as an effect is.
    law = e.memory if e.kind == LAWFUL else ()
    given = conditional(
        world.evaluations, (*e.effects, *law), e.suspects,
        some=not e.effects and kind == "recalibrate", none=not e.effects and kind == "no gap",
    )  # fmt: skip
    weights, places = systematic(np.array([c.weight for c in given]), COMPONENTS)
    found, sigma = [], 0.0
    for weight, place in zip(weights, places, strict=True):
        one = given[place]
        columns = [statistics.columns[i] for i in one.indices]
        scale = np.array([statistics.target_scale / column.scale for column in columns])
        values, vectors = np.linalg.eigh(one.covariance)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T * scale
        alive = np.flatnonzero((one.mean != 0) | np.any(root != 0, axis=0))
        root = root[np.any(root != 0, axis=1)][:, alive]
        # As text: what a file gives back is then the same.
        formulas = [columns[i].formula.plain for i in alive]
        terms = tuple(replace(formula, expression=formula.text) for formula in formulas)
        found.append(Component(float(weight), (equation,) * len(alive), terms, (one.mean * scale)[alive], root))
        sigma += weight * one.sigma * statistics.target_scale
    return found, float(sigma)


def _product(parts: Sequence[Sequence[Component]]) -> tuple[Component, ...]:
    """Components of independent mixtures together; none where one of them predicts nothing."""
    found, *others = (tuple(part) for part in parts)
    for part in others:
        # One equation after another: all choices of eight components each would be millions.
        choices = list(product(found, part))
        if not choices:
            return ()
        # In an order that has nothing to do with either: every n-th of a table row by row is of one column.
        choices = [choices[i] for i in np.random.default_rng(0).permutation(len(choices))]
        weights, places = systematic(np.array([a.weight * b.weight for a, b in choices]), COMPONENTS)
        found = tuple(_beside(weight, choices[place]) for weight, place in zip(weights, places, strict=True))
    return found


def _beside(weight: float, choice: Sequence[Component]) -> Component:
    root = np.asarray(block_diag(*(component.root for component in choice)))
    ends = np.cumsum([len(component.mean) for component in choice])
    begins = ends - [len(component.mean) for component in choice]
    terms = [np.arange(b, b + len(c.terms)) for b, c in zip(begins, choice, strict=True)]
    features = [np.arange(b + len(c.terms), e) for b, e, c in zip(begins, ends, choice, strict=True)]
    order = np.concatenate([*terms, *features])
    return Component(
        float(weight),
        tuple(name for component in choice for name in component.equations),
        tuple(term for component in choice for term in component.terms),
        np.concatenate([c.mean for c in choice])[order],
        root[:, order],
        {name: each for component in choice for name, each in component.features.items()},
    )
