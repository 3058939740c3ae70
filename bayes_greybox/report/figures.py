"""The older name of the figures of fits, which `plots` offers."""

from .plots import (
    autocorrelation,
    calibration,
    coefficients,
    discrepancy_over_states,
    discrepancy_over_time,
    fit_figures,
    loo_pit,
    predicted,
    predictive,
    sensitivity,
    study_figures,
    trade_off,
)

__all__ = [
    "autocorrelation",
    "calibration",
    "coefficients",
    "discrepancy_over_states",
    "discrepancy_over_time",
    "fit_figures",
    "loo_pit",
    "predicted",
    "predictive",
    "sensitivity",
    "study_figures",
    "trade_off",
]
