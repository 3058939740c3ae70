"""Problems with published results: the systems, their noisy samples, and what others found.

They are those of the first experiment of Tronarp, Bosch & Hennig 2022, "Fenrir: Physics-Enhanced Regression for Initial
Value Problems", ICML (arXiv 2202.01287), as its code has them (github.com/nathanaelbosch/fenrir-experiments:
src/odin_problems.jl, experiments/1/run_fenrir.jl and run_rk.jl): both states measured, starts unknown, 100 draws of the
noise. The published figures are the medians of ‖p̂ − p‖/‖p‖ over the 100 lines of each file of experiments/1/results
there. Its methods begin at parameters |N(0, 1)|, at the first sample, and keep parameters within [0, 100].
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories

LARGEST_PARAMETER = 100.0
"""Parameters lie between zero and this, as for all published methods."""

EFFICIENT_DRAWS = 100_000
"""Draws behind the median of an efficient estimator."""

SENSITIVITY_STEP = 1e-5
"""Step of differences of samples by parameters."""


@dataclass(frozen=True)
class Problem:
    """A system whose parameters are sought.

    Attributes:
        name: Name of the system.
        parameters: The true ones by name.
        starts: The true ones by state.
        time: Sampling times.
        rates: Rates of the states from states and parameters, for the integrator that makes the samples.
        dictionary: Terms by learned state.
        coefficients: Coefficients of the terms, in order, from the parameters.
        inverse: Parameters from coefficients, of which there may be more: a first guess.
    """

    name: str
    parameters: Mapping[str, float]
    starts: Mapping[str, float]
    time: Float[np.ndarray, " n_time"]
    rates: Callable[[np.ndarray, np.ndarray], list[float]]
    dictionary: Mapping[str, tuple[str, ...]]
    coefficients: Callable[[np.ndarray], np.ndarray]
    inverse: Callable[[np.ndarray], np.ndarray]

    @property
    def truth(self) -> Float[np.ndarray, " n_parameter"]:
        """The true parameters."""
        return np.array(list(self.parameters.values()))

    @cached_property
    def exact(self) -> Float[np.ndarray, "n_state n_time"]:
        """The true states."""
        return self.states(self.truth, np.array(list(self.starts.values())))

    def states(self, parameters: np.ndarray, starts: np.ndarray) -> Float[np.ndarray, "n_state n_time"]:
        """Integrate the states to the sampling times, to nine digits."""
        return solve_ivp(
            lambda t, x: self.rates(x, parameters), (self.time[0], self.time[-1]), starts, method="DOP853",
            t_eval=self.time, rtol=1e-10, atol=1e-10,
        ).y  # fmt: skip


@dataclass(frozen=True)
class OdeCell:
    """A problem with noise, and the medians that others found.

    Attributes:
        problem: The problem.
        variance: Variance of the noise of each sample.
        published: Median error by method.
    """

    problem: Problem
    variance: float
    published: Mapping[str, float]

    @property
    def key(self) -> str:
        """Name of the cell in results."""
        return f"{self.problem.name}, variance {self.variance:g}"

    @property
    def best(self) -> float:
        """The least published median."""
        return min(self.published.values())

    def samples(self, draw: int, seed: int = 0) -> Trajectories:
        """Sample the states with a draw of the noise; the same numbers give the same draw."""
        problem, exact = self.problem, self.problem.exact
        noise = np.random.default_rng((seed, draw)).standard_normal(exact.shape)
        return Trajectories.from_arrays(
            problem.time, states=dict(zip(problem.starts, exact + np.sqrt(self.variance) * noise, strict=True))
        )

    def error(self, parameters: Float[np.ndarray, " n_parameter"]) -> float:
        """Return the relative error ‖p̂ − p‖/‖p‖."""
        truth = self.problem.truth
        return float(np.linalg.norm(parameters - truth) / np.linalg.norm(truth))

    @cached_property
    def efficient(self) -> float:
        """Median error of p̂ ~ N(p, C), C the bound of Cramér and Rao with unknown starts: the least without a bias."""
        truth, starts = self.problem.truth, np.array(list(self.problem.starts.values()))
        both, n = np.concatenate([truth, starts]), len(truth)

        def sampled(at: np.ndarray) -> np.ndarray:
            return self.problem.states(*np.split(at, [n])).ravel()

        J = np.column_stack([sampled(both + h) - sampled(both - h) for h in SENSITIVITY_STEP * np.eye(len(both))]) / (
            2 * SENSITIVITY_STEP
        )
        C = self.variance * np.linalg.inv(J.T @ J)[:n, :n]
        drawn = np.random.default_rng(0).multivariate_normal(truth, C, EFFICIENT_DRAWS)
        return float(np.median(np.linalg.norm(drawn - truth, axis=1)) / np.linalg.norm(truth))


LOTKA_VOLTERRA = Problem(
    name="Lotka-Volterra",
    parameters={"alpha": 2.0, "beta": 1.0, "delta": 4.0, "gamma": 1.0},
    starts={"x": 5.0, "y": 3.0},
    time=np.linspace(0.0, 2.0, 21),
    rates=lambda x, p: [p[0] * x[0] - p[1] * x[0] * x[1], -p[2] * x[1] + p[3] * x[0] * x[1]],
    dictionary={"x": ("x", "x*y"), "y": ("y", "x*y")},
    coefficients=lambda p: p * np.array([1, -1, -1, 1]),
    inverse=lambda theta: theta * np.array([1, -1, -1, 1]),
)
"""ẋ = αx − βxy, ẏ = −δy + γxy: coefficients are parameters, but for signs."""

FITZHUGH_NAGUMO = Problem(
    name="FitzHugh-Nagumo",
    parameters={"a": 0.2, "b": 0.2, "c": 3.0},
    starts={"v": -1.0, "r": 1.0},
    time=np.linspace(0.0, 10.0, 20),
    rates=lambda x, p: [p[2] * (x[0] - x[0] ** 3 / 3 + x[1]), -(x[0] - p[0] + p[1] * x[1]) / p[2]],
    dictionary={"v": ("v - v**3/3 + r",), "r": ("v", "1", "r")},
    coefficients=lambda p: np.array([p[2], -1 / p[2], p[0] / p[2], -p[1] / p[2]]),
    inverse=lambda theta: np.array([theta[2] * theta[0], -theta[3] * theta[0], theta[0]]),
)
"""v̇ = c(v − v³/3 + r), ṙ = −(v − a + br)/c: four coefficients c, −1/c, a/c and −b/c of three parameters."""

CELLS = (
    OdeCell(LOTKA_VOLTERRA, 0.01, {"Runge-Kutta": 0.0340, "ODIN": 0.0454, "Fenrir": 0.0294}),
    OdeCell(LOTKA_VOLTERRA, 0.25, {"Runge-Kutta": 0.1594, "ODIN": 0.1815, "Fenrir": 0.1561}),
    OdeCell(FITZHUGH_NAGUMO, 0.005, {"Runge-Kutta": 0.0149, "ODIN": 0.0467, "Fenrir": 0.0172}),
    OdeCell(FITZHUGH_NAGUMO, 0.05, {"Runge-Kutta": 0.0523, "ODIN": 0.1579, "Fenrir": 0.0447}),
)
"""The four cells."""
