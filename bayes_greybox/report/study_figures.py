"""The older name of the figures of studies, which `plots` offers."""

from bayes_greybox.discovery.summary import added, marked, support

from .plots import added_coefficients as coefficients
from .plots import free_run, gap_map, gap_over_time, ranking, rounds, study_figures
from .words.study import name_of

__all__ = [
    "added", "coefficients", "free_run", "gap_map", "gap_over_time", "marked", "name_of", "ranking", "rounds",
    "study_figures", "support",
]  # fmt: skip
