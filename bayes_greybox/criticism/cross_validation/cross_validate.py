"""Cross-validation of one fit under any scheme."""

from bayes_greybox.inference.posterior import Posterior

from .folds import START, check_scheme, make_folds
from .leave_future_out import leave_future_out
from .loo import Loo, Refit, leave_folds_out, loo
from .refits import refit_without


def cross_validate(
    posterior: Posterior,
    scheme: str = "loo",
    *,
    block: int | None = None,
    start: float = START,
    at_most: int | None = None,
    refit: Refit | None = refit_without,
    max_refits: int = 10,
    progress: bool = True,
) -> Loo:
    """Expected log predictive density of what is left out, from one run.

    Args:
        posterior: Fitted model.
        scheme: "loo": one row at a time. "block": contiguous rows, for time series, whose neighbours give a row away.
            "trajectory": whole runs. "future": each step of time from all before it.
        block: Rows of a block, or time stamps of a step into the future; None: chosen from the autocorrelation of
            what the dictionary leaves, and stated in the result's notes.
        start: For "future", the share of the time stamps that is only learned from.
        at_most: Thin the draws evenly to this many; None: all.
        refit: How to fit again where Pareto k̂ is too large; None: not at all.
        max_refits: Most refits. With more folds in need of one, "future" makes as many, the other schemes none.
        progress: Whether refits show their progress.

    Returns:
        The result; its notes say what was chosen and what to beware of.

    Raises:
        InputError: A scheme or block that does not fit the data; fewer than 25 draws.
    """
    check_scheme(scheme, block, start)
    if scheme == "loo":
        return loo(posterior, at_most, refit=refit, max_refits=max_refits, progress=progress)
    folds = make_folds(posterior, scheme, block, start)
    run = leave_future_out if scheme == "future" else leave_folds_out
    return run(posterior, folds, at_most, refit=refit, max_refits=max_refits, progress=progress)
