"""Weak rows: the equations integrated with test functions, so that no sample is ever differentiated.

A row says −∫ φ̇ x_k dt = ∫ φ (g_k + Φ_k θ + f) dt for a bump φ of finite support. The operator acts on evaluated
columns, V[Φ ψ]. Noise e of all states enters the row of one equation through φ̇ and through ∂(g + Φθ)/∂x, so that all
equations share the noise of their rows, R = L S Lᵀ, and one likelihood tells of all (see `weak_path`; Bortz, Messenger
& Dukic 2023, Bull. Math. Biol. 85:110). θ in ∂(g + Φθ)/∂x is frozen in a model that is taken anew near the likeliest
one. Bumps overlap: n is the number of rows that the rows before them do not tell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from annotated_types import Lt

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.weak.weak_form import FEWEST_RADIUS_STEPS
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import NotNegative, Positive, require_limits

from .equation_rows import Acting, EquationRows, block_name
from .path.reference_path import ReferencePath
from .row_kind import Remembered, RowKind, RowsOfRuns
from .weak_path import Common, Level, Reading, WeakPath, weak_path

_READINGS, _WEAK_PATHS = Remembered(), Remembered()

Share = Annotated[NotNegative, Lt(1)]
"""Share of a variance; all of it would leave no covariance."""

FIRST_WHITE_SHARES = (0.5, 0.2, 0.05, 0.01)
"""White shares of the first outer iterations: the frozen model may be far off, and some sums of rows
are exact under it alone."""


@dataclass(frozen=True)
class WeakRows(RowKind):
    """Integrals with test functions as rows, for samples of all states under moderate noise, chaotic ones too.

    Equations that the simulation gives have rows as well: what their rows say of the noise is known then in those of
    the learned ones. Without an expression an equation that is not learned has none.

    What is left of the noise in the rows beyond its first order, and what a cubic misses of the states, is not in R:
    where noise moves ∂(g + Φθ)/∂x by its own size, or samples are too few to follow the motion, intervals are too
    narrow, and rows of samples (`TrajectoryRows`) say it better. Inputs count as exact.

    Attributes:
        radius: Half the support of the test functions, units of time. By default the half window of the cubic that
            follows the fastest state best (least mean square error, by Stein's estimate), but at least eight steps.
        white_share: δ in (1 − δ) R + δ diag R, for what is not of first order; none where R is right. Some sums of rows
            are exact under the frozen model alone and outvote all others: while that is sought, δ is large.
        added: Terms and coefficients of the frozen model, beside the simulation: what a fit has found.
        added_to: The learned state of each of these.
    """

    linear = False
    shared = True
    studied = False

    radius: Positive | None = None
    white_share: Share = 0.0
    added: tuple[tuple[str, float], ...] = ()
    added_to: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # Files have lists for tuples.
        object.__setattr__(self, "added", tuple((str(text), float(value)) for text, value in self.added))
        object.__setattr__(self, "added_to", tuple(self.added_to))
        require_limits(self)

    def from_afar(self, iteration: int) -> "WeakRows":
        """Return the rows of an outer iteration in which the frozen model is found: at first more of R is diagonal."""
        if iteration >= len(FIRST_WHITE_SHARES):
            return self
        return replace(self, white_share=max(self.white_share, FIRST_WHITE_SHARES[iteration]))

    def in_words(self, data: Trajectories) -> str:
        """Return the names of the sampled states, in a few words."""
        return f"integrals of {', '.join((data.samples or data).state_names)} with test functions"

    def left_out(self, data: Trajectories) -> tuple[str, ...]:
        """Return a sentence on the test functions, and on what of the data has no row."""
        reading = _read(data.samples or data, self.radius)
        windows = ", ".join(
            f"{2 * m + 1} samples of {name}" for name, m in zip(data.state_names, reading.half_widths, strict=True)
        )
        unit = data.units.get("t", "")
        short = data.n_run - len(set(reading.bumps.run.tolist()))
        left = f"; {short} of {data.n_run} runs are too short for any" if short else ""
        return (
            f"test functions (1 - u^2)^8 of half width {reading.bumps.radius:.3g}{' ' + unit if unit else ''}, "
            f"{len(reading.bumps)} for each equation{left}; terms at states smoothed by cubics over {windows}",
        )

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """Return the data with the states that terms are evaluated at, and their slopes; samples go along."""
        path, samples = self._near(data, equations, simulation), data.samples or data
        index = [samples.state_names.index(name) for name in equations]
        return replace(
            data,
            states=dict(zip(samples.state_names, path.states.T, strict=True)),
            derivatives=dict(zip(equations, path.rates[:, index].T, strict=True)),
            noise={},
            samples=samples,
        )

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Return the rows of one equation."""
        return self.shared_rows(data, (equation,), simulation)

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """Return the rows that tell of all these equations; see `RowKind.shared_rows`."""
        path = self._near(data, equations, simulation)
        if not path.rows.n_row:
            raise InputError(
                f"No run is as long as a test function, {2 * path.reading.bumps.radius:.3g} in time and "
                f"{2 * FEWEST_RADIUS_STEPS + 1} samples without a gap: give longer runs or a smaller "
                "WeakRows(radius=...), or use GreyBox(rows=bg.TrajectoryRows()), which needs no test functions."
            )
        return _rows_of(path, equations, path.common.sizes)

    def of_runs(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> RowsOfRuns:
        """Return a function to rows with noise, windows and scales as these samples have them."""
        return partial(self._rows_like, self._near(data, equations, simulation).common)

    def _rows_like(
        self, common: Common, data: Trajectories, equations: tuple[str, ...], simulation: Simulation
    ) -> EquationRows:
        reading = Reading.of_windows(data, np.array(common.sd), common.half_widths, common.radius)
        return _rows_of(self._path(reading, equations, simulation, common.levels), equations, common.sizes)

    def path(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> ReferencePath:
        """Refuse: weak rows follow no path."""
        raise InputError("Weak rows follow no path from its start: for that use GreyBox(rows=bg.TrajectoryRows()).")

    def _near(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> WeakPath:
        samples = data.samples or data
        lacking = [name for name in simulation.states if name not in samples.states]
        if lacking:
            raise InputError(
                f"Weak rows need samples of all states, and those of {lacking[0]!r} are missing: give them, or use "
                "GreyBox(rows=bg.TrajectoryRows()), which does without."
            )

        key = (self, equations, simulation.key)
        return _WEAK_PATHS.result(samples, key, lambda: self._path(_read(samples, self.radius), equations, simulation))

    def _path(
        self, reading: Reading, equations: tuple[str, ...], simulation: Simulation, levels: Sequence[Level] = ()
    ) -> WeakPath:
        names = reading.samples.state_names
        with_rows = tuple(name for name in names if name in equations or name in simulation.equations)
        added: dict[str, list[tuple[Term, float]]] = {}
        to = self.added_to or (equations[0],) * len(self.added)
        for (text, value), name in zip(self.added, to, strict=True):
            added.setdefault(name, []).append((Term(text), value))
        return weak_path(reading, with_rows, simulation, simulation.beside(added), self.white_share, levels)


def _rows_of(path: WeakPath, equations: tuple[str, ...], sizes: Mapping[str, float]) -> EquationRows:
    """Return the rows of a path for learned equations; forces on each state are over their sizes."""
    largest = max(sizes[name] for name in equations)
    learned = {
        name: Acting(path.rows.learned[name].operator, sizes[name] / largest if largest > 0 else 1.0)
        for name in equations
    }
    operator = learned[equations[0]].operator
    return replace(path.rows, equation=block_name(equations), operator=operator, learned=learned)


def _read(samples: Trajectories, radius: float | None) -> Reading:
    return _READINGS.result(samples, radius, lambda: Reading.of(samples, radius))
