"""Rows of measured or filtered rates: the rate at a time stamp is g + Φθ + f there, or the filter's mean around it.

An output takes the place of a rate: its equation is the same, without a derivative in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.rates.rate_filter import RowOperator
from bayes_greybox.data.rates.sample_spread import SampleSpread
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .equation_rows import EquationRows, Evaluate
from .hidden_columns import held_inputs, with_hidden
from .row_kind import RowKind, checked_interpolation


@dataclass(frozen=True)
class DerivativeRows(RowKind):
    """Rates at the time stamps, measured or filtered, with the noise that filtering gives them.

    A rate that a finite filter computed is a mean s ∗ ẋ of the true one over the filter's window. The equation for it
    is therefore s ∗ (g + Φθ + f), evaluated at the smoothed samples first. Such rows are thinned: neighbours whose
    noise has a correlation above 1/e repeat each other. Samples whose window reaches beyond their run have no row.
    Where a term jumps, a sample stands for the states around it (`SampleSpread`), but not in a simulation that is code.

    Attributes:
        interpolation: Interpolation of the inputs between samples, which hidden states are driven by: "zoh" (held) for
            all, or one for each in their order; others go on, along cubics where the steps are even, else in lines.
        filter_terms: If true, terms go through the filter, and rows are thinned; else each sample is a row with
            Φ(h ∗ x), which is not h ∗ Φ(x) where Φ is not linear.
    """

    filter_terms: bool = True
    interpolation: str | tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "interpolation", checked_interpolation("DerivativeRows", self.interpolation))

    def between(self, interpolation: str | tuple[str, ...]) -> "DerivativeRows":
        """Return rows with an interpolation of the inputs, one for all or for each."""
        return replace(self, interpolation=interpolation)

    def held(self, data: Trajectories) -> tuple[str, ...]:
        """Return the inputs that are held between samples."""
        return held_inputs(data, self.interpolation)

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Return the rows of one equation; see `RowKind.rows`."""
        measured, simulated = data.rate(equation), simulation.on(data, equation)
        noise, time, run = data.row_noise(equation), data.time, data.run
        operator, spread = self._operator(data, equation), None
        if operator is not None:
            assert data.filter is not None
            noise_of_states = data.filter.noise_of_states(data.row_steps)
            spread = SampleSpread.of(data.columns, data.run_lengths, noise_of_states)
            simulated = simulated + _jumped(data, simulation.readable_terms(equation), spread)
            simulated, noise = operator(simulated[:, None])[:, 0], operator.noise(noise)
            measured, time, run = (column[operator.sample] for column in (measured, time, run))
        return EquationRows(
            equation=equation,
            columns=data.columns,
            measured=measured,
            simulated=simulated,
            noise=noise,
            time=time,
            run=run,
            operator=operator,
            output=data.is_output(equation),
            spread=spread,
        )

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """Return the data with the hidden states that have a start."""
        return with_hidden(data, simulation, self.interpolation)

    def in_words(self, data: Trajectories) -> str:
        """Return "measured rates", "filtered rates" or "measured outputs"."""
        return super().in_words(data) if data.filter is None else "filtered rates"

    def _operator(self, data: Trajectories, equation: str) -> RowOperator | None:
        rate_filter = data.filter
        if not self.filter_terms or rate_filter is None or not rate_filter.finite:
            return None
        operator = RowOperator(rate_filter.smoothing(equation), rate_filter.every, data.run_lengths)
        if not len(operator.sample):
            raise InputError(
                f"No run has {rate_filter.window} filtered rows, the window of its filter, whose terms a row of "
                f"{equation!r} is made of: use a shorter window, or GreyBox(rows=DerivativeRows(filter_terms=False))."
            )
        return operator


def _jumped(
    data: Trajectories, terms: Sequence[tuple[Term, float]], spread: SampleSpread
) -> Float[np.ndarray, " n_obs"]:
    """Return the simulation's terms that jump, averaged over what samples stand for, less their values at the samples.

    Code and FMUs are not read: they are evaluated at the samples, and nowhere else.
    """
    added = np.zeros(data.n_obs)
    for term, value in terms:
        if term.jumps and set(term.symbols) <= set(data.columns):
            at: Evaluate = lambda columns, term=term: np.asarray(term.evaluate(columns), float)[:, None]  # noqa: E731
            added += value * (spread.mean(at, spread.beside(data.columns)) - at(data.columns))[:, 0]
    return added
