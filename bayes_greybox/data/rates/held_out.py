"""Held-out data with the filter of the training data."""

from bayes_greybox.data.trajectories import Trajectories, require_measured
from bayes_greybox.running.errors import InputError


def with_filter_of(test: Trajectories, train: Trajectories) -> Trajectories:
    """Differentiate held-out data by the filter of the training data, unless their rates are known already.

    Rates that another filter computed, and a table that was not read yet, are refused.
    """
    require_measured(test)
    if train.filter is None or test.filter == train.filter:
        return test
    if test.filter is not None:
        one, other = (f"{part.method} with a window of {part.window}" for part in (train.filter, test.filter))
        raise InputError(
            f"Training data were differentiated by {one}, held-out data by {other}, or with other settings: use one "
            "filter for both, test.differentiate(like=train)."
        )
    unknown = any(name not in test.derivatives for name in train.derivatives)
    return test.differentiate(like=train) if unknown else test
