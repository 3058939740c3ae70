"""What is kept of an equation's statistics once it was studied: columns of the model after, and the features of f."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.discovery.regressors.columns import Column, EvaluatedColumns
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.running.errors import InputError


@dataclass(frozen=True)
class KnownColumns(EvaluatedColumns):
    """The `EvaluatedColumns` of an `Amendment` that was read.

    Rows and products, which explanations are weighed on, are not kept.

    Attributes:
        equation: The learned state or output.
        columns: Terms of the model before and after.
        variables: What f depends on.
        centre, half_width: Their box in the data, user's units.
        basis: Features of f.
        target_scale: RMS of the measured rate less the simulation, user's units.
        path: States and inputs where terms were evaluated, on rows of samples.
    """

    equation: str
    columns: list[Column]
    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    target_scale: float
    path: Trajectories | None = None


def kept_amendment(amendment: Amendment) -> Amendment:
    """An amendment with what equations, free runs and predictions are made of, and nothing that weighs explanations.

    Args:
        amendment: Of a study. What undoes errors of its sensors in rows, a function, is not kept; their sizes are.
    """
    given, after, f = amendment.statistics, amendment.after, amendment.discrepancy
    used = {*given.of_kind("free"), *after.indices, *after.inner.ravel().tolist(), *(f.indices if f else ())}
    place = {index: k for k, index in enumerate(sorted(used))}

    def moved(indices: Sequence[int]) -> tuple[int, ...]:
        return tuple(place[int(index)] for index in indices)

    statistics = KnownColumns(
        given.equation,
        # Values at rows and suspects belong to rows.
        [replace(given.columns[index], values=None) for index in place],
        given.variables,
        given.centre,
        given.half_width,
        given.basis,
        given.target_scale,
        given.path,
    )
    inner = np.array([moved(draw.tolist()) for draw in after.inner], int).reshape(after.inner.shape)
    return replace(
        amendment,
        statistics=statistics,
        after=after._replace(
            indices=moved(after.indices),
            inner=inner,
            suspects=(),
            suspect_draws=np.zeros((len(after.draws), 0)),
        ),
        discrepancy=None if f is None else replace(f, statistics=statistics, indices=moved(f.indices)),
        corrected=lost,
        # A file cannot hold the code of a kind of rows of the user's own.
        rows=amendment.rows if type(amendment.rows) in ROW_KINDS.values() else None,
    )


def lost(data: Trajectories) -> Trajectories:
    """Stands for what undoes errors of sensors in rows.

    Raises:
        InputError: Always: a file holds how large these errors are, not what undoes them.
    """
    raise InputError(
        "A study that was read from a file knows its sensors' errors, not how rows lose them: run find_missing_effects "
        "again to put other data right."
    )
