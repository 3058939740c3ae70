"""One table of products that every hypothesis about one equation is judged on; effects add columns to it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import sympy
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.noise import BandedNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.evidence import DiscrepancyPrior, NoisePrior
from bayes_greybox.model.assemble import discrepancy_box, features_per_variable, scale_of, with_rounding
from bayes_greybox.model.discrepancy import OrthogonalGP
from bayes_greybox.model.features import HilbertBasis
from bayes_greybox.model.frame import held_features, scaled_position
from bayes_greybox.model.program import Program, measured_rate
from bayes_greybox.model.simulation import Simulation
from bayes_greybox.physics.effects import BoundEffect
from bayes_greybox.physics.terms import Dictionary, Term

CHUNK = 16_384
"""Rows evaluated at once."""

KEPT = 3e7
"""Numbers up to which the evaluated rows stay in memory; beyond, new columns cost another pass over the data."""

FREE_SCALE = 10.0
"""Prior standard deviation of the coefficients of the user's own dictionary, scaled units: hardly a prior at all."""

CORRECTION_SCALE = 0.3
"""Prior standard deviation of a correction over the simulation's own coefficient."""

EFFECT_SCALE = 1.0
"""Prior standard deviation of an effect's coefficient, scaled units: its RMS in units of the gap's RMS."""

FEATURES = {1: 40, 2: 16, 3: 10}
"""Features per variable when the user names none: finer than in a fit, since what is missing may be finer than what is
left after it was added, and no chain has to pay for them."""

