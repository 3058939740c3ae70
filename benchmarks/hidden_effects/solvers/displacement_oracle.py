"""The best that anybody could do with a displacement: the classifier of `oracle`, on samples of the position.

It knows all that the other one knows, and the true path y* with the effect φ* at its coefficient θ* besides, but not
where the path started. Another effect φ with the coefficient θ would have given, to first order,

    y ≈ y* − V φ* θ* + V φ θ + V₀ δ₀ + ε,

V the response of the position to a force and V₀ to the start, both by integrating the true system with a small force or
another start. With w what V φ gives at a ratio of one beside all starts, over the noise, the rest is as there:
log p(y | φ, sign, r) − log p(y | none) = ± r wᵀz − r² wᵀw / 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.hidden import Hidden
from benchmarks.hidden_effects.systems.ode import Acting, HostODE, paths
from benchmarks.hidden_effects.systems.trajectories import rms

from .displacement import displacement
from .oracle import candidates, effect_values, over_inner, over_ratio, weighed

SMALL_FORCE = 1e-4
"""RMS of a small force over that of the rate, and of another start over the spread of its state."""

NODES = 10
"""Nodes over a nonlinear parameter's range, and again around the best of them."""


def ask(data: CaseData, noise: float) -> dict[str, Any]:
    """Return the oracle's answer by samples of the position, with noise over its spread; see `oracle.Oracle`."""
    samples, place = displacement(data, noise)[0], data.host.roles["position"]
    return seen(data, samples.states[place], noise * float(np.std(data.train.states[place])))


def seen(data: CaseData, samples: Float[np.ndarray, " n_obs"], sigma: float) -> dict[str, Any]:
    """Return the oracle's answer by the samples of a position.

    Args:
        data: Data of the case.
        samples: Samples of the position, of all runs of the training data.
        sigma: Standard deviation of their noise.

    Returns:
        "oracle", probabilities of "none" and of each candidate, best first; "visible", the true coefficient over the
        standard error that it would have, the path and all else but starts known; NaN where nothing is hidden.
    """
    assert data.ode is not None
    place = data.host.roles["position"]
    error = samples - data.exact["train"].columns[place]
    starts = np.linalg.qr(_to_starts(data) / sigma)[0]

    def beside(columns: np.ndarray) -> np.ndarray:
        return columns - starts @ (starts.T @ columns)

    scale = data.sigma
    truth = sum((act.coefficient * _responses(data, [act])[:, 0] for act in data.ode.acting), np.zeros(len(samples)))
    z = beside((error + truth) / sigma)
    visible = float(np.linalg.norm(beside(truth / sigma))) if data.ode.acting else float("nan")

    def log_evidence(effect: Hidden) -> float:
        def logs_of(nodes: np.ndarray) -> np.ndarray:
            size = np.sqrt(np.mean(effect_values(data, effect, nodes) ** 2, axis=1))
            w = beside(_responses(data, [Acting(effect, 1.0, float(v)) for v in nodes]) * (scale / size) / sigma)
            return over_ratio(w.T @ z, np.sum(w**2, axis=0), data.case.noise)

        return over_inner(data, effect, logs_of, NODES)

    evidence = {slug: log_evidence(effect) for slug, effect in candidates(data).items()}
    return {"oracle": weighed(evidence), "visible": visible}


def _responses(data: CaseData, forces: Sequence[Acting]) -> Float[np.ndarray, "n_obs n_force"]:
    """Return V φ of each force, by central differences of the true system with a little of it."""
    assert data.ode is not None
    rate = rms(data.exact["train"].rates[data.equation])
    sizes = [
        SMALL_FORCE * rate / max(rms(effect_values(data, f.effect, np.array([f.inner]))[0]), 1e-300) for f in forces
    ]
    up, down = (
        [replace(force, coefficient=side * size) for force, size in zip(forces, sizes, strict=True)]
        for side in (1.0, -1.0)
    )
    found = _nudged(data, [*up, *down])
    return (found[:, : len(up)] - found[:, len(up) :]) / (2 * np.array(sizes))


def _nudged(data: CaseData, nudges: Sequence[Acting]) -> Float[np.ndarray, "n_obs n_nudge"]:
    """Return the position with each of these forces beside the truth."""
    ode, excited = data.ode, data.excited["train"]
    assert ode is not None
    row = list(ode.rates).index(data.host.roles["position"])
    if any(act.effect.jump for act in ode.acting):
        # The integrator stops at jumps, which come at times of their own for every force.
        found = [
            paths(HostODE(ode.host, ode.rates, (*ode.acting, nudge)), excited.starts, excited.signal)[:, row].ravel()
            for nudge in nudges
        ]
        return np.stack(found, axis=1)
    many = Nudged(ode.host, ode.rates, ode.acting, nudges=tuple(nudges))
    starts, signal = np.repeat(excited.starts, len(nudges), axis=0), excited.signal
    repeated = None if signal is None else (lambda t: np.repeat(signal(t), len(nudges)))
    found = paths(many, starts, repeated)[:, row]
    return found.reshape(len(excited.starts), len(nudges), -1).swapaxes(1, 2).reshape(-1, len(nudges))


@dataclass(frozen=True)
class Nudged(HostODE):
    """Copies of a system side by side, each run's next to each other, every copy with a force of its own besides.

    Attributes:
        nudges: Forces of the copies.
    """

    nudges: tuple[Acting, ...] = ()

    @cached_property
    def alike(self) -> list[tuple[Hidden, list[int], np.ndarray, np.ndarray]]:
        """Copies with a force of the same effect, their coefficients and nonlinear parameters."""
        found = []
        for effect in dict.fromkeys(nudge.effect for nudge in self.nudges):
            own = [k for k, nudge in enumerate(self.nudges) if nudge.effect == effect]
            numbers = np.array([(self.nudges[k].coefficient, self.nudges[k].inner) for k in own])
            found.append((effect, own, *numbers.T))
        return found

    def rate(self, columns: Mapping[str, Any], memory: Any = 0.0) -> np.ndarray:
        """Return rates of all states of all copies."""
        rates, n = super().rate(columns, memory), len(self.nudges)
        # [n_run, n_copy]
        roles = {name: np.reshape(value, (-1, n)) for name, value in self.host.in_roles(columns).items()}
        rate = rates[list(self.rates).index(self.host.equation)].reshape(-1, n)
        for effect, own, coefficients, inner in self.alike:
            of_own = {name: value[:, own] for name, value in roles.items()}
            rate[:, own] += coefficients * effect.value({**of_own, "t": columns["t"]}, inner)
        return rates


def _to_starts(data: CaseData) -> Float[np.ndarray, "n_obs n_start"]:
    """Return V₀, the position's response to the start of every state of every run."""
    ode, excited, host = data.ode, data.excited["train"], data.host
    assert ode is not None
    row, columns = list(ode.rates).index(host.roles["position"]), []
    exact, n_run = data.exact["train"], len(excited.starts)
    for k, state in enumerate(host.states):
        h = SMALL_FORCE * float(np.std(exact.columns[state]))
        up, down = (
            paths(ode, excited.starts + side * h * np.eye(len(host.states))[k], excited.signal)[:, row]
            for side in (1.0, -1.0)
        )
        slope = (up - down) / (2 * h)
        columns += [np.where(np.arange(n_run)[:, None] == r, slope, 0.0).ravel() for r in range(n_run)]
    return np.stack(columns, axis=1)
