"""The sufficient statistics that every hypothesis about one equation is judged on; effects add columns to them."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.channels import ChannelSuspect
from bayes_greybox.discovery.suspects.memory import Memory
from bayes_greybox.model.frame import held_features, scaled_position
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.gp.hyper import HyperPrior, NoisePrior
from bayes_greybox.model.rows.equation_rows import Columns, EquationRows, Jumps
from bayes_greybox.physics.hidden_states import along
from bayes_greybox.physics.terms import Term

from .columns import Column
from .row_tables import table_of

FREE_SCALE = 10.0
"""Prior standard deviation of the coefficients of the user's own dictionary, scaled units: hardly a prior at all."""

CORRECTION_SCALE = 0.3
"""Prior standard deviation of a correction over the simulation's own coefficient."""

EFFECT_SCALE = 1.0
"""Prior standard deviation of an effect's coefficient, scaled units: its RMS in units of the gap's RMS."""

COLLINEAR = 1e-9
"""Share of a column's square outside the span of the model's own terms below which it is no effect of its own."""


ZERO = "zero on all the data"
"""Why a term cannot serve whose columns are zero."""

PARALLEL = 1e-4
"""Share of a suspect's square outside another column's span below which the two are one."""


@dataclass
class SufficientStatistics:
    """Products FᵀR⁻¹F of F = [columns, features of f, target] for one equation, scaled to unit RMS.

    Attributes:
        rows: Rows of the equation.
        variables: What f depends on.
        centre, half_width: Their box in the data, user's units.
        basis: Features of f.
        kernel: Name of its base kernel.
        prior: Prior of η.
        columns: Terms; free ones first, then corrections, then effects.
        left_out: Effects that cannot be told from the model's own terms, or cannot be evaluated, with the reason.
        twins: Suspects left out because another column is the same, with its name.
        changes: By how much those of one prior standard deviation change its coefficient, user's units.
        shared: What the same rows have in common under any noise.
        path: States and inputs where terms are evaluated, in order of time, on rows of samples: what remembers follows
            from them.
        square: yᵀR⁻¹y; with `n_obs`, `noise` what the evidence needs beside the products.
        products: XᵀR⁻¹X of the columns; `with_target` XᵀR⁻¹y.
    """

    rows: EquationRows
    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    kernel: str
    prior: HyperPrior
    columns: list[Column] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    twins: dict[str, str] = field(default_factory=dict)
    changes: dict[str, float] = field(default_factory=dict)
    shared: dict[str, tuple[Columns, np.ndarray]] = field(default_factory=dict, repr=False)
    path: Trajectories | None = field(default=None, repr=False)
    _kinds: tuple[list[Column], int, dict[str, list[int]]] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        p, m = 0, self.basis.size
        self.products, self.with_target = np.zeros((p, p)), np.zeros(p)
        self._table = table_of(self.rows, self.evaluate_features, m, self._at_rows, self.shared)
        self.square = float(self._table.target @ self._table.target)

    @property
    def with_features(self) -> Float[np.ndarray, "n_column n_basis"]:
        """XᵀR⁻¹ψ; of rows that are kept, found when it is asked for: explanations without f do without."""
        return self._table.with_features

    @property
    def features(self) -> Float[np.ndarray, "n_basis n_basis"]:
        """ψᵀR⁻¹ψ."""
        return self._table.features[0]

    @property
    def features_target(self) -> Float[np.ndarray, " n_basis"]:
        """ψᵀR⁻¹y."""
        return self._table.features[1]

    @property
    def equation(self) -> str:
        """The learned state."""
        return self.rows.equation

    @property
    def target_scale(self) -> float:
        """RMS of the measured rate less the simulation, user's units."""
        return self.rows.scale

    @property
    def n_obs(self) -> float:
        """Number of observations."""
        return float(self.rows.n_white)

    @property
    def noise(self) -> NoisePrior:
        """Prior of σ."""
        return self.prior.noise

    def of_kind(self, kind: str) -> list[int]:
        """Indices of the columns of one kind."""
        # Asked of thousands of columns, thousands of times; a column that is replaced stays of its kind.
        known = self._kinds
        if known is None or known[0] is not self.columns or known[1] != len(self.columns):
            kinds: dict[str, list[int]] = {}
            for i, column in enumerate(self.columns):
                kinds.setdefault(column.kind, []).append(i)
            known = self._kinds = self.columns, len(self.columns), kinds
        return list(known[2].get(kind, ()))

    def add(self, kind: str, items: Sequence[tuple[Term, dict]]) -> None:
        """Evaluate terms and extend the products by their columns; a term that cannot serve is left out, with a reason.

        Args:
            kind: Kind of the columns.
            items: Terms, with what their columns are to carry beside (nominal, effect, inner, log_weight), or the
                prior standard deviation of their coefficients (spread, user's units).

        Raises:
            InputError: A free term that is zero or not finite on the data.
        """
        kept, refused, known = [], {}, {}
        for (term, about), hidden in zip(items, self._hidden([term for term, _ in items]), strict=True):
            value = np.asarray(term.evaluate({**self.rows.columns, **hidden}), float)
            size = float(np.sqrt(np.mean(value**2))) if np.all(np.isfinite(value)) else np.nan
            if not size > 0 or not np.isfinite(size):
                why = ZERO if size == 0 else "not finite on all the data"
                if kind == "free":
                    raise InputError(f"Term {term.name!r} of equation {self.equation!r} is {why}: remove it.")
                if about.get("effect") is not None:
                    refused[about["effect"].slug] = why
                continue
            spread, about = about.get("spread"), {name: each for name, each in about.items() if name != "spread"}
            sd = {"free": FREE_SCALE, "effect": EFFECT_SCALE, "law": EFFECT_SCALE}.get(kind, 0.0)
            if spread is not None:
                sd = spread * size / self.target_scale
            if kind == "correction":
                sd = CORRECTION_SCALE * abs(about["nominal"]) * size / self.target_scale
            if kind == "effect" and about.get("nominal"):
                about["expected"] = about["nominal"] * size / self.target_scale
            kept.append(Column(kind, term, size, sd, **about))
            if hidden:
                known[len(kept) - 1] = value / size
        self.leave_out(refused, kept)
        if kept:
            at_rows = np.zeros((self.rows.n_row, len(kept)))
            plain = [k for k in range(len(kept)) if k not in known]
            chosen = [(kept[k].formula, kept[k].scale) for k in plain]
            if plain:
                table = self.rows.table(partial(evaluated, chosen), jumps=_jumps(chosen))
                at_rows[:, plain] = table(np.arange(self.rows.n_row))
            if known:
                at_rows[:, list(known)] = self.rows.operate(np.column_stack(list(known.values())))
                kept = [
                    replace(each, values=at_rows[:, k].copy()) if k in known else each for k, each in enumerate(kept)
                ]
            # Within a step of a path a term may leave its domain though it does not at the step's ends.
            inside = np.all(np.isfinite(at_rows), axis=0)
            if kind == "free" and not np.all(inside):
                out = kept[int(np.argmin(inside))].formula.name
                raise InputError(
                    f"Term {out!r} of equation {self.equation!r} is not finite on all the data: remove it."
                )
            refused = {
                each.effect.slug: "not finite on all the data"
                for each, there in zip(kept, inside, strict=True)
                if each.effect is not None and not there
            }
            kept = [each for each, there in zip(kept, inside, strict=True) if there]
            self.leave_out(refused, kept)
            if kept:
                self._extend(kept, at_rows[:, inside])

    def _hidden(self, terms: Sequence[Term]) -> list[dict[str, np.ndarray]]:
        """Hidden states of terms along the path, for each term; empty where it remembers nothing."""
        found: list[dict[str, np.ndarray]] = [{} for _ in terms]
        remember = [k for k, term in enumerate(terms) if term.states]
        if remember:
            assert self.path is not None
            fresh = np.diff(self.path.run, prepend=-1) != 0
            systems = [terms[k].states for k in remember]
            for k, values in zip(remember, along(systems, self.path.time, self.path.columns, fresh), strict=True):
                found[k] = values
        return found

    def suspect(
        self,
        suspects: Sequence[tuple[ChannelSuspect, Float[np.ndarray, " n"]]],
        found: Collection[str] = (),
        at_rows: bool = False,
    ) -> None:
        """Extend the products by suspects about channels; those that another column stands for already are left out.

        Args:
            suspects: Each with its column at the samples, user's units of the rate per unit of its size.
            found: Keys of suspects that were found already, which stay whatever else has the same column now.
            at_rows: Whether the columns are those of the rows: what a sensor does to what it shows, and to no force.
        """
        for suspect, value in suspects:
            size = float(np.sqrt(np.mean(value**2)))
            if not size > 0 or not np.isfinite(size):
                continue
            scaled = value / size if at_rows else self.rows.operate((value / size)[:, None])[:, 0]
            column = Column(
                "suspect", None, size, suspect.sd * size / self.target_scale, suspect=suspect, values=scaled
            )
            before = len(self.columns)
            self._extend([column], scaled[:, None])
            new = len(self.columns) > before and suspect.key not in found
            twin = self._twin(len(self.columns) - 1) if new else None
            if twin is None:
                continue
            other = self.columns[twin]
            if other.suspect is not None and other.sd < column.sd:
                # Two errors that look alike have one name; it may be as large as the larger of them.
                wider = replace(other.suspect, sd=other.suspect.sd * column.sd / other.sd)
                self.columns[twin] = replace(other, sd=column.sd, suspect=wider)
            self.twins[suspect.key], self.changes[suspect.key] = _called(other), suspect.sd * size / other.scale
            self._keep(list(range(len(self.columns) - 1)))

    def remember(self, memories: Iterable[tuple[Memory, Float[np.ndarray, "n n_element"]]]) -> None:
        """Extend the products by the elements of forces that remember.

        Args:
            memories: Each with what its elements do at the samples.
        """
        for memory, table in memories:
            size = np.sqrt(np.mean(table**2, axis=0))
            table, size = table[:, size > 0], size[size > 0]
            if not len(size):
                continue
            # All elements together are as large as one effect.
            sd, scaled = EFFECT_SCALE / math.sqrt(len(size)), self.rows.operate(table / size)
            self._multiply(
                [
                    Column("memory", None, float(each), sd, memory=memory, values=column)
                    for each, column in zip(size, scaled.T, strict=True)
                ],
                scaled,
            )

    def drop(self, kind: str) -> None:
        """Forget the columns of one kind."""
        self._keep([i for i, column in enumerate(self.columns) if column.kind != kind])

    def forget(self, first: int) -> None:
        """Forget the columns from this one on."""
        self._keep(list(range(first)))

    def with_noise(self, noise: RowNoise) -> "SufficientStatistics":
        """The same columns under another noise of the rows."""
        again = replace(self, rows=replace(self.rows, noise=noise), columns=[], left_out=dict(self.left_out), twins={})
        if self.columns:
            values = self.at_rows(range(len(self.columns)))
            # What can be told apart was settled under the first noise, so that columns keep their places.
            again._multiply(list(self.columns), values)
        again.twins, again.changes = dict(self.twins), dict(self.changes)
        return again

    def _extend(self, kept: list[Column], values: np.ndarray) -> None:
        """Add columns by their scaled values at the rows, but for those in the span of the model's own terms."""
        self._multiply(kept, values)
        self._drop_collinear(len(kept))

    def _multiply(self, kept: list[Column], values: np.ndarray) -> None:
        """Extend the products by columns."""
        with_old, corner, with_target = self._table.extend(values)
        self.products = np.block([[self.products, with_old], [with_old.T, corner]])
        self.with_target = np.concatenate([self.with_target, with_target])
        self.columns += kept

    def evaluate(
        self, indices: Sequence[int], columns: Mapping[str, np.ndarray]
    ) -> Float[np.ndarray, "n_row n_column"]:
        """Chosen columns at any samples, scaled; suspects are known at the rows of the equation only."""
        return evaluated([(self.columns[i].formula, self.columns[i].scale) for i in indices], columns)

    def at_rows(self, indices: Sequence[int]) -> Float[np.ndarray, "n_row n_column"]:
        """Chosen columns at the rows of the equation, scaled."""
        found = np.zeros((self.rows.n_row, len(indices)))
        formulas = [k for k, i in enumerate(indices) if self.columns[i].values is None]
        if formulas:
            chosen = [indices[k] for k in formulas]
            terms = [(self.columns[i].formula, self.columns[i].scale) for i in chosen]
            found[:, formulas] = self._table.at_rows(chosen, partial(evaluated, terms), _jumps(terms))
        for k, i in enumerate(indices):
            if (values := self.columns[i].values) is not None:
                found[:, k] = values
        return found

    def evaluate_features(self, columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n_row n_basis"]:
        """Features of f at any rows."""
        x = scaled_position(columns, self.variables, self.centre, self.half_width)
        return np.asarray(held_features(self.basis, x))

    def _drop_collinear(self, count: int) -> None:
        """Leave out new columns in the span of the model's own terms: of corrections, those that repeat a free term."""
        own = [*self.of_kind("free"), *self.of_kind("correction")]
        first = len(self.columns) - count
        keep = list(range(first))
        for i in range(first, len(self.columns)):
            # A suspect may well be a sum of the simulation's terms: with one number it says what they say with many.
            base = [
                j
                for j in own
                if j != i
                and j in keep
                and not (self.columns[i].kind == "suspect" and self.columns[j].kind == "correction")
            ]
            norm = self.products[i, i]
            if base:
                G, g = self.products[np.ix_(base, base)], self.products[base, i]
                outside = norm - g @ np.linalg.lstsq(G, g, rcond=1e-12)[0]
            else:
                outside = norm
            if not outside < COLLINEAR * norm:
                keep.append(i)
        why = "the model has this term already: a change of its coefficient is a recalibration"
        refused = {column.effect.slug: why for column in self.columns[first:] if column.effect is not None}
        self._keep(keep)
        self.leave_out(refused)

    def _twin(self, index: int) -> int | None:
        """A correction or suspect whose column is parallel to this one, if there is one."""
        for j in [*self.of_kind("correction"), *self.of_kind("suspect")]:
            norm = self.products[index, index] * self.products[j, j]
            if j != index and self.products[index, j] ** 2 > (1 - PARALLEL) * norm:
                return j
        return None

    def _keep(self, keep: list[int]) -> None:
        if len(keep) == len(self.columns):
            return
        self.columns = [self.columns[i] for i in keep]
        self.products = self.products[np.ix_(keep, keep)]
        self.with_target = self.with_target[keep]
        self._table.keep(keep)

    def leave_out(self, refused: Mapping[str, str], new: Sequence[Column] = ()) -> None:
        """Note effects that no column is left of, by another binding or another value of their inner parameter.

        Args:
            refused: Reasons by slug.
            new: Columns that are about to be added.
        """
        serving = {column.effect.slug for column in (*self.columns, *new) if column.effect is not None}
        self.left_out |= {slug: why for slug, why in refused.items() if slug not in serving}

    def explained(self, weight: Float[np.ndarray, " n_basis"]) -> Float[np.ndarray, " n_row"]:
        """What features with these weights are at the rows."""
        return self._table.explained(weight)

    def _at_rows(self) -> Float[np.ndarray, "n_row n_column"]:
        return self.at_rows(range(len(self.columns)))


def evaluated(chosen: Sequence[tuple[Term, float]], columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n k"]:
    """Terms over their scales."""
    parts = [np.asarray(term.evaluate(columns)) / scale for term, scale in chosen]
    return np.column_stack(parts) if parts else np.zeros((len(next(iter(columns.values()))), 0))


def _jumps(chosen: Sequence[tuple[Term, float]]) -> Jumps:
    """Those that may jump."""
    places = [k for k, (term, _) in enumerate(chosen) if term.jumps]
    return Jumps(places, partial(evaluated, [chosen[k] for k in places]))


def _called(column: Column) -> str:
    return column.suspect.key if column.suspect is not None else f"recalibration of {column.formula.name}"
