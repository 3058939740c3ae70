"""Figures: every number they draw arrives computed.

Each function returns the figure. It is not registered with pyplot: in a notebook it shows once, as the value
of the cell, and a loop that draws hundreds leaves nothing open. Hand over axes of your own to draw into a
figure of your own.
"""

from bayes_greybox.report.plots.before_after import plot_free_run, plot_gap_over_time
from bayes_greybox.report.plots.calibration import plot_calibration
from bayes_greybox.report.plots.checks import plot_autocorrelation, plot_loo_pit, plot_predictive, plot_sensitivity
from bayes_greybox.report.plots.coefficients import plot_coefficients
from bayes_greybox.report.plots.comparison import plot_comparison
from bayes_greybox.report.plots.confounding import plot_confounding
from bayes_greybox.report.plots.files import save_figures
from bayes_greybox.report.plots.gap_map import plot_gap_curve, plot_gap_map
from bayes_greybox.report.plots.over_states import plot_discrepancy_over_states
from bayes_greybox.report.plots.over_time import plot_discrepancy_over_time
from bayes_greybox.report.plots.posteriors import Coefficient, plot_posteriors
from bayes_greybox.report.plots.predicted import plot_predicted
from bayes_greybox.report.plots.ranking import plot_hypotheses, plot_rounds
from bayes_greybox.report.plots.tradeoff import plot_tradeoff

__all__ = [
    "Coefficient",
    "plot_calibration",
    "plot_autocorrelation",
    "plot_coefficients",
    "plot_comparison",
    "plot_confounding",
    "plot_discrepancy_over_states",
    "plot_discrepancy_over_time",
    "plot_free_run",
    "plot_gap_curve",
    "plot_gap_map",
    "plot_gap_over_time",
    "plot_hypotheses",
    "plot_loo_pit",
    "plot_posteriors",
    "plot_predicted",
    "plot_predictive",
    "plot_rounds",
    "plot_sensitivity",
    "plot_tradeoff",
    "save_figures",
]
