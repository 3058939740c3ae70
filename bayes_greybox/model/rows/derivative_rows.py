"""Rows of measured or filtered rates: the rate at a time stamp is g + Φθ + f there, or the filter's mean around it.

An output is in the place of a rate: its equation is the same, without a derivative in it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.rates.rate_filter import RowOperator
from bayes_greybox.data.rates.sample_spread import SampleSpread
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .equation_rows import Columns, EquationRows
from .row_kind import RowKind


@dataclass(frozen=True)
class DerivativeRows(RowKind):
    """Rates at the time stamps, measured or filtered, with the noise that filtering gives them.

    A rate that a finite filter computed is a mean s ∗ ẋ of the true one over the filter's window, so what the equation
    says of it is s ∗ (g + Φθ + f), evaluated at the smoothed samples first. Such rows are thinned: neighbours whose
    noise has a correlation above 1/e repeat each other. Samples whose window reaches beyond their run have no row.
    Where a term jumps, a sample stands for the states around it (`SampleSpread`).

    Attributes:
        filter_terms: Whether terms go through the filter, and rows are thinned; without, each sample is a row that
            says Φ(h ∗ x), which is not h ∗ Φ(x) where Φ is not linear.
    """

    filter_terms: bool = True

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """The rows of one equation; see `RowKind.rows`."""
        measured, simulated = data.rate(equation), simulation.on(data, equation)
        noise, time, run = data.row_noise(equation), data.time, data.run
        operator, spread = self._operator(data, equation), None
        if operator is not None:
            assert data.filter is not None
            spread = SampleSpread.of({"t": data.time, **data.columns}, data.run_lengths, data.filter.noise_of_states())
            if not data.is_output(equation):
                simulated = _simulated(data, equation, simulation, spread)
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

    def in_words(self, data: Trajectories) -> str:
        """Measured or filtered rates, or outputs."""
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


def _simulated(
    data: Trajectories, equation: str, simulation: Simulation, spread: SampleSpread
) -> Float[np.ndarray, " n_obs"]:
    """What the simulation says at samples, over what they stand for."""
    states, inputs = simulation.states, simulation.inputs

    def rate(columns: Columns) -> Float[np.ndarray, "n 1"]:
        x, u = (
            np.stack([columns[name] for name in names], axis=-1) if names else np.zeros((len(columns["t"]), 0))
            for names in (states, inputs)
        )
        return simulation.rates(columns["t"], x, u)[:, [states.index(equation)]]

    return spread.mean(rate, spread.beside({"t": data.time, **data.columns}))[:, 0]
