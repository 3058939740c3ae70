"""The best that anybody could do: a classifier that knows the noise, the simulation, and how the cases are made.

It knows σ, all true coefficients of the simulation, that exactly one effect of the catalogue or none is hidden, and
the distribution that the cases of the family "catalogue" are drawn from: every effect as likely as any other, the sign
either way, the ratio and the nonlinear parameter by their own laws. With e the measured derivative less the simulation
and φ an effect at unit RMS, e = ± r σ φ + ε, so that

    log p(e | effect, sign, r) - log p(e | none) = ± r b - r² N / 2,   b = φᵀe / σ,

which is integrated over r, over the nonlinear parameter and over both signs. Nothing can name effects more often right
on average over such cases, or separate more of them.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from benchmarks.hidden_effects.cases import NULLS, RATIO_EDGES, ratio_density
from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.hidden import ADDED, CATALOGUE, Hidden
from benchmarks.hidden_effects.systems.hosts import term_value
from benchmarks.hidden_effects.systems.trajectories import rms

Oracle = Callable[["CaseData"], Mapping[str, Any]]
"""Function from the data of a case to entries of its record: "oracle", probabilities by name, best first; "visible",
the size of the hidden effect over the standard error that it would have, where that is not its ratio to a rate's
noise."""

NONE = "none"
"""Name of the hypothesis that nothing is hidden."""

RATIO_NODES = 96
"""Gauss-Legendre nodes over the ratio, on each of its ranges."""

REACH = 12.0
"""Half-width of the integration over the ratio, in standard deviations given everything else."""

INNER_NODES = 200
"""Nodes over a nonlinear parameter's whole range, and again around the best of them."""

FINE_ENOUGH, ZOOMS = 1.0, 4
"""Nats between the best node and its neighbours up to which a nonlinear parameter's grid is fine, and how often it is
refined."""

OWN = 1e-9
"""An effect is the simulation's own if less than this share of its mean square lies outside the span of its terms."""


def candidates(data: CaseData, joined: bool = False) -> dict[str, Hidden]:
    """Return effects that the host has the roles for and that are not in its simulation already, by slug.

    With those that have `joined` the catalogue later, in `hidden.ADDED`, if asked.
    """
    own = own_terms(data)
    kept = {}
    domain = data.host.domain
    for slug, effect in {**CATALOGUE[domain], **(ADDED[domain] if joined else {})}.items():
        if effect.fits(data.host):
            value = effect_values(data, effect, inner_nodes(data, effect, 1))[0]
            if rms(_outside(value, own)) ** 2 > OWN * rms(value) ** 2:
                kept[slug] = effect
    return kept


def ask(data: CaseData) -> dict[str, Any]:
    """Return the probabilities as "oracle"."""
    return {"oracle": posterior(data)}


def posterior(data: CaseData) -> dict[str, float]:
    """Return probabilities of "none" and of each candidate effect, best first."""
    return weighed({slug: log_evidence(data, effect) for slug, effect in candidates(data).items()})


def weighed(evidence: Mapping[str, float]) -> dict[str, float]:
    """Return probabilities of "none" and of effects, best first, by the log evidence of each over that of none."""
    # The prior of "none" is its share among the benchmark's cases of one effect or none.
    none = NULLS / (NULLS + 4 * sum(len(entries) for entries in CATALOGUE.values()))
    logs = {NONE: float(np.log(none))}
    logs |= {slug: float(np.log((1.0 - none) / len(evidence)) + value) for slug, value in evidence.items()}
    total = float(np.asarray(logsumexp(list(logs.values()))))
    return {name: float(np.exp(logs[name] - total)) for name in sorted(logs, key=lambda name: -logs[name])}


def log_evidence(data: CaseData, effect: Hidden) -> float:
    """Return the logarithm of p(e | effect) over p(e | none)."""
    residual = data.residual(true_coefficients=True) / data.sigma

    def logs_of(nodes: np.ndarray) -> np.ndarray:
        values = effect_values(data, effect, nodes)
        b = values @ residual / np.sqrt(np.mean(values**2, axis=1))
        return over_ratio(b, np.full(len(b), values.shape[1]), data.case.noise)

    return over_inner(data, effect, logs_of)


