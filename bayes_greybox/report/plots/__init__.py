"""Every figure: of fits, of studies, and of numbers of your own.

Figures of results take the result: `coefficients(fit)`, `gap_map(study, "ydot")`; `fit_figures` and
`study_figures` draw them all, `overview(study)` the three that say most, in one figure. The functions plot_*
draw numbers that are handed to them.

Each function returns the figure. It is not registered with pyplot: in a notebook it shows once, as the value of
the cell, and a loop that draws hundreds leaves nothing open. Hand over axes of your own to draw into a figure
of your own.
"""

from typing import TYPE_CHECKING, Any

from bayes_greybox.report.plots.gap.before_after import plot_free_run, plot_gap_over_time
from bayes_greybox.report.plots.gap.gap_map import plot_gap_curve, plot_gap_map
from bayes_greybox.report.plots.posterior.along_time import plot_discrepancy_over_time, plot_predicted
from bayes_greybox.report.plots.posterior.coefficients import plot_coefficients
from bayes_greybox.report.plots.posterior.comparison import plot_comparison, plot_confounding
from bayes_greybox.report.plots.posterior.over_states import plot_discrepancy_over_states
from bayes_greybox.report.plots.posterior.tradeoff import plot_tradeoff
from bayes_greybox.report.plots.style import save_figures

from .fits import (
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
    simulated,
    trade_off,
)
from .gap.hypotheses import Coefficient, plot_hypotheses, plot_posteriors, plot_responses, plot_rounds
from .posterior.checks import plot_autocorrelation, plot_calibration, plot_loo_pit, plot_predictive, plot_sensitivity

if TYPE_CHECKING:
    from .studies import (
        added_coefficients,
        free_run,
        gap_map,
        gap_over_time,
        next_experiment,
        ranking,
        rounds,
        study_figures,
    )
    from .whole_study import overview

__all__ = [
    "Coefficient", "added_coefficients", "autocorrelation", "calibration", "coefficients", "discrepancy_over_states",
    "discrepancy_over_time", "fit_figures", "free_run", "gap_map", "gap_over_time", "loo_pit", "next_experiment",
    "overview", "plot_autocorrelation", "plot_calibration", "plot_coefficients", "plot_comparison", "plot_confounding",
    "plot_discrepancy_over_states", "plot_discrepancy_over_time", "plot_free_run", "plot_gap_curve", "plot_gap_map",
    "plot_gap_over_time", "plot_hypotheses", "plot_loo_pit", "plot_posteriors", "plot_predicted", "plot_predictive",
    "plot_responses", "plot_rounds", "plot_sensitivity", "plot_tradeoff", "predicted", "predictive", "ranking",
    "rounds", "save_figures", "sensitivity", "simulated", "study_figures", "trade_off",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    # Those of studies: the figures of a fit do without all that a study imports.
    if name in __all__:
        from . import studies, whole_study

        return getattr(whole_study if name == "overview" else studies, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
