"""Rows of measured or filtered rates: the rate at a time stamp is g + Φθ + f there, or the filter's mean around it.

An output takes the place of a rate: its equation is the same, without a derivative in it. Hidden states with a known
start follow from the columns.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.data.rates.rate_filter import RowOperator
from bayes_greybox.data.rates.sample_spread import SampleSpread
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.physics.hidden_states import HiddenState, along
from bayes_greybox.physics.integration.adaptive_steps import one_for_each
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .equation_rows import EquationRows, Evaluate
from .row_kind import RowKind, checked_interpolation

FEWEST_SAMPLES = 10.0
"""Samples per period of the fastest visible motion below which derivatives of samples are rough."""


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
        kinds = one_for_each(self.interpolation or "linear", len(data.input_names))
        return tuple(name for name, kind in zip(data.input_names, kinds, strict=True) if kind == "zoh")

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
        output = data.is_output(equation)
        columns = (data.columns, measured, simulated, noise, time, run)
        return EquationRows(equation, *columns, operator=operator, output=output, spread=spread)

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """Return the data with the hidden states that have a start."""
        return _with_hidden(data, simulation, self)

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


def _with_hidden(data: Trajectories, simulation: Simulation, kind: DerivativeRows) -> Trajectories:
    """Return the data with the hidden states of a simulation as further states, computed anew.

    A hidden state z with ż = r(x, u, z) and a known start follows from the measured columns alone.
    """
    measured = {name: column for name, column in data.columns.items() if name not in data.computed}
    names = [name for name in simulation.states if name not in measured]
    if not names:
        return data
    if simulation.code:
        raise InputError(f"Hidden states with a start need formulas, simulation={{{names[0]!r}: ...}}: it is code.")
    lacking = next((name for name in names if name not in simulation.equations), None)
    if lacking is not None:
        raise InputError(
            f"The hidden state {lacking!r} has a start and no formula: give simulation={{{lacking!r}: ...}}."
        )
    states = [HiddenState(name, to_text(simulation.formula(name)), name) for name in names]
    columns = {symbol for state in states for symbol in state.symbols} - {*names}
    given = {name: start for name, start in simulation.starts.items() if name in names and start != ""}
    columns |= {start for start in given.values() if isinstance(start, str)}
    time, run, values, own = _since_start(data, sorted(columns))
    starts = {
        name: values[start] if isinstance(start, str) else np.full(len(time), start) for name, start in given.items()
    }
    (paths,) = along([states], time, {**values, **starts}, np.diff(run, prepend=-1) != 0, kind.held(data))
    for name, path in paths.items():
        if not np.all(np.isfinite(path)):
            raise InputError(
                f"The hidden state {name!r} does not stay finite along the data: check its formula and start."
            )
    seen = {name: column for name, column in data.states.items() if name in measured}
    return replace(data, states={**seen, **{name: path[own] for name, path in paths.items()}}, computed=tuple(names))


def _since_start(
    data: Trajectories, names: Sequence[str]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], dict[str, Float[np.ndarray, " n"]], Bool[np.ndarray, " n"]]:
    """Return time, number of the run and columns of the runs from their starts on; and which rows are the data's."""
    parts = [data]
    while (earlier := parts[0].before) is not None:
        parts.insert(0, earlier)
    parts = [part for part in parts if {*part.run_names} & {*data.run_names}]
    lacking = [(name, part) for part in parts for name in names if name not in part.columns]
    if lacking:
        why = "the earlier rows of these runs lack: split the data when they have all their columns."
        if lacking[0][1] is data:
            why = f"is no state and no input of the data; there are {', '.join(data.columns)}."
        raise InputError(f"Hidden states depend on {lacking[0][0]!r}, which {why}")
    pieces = [
        (k, part, part.run == part.run_names.index(name))
        for k, name in enumerate(data.run_names)
        for part in parts
        if name in part.run_names
    ]
    run = np.concatenate([np.full(int(np.sum(rows)), k) for k, _, rows in pieces])
    own = np.concatenate([np.full(int(np.sum(rows)), part is data) for _, part, rows in pieces])
    time = np.concatenate([part.time[rows] for _, part, rows in pieces])
    return time, run, {name: np.concatenate([p.columns[name][rows] for _, p, rows in pieces]) for name in names}, own


