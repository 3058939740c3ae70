"""Remarks on the data, for pages and terminal."""

from bayes_greybox.data.trajectories import Trajectories


def data_remarks(*parts: Trajectories | None) -> list[str]:
    """Return what was done to training and held-out data and what of them is missing, each remark once."""
    return list(dict.fromkeys(remark for part in parts if part is not None for remark in part.remarks))
