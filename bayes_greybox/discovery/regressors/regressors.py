"""All regressors of one equation, evaluated at its rows."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, FREE, FREE_SCALE, SENSOR, of_any_size
from bayes_greybox.discovery.sensor_errors.channels import ErrorColumns
from bayes_greybox.discovery.sensor_errors.memory import Memory
from bayes_greybox.model.algebra.truncated import log_mass
from bayes_greybox.model.rows.equation_rows import EquationRows, Jumps
from bayes_greybox.physics.hidden_states import along
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .columns import Column, EvaluatedColumns, evaluated

CORRECTION_SCALE, EFFECT_SCALE = 0.3, 1.0
"""Prior standard deviations of a correction, over the coefficient, and of an effect, over the gap's RMS."""

COLLINEAR, PARALLEL = 1e-9, 1e-4
"""Share of a column's square outside the span of the model's own terms below which it is no effect of its own; the same
of sensor errors and another column."""


ALWAYS_ZERO, NOT_FINITE = "zero on all the data", "not finite on all the data"
"""Reasons why a term cannot serve."""


@dataclass(eq=False)
class Regressors(EvaluatedColumns):
    """Regressors of one equation, scaled to unit RMS, with the target and the features of f.

    Attributes:
        acting: Regressors as forces at the samples of the rows; zero for errors of a sensor that shows the rows.
        shown: Effect on the rows, scaled, of the errors of sensors and parameters that they are free of; added to the
            target, so that a coefficient is a whole error.
        freed: Names of those errors.
        left_out: Effects that cannot be told from the model's own terms, or cannot be evaluated, with the reason.
        twins: Sensor errors left out because another column is the same, with its name.
        changes: Change of that column's coefficient by one prior standard deviation of these, user's units.
        memories: Elements of forces with memory: their effects on the rows, and themselves there.
        held: Inputs that stay between the nodes of the path.
        kept: Which nodes of the path have a row; None: all. What remembers goes on where rows are left out.
    """

    equation: str = field(init=False)
    target_scale: float = field(init=False)
    rows: EquationRows = field(kw_only=True)
    values: Float[np.ndarray, "n_row n_column"] = field(init=False)
    acting: Float[np.ndarray, "n_row n_column"] = field(init=False)
    shown: Float[np.ndarray, " n_row"] | float = 0.0
    freed: Collection[str] = ()
    left_out: dict[str, str] = field(default_factory=dict)
    twins: dict[str, str] = field(default_factory=dict)
    changes: dict[str, float] = field(default_factory=dict)
    memories: dict[Memory, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    kept: Bool[np.ndarray, " n_node"] | None = None

    def __post_init__(self) -> None:
        self.values = self.acting = np.zeros((self.rows.n_row, 0))
        self.equation, self.target_scale = self.rows.equation, self.rows.scale

    @property
    def target(self) -> Float[np.ndarray, " n_row"]:
        """Return the scaled target."""
        return self.rows.target / self.target_scale + self.shown

    def group(self, label: str) -> list[int]:
        """Return the columns of one effect on its own columns of the data."""
        return [i for i, c in enumerate(self.columns) if c.effect is not None and c.effect.label == label]

    def features(self) -> Float[np.ndarray, "n_row n_basis"]:
        """Return the features of f as they act on the rows."""
        return self.rows.table(self.evaluate_features)(np.arange(self.rows.n_row))

    def at_rows(self, indices: Sequence[int]) -> Float[np.ndarray, "n_row n_column"]:
        """Return chosen columns at the rows."""
        return self.values[:, list(indices)]

    def least_squares(self, indices: Sequence[int]) -> tuple[np.ndarray, float]:
        """Return coefficients of columns, and the sum of their squared residuals, whitened."""
        white = self.rows.whiten(np.column_stack([self.target, self.at_rows(indices)]))
        theta = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-12)[0]
        return theta, float(np.sum((white[:, 0] - white[:, 1:] @ theta) ** 2))

    @property
    def own(self) -> list[int]:
        """Return the columns of the user's own terms that may have any size: those without a stated prior."""
        return of_any_size(self.columns)

    def own_terms(self) -> tuple[tuple[Term, float], ...]:
        """Return the user's own terms of any size, with their coefficients by least squares, user's units."""
        sizes = self.least_squares(self.own)[0] * self.target_scale
        columns = [self.columns[i] for i in self.own]
        return tuple((c.term, size / c.scale) for c, size in zip(columns, sizes.tolist(), strict=True) if c.term)

    def add(self, kind: str, items: Sequence[tuple[Term, dict]]) -> None:
        """Evaluate terms and add their columns; a term that cannot serve is left out, with a reason.

        With the terms come fields of their columns, and the prior standard deviation of coefficients (spread) or the
        limits of a correction, both in user's units.

        Raises:
            InputError: A free term that is zero or not finite on the data.
        """
        kept, refused, along_path, forces = [], {}, {}, []
        each = hidden_columns([term for term, _ in items], self.path, self.held, self.kept)
        for (term, about), hidden in zip(items, each, strict=True):
            value = np.asarray(term.evaluate({**self.rows.columns, **hidden}), float)
            size = float(np.sqrt(np.mean(value**2))) if np.all(np.isfinite(value)) else np.nan
            if not size > 0 or not np.isfinite(size):
                why = ALWAYS_ZERO if size == 0 else NOT_FINITE
                self._require(kind, term, why)
                if about.get("effect") is not None:
                    refused[about["effect"].slug] = why
                continue
            kept.append(self._column(kind, term, size, about))
            forces.append(np.broadcast_to(value / size, len(next(iter(self.rows.columns.values()))))[self._place])
            if hidden:
                along_path[len(kept) - 1] = value / size
        self.leave_out(refused, kept)
        if not kept:
            return
        at_rows = self._at_rows(kept, along_path)
        # Within a step of a path a term may leave its domain though it does not at the step's ends.
        inside = np.all(np.isfinite(at_rows), axis=0)
        outside, kept = ([kept[k] for k in np.flatnonzero(which)] for which in (~inside, inside))
        for column in outside:
            self._require(kind, column.formula, NOT_FINITE)
        self.leave_out({column.effect.slug: NOT_FINITE for column in outside if column.effect is not None}, kept)
        self._extend(kept, at_rows[:, inside], np.column_stack(forces)[:, inside])

    def _require(self, kind: str, term: Term, why: str) -> None:
        if kind == FREE:
            raise InputError(f"Term {term.name!r} of equation {self.equation!r} is {why}: remove it.")

    def _column(self, kind: str, term: Term, size: float, about: Mapping) -> Column:
        spread, fields = about.get("spread"), {name: each for name, each in about.items() if name != "spread"}
        sd = {FREE: FREE_SCALE, EFFECT: EFFECT_SCALE}.get(kind, 0.0)
        if spread is not None:
            sd = spread * size / self.target_scale
        if kind == CORRECTION:
            # Of a parameter that is zero nothing says how large it might be.
            sd = CORRECTION_SCALE * abs(fields["nominal"]) * size / self.target_scale or EFFECT_SCALE
            # Changes that a parameter's bounds allow.
            least, most = (float(end) * size / self.target_scale / sd for end in fields.get("limits", Column.limits))
            fields["limits"] = (least, most)
            # The prior between the limits is whole.
            fields["log_weight"] = -float(log_mass(jnp.asarray(least), jnp.asarray(most)))
        if kind == EFFECT and fields.get("nominal"):
            fields["expected"] = fields["nominal"] * size / self.target_scale
        return Column(kind, term, size, sd, **fields)

    def _at_rows(self, kept: Sequence[Column], along_path: Mapping[int, np.ndarray]) -> np.ndarray:
        """Return columns at the rows; those of hidden states are known along the path."""
        at_rows = np.zeros((self.rows.n_row, len(kept)))
        plain = [k for k in range(len(kept)) if k not in along_path]
        chosen = [(kept[k].formula, kept[k].scale) for k in plain]
        if plain:
            table = self.rows.table(partial(evaluated, chosen), jumps=_jumps(chosen))
            at_rows[:, plain] = table(np.arange(self.rows.n_row))
        if along_path:
            at_rows[:, list(along_path)] = self.rows.operate(np.column_stack(list(along_path.values())))
        return at_rows

    def add_sensor_errors(self, suspects: ErrorColumns, found: Collection[str] = (), at_rows: bool = False) -> None:
        """Add sensor errors, columns of the rate per unit of their size, but for those that another column stands for.

        Errors `found` so far stay whatever else has the same column; `at_rows` are errors of a reading, which are no
        force.
        """
        for suspect, value in suspects:
            size = float(np.sqrt(np.mean(value**2)))
            # An error that is a share of what the simulation gives is none where it gives nothing.
            if not size > 0 or not np.isfinite(size) or not suspect.sd > 0:
                continue
            scaled = value / size if at_rows else self.rows.operate((value / size)[:, None])[:, 0]
            sd = suspect.sd * size / self.target_scale
            column = Column(SENSOR, None, size, sd, suspect=suspect)
            before = len(self.columns)
            force = np.zeros(self.rows.n_row) if at_rows else (value / size)[self._place]
            self._extend([column], scaled[:, None], force[:, None])
            new = len(self.columns) > before and suspect.key not in found
            twin = self._twin(len(self.columns) - 1) if new else None
            # One whose size is known cannot stand for another of any size.
            if twin is None or ((known := self.columns[twin].suspect) is not None and known.expected):
                continue
            other = self.columns[twin]
            if other.suspect is not None and other.sd < column.sd:
                # Two errors that look alike have one name; it may be as large as the larger of them.
                wider = replace(other.suspect, sd=other.suspect.sd * column.sd / other.sd)
                self.columns[twin] = replace(other, sd=column.sd, suspect=wider)
            self.twins[suspect.key], self.changes[suspect.key] = _called(other), suspect.sd * size / other.scale
            self.columns, self.values, self.acting = self.columns[:-1], self.values[:, :-1], self.acting[:, :-1]

    def remember(self, memories: Iterable[tuple[Memory, Float[np.ndarray, "n n_element"]]]) -> None:
        """Add forces with memory."""
        for memory, table in memories:
            size = np.sqrt(np.mean(table**2, axis=0))
            table, size = table[:, size > 0], size[size > 0]
            if len(size):
                self.memories[memory] = self.rows.operate(table / size), (table / size)[self._place]

    @property
    def _place(self) -> Any:
        """Return the places of the samples of the rows among the points that terms are evaluated at."""
        return slice(None) if self.rows.operator is None else self.rows.operator.place

    def _extend(self, kept: Sequence[Column], values: np.ndarray, acting: np.ndarray) -> None:
        """Add columns by their values at the rows, but for those in the span of the model's own terms."""
        own = [*self.of_kind(FREE), *self.of_kind(CORRECTION)]
        white = self.rows.whiten(np.hstack([self.values[:, own], values]))
        base, new = list(range(len(own))), []
        for k, column in enumerate(kept):
            place, norm = len(own) + k, float(white[:, len(own) + k] @ white[:, len(own) + k])
            # A sensor error may well be a sum of the simulation's terms: one number does the work of many.
            beside = base if column.kind != SENSOR else base[: len(self.of_kind(FREE))]
            outside = norm
            if beside:
                fitted = np.linalg.lstsq(white[:, beside], white[:, place], rcond=1e-12)[0]
                outside = float(np.sum((white[:, place] - white[:, beside] @ fitted) ** 2))
            spans = outside >= COLLINEAR * norm
            # One wrong mass is one parameter, though changes of all the others would do the same.
            if spans or column.parameter:
                new.append(k)
            if spans and column.kind in (FREE, CORRECTION):
                base.append(place)
        why = "the model has this term already: a change of its coefficient is a recalibration"
        refused = {c.effect.slug: why for k, c in enumerate(kept) if c.effect is not None and k not in new}
        self.columns += [kept[k] for k in new]
        self.values = np.hstack([self.values, values[:, new]])
        self.acting = np.hstack([self.acting, acting[:, new]])
        self.leave_out(refused)

    def _twin(self, index: int) -> int | None:
        """Return a correction or a sensor error whose column is parallel to this one, if there is one."""
        others = [j for j in [*self.of_kind(CORRECTION), *self.of_kind(SENSOR)] if j != index]
        white = self.rows.whiten(self.values[:, [index, *others]])
        products, squares = white[:, 0] @ white[:, 1:], np.sum(white**2, axis=0)
        parallel = np.flatnonzero(products**2 > (1 - PARALLEL) * squares[0] * squares[1:])
        return others[parallel[0]] if len(parallel) else None

    def leave_out(self, refused: Mapping[str, str], new: Sequence[Column] = ()) -> None:
        """Note effects that have no column left, by another binding or another value of a nonlinear parameter."""
        serving = {column.effect.slug for column in (*self.columns, *new) if column.effect is not None}
        self.left_out |= {slug: why for slug, why in refused.items() if slug not in serving}


def hidden_columns(
    terms: Sequence[Term], path: Trajectories | None, held: Sequence[str], kept: Bool[np.ndarray, " n_node"] | None
) -> list[dict[str, np.ndarray]]:
    """Return the hidden states of each term along a path, at the nodes that are kept; empty where it has none."""
    systems = {k: term.states for k, term in enumerate(terms) if term.states}
    if not systems:
        return [{} for _ in terms]
    assert path is not None
    fresh = np.diff(path.run, prepend=-1) != 0
    values = dict(zip(systems, along(list(systems.values()), path.time, path.columns, fresh, held), strict=True))
    at = slice(None) if kept is None else kept
    return [{name: x[at] for name, x in values.get(k, {}).items()} for k in range(len(terms))]


def _jumps(chosen: Sequence[tuple[Term, float]]) -> Jumps:
    places = [k for k, (term, _) in enumerate(chosen) if term.jumps]
    return Jumps(places, partial(evaluated, [chosen[k] for k in places]))


def _called(column: Column) -> str:
    return column.suspect.key if column.suspect is not None else f"recalibration of {column.formula.name}"