def over_inner(
    data: CaseData, effect: Hidden, logs_of: Callable[[np.ndarray], np.ndarray], count: int = INNER_NODES
) -> float:
    """Return the log of an evidence integrated over the prior of an effect's nonlinear parameter, if it has one.

    Log evidences at values of the nonlinear parameter are those of `logs_of`, at so many nodes over its range, and
    again around the best of them.
    """
    nodes = inner_nodes(data, effect, count)
    logs = logs_of(nodes[:1] if effect.inner is None else nodes)
    if effect.inner is None:
        return float(logs[0])
    # A large effect fixes its nonlinear parameter better than the first nodes can show.
    for _ in range(ZOOMS):
        best = int(np.argmax(logs))
        around = np.geomspace(nodes[max(0, best - 2)], nodes[min(len(nodes) - 1, best + 2)], count)
        order = np.argsort(np.concatenate([nodes, around]))
        nodes, logs = (np.concatenate(pair)[order] for pair in ((nodes, around), (logs, logs_of(around))))
        best = int(np.argmax(logs))
        if np.max(logs[best] - logs[max(0, best - 1) : best + 2]) < FINE_ENOUGH:
            break
    place = np.log(nodes)
    # Trapezoidal rule; the prior is uniform in the logarithm.
    width = np.diff(place, prepend=place[0]) + np.diff(place, append=place[-1])
    used = width > 0
    return float(np.asarray(logsumexp(logs[used], b=width[used] / 2 / (place[-1] - place[0]))))


def nearest(data: CaseData) -> tuple[str, float]:
    """Return the candidate that comes nearest to the gap, and the share of its mean square that it explains.

    Both are taken without noise and beside free coefficients of the simulation's own terms.
    """
    own = own_terms(data)
    gap = _outside(data.gap(), own)
    best, share = NONE, 0.0
    for slug, effect in candidates(data).items():
        for value in effect_values(data, effect, inner_nodes(data, effect, 60)):
            shape = _outside(value, own)
            explained = (shape @ gap) ** 2 / (shape @ shape) / (gap @ gap)
            if explained > share:
                best, share = slug, float(explained)
    return best, share


def own_terms(data: CaseData) -> Float[np.ndarray, "n_obs n_term"]:
    """Return the simulation's terms in the studied equation, on the training data."""
    columns = data.measured()
    n_obs = len(columns["t"])
    return np.column_stack([np.broadcast_to(term_value(t, columns), n_obs) for t in data.true_rates[data.equation]])


def inner_nodes(data: CaseData, effect: Hidden, count: int) -> Float[np.ndarray, " n_node"]:
    """Return values of an effect's nonlinear parameter, evenly spaced in the logarithm; one alone is in the middle."""
    if effect.inner is None:
        return np.array([np.nan])
    given = effect.inner
    column = data.measured()["t" if given.role == "t" else data.host.roles[given.role]]
    low, high = np.log(given.low), np.log(given.high)
    fractions = np.linspace(low, high, count) if count > 1 else np.array([(low + high) / 2])
    return np.exp(fractions) * float(np.max(np.abs(column)))


def effect_values(
    data: CaseData, effect: Hidden, inner: Float[np.ndarray, " n_node"]
) -> Float[np.ndarray, "n_node n_obs"]:
    """Return an effect on the training data, for each value of its nonlinear parameter."""
    columns = data.measured()
    roles = {**data.host.in_roles(columns), "t": columns["t"]}
    return np.broadcast_to(effect.value(roles, inner[:, None]), (len(inner), len(columns["t"])))


def _outside(values: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return the part of (rows of) values outside the span of the columns of `own`."""
    basis = np.linalg.qr(own / np.linalg.norm(own, axis=0))[0]
    return values - (values @ basis) @ basis.T


def over_ratio(
    b: Float[np.ndarray, " n_node"], n: Float[np.ndarray, " n_node"], noise: float
) -> Float[np.ndarray, " n_node"]:
    """Return the log of the integral of exp(± r b - r² n / 2) over the prior of the ratio r and of the sign.

    Args:
        b: Product of the effect at a ratio of one with the residual, in units of their noise.
        n: Square of the effect.
        noise: Noise of the case, which the prior of r depends on.
    """
    x, w = np.polynomial.legendre.leggauss(RATIO_NODES)
    parts = []
    for low, high in pairwise(RATIO_EDGES):
        density = float(ratio_density(noise, np.log([low * high]) / 2)[0])
        if density == 0.0:
            continue
        for sign in (-1.0, 1.0):
            centre = np.clip(sign * b / n, low, high)
            start, stop = (np.clip(centre + side * REACH / np.sqrt(n), low, high) for side in (-1.0, 1.0))
            r = (start + stop)[:, None] / 2 + (stop - start)[:, None] / 2 * x
            weight = w * (stop - start)[:, None] / 2 * density / r / 2
            parts.append(logsumexp(sign * r * b[:, None] - r**2 * n[:, None] / 2, b=weight, axis=1))
    return np.asarray(logsumexp(np.stack(parts), axis=0))
