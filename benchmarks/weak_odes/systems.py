"""The systems, their samples and their candidate terms; by NumPy and SciPy alone, which know nothing of the package.

They are those of Messenger & Bortz 2021, "Weak SINDy: Galerkin-Based Data-Driven Model Selection", Multiscale Model.
Simul. 19:1474, Tables 1 and 2 and Figures 3.5 to 3.9, starts and parameters as in their code
(github.com/MathBioCU/WSINDy_ODE: gen_data.m, sim_ode.m): white noise of standard deviation ν ‖x‖_F/√(M D) on all D
states (Eq. 3.1); candidates are all monomials up to degree five, for the pendulum sin and cos of each state and of
twice it as well. The published errors are those in the captions of the figures, of one draw of the noise at ν = 0.1
each, found with the threshold ¼ min |w*|, which knows the smallest true coefficient.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.published_odes.problems import EFFICIENT_DRAWS

DEGREE = 5
"""Largest total degree of the monomials."""

NOISES = (0.1, 0.2, 0.4)
"""Levels ν of the noise."""

CHANGE = 1e-6
"""Step of differences of samples by coefficients and starts, over one and their size."""

Coefficients = Mapping[str, Mapping[str, float]]
"""By equation and term."""


@dataclass(frozen=True)
class WeakSystem:
    """A system of differential equations.

    Attributes:
        name: Name of the system.
        starts: Initial values by state.
        step: Time between samples.
        samples: Number of samples.
        columns: Values of the true terms of each equation at a point, in the order of `truth`.
        truth: Coefficients of the true terms.
        published: ‖ŵ − w*‖/‖w*‖ at 10 % noise.
        trigonometric: True if sines and cosines are candidates.
    """

    name: str
    starts: Mapping[str, float]
    step: float
    samples: int
    columns: Callable[[np.ndarray], list[list[float]]]
    truth: Coefficients
    published: float
    trigonometric: bool = False

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.starts)

    @property
    def time(self) -> Float[np.ndarray, " n"]:
        """Times of the samples."""
        return self.step * np.arange(self.samples)

    @property
    def candidates(self) -> list[str]:
        """Terms of each equation."""
        powers = [p for p in itertools.product(range(DEGREE + 1), repeat=len(self.states)) if sum(p) <= DEGREE]
        terms = [_monomial(self.states, p) for p in sorted(powers, key=sum)]
        if self.trigonometric:
            terms += [f"{f}({k}{name})" for f in ("sin", "cos") for k in ("", "2*") for name in self.states]
        return terms

    @cached_property
    def exact(self) -> Float[np.ndarray, "n n_state"]:
        """States at the times of the samples."""
        return self._solved(np.array([*self._values, *self.starts.values()]))

    def sampled(self, noise: float, replicate: int, seed: int) -> Trajectories:
        """Sample the states with a draw of the noise at a level ν."""
        # Systems share no noise: what is unlucky for one is not so for all.
        rng = np.random.default_rng([seed, replicate, round(1000 * noise), *self.name.encode()])
        sd = noise * np.sqrt(np.mean(self.exact**2))
        noisy = self.exact + sd * rng.standard_normal(self.exact.shape)
        return Trajectories.from_arrays(self.time, states=dict(zip(self.states, noisy.T, strict=True)))

    def error(self, found: Coefficients) -> float:
        """Return ‖ŵ − w*‖/‖w*‖ over all coefficients of all equations (Eq. 3.2)."""
        apart, size = 0.0, sum(b**2 for own in self.truth.values() for b in own.values())
        for name, own in self.truth.items():
            terms = {*own, *found.get(name, {})}
            apart += sum((found.get(name, {}).get(term, 0.0) - own.get(term, 0.0)) ** 2 for term in terms)
        return float(np.sqrt(apart / size))

    def true_positives(self, found: Coefficients) -> float:
        """Return TP/(TP + FN + FP), terms of all equations counted (Eq. A.1)."""
        true = {(name, term) for name, own in self.truth.items() for term in own}
        said = {(name, term) for name, own in found.items() for term in own}
        return len(true & said) / len(true | said)

    def efficient(self, noise: float) -> float:
        """Return the median error of ŵ ~ N(w, C), C Cramér and Rao's bound for known terms and unknown starts."""
        values, starts = self._values, np.array(list(self.starts.values()))
        both = np.concatenate([values, starts])
        steps = CHANGE * np.diag(np.maximum(1.0, np.abs(both)))
        J = np.column_stack([(self._solved(both + h) - self._solved(both - h)).ravel() / (2 * h.max()) for h in steps])
        variance = noise**2 * np.mean(self.exact**2)
        C = variance * np.linalg.inv(J.T @ J)[: len(values), : len(values)]
        drawn = np.random.default_rng(0).multivariate_normal(np.zeros(len(values)), C, EFFICIENT_DRAWS)
        return float(np.median(np.linalg.norm(drawn, axis=1)) / np.linalg.norm(values))

    @property
    def _values(self) -> Float[np.ndarray, " n_true"]:
        return np.array([b for own in self.truth.values() for b in own.values()])

    def _solved(self, both: Float[np.ndarray, " n_both"]) -> Float[np.ndarray, "n n_state"]:
        values, starts = np.split(both, [len(self._values)])
        parts = np.split(values, np.cumsum([len(own) for own in self.truth.values()])[:-1])

        def rates(t: float, x: np.ndarray) -> list[float]:
            return [float(np.dot(b, own)) for b, own in zip(parts, self.columns(x), strict=True)]

        return solve_ivp(
            rates, (0.0, self.time[-1]), starts, method="DOP853", t_eval=self.time, rtol=1e-10, atol=1e-10
        ).y.T


