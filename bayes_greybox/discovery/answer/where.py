"""Location of the gap: over states and along time, and a few readable regions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.special import ndtr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text

MAP_POINTS, MAP_WIDTH = 41, 0.05
"""Points of a map along each variable, and width of the Gaussian that smooths it, over the range."""

MOST_SEARCHED, CUTS = 5000, 19
"""Largest number of rows that are searched, evenly thinned, and cut points along each variable, at even quantiles."""

REGION, WINDOW = "region", "window"
MOST_REGIONS, MOST_WINDOWS = 3, 5
"""Kinds of places that hold a gap, of the states and of time, and their largest numbers."""

LEAST_WINDOW = 40
"""Rows of a run over those of its shortest window, so that noise does not cut windows up."""


@dataclass(frozen=True)
class GapMap:
    """The gap over one or two variables, before and after the model was extended; the others at their median.

    Means [n_0, n_1] (or [n_0]) and P(|gap| > threshold) on a grid; the threshold is one noise standard deviation, or
    that of the gap where it is larger; user's units, "" where one is not known.
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
    """Posterior of the smoothed latent force along time, user's units."""

    mean: Float[np.ndarray, " n_sample"]
    sd: Float[np.ndarray, " n_sample"]


class Along(NamedTuple):
    """Samples along which a gap is known."""

    equation: str
    time: Float[np.ndarray, " n_sample"]
    run: Int[np.ndarray, " n_sample"]
    columns: Mapping[str, Float[np.ndarray, " n_sample"]]

    def thinned(self, gap: Gap) -> "tuple[Along, Gap]":
        """Return at most `MOST_SEARCHED` samples, evenly thinned."""
        pick = np.unique(np.linspace(0, len(self.time) - 1, min(len(self.time), MOST_SEARCHED)).astype(int))
        columns = {name: column[pick] for name, column in self.columns.items()}
        return Along(self.equation, self.time[pick], self.run[pick], columns), Gap(gap.mean[pick], gap.sd[pick])


def exceedance(mean: np.ndarray, sd: np.ndarray, threshold: float) -> np.ndarray:
    """Return P(|gap| > threshold) of a Gaussian gap, on the likelier side of zero alone."""
    return ndtr((np.abs(mean) - threshold) / np.maximum(sd, 1e-12 * threshold))


def gap_map(
    data: Trajectories, along: Along, before: Gap, after: Gap, variables: tuple[str, ...], threshold: float, unit: str
) -> GapMap:
    """Return the gap averaged over cells of one or two variables, with the weights of a normal density."""
    (thin, first), (_, last) = along.thinned(before), along.thinned(after)
    x = np.column_stack([thin.columns[v] for v in variables])
    axes = tuple(np.linspace(column.min(), column.max(), MAP_POINTS) for column in x.T)
    mesh = np.column_stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")])
    width = np.maximum(np.ptp(x, axis=0) * MAP_WIDTH, np.finfo(float).tiny)
    log_weight = -0.5 * np.sum(((mesh[:, None] - x) / width) ** 2, axis=-1)
    # In cells without samples the nearest one counts alone.
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
    """Return regions of state space and windows of time in which the gap exceeds the threshold, by share of the gap.

    A region is a rule on one variable, or on two, that maximises Σ (p − ½) over its rows. Columns are equation, kind,
    description, probability (mean over the rows), gap_share (of the gap's square) and sample_share.
    """
    thin, _ = along.thinned(Gap(along.time, along.time))
    p, square = trace.probability, trace.before**2
    rules = [(v, *rule) for v in variables for rule in _rules(v, thin.columns[v], data.unit(v) or "")]
    rows = []
    parts = ((REGION, MOST_REGIONS, _regions(p, rules)), (WINDOW, MOST_WINDOWS, _windows(trace, data)))
    for kind, most, places in parts:
        part = [
            (trace.equation, kind, text, p[inside].mean(), square[inside].sum() / square.sum(), inside.mean())
            for text, inside in places
        ]
        rows += sorted(part, key=lambda row: -row[4])[:most]
    names = ["equation", "kind", "description", "probability", "gap_share", "sample_share"]
    return pd.DataFrame(rows, columns=names)


def _regions(p: np.ndarray, rules: Sequence[tuple[str, str, np.ndarray]]) -> list[tuple[str, np.ndarray]]:
    """Return regions greedily, each the best rule, or pair of rules, on the rows outside those before it."""
    gain, found, left = p - 0.5, [], np.ones(len(p), bool)
    whole = gain.sum()
    while len(found) < MOST_REGIONS:
        scored = [(gain[inside & left].sum(), v, text, inside) for v, text, inside in rules]
        score, first, text, inside = max(scored, key=lambda item: item[0])
        if not found and whole >= 0.95 * score and whole > 0:
            return [("everywhere", left)]
        if score <= 0.02 * len(p):
            break
        deeper = [(gain[inside & left & more].sum(), also, more) for v, also, more in rules if v != first]
        second, also, more = max(deeper, key=lambda item: item[0], default=(0.0, "", inside))
        if second > 1.1 * score:
            text, inside = f"{text} and {also}", inside & more
        found.append((text, inside & left))
        left = left & ~inside
    return found


def _rules(name: str, x: np.ndarray, unit: str) -> Iterator[tuple[str, np.ndarray]]:
    unit = f" {unit_text(unit)}" if unit_text(unit) else ""
    levels = np.linspace(0.05, 0.95, CUTS)
    signed = [(name, x)] + ([(f"|{name}|", np.abs(x))] if x.min() < 0 < x.max() else [])
    for label, values in signed:
        for c in np.unique(np.quantile(values, levels)):
            yield f"{label} > {c:.3g}{unit}", values > c
            yield f"{label} < {c:.3g}{unit}", values < c
    coarse = np.unique(np.quantile(x, levels[::2]))
    for i, low in enumerate(coarse):
        for high in coarse[i + 1 :]:
            yield f"{low:.3g} < {name} < {high:.3g}{unit}", (x > low) & (x < high)


def _windows(trace: GapTrace, data: Trajectories) -> Iterator[tuple[str, np.ndarray]]:
    unit = f" {data.unit('t')}" if data.unit("t") else ""
    for run in np.unique(trace.run):
        rows = np.flatnonzero(trace.run == run)
        width = max(3, len(rows) // LEAST_WINDOW)
        smooth = np.convolve(trace.probability[rows], np.ones(width) / width, mode="same")
        high = np.concatenate([[False], smooth > 0.5, [False]])
        edges = np.flatnonzero(np.diff(high.astype(int)))
        merged: list[list[int]] = []
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if merged and start - merged[-1][1] < width:
                merged[-1][1] = stop
            else:
                merged.append([start, stop])
        label = f", run {data.run_names[int(run)]}" if data.n_run > 1 else ""
        for start, stop in merged:
            if stop - start >= width:
                first, last = trace.time[rows[[start, stop - 1]]]
                inside = np.isin(np.arange(len(trace.run)), rows[start:stop])
                yield f"t = {first:.4g} to {last:.4g}{unit}{label}", inside
