"""Cross-validation of one fit under any scheme."""

from bayes_greybox.inference.posterior import Posterior

from .folds import FUTURE_START, check_scheme, make_folds
from .leave_future_out import leave_future_out
from .loo import Loo, Refit, leave_folds_out, refit_without


def cross_validate(
    posterior: Posterior,
    scheme: str = "loo",
    *,
    block: int | None = None,
    start: float = FUTURE_START,
    at_most: int | None = None,
    refit: Refit | None = refit_without,
    max_refits: int = 10,
    progress: bool = True,
) -> Loo:
    """Estimate the expected log predictive density of rows that are left out, from one run.

    Args:
        posterior: Fitted model.
        scheme: "loo": one row at a time. "block": contiguous rows, for time series, whose neighbours predict a row.
            "trajectory": whole runs. "future": each step of time from all before it.
        block: Rows of a block, or time stamps of a step into the future; None: chosen from the autocorrelation of
            the residual of the dictionary, and stated in the result's notes.
        start: Share of the time stamps before the first prediction, for "future".
        at_most: Thin the draws evenly to this many; None: all.
        refit: Function that fits again without folds whose Pareto k̂ is too large; None: no refits.
        max_refits: Most refits. If more folds need one, "future" makes this many, the other schemes none.
        progress: If true, refits show their progress.

    Returns:
        The result; its notes have choices and warnings.

    Raises:
        InputError: The scheme or block does not suit the data, or there are fewer than 25 draws.
    """
    check_scheme(scheme, block, start)
    if scheme == "loo":
        return leave_folds_out(posterior, None, at_most, refit, max_refits, progress)
    folds = make_folds(posterior, scheme, block, start)
    run = leave_future_out if scheme == "future" else leave_folds_out
    return run(posterior, folds, at_most, refit, max_refits, progress)
