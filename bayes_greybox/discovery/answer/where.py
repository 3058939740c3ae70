"""Where simulation and measurement disagree: the gap over states and along time, and a few readable regions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.special import ndtr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator, WithDiscrepancy
from bayes_greybox.model.estimate.evidence import Spectrum

GRID = 41
"""Points of a map along each variable."""

MOST_ROWS = 5000
"""Rows, evenly thinned, on which regions and windows are sought."""

CUTS = 19
"""Cut points tried along each variable, at even quantiles of the data."""

MOST_REGIONS, MOST_WINDOWS = 3, 5
"""Regions and windows reported at most."""

WINDOW = 40
"""A window lasts at least this part of a run's rows, so that noise does not cut it up."""


@dataclass(frozen=True)
class GapMap:
    """The gap over one or two variables, before and after the model was amended; the others at their median.

    Attributes:
        equation: The state whose rate is meant.
        variables: One or two variables.
        axes: Grid positions, user's units.
        before, after: Posterior mean of the gap [n_0, n_1] (or [n_0]), user's units.
        probability, after_probability: P(|gap| > threshold).
        samples: Positions of the data.
        threshold: One noise standard deviation.
        unit: Of the gap; "" if it is not known.
        units: Of the variables.
    """

    equation: str
    variables: tuple[str, ...]
    axes: tuple[np.ndarray, ...]
    before: np.ndarray
    after: np.ndarray
    probability: np.ndarray
    after_probability: np.ndarray
    samples: Float[np.ndarray, "n_obs n_var"]
    threshold: float
    unit: str
    units: tuple[str, ...]


@dataclass(frozen=True)
class GapTrace:
    """The gap along time on the training rows, before and after; means and standard deviations in user's units."""

    equation: str
    time: np.ndarray
    run: np.ndarray
    before: np.ndarray
    before_sd: np.ndarray
    after: np.ndarray
    after_sd: np.ndarray
    probability: np.ndarray
    threshold: float
    unit: str


