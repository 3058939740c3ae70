"""Data that all contenders are given: rates of one state, and terms for them in scaled units. Knows no sampler."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

SPEED_NOISE = 0.02
"""Standard deviation of the noise, as a share of that of the rate."""

INTEGRATED = 20_000
"""Rows up to which the oscillator is integrated to each; more lie on splines through as many."""

OSCILLATOR_POWERS = ((1, 0), (0, 1), (2, 0), (0, 2), (3, 0), (0, 3))
"""Powers of y and ydot: the terms of the oscillator."""

MISSING = (3, 0)
"""The term that an incomplete dictionary lacks."""

BOX_COEFFICIENTS = (-1.0, -0.5, 0.3)
"""Coefficients of the first, the middle and the last term in the box."""

BOX_STATES = ("a", "b", "c", "d")
"""Names of the states in the box."""

COMPLETE, PARTIAL, BOX = "complete", "partial", "box"
"""Kinds of problems: the oscillator with all its terms, or without one; random states in a box."""


@dataclass(frozen=True)
class Problem:
    """A problem.

    Attributes:
        kind: `COMPLETE`, `PARTIAL` or `BOX`.
        n_obs: Rows N.
        n_term: Terms K.
        n_var: Variables d that f depends on.
    """

    kind: str
    n_obs: int
    n_term: int = len(OSCILLATOR_POWERS)
    n_var: int = 2

    @property
    def name(self) -> str:
        """Name that tells it from others."""
        return f"{self.kind} N={self.n_obs} K={self.n_term} d={self.n_var}"


class Scaled(NamedTuple):
    """Rows in scaled units: columns of Φ and y have unit RMS, x lies in [−1, 1]^d."""

    Phi: Float[np.ndarray, "n_obs n_term"]
    x: Float[np.ndarray, "n_obs n_var"]
    y: Float[np.ndarray, " n_obs"]


@dataclass(frozen=True, eq=False)
class Data:
    """Rates of one state at all states.

    Attributes:
        problem: Problem that they belong to.
        columns: States by name.
        equation: The state whose rate was measured.
        rate: Measured rate.
        time: Time stamps.
    """

    problem: Problem
    columns: Mapping[str, Float[np.ndarray, " n_obs"]]
    equation: str
    rate: Float[np.ndarray, " n_obs"]
    time: Float[np.ndarray, " n_obs"]

    @property
    def formulas(self) -> list[str]:
        """The terms, as formulas of the columns."""
        return [_formula(powers, tuple(self.columns), self.problem.kind == BOX) for powers in degrees(self.problem)]

    def scaled(self) -> Scaled:
        """Return the same numbers for samplers that have no formulas."""
        states = np.column_stack([*self.columns.values()])
        low, high = states.min(axis=0), states.max(axis=0)
        Phi = terms(self.problem, states)
        Phi /= np.sqrt(np.mean(Phi**2, axis=0))
        x = (states - 0.5 * (low + high)) / (0.5 * (high - low))
        return Scaled(Phi, x, self.rate / np.sqrt(np.mean(self.rate**2)))


def problems() -> list[Problem]:
    """Return all problems of the table, those at a thousand rows first; then by rows, by terms, by variables."""
    return [
        Problem(COMPLETE, 1000),
        Problem(PARTIAL, 1000, len(OSCILLATOR_POWERS) - 1),
        *(Problem(COMPLETE, 10**power) for power in (2, 4, 5, 6, 7)),
        *(Problem(BOX, 1000, n_term) for n_term in (6, 20, 50)),
        *(Problem(BOX, 1000, 6, n_var) for n_var in (1, 3, 4)),
    ]


def measured(problem: Problem, seed: int) -> Data:
    """Return the data of a problem; the seed is that of states in the box, and of the noise."""
    if problem.kind != BOX:
        # Imported here: it brings JAX.
        from bayes_greybox.physics.experiments.systems import oscillator

        system, time = oscillator(), np.linspace(0.0, 100.0, problem.n_obs)
        if problem.n_obs <= INTEGRATED:
            seen = system.simulate(t=time, noise=SPEED_NOISE, seed=seed)
            return Data(problem, seen.states, "ydot", seen.derivatives["ydot"], seen.time)
        path = system.simulate(t=np.linspace(0.0, 100.0, INTEGRATED))
        spline = CubicSpline(path.time, path.matrix(path.state_names))
        columns = dict(zip(path.state_names, np.ascontiguousarray(spline(time).T), strict=True))
        rate = np.array(system.rate(columns)[:, path.state_names.index("ydot")])
        rate += SPEED_NOISE * rate.std() * np.random.default_rng(seed).standard_normal(problem.n_obs)
        return Data(problem, columns, "ydot", rate, time)
    generator = np.random.default_rng(seed)
    states = generator.uniform(-1.0, 1.0, (problem.n_obs, problem.n_var))
    theta = np.zeros(problem.n_term)
    theta[[0, problem.n_term // 2, -1]] = BOX_COEFFICIENTS
    rate = terms(problem, states) @ theta
    rate += SPEED_NOISE * rate.std() * generator.standard_normal(problem.n_obs)
    names = BOX_STATES[: problem.n_var]
    return Data(problem, dict(zip(names, states.T, strict=True)), "a", rate, np.arange(problem.n_obs) * 1e-3)


def degrees(problem: Problem) -> list[tuple[int, ...]]:
    """Return degrees of each term in each variable; in the box the lowest ones in all, without the constant."""
    if problem.kind != BOX:
        return [powers for powers in OSCILLATOR_POWERS if problem.kind == COMPLETE or powers != MISSING]
    # All of the least total degree that has enough.
    most = next(m for m in count(1) if math.comb(m + problem.n_var, problem.n_var) > problem.n_term)
    low = [each for each in product(range(most + 1), repeat=problem.n_var) if 0 < sum(each) <= most]
    return sorted(low, key=lambda each: (sum(each), each))[: problem.n_term]


def terms(problem: Problem, states: Float[np.ndarray, "n_obs n_var"]) -> Float[np.ndarray, "n_obs n_term"]:
    """Return Φ in the units of the data: powers of the oscillator's states, or products of polynomials in the box.

    Legendre's are orthogonal over the box, which spares samplers of θ the correlations that they are slow with.
    """
    wanted = degrees(problem)
    most = max(max(each) for each in wanted)
    if problem.kind == BOX:
        # [n_obs, n_var, degree]
        powers = np.polynomial.legendre.legvander(states, most)
    else:
        powers = states[..., None] ** np.arange(most + 1)
    return np.column_stack([np.prod([powers[:, d, k] for d, k in enumerate(each)], axis=0) for each in wanted])


def _formula(powers: tuple[int, ...], names: tuple[str, ...], legendre: bool) -> str:
    factors = []
    for name, degree in zip(names, powers, strict=True):
        if not degree:
            continue
        coefficients = np.polynomial.legendre.leg2poly([0.0] * degree + [1.0]) if legendre else np.eye(degree + 1)[-1]
        parts = [_part(float(c), name, k) for k, c in enumerate(coefficients) if c]
        factors.append(parts[0] if len(parts) == 1 else f"({' + '.join(parts)})")
    return "*".join(factors)


def _part(coefficient: float, name: str, power: int) -> str:
    if not power:
        return repr(coefficient)
    raised = name if power == 1 else f"{name}**{power}"
    return raised if coefficient == 1.0 else f"{coefficient!r}*{raised}"
