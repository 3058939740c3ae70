"""The part of an equation's statistics that files keep: columns of the model after, and the features of f."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.discovery.regressors.columns import Column, EvaluatedColumns
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.running.errors import InputError

KEPT_ATTRIBUTES = ("equation", "variables", "centre", "half_width", "basis", "target_scale", "path")
"""Attributes of an equation's statistics that are kept as they are."""


@dataclass(frozen=True)
class KnownColumns(EvaluatedColumns):
    """The `EvaluatedColumns` of an `Amendment` that was read; rows and products are not kept.

    Attributes:
        equation: The learned state or output.
        columns: Terms of the model before and after.
        variables: Variables of f.
        centre, half_width: Box of the variables in the data, user's units.
        basis: Features of f.
        target_scale: RMS of the measured rate less the simulation, user's units.
        path: States and inputs at which terms were evaluated, on rows of samples.
    """

    equation: str
    columns: list[Column]
    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    target_scale: float
    path: Trajectories | None = None


@dataclass(frozen=True)
class Features:
    """Features of a discrepancy, which files of older versions hold of explanations; they are not used.

    Attributes:
        variables: Variables of f.
        centre: Middle of their box in the data, user's units.
        half_width: Half the sides of the box.
        basis: All features, on the box as [−1, 1]^d.
        kept: Numbers of the features of the explanation.
    """

    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    kept: Int[np.ndarray, " n_feature"]


def kept_amendment(amendment: Amendment) -> Amendment:
    """Return an amendment with the parts that equations, free runs and predictions need.

    The function that removes errors of the sensors is not kept; their sizes are.
    """
    statistics, after, f = amendment.statistics, amendment.after, amendment.discrepancy
    used = {*statistics.of_kind("free"), *after.indices, *after.inner.ravel().tolist(), *(f.indices if f else ())}
    place = {index: k for k, index in enumerate(sorted(used))}

    def moved(indices: Sequence[int]) -> tuple[int, ...]:
        return tuple(place[int(index)] for index in indices)

    kept = KnownColumns(
        # Values at rows belong to rows.
        columns=[replace(statistics.columns[index], values=None) for index in place],
        **{name: getattr(statistics, name) for name in KEPT_ATTRIBUTES},
    )
    inner = np.array([moved(draw.tolist()) for draw in after.inner], int).reshape(after.inner.shape)
    no_errors = {"suspects": (), "suspect_draws": np.zeros((len(after.draws), 0))}
    return replace(
        amendment,
        statistics=kept,
        after=after._replace(indices=moved(after.indices), inner=inner, **no_errors),
        discrepancy=None if f is None else replace(f, statistics=kept, indices=moved(f.indices)),
        corrected=lost,
        # A file cannot hold the code of a kind of rows of the user's own.
        rows=amendment.rows if type(amendment.rows) in ROW_KINDS.values() else None,
    )


def lost(data: Trajectories) -> Trajectories:
    """Stand for the function that removes errors of sensors.

    Raises:
        InputError: Always: a file holds the sizes of these errors, not that function.
    """
    raise InputError(
        "A study that was read from a file knows its sensors' errors, not how rows lose them: run find_missing_effects "
        "again to put other data right."
    )