COLLINEAR = 1e-9
"""Share of a column's square outside the span of the model's own terms below which it is no effect of its own."""


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes:
        kind: "free" (a term of the user's dictionary), "correction" (a term of the simulation) or "effect".
        term: Its formula over the data's columns.
        scale: RMS over the data, user's units.
        sd: Prior standard deviation of its coefficient, scaled units.
        nominal: The simulation's own coefficient, of a correction.
        effect: The catalogue's entry, of an effect.
        inner: Values of its inner parameter.
        log_weight: Log prior weight of these values.
    """

    kind: str
    term: Term
    scale: float
    sd: float
    nominal: float = 0.0
    effect: BoundEffect | None = None
    inner: Mapping[str, float] = field(default_factory=dict)
    log_weight: float = 0.0


@dataclass
class GapTable:
    """Products FᵀR⁻¹F of F = [columns, features of f, target] for one equation, scaled to unit RMS.

    Attributes:
        equation: The learned state.
        data: Training data.
        columns: Terms; free ones first, then corrections, then effects.
        target_scale: RMS of the measured rate less the simulation, user's units.
        square: yᵀR⁻¹y; with `n_obs`, `noise` what the evidence needs beside the products.
        products: XᵀR⁻¹X of the columns; `with_target` XᵀR⁻¹y; `with_features` XᵀR⁻¹ψ.
        features, features_target: ψᵀR⁻¹ψ and ψᵀR⁻¹y.
        left_out: Effects that cannot be told from the model's own terms, or cannot be evaluated, with the reason.
    """

    equation: str
    data: Trajectories
    target: Float[np.ndarray, " n_obs"]
    target_scale: float
    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    n_obs: float
    noise: NoisePrior
    prior: DiscrepancyPrior
    columns: list[Column] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        p, m = 0, self.basis.size
        self.products, self.with_target, self.with_features = np.zeros((p, p)), np.zeros(p), np.zeros((p, m))
        self.features, self.features_target, self.square = np.zeros((m, m)), np.zeros(m), 0.0
        self._kept: list[np.ndarray] | None = None
        self._known: np.ndarray | None = None
        blocks = [] if self.data.n_obs * (m + 1) <= KEPT or self.equation in self.data.noise else None
        for block in self._fixed():
            psi, y = block[:, :-1], block[:, -1]
            self.features += psi.T @ psi
            self.features_target += psi.T @ y
            self.square += float(y @ y)
            if blocks is not None:
                blocks.append(block)
        self._kept = blocks

    def of_kind(self, kind: str) -> list[int]:
        """Indices of the columns of one kind."""
        return [i for i, column in enumerate(self.columns) if column.kind == kind]

    def add(self, kind: str, items: Sequence[tuple[Term, dict]]) -> None:
        """Evaluate terms and extend the products by their columns; a term that cannot serve is left out, with a reason.

        Args:
            kind: Kind of the columns.
            items: Terms, with what their columns are to carry beside (nominal, effect, inner, log_weight).

        Raises:
            InputError: A free term that is zero or not finite on the data.
        """
        values, kept, refused = [], [], {}
        for term, about in items:
            value = np.asarray(term.evaluate(self.data.columns), float)
            size = float(np.sqrt(np.mean(value**2))) if np.all(np.isfinite(value)) else np.nan
            if not size > 0 or not np.isfinite(size):
                why = "zero on all the data" if size == 0 else "not finite on all the data"
                if kind == "free":
                    raise InputError(f"Term {term.name!r} of equation {self.equation!r} is {why}: remove it.")
                if about.get("effect") is not None:
                    refused[about["effect"].slug] = why
                continue
            sd = {"free": FREE_SCALE, "effect": EFFECT_SCALE}.get(kind, 0.0)
            if kind == "correction":
                sd = CORRECTION_SCALE * abs(about["nominal"]) * size / self.target_scale
            values.append(value / size)
            kept.append(Column(kind, term, size, sd, **about))
        self._leave_out(refused, [*self.columns, *kept])
        if not kept:
            return
        new = self._whitened(np.column_stack(values))
        old = self._evaluated()
        if self._kept is not None:
            self._known = np.hstack([old, new])
        cross_y, cross_psi, cross_old = [], [], []
        start = 0
        for fixed in self._blocks():
            part = new[start : start + len(fixed)]
            cross_psi.append(part.T @ fixed[:, :-1])
            cross_y.append(part.T @ fixed[:, -1])
            cross_old.append(part.T @ old[start : start + len(fixed)])
            start += len(fixed)
        with_old = sum(cross_old)
        corner = new.T @ new
        self.products = np.block([[self.products, np.transpose(with_old)], [with_old, corner]])
        self.with_target = np.concatenate([self.with_target, sum(cross_y)])
        self.with_features = np.vstack([self.with_features, sum(cross_psi)])
        self.columns += kept
        self._drop_collinear(len(kept))

    def rows(self, indices: Sequence[int], columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n_row n_column"]:
        """Chosen columns at any rows, scaled."""
        parts = [np.asarray(self.columns[i].term.evaluate(columns)) / self.columns[i].scale for i in indices]
        return np.column_stack(parts) if parts else np.zeros((len(next(iter(columns.values()))), 0))

    def residual(self, indices: Sequence[int], beta: Float[np.ndarray, " n_column"]) -> np.ndarray | None:
        """Whitened target less columns with these scaled coefficients; None where whitening leaves no order in time."""
        rows = self.target / self.target_scale - self.rows(indices, self.data.columns) @ beta
        noise = self.data.noise.get(self.equation)
        if noise is None:
            return rows
        return noise.whiten(rows[:, None])[:, 0] if isinstance(noise, BandedNoise) else None

    def feature_rows(self, columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n_row n_basis"]:
        """Features of f at any rows."""
        x = scaled_position(columns, self.variables, self.centre, self.half_width)
        return np.asarray(held_features(self.basis, x))

    def _drop_collinear(self, count: int) -> None:
        """Leave out new columns in the span of the model's own terms: of corrections, those that repeat a free term."""
        own = [i for i in range(len(self.columns)) if self.columns[i].kind != "effect"]
        first = len(self.columns) - count
        keep = list(range(first))
        for i in range(first, len(self.columns)):
            base = [j for j in own if j != i and j in keep]
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
        self._leave_out(refused, [self.columns[i] for i in keep])
        self.columns = [self.columns[i] for i in keep]
        self.products = self.products[np.ix_(keep, keep)]
        self.with_target, self.with_features = self.with_target[keep], self.with_features[keep]
        if self._known is not None:
            self._known = self._known[:, keep]

    def _leave_out(self, refused: Mapping[str, str], left: Sequence[Column]) -> None:
        """Note effects that no column is left of, by another binding or another value of their inner parameter."""
        serving = {column.effect.slug for column in left if column.effect is not None}
        self.left_out |= {slug: why for slug, why in refused.items() if slug not in serving}

    def _evaluated(self) -> np.ndarray:
        if self._known is not None:
            return self._known
        if not self.columns:
            return np.zeros((self._n_white(), 0))
        return self._whitened(self.rows(range(len(self.columns)), self.data.columns))

    def _n_white(self) -> int:
        noise = self.data.noise.get(self.equation)
        return self.data.n_obs if noise is None else noise.n_white

    def _whitened(self, rows: np.ndarray) -> np.ndarray:
        noise = self.data.noise.get(self.equation)
        return rows if noise is None else noise.whiten(rows)

    def _blocks(self) -> Iterator[np.ndarray]:
        return iter(self._kept) if self._kept is not None else self._fixed()

    def _fixed(self) -> Iterator[np.ndarray]:
        """[ψ y] in blocks; of correlated rows, all at once."""
        y = self.target / self.target_scale
        chunk = CHUNK if self.equation not in self.data.noise else self.data.n_obs
        for start in range(0, self.data.n_obs, chunk):
            part = {name: column[start : start + chunk] for name, column in self.data.columns.items()}
            yield self._whitened(np.column_stack([self.feature_rows(part), y[start : start + chunk]]))


def gap_table(model: Program, data: Trajectories, equation: str, effects: Sequence[BoundEffect]) -> GapTable:
    """Read one equation: its own dictionary, the terms of its simulation, the catalogue's effects, and features of f.

    Args:
        model: Simulation, dictionary and discrepancy.
        data: Training data.
        equation: The learned state.
        effects: Effects bound to columns of the data.

    Raises:
        InputError: The simulation equals the measurement exactly; a variable of f that is constant or unknown.
    """
    simulation = Simulation.of(model.simulation, data.state_names, data.input_names)
    measured = measured_rate(data, equation)
    target = measured - simulation.on(data, equation)
    target_scale = scale_of(target, measured, equation)
    gp = model.discrepancy or OrthogonalGP()
    variables, centre, half_width = discrepancy_box(gp, data)
    finer = FEATURES.get(len(variables))
    default = None if finer is None else (finer,) * len(variables)
    basis = HilbertBasis(gp.boundary, features_per_variable(gp, len(variables), default))
    noise = data.noise.get(equation)
    table = GapTable(
        equation=equation,
        data=data,
        target=target,
        target_scale=target_scale,
        variables=variables,
        centre=centre,
        half_width=half_width,
        basis=basis,
        n_obs=float(data.n_obs if noise is None else noise.n_white),
        noise=NoisePrior(with_rounding(measured / target_scale, model.noise_floor), model.noise),
        prior=DiscrepancyPrior(
            gp.amplitude, gp.length_scale, gp.length_scale_spread, gp.kernel, np.asarray(basis.frequency)
        ),
    )
    own = model.dictionary.get(equation, ())
    if own:
        names = (*data.state_names, *data.input_names)
        table.add("free", [(term, {}) for term in Dictionary.of(own, names).terms])
    if equation in simulation.expressions:
        parts = additive_terms(simulation.expressions[equation])
        table.add("correction", [(term, {"nominal": value}) for term, value in parts])
    table.add("effect", [item for effect in effects for item in nodes(effect, data)])
    return table


def nodes(effect: BoundEffect, data: Trajectories, values: np.ndarray | None = None) -> list[tuple[Term, dict]]:
    """The columns of one effect: one, or one for each value of its inner parameter with that value's prior weight.

    Args:
        effect: Effect bound to columns.
        data: Its range scales the inner parameter's prior.
        values: Increasing values of the inner parameter; its own grid by default.
    """
    if not effect.effect.inner:
        return [(effect.term(), {"effect": effect})]
    (inner,) = effect.effect.inner
    size = float(np.max(np.abs(data.column(effect.names[inner.of]))))
    if values is None:
        values = inner.nodes(size)[0]
    # Trapezoidal weights of the log-uniform prior, so that grids of any spacing can be mixed.
    position = np.log(np.asarray(values) / (inner.low * size)) / np.log(inner.high / inner.low)
    edges = np.clip(np.concatenate([[0.0], (position[1:] + position[:-1]) / 2, [1.0]]), 0.0, 1.0)
    weight = np.maximum(np.diff(edges), 1e-12)
    return [
        (
            effect.term({inner.name: float(v)}),
            {"effect": effect, "inner": {inner.name: float(v)}, "log_weight": float(w)},
        )
        for v, w in zip(values, np.log(weight), strict=True)
    ]


def additive_terms(expression: sympy.Expr) -> list[tuple[Term, float]]:
    """The additive terms of a simulation's expression, each with its coefficient: F - 2*y gives (F, 1) and (y, -2)."""
    found: dict[sympy.Expr, float] = {}
    for part in sympy.Add.make_args(sympy.expand(expression)):
        value, form = part.as_coeff_Mul()
        found[form] = found.get(form, 0.0) + float(value)
    return [(Term(form), value) for form, value in found.items() if value != 0]
