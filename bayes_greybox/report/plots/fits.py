"""Figures of a fit: they draw the numbers of `criticism`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bayes_greybox.criticism.bands import Band
from bayes_greybox.criticism.calibration.calibrate import Calibration
from bayes_greybox.criticism.checks.checks import checks
from bayes_greybox.criticism.checks.sensitivity import SENSITIVITY_THRESHOLD
from bayes_greybox.criticism.discrepancy import discrepancy_grid
from bayes_greybox.criticism.free_run import FreeRun
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.criticism.prediction import predict
from bayes_greybox.criticism.trade_off import strongest_trade_off
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.units import target_unit
from bayes_greybox.report.plots.gap.before_after import plot_free_run, seen_as
from bayes_greybox.report.plots.posterior.along_time import plot_discrepancy_over_time, plot_predicted
from bayes_greybox.report.plots.posterior.coefficients import plot_coefficients
from bayes_greybox.report.plots.posterior.over_states import plot_discrepancy_over_states
from bayes_greybox.report.plots.posterior.tradeoff import plot_tradeoff
from bayes_greybox.report.words.fit import row_label
from bayes_greybox.report.words.formatting import formula, probability_column
from bayes_greybox.running.errors import InputError

from .posterior.checks import plot_autocorrelation, plot_calibration, plot_loo_pit, plot_predictive, plot_sensitivity


def fit_figures(fit: Posterior) -> dict[str, Figure]:
    """Return every figure of a fit by file name: coefficients, predictions, discrepancy, trade-off, checks."""
    figures = {"coefficients": coefficients(fit)}
    for name in fit.model.equations:
        figures[f"predicted_{name}" if len(fit.model.equations) > 1 else "predicted"] = predicted(fit, name)
    for name in fit.equations:
        suffix = f"_{name}" if len(fit.equations) > 1 else ""
        if fit.equations[name].frame.variables:
            figures[f"discrepancy_states{suffix}"] = discrepancy_over_states(fit, name)
            figures[f"discrepancy_time{suffix}"] = discrepancy_over_time(fit, name)
            figures[f"trade_off{suffix}"] = trade_off(fit, name)
        if "prior_predictive" in fit.idata:
            figures[f"predictive{suffix}"] = predictive(fit, name)
        figures[f"loo_pit{suffix}"] = loo_pit(fit, name)
        figures[f"autocorrelation{suffix}"] = autocorrelation(fit, name)
    figures["sensitivity"] = sensitivity(fit)
    return figures


def coefficients(fit: Posterior, truth: Mapping | None = None, level: float = 0.9, least: float = 0.0) -> Figure:
    """Draw the coefficients with their probabilities, beside the true values if they are known.

    Args:
        fit: Fit.
        truth: True coefficients, {equation: {term: value}}.
        level: Probability of the intervals.
        least: Terms that are less probable are not drawn.

    Raises:
        InputError: No term is as probable as that.
    """
    table: Any = inclusion(fit, level)
    return plot_coefficients(table[table[probability_column(table)] >= least], truth=truth)


def calibration(found: Calibration) -> Figure:
    """Draw ECDF differences of the ranks with their simultaneous band, and the reliability of P(included)."""
    band = found.band
    reliability = {name: part.bins for name, part in found.inclusion.items()}
    return plot_calibration(found.ecdf_differences, band.lower, band.upper, found.tests, reliability)


def predicted(fit: Posterior, equation: str | None = None, level: float = 0.9) -> Figure:
    """Draw predicted against measured rate, or output, over the training data, with the band of a measurement."""
    equation = equation or fit.model.equations[0]
    shown = predict(fit, fit.data, level)[equation]
    values = (fit.data.derivatives[equation], shown.rate.mean, shown.measurement.lower, shown.measurement.upper)
    about = {"label": row_label(fit, equation, "samples"), "level": level, **_along_time(fit, equation)}
    return plot_predicted(fit.data.time, *values, **about)


def simulated(run: FreeRun, state: str, width: float = 9.0) -> Figure:
    """Draw a state as measured and as the fitted model runs it from its start alone.

    Args:
        run: Result of `fit.simulate(data)`.
        state: Name of the state.
        width: Width of the figure in inches.
    """
    data = run.data
    return plot_free_run(
        data.time, data.states[state], None, band_rows(run.states[state]),
        state=state, holds=run.holds, seen_as=seen_as(data, state), unit=data.unit(state), width=width,
        **runs_of(data, data.run),
    )  # fmt: skip


def discrepancy_over_states(
    fit: Posterior, equation: str | None = None, variables: tuple[str, ...] | None = None, level: float = 0.9
) -> Figure:
    """Draw the posterior of f over one or two of its variables."""
    equation = equation or next(iter(fit.equations))
    grid = discrepancy_grid(fit, equation, variables, level=level)
    return plot_discrepancy_over_states(grid, noise=_noise(fit, equation))


def discrepancy_over_time(fit: Posterior, equation: str | None = None, level: float = 0.9) -> Figure:
    """Draw the posterior of f along the training data, against the noise level."""
    equation = equation or next(iter(fit.equations))
    band = predict(fit, fit.data, level)[equation].discrepancy
    about = {"sigma": _noise(fit, equation), "level": level, **_along_time(fit, equation)}
    return plot_discrepancy_over_time(fit.data.time, band.mean, band.lower, band.upper, **about)


def trade_off(fit: Posterior, equation: str | None = None) -> Figure:
    """Draw posterior pairs of the coefficient that f can stand in for most."""
    pair = strongest_trade_off(fit, equation or next(iter(fit.equations)))
    about: dict[str, Any] = {"equation": pair.equation, "correlation": pair.correlation, "unit": pair.unit}
    return plot_tradeoff(pair.theta, pair.projection, term=formula(pair.term), **about)


def predictive(fit: Posterior, equation: str | None = None) -> Figure:
    """Draw the distribution of the measured rate, or output, beside data drawn from prior and posterior.

    Raises:
        InputError: The fit holds no predictive draws, which are left out for long records.
    """
    equation = equation or next(iter(fit.equations))
    if "prior_predictive" not in fit.idata or "posterior_predictive" not in fit.idata:
        raise InputError(
            "The fit holds no predictive draws of both: its record is too long, an older version saved it, or it was "
            "refined under priors of its own."
        )
    rate = fit.sites[equation].rate
    measured = fit.idata["observed_data"][rate].to_numpy()
    groups = {source: fit.idata[f"{source}_predictive"][rate].to_numpy() for source in ("posterior", "prior")}
    drawn = {source: values.reshape(-1, len(measured)) for source, values in groups.items()}
    label, unit = row_label(fit, equation, "samples"), target_unit(equation, fit.data)
    if fit.data.samples is not None and fit.equations[equation].rows.gain != 1.0:
        units = {fit.data.samples.unit(name) for name in fit.data.samples.state_names}
        label, unit = "samples", (units.pop() or "") if len(units) == 1 else ""
    return plot_predictive(measured, **drawn, equation=equation, label=label, unit=unit)


def loo_pit(fit: Posterior, equation: str | None = None) -> Figure:
    """Draw the leave-one-out probabilities of the measurements against a uniform distribution."""
    pit = checks(fit).loo_pit[equation or next(iter(fit.equations))]
    return plot_loo_pit(pit.value, equation=pit.equation, band=pit.band, p=pit.p)


def autocorrelation(fit: Posterior, equation: str | None = None) -> Figure:
    """Draw the autocorrelation of the whitened residuals."""
    white = checks(fit).whiteness[equation or next(iter(fit.equations))]
    about = {name: getattr(white, name) for name in ("equation", "p", "standing_out", "by_frequency")}
    return plot_autocorrelation(white.lag, white.autocorrelation, white.bound, **about)


def sensitivity(fit: Posterior) -> Figure:
    """Draw the power-scaling sensitivity of coefficients and inclusion probabilities."""
    labels = {name: row_label(fit, name, "samples") for name in fit.equations}
    return plot_sensitivity(checks(fit).sensitivity, threshold=SENSITIVITY_THRESHOLD, labels=labels)


def _noise(fit: Posterior, equation: str) -> float:
    return float(np.mean(fit.idata["posterior"][fit.sites[equation].sigma].to_numpy()))


def band_rows(band: Band) -> Float[np.ndarray, "3 n_obs"]:
    """Return mean, lower and upper end of a band as rows."""
    return np.stack([band.mean, band.lower, band.upper])


def runs_of(data: Trajectories, run: np.ndarray) -> dict[str, Any]:
    """Return what figures along time are told of time and of runs, where there are several."""
    about = {"time_unit": data.unit("t") or ""}
    return about if len(np.unique(run)) == 1 else {**about, "run": run, "run_names": list(data.run_names)}


def _along_time(fit: Posterior, equation: str) -> dict[str, Any]:
    return {"equation": equation, "unit": target_unit(equation, fit.data), **runs_of(fit.data, fit.data.run)}