def row_warnings(kind: RowKind, data: Trajectories, equation: str, simulation: Simulation) -> list[str]:
    """Return a sentence with its figures on each thing that is wrong with the rows of an equation.

    Noise in the regressors: s² mean (∂g/∂x)² of each state x with noise s against the noise variance σ² of the rate,
    since E[e | x] = s² ∇ log p(x) is a force that more rows make surer; s and σ from third differences of the samples.
    Truncation: what the filter takes from the simulation's rate when the states pass through it once more, against the
    gap. Sampling: samples per period of the frequency below which 99 % of the rate's power lies.
    """
    rows = kind.rows(data, equation, simulation)
    sentences = [*_noisy(data, equation, simulation), *_coarse(data, equation)]
    size, gap = _truncation(data, equation, simulation), float(np.sqrt(np.mean(rows.target**2)))
    if size > 0.1 * gap:
        sentences.append(
            f"The filter takes {size:.2g} from the simulation's {_called(data, equation)}, where {gap:.2g} is left to "
            "explain: coefficients of fast terms are off. Halve its window, and see whether they stay."
        )
    return sentences


def _noisy(data: Trajectories, equation: str, simulation: Simulation) -> list[str]:
    filtered, sentences = data.filter, []
    if filtered is not None and not filtered.finite:
        return []
    columns = np.column_stack([data.matrix(data.state_names), data.rate(equation)])
    *of_states, sigma = sample_noise(data.time, columns, data.run_lengths)
    noise = dict(zip(data.state_names, of_states, strict=True))
    if filtered is not None:
        steps = data.row_steps
        noise, sigma = filtered.noise_of_states(steps), filtered.noise_of_rate(equation, steps)
    here = simulation.on(data, equation)
    for name, s in noise.items():
        # Steps of the noise's own size, so that kinks count by how often they are crossed.
        moved = replace(data, states={**data.states, name: data.states[name] + s})
        reached = float(np.sqrt(np.mean((simulation.on(moved, equation) - here) ** 2)))
        if s > 0 and reached**2 > 0.1 * sigma**2:
            sentences.append(
                f"Noise of {s:.2g} in {name} reaches the simulation's {_called(data, equation)} with {reached:.2g}, "
                f"beside noise of {sigma:.2g} in the measured {data.target_in_words(equation)}: coefficients are "
                "biased, and more rows do not help."
            )
    return sentences


def _truncation(data: Trajectories, equation: str, simulation: Simulation) -> float:
    """Return the RMS of s ∗ g(x) − s ∗ g(s ∗ x), x the smoothed states."""
    filtered = data.filter
    if filtered is None or not filtered.finite or max(data.run_lengths) < 2 * filtered.window:
        return 0.0

    def smooth(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            name: RowOperator(filtered.column_weights(name), 1, data.run_lengths)(column[:, None])[:, 0]
            for name, column in values.items()
        }

    again = RowOperator(filtered.smoothing(equation), 1, data.run_lengths)
    time, run, states, inputs = (
        data.time[again.sample],
        data.run[again.sample],
        smooth(data.states),
        smooth(data.inputs),
    )
    part = replace(data, time=time, run=run, states=states, inputs=inputs, derivatives={}, noise={})
    lost = simulation.on(part, equation) - simulation.on(data, equation)[again.sample]
    last = RowOperator(again.weights, 1, again.row_lengths)
    return float(np.sqrt(np.mean(last(lost[:, None]) ** 2)))


def _coarse(data: Trajectories, equation: str) -> list[str]:
    longest = int(np.argmax(data.run_lengths))
    rate = data.rate(equation)[data.run == longest]
    if len(rate) < 4 * FEWEST_SAMPLES:
        return []
    power = np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(len(rate)))) ** 2
    # What all frequencies have alike is noise.
    power = np.maximum(power - 3 * np.median(power), 0.0)
    share: Float[np.ndarray, " n"] = np.cumsum(power) / np.sum(power)
    samples = len(rate) / max(1, int(np.searchsorted(share, 0.99)))
    if samples >= FEWEST_SAMPLES or math.isnan(samples):
        return []
    remedy = "sample faster" if data.is_output(equation) else "sample faster, or measure the rate"
    return [
        f"The fastest visible motion in {_called(data, equation, 'the ')} has {samples:.1f} samples a period, fewer "
        f"than {FEWEST_SAMPLES:.0f}: {remedy}."
    ]


def _called(data: Trajectories, equation: str, article: str = "") -> str:
    words = data.target_in_words(equation, article=article)
    return words if data.is_output(equation) else f"{words} of {equation}"