@dataclass(frozen=True)
class GapField:
    """Posterior of what a model lacks in one equation, as a Gaussian process over its variables.

    Attributes:
        statistics: Of the equation.
        mean: Posterior mean of the features' weights.
        root: Factor of their covariance, W with Wᵀ W = cov.
        sigma: Noise standard deviation, user's units.
        projection: Coefficients of the features on the free columns, taken off wherever they are evaluated.
    """

    statistics: SufficientStatistics
    mean: Float[np.ndarray, " n_basis"]
    root: Float[np.ndarray, "n_basis n_basis"]
    sigma: float
    projection: Float[np.ndarray, "n_free n_basis"]

    @classmethod
    def of(
        cls,
        statistics: SufficientStatistics,
        evaluator: Evaluator,
        indices: Sequence[int] = (),
        beta: np.ndarray | None = None,
    ) -> "GapField":
        """The gap left by columns with given coefficients; free columns take their share by least squares.

        Args:
            statistics: Products of the equation.
            evaluator: Its evidence with f, whose mode sets η.
            indices: Columns taken into the model.
            beta: Their scaled coefficients.
        """
        beta = np.zeros(len(indices)) if beta is None else beta
        taken = list(indices)
        within = statistics.products[np.ix_(taken, taken)]
        square = float(statistics.square - 2 * beta @ statistics.with_target[taken] + beta @ within @ beta)
        product = statistics.features_target - beta @ statistics.with_features[taken]
        free = statistics.of_kind("free")
        G = statistics.products[np.ix_(free, free)]
        g = statistics.with_target[free] - statistics.products[np.ix_(free, taken)] @ beta
        sd = np.array([[statistics.columns[i].sd for i in free]])
        spectrum = Spectrum.of(G, g, square, statistics.n_obs, sd)
        inverse, C = np.linalg.pinv(G, rcond=1e-12, hermitian=True) if free else G, statistics.with_features[free]
        hypothesis = WithDiscrepancy(
            spectrum.eigenvalues, spectrum.loading, np.zeros(1), max(square, 1e-300), statistics.n_obs,
            statistics.features - C.T @ inverse @ C, product - C.T @ inverse @ g,
        )  # fmt: skip
        found = evaluator.integrate(hypothesis, draws=0)
        mean, root = evaluator.weights(hypothesis, found.mode)
        sigma = float(statistics.noise.sigma(found.mode[0])) * statistics.target_scale
        return cls(statistics, mean, root, float(sigma), inverse @ C)

    def at(self, columns: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean and standard deviation at rows, user's units."""
        free = self.statistics.of_kind("free")
        means, sds = [], []
        n = len(next(iter(columns.values())))
        for start in range(0, n, 4096):
            part = {name: np.asarray(column)[start : start + 4096] for name, column in columns.items()}
            psi = self.statistics.evaluate_features(part) - self.statistics.evaluate(free, part) @ self.projection
            means.append(psi @ self.mean)
            sds.append(np.linalg.norm(psi @ self.root.T, axis=1))
        scale = self.statistics.target_scale
        return scale * np.concatenate(means), scale * np.concatenate(sds)


def exceedance(mean: np.ndarray, sd: np.ndarray, threshold: float) -> np.ndarray:
    """P(|gap| > threshold) for a Gaussian gap."""
    sd = np.maximum(sd, 1e-12 * threshold)
    return ndtr((mean - threshold) / sd) + ndtr((-mean - threshold) / sd)


def gap_map(
    data: Trajectories, before: GapField, after: GapField, variables: tuple[str, ...], threshold: float, unit: str
) -> GapMap:
    """The gap on a grid over one or two variables of f, the others held at their median."""
    columns = data.columns
    axes = tuple(np.linspace(columns[v].min(), columns[v].max(), GRID) for v in variables)
    mesh = np.meshgrid(*axes, indexing="ij")
    rows = {name: np.full(mesh[0].size, np.median(column)) for name, column in columns.items()}
    rows |= {v: m.ravel() for v, m in zip(variables, mesh, strict=True)}
    (m0, s0), (m1, s1) = before.at(rows), after.at(rows)
    shape = mesh[0].shape
    return GapMap(
        before.statistics.equation, variables, axes, m0.reshape(shape), m1.reshape(shape),
        exceedance(m0, s0, threshold).reshape(shape), exceedance(m1, s1, threshold).reshape(shape),
        np.column_stack([columns[v] for v in variables]), threshold, unit,
        tuple(data.unit(v) or "" for v in variables),
    )  # fmt: skip


def gap_trace(data: Trajectories, before: GapField, after: GapField, threshold: float, unit: str) -> GapTrace:
    """The gap along time on the training rows."""
    pick = _shown(data)
    rows = {name: column[pick] for name, column in data.columns.items()}
    (m0, s0), (m1, s1) = before.at(rows), after.at(rows)
    p, equation = exceedance(m0, s0, threshold), before.statistics.equation
    return GapTrace(equation, data.time[pick], data.run[pick], m0, s0, m1, s1, p, threshold, unit)


def where_table(data: Trajectories, variables: Sequence[str], trace: GapTrace) -> pd.DataFrame:
    """Regions of state space and windows of time in which the gap exceeds the threshold.

    A region is a rule on one variable, or on two, that gathers as many rows of high probability and as few of low as
    any other: it maximises Σ (p − ½) over its rows.

    Args:
        data: Training data.
        variables: What f depends on.
        trace: The gap along time.

    Returns:
        Columns equation, kind, description, probability (mean over the rows), gap_share (of the gap's square),
        sample_share; largest share of the gap first within each kind.
    """
    columns = {v: data.column(v)[_shown(data)] for v in variables}
    units = {v: data.unit(v) or "" for v in columns}
    p, square = trace.probability, trace.before**2
    rows = []
    for kind, found in (("region", _regions(p, columns, units)), ("window", _windows(trace, data))):
        part = [
            (trace.equation, kind, text, p[inside].mean(), square[inside].sum() / square.sum(), inside.mean())
            for text, inside in found
        ]
        rows += sorted(part, key=lambda row: -row[4])[: MOST_REGIONS if kind == "region" else MOST_WINDOWS]
    names = ["equation", "kind", "description", "probability", "gap_share", "sample_share"]
    return pd.DataFrame(rows, columns=names)


def _shown(data: Trajectories) -> Int[np.ndarray, " n_shown"]:
    """Rows, evenly thinned, that regions and windows are sought on."""
    return np.unique(np.linspace(0, data.n_obs - 1, min(data.n_obs, MOST_ROWS)).astype(int))


def _regions(
    p: np.ndarray, columns: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> list[tuple[str, np.ndarray]]:
    gain, found = p - 0.5, []
    left = np.ones(len(p), bool)
    whole = gain.sum()
    while len(found) < MOST_REGIONS:
        rules = [(v, *rule) for v in columns for rule in _rules(v, columns[v], units[v])]
        scored = [(gain[inside & left].sum(), v, text, inside) for v, text, inside in rules]
        score, first, text, inside = max(scored, key=lambda item: item[0])
        if not found and whole >= 0.95 * score and whole > 0:
            return [("everywhere", left)]
        if score <= 0.02 * len(p):
            break
        deeper = [(gain[inside & left & more].sum(), also, more) for v, also, more in rules if v != first]
        second, also, more = max(deeper, key=lambda item: item[0], default=(0.0, "", inside))
        if second > 1.1 * score:
            score, text, inside = second, f"{text} and {also}", inside & more
        found.append((text, inside & left))
        left = left & ~inside
    return found


def _rules(name: str, x: np.ndarray, unit: str) -> Iterator[tuple[str, np.ndarray]]:
    unit = f" {unit_text(unit)}" if unit_text(unit) else ""
    levels = np.linspace(0.05, 0.95, CUTS)
    for c in np.unique(np.quantile(x, levels)):
        yield f"{name} > {c:.3g}{unit}", x > c
        yield f"{name} < {c:.3g}{unit}", x < c
    if x.min() < 0 < x.max():
        for c in np.unique(np.quantile(np.abs(x), levels)):
            yield f"|{name}| > {c:.3g}{unit}", np.abs(x) > c
            yield f"|{name}| < {c:.3g}{unit}", np.abs(x) < c
    coarse = np.unique(np.quantile(x, levels[::2]))
    for i, low in enumerate(coarse):
        for high in coarse[i + 1 :]:
            yield f"{low:.3g} < {name} < {high:.3g}{unit}", (x > low) & (x < high)


def _windows(trace: GapTrace, data: Trajectories) -> list[tuple[str, np.ndarray]]:
    unit = f" {data.unit('t')}" if data.unit("t") else ""
    found = []
    for run in np.unique(trace.run):
        rows = np.flatnonzero(trace.run == run)
        width = max(3, len(rows) // WINDOW)
        smooth = np.convolve(trace.probability[rows], np.ones(width) / width, mode="same")
        high = np.concatenate([[False], smooth > 0.5, [False]])
        edges = np.flatnonzero(np.diff(high.astype(int)))
        spans = [list(span) for span in zip(edges[::2], edges[1::2], strict=True)]
        merged: list[list[int]] = []
        for span in spans:
            if merged and span[0] - merged[-1][1] < width:
                merged[-1][1] = span[1]
            else:
                merged.append(span)
        label = f", run {data.run_names[int(run)]}" if data.n_run > 1 else ""
        for a, b in merged:
            if b - a < width:
                continue
            inside = np.zeros(len(trace.run), bool)
            inside[rows[a:b]] = True
            t = trace.time[rows[[a, b - 1]]]
            found.append((f"t = {t[0]:.4g} to {t[1]:.4g}{unit}{label}", inside))
    return found
