"""The classical competitor: the experiment whose rows make the determinant of the coefficients' information largest.

The model has the terms of all explanations of a tie together, which is linear in its coefficients. Its information is
M = ΦᵀΦ / σ², of the record and of an experiment the sum, and D-optimal is the experiment with the largest |M| (Fedorov
1972, Theory of Optimal Experiments, 2.2; with a record that is there, 3.3). Φ of an experiment is along the path that
this model takes at the posterior mean: each coefficient's, by the probabilities of the explanations.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import qr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.explained import PREDICTING, Explained
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.physics.integration.side_by_side import side_by_side, stage_times
from bayes_greybox.physics.terms import Term
from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.hosts import term_value

STEPS_A_SAMPLE = 8
"""Steps between two samples."""

LOST_AT = 1e3
"""A run has failed once a state is so many times its largest value in the record."""

SAME = 1e-6
"""A column that others give but for this share of its length is left out: the determinant would be zero."""


class Encompassing(NamedTuple):
    """The model with the terms of all explanations.

    Attributes:
        terms: Each once.
        mean: Means of their coefficients; a term counts as zero where an explanation is without it.
    """

    terms: tuple[Term, ...]
    mean: Float[np.ndarray, " n_term"]


def encompassing(explanations: Sequence[Explained]) -> Encompassing:
    """Return the model with the terms of all explanations, at the likeliest value of a nonlinear parameter of each."""
    known = [e for e in explanations if e.components and (e.slugs or e.name in PREDICTING)]
    total = sum(e.probability for e in known)
    terms: dict[str, Term] = {}
    mean: dict[str, float] = {}
    for e in known:
        likeliest = max(e.components, key=lambda c: c.weight)
        # Behind the terms' come the coefficients of f.
        for term, value in zip(likeliest.terms, likeliest.mean[: len(likeliest.terms)].tolist(), strict=True):
            key = str(term.expression)
            terms.setdefault(key, term)
            mean[key] = mean.get(key, 0.0) + e.probability / total * value
    return Encompassing(tuple(terms.values()), np.array([mean[key] for key in terms]))


def log_determinants(
    data: CaseData, record: Trajectories, explanations: Sequence[Explained], candidates: Sequence[Candidate]
) -> Float[np.ndarray, " n_candidate"]:
    """Return the log determinant of the information after each candidate, up to a constant; −∞ where its run fails.

    Of the case only the simulation and the columns' meanings are used, which a user gives.
    """
    model = encompassing(explanations)
    measured = _columns(model.terms, {"t": record.time, **record.columns})
    size = np.sqrt(np.mean(measured**2, axis=0))
    size = np.where(size > 0, size, 1.0)
    tables = [None if p is None else _columns(model.terms, p) / size for p in _paths(data, record, model, candidates)]
    stacked = np.vstack([measured / size, *(t for t in tables if t is not None)])
    # With pivots the columns come in an order in which each adds most to those before.
    R, order = qr(stacked, mode="r", pivoting=True)  # pyright: ignore[reportAssignmentType]
    diagonal = np.abs(np.diag(R))
    kept = np.sort(order[: int(np.sum(diagonal > SAME * diagonal[0]))])
    M = (measured / size)[:, kept].T @ (measured / size)[:, kept]
    return np.array([-np.inf if t is None else _log_determinant(M + t[:, kept].T @ t[:, kept]) for t in tables])


def _log_determinant(M: Float[np.ndarray, "n n"]) -> float:
    sign, value = np.linalg.slogdet(M)
    return float(value) if sign > 0 else -np.inf


def _columns(terms: Sequence[Term], columns: Mapping[str, Any]) -> Float[np.ndarray, "n_row n_term"]:
    n = len(columns["t"])
    return np.stack([np.broadcast_to(np.asarray(term.evaluate(columns), float), n) for term in terms], axis=-1)


def _paths(
    data: CaseData, record: Trajectories, model: Encompassing, candidates: Sequence[Candidate]
) -> list[dict[str, np.ndarray] | None]:
    """Return columns of each candidate's run; None of one that fails."""
    names, inputs = data.host.states, data.host.inputs
    limit = np.array([LOST_AT * (float(np.max(np.abs(record.states[name]))) or 1.0) for name in names])
    rate, found = _rate(data, record, model), {}
    # Side by side where they are sampled at the same times.
    for length in {(each.duration, each.rows) for each in candidates}:
        places = [i for i, each in enumerate(candidates) if (each.duration, each.rows) == length]
        times = candidates[places[0]].times
        stages = stage_times(times, STEPS_A_SAMPLE)
        u = np.zeros((len(places), len(stages), len(inputs)))
        for k, i in enumerate(places):
            for j, name in enumerate(inputs):
                u[k, :, j] = candidates[i].inputs[name].value(stages)
        starts = np.array([[[candidates[i].start[name] for name in names]] for i in places], float)
        for i, path in zip(places, side_by_side(rate, starts, times, u, limit)[:, 0], strict=True):
            columns = {"t": times, **dict(zip(names, path.T, strict=True))}
            columns |= {name: candidates[i].inputs[name].value(times) for name in inputs}
            found[i] = columns if np.all(np.isfinite(path)) else None
    return [found[i] for i in range(len(candidates))]


def _rate(data: CaseData, record: Trajectories, model: Encompassing) -> Callable[..., np.ndarray]:
    states, inputs = data.host.states, data.host.inputs
    place = states.index(data.equation)
    # An integrator cannot stay on a jump.
    terms = [term.rounded(record.columns) for term in model.terms]

    def rate(x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
        columns: dict[str, Any] = {"t": np.full(x.shape[:2], t), **{name: x[..., i] for i, name in enumerate(states)}}
        columns |= {name: np.broadcast_to(u[..., i], x.shape[:2]) for i, name in enumerate(inputs)}
        found = np.zeros_like(x)
        for i, name in enumerate(states):
            for text, value in data.given_rates[name].items():
                found[..., i] += value * term_value(text, columns)
        for term, value in zip(terms, model.mean.tolist(), strict=True):
            found[..., place] += value * term.evaluate(columns)
        return found

    return rate
