"""Hidden states along measured columns, from where runs start.

Rows of rates and outputs have their columns as they were measured. A hidden state z with ż = r(x, u, z) and a known
start follows from these alone, wherever nothing that is learned acts on it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.physics.hidden_states import HiddenState, along
from bayes_greybox.physics.integration.adaptive_steps import one_for_each
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.running.errors import InputError

Interpolation = str | tuple[str, ...] | None
"""Interpolation of the inputs between samples, one for all or for each; None: as suits hidden states."""


def with_hidden(data: Trajectories, simulation: Simulation, interpolation: Interpolation = None) -> Trajectories:
    """Return the data with the hidden states of a simulation as further states, computed anew.

    Raises:
        InputError: A hidden state has no formula or no start, or leaves the range of numbers; earlier rows of the runs
            lack a column.
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
    held = held_inputs(data, interpolation)
    (paths,) = along([states], time, {**values, **starts}, np.diff(run, prepend=-1) != 0, held)
    for name, path in paths.items():
        if not np.all(np.isfinite(path)):
            raise InputError(
                f"The hidden state {name!r} does not stay finite along the data: check its formula and start."
            )
    seen = {name: column for name, column in data.states.items() if name in measured}
    return replace(data, states={**seen, **{name: path[own] for name, path in paths.items()}}, computed=tuple(names))


def held_inputs(data: Trajectories, interpolation: Interpolation) -> tuple[str, ...]:
    """Return the inputs that are held between samples."""
    kinds = one_for_each(interpolation or "linear", len(data.input_names))
    return tuple(name for name, kind in zip(data.input_names, kinds, strict=True) if kind == "zoh")


def _since_start(
    data: Trajectories, names: Sequence[str]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], dict[str, Float[np.ndarray, " n"]], Bool[np.ndarray, " n"]]:
    """Return time, number of the run and columns of the runs from their starts on; and which rows are the data's."""
    parts = [data]
    while (earlier := parts[0].before) is not None:
        parts.insert(0, earlier)
    parts = [part for part in parts if {*part.run_names} & {*data.run_names}]
    for part in parts:
        lacking = next((name for name in names if name not in part.columns), None)
        if lacking is not None and part is data:
            raise InputError(
                f"Hidden states depend on {lacking!r}, which is no state and no input of the data; there are "
                f"{', '.join(data.columns)}."
            )
        if lacking is not None:
            raise InputError(
                f"Hidden states depend on {lacking!r}, which the earlier rows of these runs lack: split the data when "
                "they have all their columns."
            )
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
