"""Remarks on the data, for pages and terminal."""

from bayes_greybox.data.trajectories import Trajectories


def data_remarks(*parts: Trajectories | None) -> list[str]:
    """Return what was done to the data and what of them is missing, each remark once.

    Args:
        parts: Training and held-out data; None where there are none.
    """
    return list(dict.fromkeys(remark for part in parts if part is not None for remark in part.remarks))
