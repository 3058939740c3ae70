"""Figures of the checks: predictive distributions, LOO-PIT, residuals, prior sensitivity, calibration by simulation."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import formula, number, p_text
from bayes_greybox.running.errors import InputError


@mpl.rc_context(style.STYLE)
def plot_predictive(
    measured: Float[np.ndarray, " n_obs"],
    posterior: Float[np.ndarray, "n_draw n_obs"],
    prior: Float[np.ndarray, "n_prior_draw n_obs"],
    *,
    equation: str,
    label: str | None = None,
    unit: str | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw distribution functions of the measured derivative, and of data drawn from prior and posterior.

    Args:
        measured: measured derivative, in `unit`.
        posterior: posterior predictive data sets.
        prior: prior predictive data sets.
        equation: name of the state whose derivative is drawn.
        label: name of another drawn quantity, such as an output.
        unit: unit of the derivative.
        axes: axes to draw into: prior, posterior.
    """
    panels = style.panels_of(axes, 2, "prior, posterior", (9.0, 3.6), nrows=1, ncols=2)
    steps = (np.arange(len(measured)) + 0.5) / len(measured)
    for ax, drawn, name in zip(panels, (prior, posterior), ("prior", "posterior"), strict=True):
        shown = drawn[np.unique(np.linspace(0, len(drawn) - 1, 60).round().astype(int))]
        for i, values in enumerate(np.sort(shown, axis=1)):
            ax.plot(values, steps, color=style.SKY, linewidth=0.6, alpha=0.5, label="predicted" if i == 0 else None)
        ax.plot(np.sort(measured), steps, color=style.DARK, linewidth=1.6, label="measured")
        ax.set(title=f"Drawn from the {name}", xlabel=style.with_unit(label or f"d({equation})/dt", unit))
        ax.xaxis.set_major_locator(MaxNLocator(5))
    # Priors with heavy tails would leave nothing to see of the data.
    reach = np.quantile(prior, [0.02, 0.98])
    panels[0].set_xlim(min(float(reach[0]), float(measured.min())), max(float(reach[1]), float(measured.max())))
    panels[0].set_ylabel("share of the rows below")
    style.place_legend(panels[0], axes is None)
    return style.figure_of(panels[0])


@mpl.rc_context(style.STYLE)
def plot_loo_pit(
    value: Float[np.ndarray, " n_obs"],
    *,
    equation: str,
    band: float | np.floating,
    p: float | np.floating,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the distribution function of the LOO-PIT values less the uniform one, with its band.

    A curve that rises on the left and falls on the right comes from predictions that are too narrow, the opposite from
    predictions that are too wide.

    Args:
        value: LOO-PIT values.
        equation: name of the state whose derivative is predicted.
        band: half-width of the band that holds the whole curve in 99 % of well-specified data sets.
        p: p-value of uniformity.
        axes: axes to draw into, one.
    """
    (ax,) = style.panels_of(axes, 1, "the curve", (5.6, 3.4))
    # The distribution function jumps at each value, and less uniform it falls between them.
    u = np.concatenate([[0.0], np.repeat(np.sort(value), 2), [1.0]])
    share = np.repeat(np.arange(len(value) + 1) / len(value), 2)
    ax.axhspan(-float(band), float(band), color=style.LIGHT, alpha=0.6, linewidth=0, label="99 % band")
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)
    ax.plot(u, share - u, color=style.BLUE, linewidth=1.4, label="LOO-PIT")
    ax.set(xlim=(0.0, 1.0), xlabel="LOO-PIT value", ylabel="share below, less uniform")
    ax.set_title(f"Leave-one-out predictions of {style.plain(equation)} ({p_text(float(p))})")
    style.place_legend(ax, axes is None)
    return style.figure_of(ax)


@mpl.rc_context(style.STYLE)
def plot_autocorrelation(
    lag: Int[np.ndarray, " n_lag"],
    autocorrelation: Float[np.ndarray, " n_lag"],
    bound: Float[np.ndarray, " n_lag"],
    *,
    equation: str,
    p: float | np.floating,
    standing_out: Sequence[int] = (),
    by_frequency: bool = False,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the autocorrelation of the whitened residuals with the bound that white noise keeps.

    Args:
        lag: lags.
        autocorrelation: at each lag, mean over posterior draws.
        bound: bound of each.
        equation: name of the state whose derivative is modelled.
        p: p-value of whiteness.
        standing_out: lags to mark.
        by_frequency: if true, the lags are steps of frequency.
        axes: axes to draw into, one.
    """
    (ax,) = style.panels_of(axes, 1, "the bars", (5.6, 3.4))
    ax.fill_between(lag, -bound, bound, color=style.LIGHT, alpha=0.6, linewidth=0, label="white noise, all lags 99 %")
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)
    marked = np.isin(lag, standing_out)
    for chosen, colour, name in ((~marked, style.BLUE, "autocorrelation"), (marked, style.ORANGE, "standing out")):
        if chosen.any():
            ax.vlines(lag[chosen], 0.0, autocorrelation[chosen], color=colour, linewidth=2.0)
            ax.plot(lag[chosen], autocorrelation[chosen], "o", color=colour, markersize=4, label=name)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="lag [frequencies]" if by_frequency else "lag [rows]", ylabel="autocorrelation")
    ax.set_title(f"Whitened residuals of {style.plain(equation)} ({p_text(float(p))})")
    style.place_legend(ax, axes is None)
    return style.figure_of(ax)