@cache
def weak_systems() -> dict[str, WeakSystem]:
    """Return all systems by name."""
    every = (
        WeakSystem(
            "duffing", {"x": 0.0, "y": 2.0}, 0.01, 3001,
            lambda x: [[x[1]], [x[1], x[0], x[0] ** 3]],
            {"x": {"y": 1.0}, "y": {"y": -0.2, "x": -0.2, "x**3": -1.0}}, 0.0075,
        ),
        WeakSystem(
            "van-der-pol", {"x": 0.0, "y": 1.0}, 0.01, 3001,
            lambda x: [[x[1]], [x[1], x[0] ** 2 * x[1], x[0]]],
            {"x": {"y": 1.0}, "y": {"y": 4.0, "x**2*y": -4.0, "x": -1.0}}, 0.0073,
        ),
        WeakSystem(
            "lotka-volterra", {"x": 1.0, "y": 1.0}, 0.01, 1001,
            lambda x: [[x[0], x[0] * x[1]], [x[0] * x[1], x[1]]],
            {"x": {"x": 3.0, "x*y": -1.0}, "y": {"x*y": 1.0, "y": -6.0}}, 0.0013,
        ),
        WeakSystem(
            "pendulum", {"x": 15 * np.pi / 16, "y": 0.0}, 0.1, 501,
            lambda x: [[x[1]], [np.sin(x[0])]],
            {"x": {"y": 1.0}, "y": {"sin(x)": -1.0}}, 0.0089, trigonometric=True,
        ),
        WeakSystem(
            "lorenz", {"x": -8.0, "y": 7.0, "z": 27.0}, 0.001, 10_001,
            lambda x: [[x[0], x[1]], [x[0], x[1], x[0] * x[2]], [x[2], x[0] * x[1]]],
            {"x": {"x": -10.0, "y": 10.0}, "y": {"x": 28.0, "y": -1.0, "x*z": -1.0}, "z": {"z": -8 / 3, "x*y": 1.0}},
            0.0084,
        ),
    )  # fmt: skip
    return {each.name: each for each in every}


def _monomial(names: tuple[str, ...], powers: tuple[int, ...]) -> str:
    factors = [name if k == 1 else f"{name}**{k}" for name, k in zip(names, powers, strict=True) if k]
    return "*".join(factors) or "1"
