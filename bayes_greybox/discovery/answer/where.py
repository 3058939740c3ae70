"""Where simulation and measurement disagree: the gap over states and along time, and a few readable regions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.special import ndtr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text

GRID = 41
"""Points of a map along each variable."""

MOST_ROWS = 5000
"""Rows, evenly thinned, on which regions and windows are sought."""

CUTS = 19
"""Cut points tried along each variable, at even quantiles of the data."""

MOST_REGIONS, MOST_WINDOWS = 3, 5
"""Regions and windows reported at most."""

CELL = 0.05
"""Width of the Gaussian that smooths a map, over the range of its variable: a grid of 41 points has two in it.

It decides nothing."""

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
        threshold: One noise standard deviation, or that of the gap where it is larger.
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


class Gap(NamedTuple):
    """Smoothed latent force along time, which the model lacks, user's units.

    Attributes:
        mean: Posterior mean at the samples.
        sd: Its standard deviation.
    """

    mean: Float[np.ndarray, " n_sample"]
    sd: Float[np.ndarray, " n_sample"]


class Along(NamedTuple):
    """Samples that a gap is along.

    Attributes:
        equation: The state whose rate is meant.
        time: Of the samples.
        run: Their runs.
        columns: States and inputs there.
    """

    equation: str
    time: Float[np.ndarray, " n_sample"]
    run: Int[np.ndarray, " n_sample"]
    columns: Mapping[str, Float[np.ndarray, " n_sample"]]

    def thinned(self, gap: Gap) -> "tuple[Along, Gap]":
        """Return at most `MOST_ROWS` of them, evenly thinned."""
        pick = np.unique(np.linspace(0, len(self.time) - 1, min(len(self.time), MOST_ROWS)).astype(int))
        columns = {name: column[pick] for name, column in self.columns.items()}
        return Along(self.equation, self.time[pick], self.run[pick], columns), Gap(gap.mean[pick], gap.sd[pick])


def exceedance(mean: np.ndarray, sd: np.ndarray, threshold: float) -> np.ndarray:
    """Return P(|gap| > threshold) for a Gaussian gap, on the likelier side of zero.

    Where nothing is known of the gap either sign exceeds any threshold: that it is large in one direction is not.
    """
    return ndtr((np.abs(mean) - threshold) / np.maximum(sd, 1e-12 * threshold))


def gap_map(
    data: Trajectories, along: Along, before: Gap, after: Gap, variables: tuple[str, ...], threshold: float, unit: str
) -> GapMap:  # fmt: skip
    """Return the gap averaged over cells of one or two variables, with the weights of a normal density.

    Args:
        data: Training data, for units.
        along: Samples.
        before: Gap that the model before leaves there.
        after: Gap that the model after leaves.
        variables: One or two variables.
        threshold: One noise standard deviation.
        unit: Of the gap.
    """
    (thin, first), (_, last) = along.thinned(before), along.thinned(after)
    x = np.column_stack([thin.columns[v] for v in variables])
    axes = tuple(np.linspace(column.min(), column.max(), GRID) for column in x.T)
    mesh = np.column_stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")])
    width = np.maximum(np.ptp(x, axis=0) * CELL, np.finfo(float).tiny)
    log_weight = -0.5 * np.sum(((mesh[:, None] - x) / width) ** 2, axis=-1)
    # Where no sample is near the nearest one speaks.
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    shape = tuple(len(axis) for axis in axes)
    means = [(weight @ gap.mean).reshape(shape) for gap in (first, last)]
    # Neighbours share their errors: an average is known no better than each of them.
    sds = [np.sqrt(weight @ gap.sd**2).reshape(shape) for gap in (first, last)]
    sure = [exceedance(mean, sd, threshold) for mean, sd in zip(means, sds, strict=True)]
    return GapMap(
        along.equation, variables, axes, means[0], means[1], sure[0], sure[1],
        np.column_stack([along.columns[v] for v in variables]), threshold, unit,
        tuple(data.unit(v) or "" for v in variables),
    )  # fmt: skip


def gap_trace(along: Along, before: Gap, after: Gap, threshold: float, unit: str) -> GapTrace:
    """Return the gap along time; arguments as of `gap_map`."""
    (thin, first), (_, last) = along.thinned(before), along.thinned(after)
    p = exceedance(first.mean, first.sd, threshold)
    return GapTrace(along.equation, thin.time, thin.run, *first, *last, p, threshold, unit)


def where_table(data: Trajectories, along: Along, variables: Sequence[str], trace: GapTrace) -> pd.DataFrame:
    """Regions of state space and windows of time in which the gap exceeds the threshold.

    A region is a rule on one variable, or on two, that gathers as many rows of high probability and as few of low as
    any other: it maximises Σ (p − ½) over its rows.

    Args:
        data: Training data.
        along: Samples.
        variables: What f depends on.
        trace: The gap along time.

    Returns:
        Columns equation, kind, description, probability (mean over the rows), gap_share (of the gap's square),
        sample_share; largest share of the gap first within each kind.
    """
    thin, _ = along.thinned(Gap(along.time, along.time))
    columns = {v: thin.columns[v] for v in variables}
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
