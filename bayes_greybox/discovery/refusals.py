"""Refusals of a study before its search, and of experiments that cannot be simulated."""

from collections.abc import Collection, Sequence
from numbers import Integral, Real
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.noise.asked import Noise, check_asked
from bayes_greybox.model.noise.suspicions import LEAST_ROWS
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effect_tables import nearest
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.physics.integration.adaptive_steps import check_interpolation
from bayes_greybox.physics.simulation.code import require_traceable
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.units import check_units, require_units_of
from bayes_greybox.running.errors import InputError

from .odds import Odds


def check_settings(effects_at_most: Any, negligible: Any, odds: Any, interpolation: Any) -> None:
    """Refuse settings that no data can have.

    Raises:
        InputError: A setting that cannot be used, with the remedy.
    """
    if isinstance(effects_at_most, bool) or not isinstance(effects_at_most, Integral) or effects_at_most < 1:
        raise InputError(f"effects_at_most={effects_at_most!r} must be a whole number, at least 1.")
    if isinstance(negligible, bool) or not isinstance(negligible, Real) or not 0 <= float(negligible) < 1:
        raise InputError(f"negligible={negligible!r} must be a share of the modelled rate, from 0 to below 1.")
    if odds is not None and not isinstance(odds, Odds):
        raise InputError(f"odds is {type(odds).__name__}: give bg.Odds(...), such as bg.Odds(no_gap=0.5).")
    if interpolation is not None:
        check_interpolation(interpolation)


def check_rows(model: Program) -> None:
    """Refuse rows on which no study weighs anything.

    Raises:
        InputError: Such rows.
    """
    if not model.rows.studied:
        raise InputError(
            f"A study does not weigh explanations on {type(model.rows).__name__}: give "
            "GreyBox(rows=bg.TrajectoryRows()), or rates from data.differentiate(); or let "
            "GreyBox(dictionary=...).fit choose among candidate terms."
        )


def check_data(
    model: Program, equations: Sequence[str], train: Trajectories, test: Trajectories | None, free_runs: bool
) -> None:
    """Refuse data that the search, or the gap and the fit after it, could not use.

    Raises:
        InputError: Data that cannot be used, with the remedy.
    """
    check_units({}, train.units, train.derivative_names, train.time_name)
    if train.n_obs < LEAST_ROWS:
        raise InputError(
            f"The training data have {train.n_obs} rows, on which nothing can be told from noise: give at least "
            f"{LEAST_ROWS}."
        )
    learnable = (*model.states(train), *train.output_names)
    stranger = next((name for name in equations if name not in learnable), None)
    if stranger is not None:
        raise InputError(
            f"There is no state {stranger!r} whose equation could be learned, and the dictionary has terms for it: "
            f"leave GreyBox(dictionary=...) without it; {nearest(stranger, list(learnable))}"
        )
    simulation = model.simulator(train)
    # Outputs have no free run, and no part in that of states.
    integrable = not all(train.is_output(name) for name in equations)
    integrable = integrable and set(train.state_names) <= {*simulation.equations, *equations}
    for part, data in (("training", train), *([("test", test)] if test is not None else [])):
        missing = [name for name in train.columns if name not in data.columns]
        missing += [name for name in train.output_names if name not in data.output_names]
        if missing:
            raise InputError(f"The {part} data have no {missing[0]!r}, which the training data have: add it.")
        short = [name for name, n in zip(data.run_names, data.run_lengths, strict=True) if n < 2]
        if free_runs and integrable and short:
            raise InputError(
                f"Run {short[0]!r} of the {part} data has one row, and a free run needs two: leave that run out, or "
                "the free runs with free_runs=False."
            )
    if test is not None:
        require_units_of(test, train)
    if isinstance(model.noise, Noise):
        for name in equations:
            check_asked(model.noise, model.equation_rows(train, name))
    if free_runs and integrable:
        require_traceable(simulation, ", or leave the free runs out with free_runs=False")


def check_ranking(
    data: Trajectories, equations: Collection[str], numbers: tuple[int, int, float], described: Collection[str]
) -> None:
    """Refuse to rank experiments.

    Raises:
        InputError: A study of outputs or of an older file, impossible numbers, or settings without effect.
    """
    batch, outcomes, threshold = numbers
    if not equations:
        raise InputError("The study holds no explanations, as in files of before: run find_missing_effects again.")
    if any(data.is_output(name) for name in equations):
        raise InputError("What to measure next is found by simulating runs, and an output has none: study a rate.")
    if batch < 1 or outcomes < 2 or not threshold >= 0:
        raise InputError("Ranking needs a batch of at least 1, at least 2 outcomes and a threshold of at least 0.")
    if described:
        raise InputError(f"{', '.join(described)} describes default candidates: leave candidates out.")


def check_runs(simulation: Simulation, data: Trajectories, equations: Collection[str]) -> None:
    """Refuse a simulation that no experiment can be simulated with.

    Raises:
        InputError: A state without an equation, or without data.
    """
    if still := [name for name in simulation.states if name not in (*simulation.equations, *equations)]:
        raise InputError(f"The state {still[0]!r} has no equation to integrate: add it to the simulation.")
    if lacking := [name for name in simulation.states if name not in data.states]:
        raise InputError(f"The data lack the state {lacking[0]!r}: what runs reach is compared with its range.")


def check_candidate(candidate: Candidate, simulation: Simulation) -> None:
    """Refuse a candidate that the model cannot be simulated for.

    Raises:
        InputError: A start, an input or a sensor that is missing or unknown.
    """
    states, inputs, of = simulation.states, simulation.inputs, f"of candidate {candidate.name!r}"
    for what, given, needed in (("start", candidate.start, states), ("inputs", candidate.inputs, inputs)):
        if lacking := [name for name in needed if name not in given]:
            raise InputError(f"{what} {of}: {lacking[0]!r} is missing; give it a value.")
        if unknown := [name for name in given if name not in needed]:
            raise InputError(f"{what} {of}: there is no {unknown[0]!r} in the model.")
    if unknown := [name for name in candidate.sensors if name not in states]:
        raise InputError(f"sensors {of}: there is no state {unknown[0]!r}; there are {', '.join(states)}.")
