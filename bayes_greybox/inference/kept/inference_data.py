"""The groups of a fit as the object that the installed ArviZ takes."""

from typing import Any

import xarray as xr


def to_inferencedata(tree: xr.DataTree) -> Any:
    """A copy of the groups as what the functions of the installed `arviz` take.

    Args:
        tree: Groups of a fit.

    Returns:
        A `DataTree` where ArviZ is of its generation 1, which takes that; before it, an `arviz.InferenceData` of the
        same groups. The arrays are those of the tree, not copied.
    """
    import arviz  # some seconds, so not at the top

    # ArviZ 1 answers to the old name as well, with a warning and the class DataTree.
    kind = vars(arviz).get("InferenceData")
    if kind is None:
        return tree.copy()
    return kind(attrs=dict(tree.attrs), **{name: node.to_dataset() for name, node in tree.children.items()})