@mpl.rc_context(style.STYLE)
def plot_sensitivity(
    table: pd.DataFrame,
    *,
    threshold: float | np.floating,
    labels: Mapping[str, str] | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the sensitivity of each quantity to prior and likelihood, against the threshold.

    Args:
        table: indexed by (equation, quantity), with columns prior and likelihood.
        threshold: sensitivities above it are worth a look.
        labels: left-hand side of each equation; by default the derivative of a state.
        axes: axes to draw into, one.
    """
    (ax,) = style.panels_of(axes, 1, "the dots", (6.4, 1.4 + 0.26 * len(table)))
    equations, labels = table.index.unique(0), labels or {}
    where = {name: f" in {labels.get(name, f'd({name})/dt')}" if len(equations) > 1 else "" for name in equations}
    names = [f"{formula(str(quantity))}{where[equation]}" for equation, quantity in table.index]
    rows = style.guide_rows(ax, len(table))
    ax.axvline(float(threshold), color=style.DARK, linewidth=1.0, linestyle=style.DASHED, label="threshold")
    likelihood, prior = table["likelihood"].to_numpy(float), table["prior"].to_numpy(float)
    hollow: dict[str, Any] = {"color": style.GREY, "markersize": 5, "markerfacecolor": "none"}
    ax.plot(likelihood, rows, "o", clip_on=False, label="to the likelihood", **hollow)
    ax.plot(prior, rows, "o", color=style.BLUE, markersize=5.5, clip_on=False, label="to the prior")
    ax.set_yticks(rows, [style.plain(name) for name in names])
    ax.set_xlim(left=0.0)
    ax.spines["left"].set_visible(False)
    ax.set(xlabel="change for each doubling of its weight", title="Power-scaling sensitivity")
    style.place_legend(ax, axes is None)
    return style.figure_of(ax)


@mpl.rc_context(style.STYLE)
def plot_calibration(
    differences: pd.DataFrame,
    lower: Float[np.ndarray, " n_point"],
    upper: Float[np.ndarray, " n_point"],
    tests: pd.DataFrame,
    reliability: Mapping[str, pd.DataFrame] | None = None,
) -> Figure:
    """Draw a panel for each ranked quantity, then one for the inclusion probabilities of each equation.

    A curve that leaves the band, drawn in orange where its test failed, says that the posterior is wrong: an arch above
    zero that the draws are too large, one below that they are too small, an S that they are too wide or too narrow.

    Args:
        differences: ECDF of the ranks less that of uniform values, one column a quantity, indexed by where.
        lower: Least difference inside the simultaneous band.
        upper: Largest.
        tests: By quantity: adjusted p and passed.
        reliability: By equation: low, high, count, predicted and observed share of included terms, lower and upper.

    Raises:
        InputError: Nothing to draw, or a column is missing.
    """
    reliability = reliability or {}
    if differences.empty:
        raise InputError("There are no ranks to draw; pass what calibrate() returns.")
    for table in reliability.values():
        missing = {"predicted", "observed", "lower", "upper", "count"} - set(table.columns)
        if missing:
            raise InputError(f"The reliability table lacks the column {min(missing)!r}; pass that of calibrate().")
    n_panel = differences.shape[1] + len(reliability)
    down = -(-n_panel // 4)
    figure = style.new_figure(10.5, 0.4 + 2.0 * down)
    panels = figure.subplots(down, 4, squeeze=False).ravel()
    at = differences.index.to_numpy(float)
    reach = 1.15 * max(float(np.abs(differences.to_numpy()).max()), float(-lower.min()), float(upper.max()))
    for ax, name in zip(panels, differences, strict=False):
        passed, adjusted = bool(tests.loc[name, "passed"]), float(np.asarray(tests.loc[name, "adjusted"]))
        ax.fill_between(at, lower, upper, color=style.LIGHT, linewidth=0, label="band")
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        colour = style.BLUE if passed else style.ORANGE
        ax.plot(at, differences[name].to_numpy(float), color=colour, linewidth=1.3, label="ECDF")
        ax.set_ylim(-reach, reach)
        _finish(ax, str(name), f"adjusted p = {number(adjusted, 2)}")
    for ax, (name, table) in zip(panels[differences.shape[1] :], reliability.items(), strict=False):
        _draw_reliability(ax, table)
        _finish(ax, f"{name}: P(included)", "")
    for ax in panels[n_panel:]:
        ax.set_visible(False)
    figure.supxlabel("rank of the truth / number of draws", fontsize=10)
    figure.supylabel("ECDF − uniform", fontsize=10)
    return figure


def _draw_reliability(ax: Axes, table: pd.DataFrame) -> None:
    shown = table.loc[table["count"].to_numpy() > 0]
    predicted, observed = shown["predicted"].to_numpy(float), shown["observed"].to_numpy(float)
    ax.plot([0, 1], [0, 1], color=style.GREY, linewidth=0.6)
    ax.vlines(predicted, shown["lower"].to_numpy(float), shown["upper"].to_numpy(float), color=style.LIGHT, linewidth=5)
    ax.plot(predicted, observed, "o", color=style.BLUE, markersize=4, label="observed share")
    ax.set_ylim(-0.05, 1.05)
    ax.set_xlabel("predicted", fontsize=9)
    ax.set_ylabel("observed", fontsize=9)


def _finish(ax: Axes, title: str, note: str) -> None:
    ax.set_title(style.plain(title), fontsize=9)
    ax.set_xlim(0, 1)
    ax.set_xticks([0, 0.5, 1], ["0", "½", "1"])
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.text(0.98, 0.04, note, transform=ax.transAxes, ha="right", va="bottom", fontsize=8, color=style.DARK)
