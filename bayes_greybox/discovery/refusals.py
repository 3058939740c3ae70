"""What a study refuses before it searches."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.noise.asked import Noise, check_asked
from bayes_greybox.model.noise.suspicions import LEAST_ROWS
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effect_tables import nearest
from bayes_greybox.physics.integrate import check_interpolation
from bayes_greybox.physics.simulation.code import require_traceable
from bayes_greybox.physics.units import check_units, require_units_of

from .evidence.odds import Odds


def check_settings(effects_at_most: Any, odds: Any, interpolation: Any) -> None:
    """Refuse settings that no data can have.

    Args:
        effects_at_most: Largest number of effects of an equation.
        odds: Prior probabilities, if they were given.
        interpolation: Of the inputs in free runs, if it was given.

    Raises:
        InputError: What cannot be used, with the remedy.
    """
    if isinstance(effects_at_most, bool) or not isinstance(effects_at_most, Integral) or effects_at_most < 1:
        raise InputError(f"effects_at_most={effects_at_most!r} must be a whole number, at least 1.")
    if odds is not None and not isinstance(odds, Odds):
        raise InputError(f"odds is {type(odds).__name__}: give bg.Odds(...), such as bg.Odds(no_gap=0.5).")
    if interpolation is not None:
        check_interpolation(interpolation)


def check_rows(model: Program) -> None:
    """Refuse rows on which no study weighs anything.

    Args:
        model: The model.

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
    """Refuse before the search what the search, or the gap and the fit after it, could not use.

    Args:
        model: The model.
        equations: Studied.
        train: Training data.
        test: Held-out data.
        free_runs: Whether there are free runs.

    Raises:
        InputError: What cannot be used, with the remedy.
    """
    check_units({}, train.units, train.derivative_names, train.time_name)
    if train.n_obs < LEAST_ROWS:
        raise InputError(
            f"The training data have {train.n_obs} rows, on which nothing can be told from noise: give at least "
            f"{LEAST_ROWS}."
        )
    known = (*model.states(train), *train.output_names)
    stranger = next((name for name in equations if name not in known), None)
    if stranger is not None:
        raise InputError(
            f"There is no state {stranger!r} whose equation could be learned, and the dictionary has terms for it: "
            f"leave GreyBox(dictionary=...) without it; {nearest(stranger, list(known))}"
        )
    simulation = model.simulator(train)
    # Outputs have no free run, and no part in that of states.
    whole = not all(train.is_output(name) for name in equations)
    whole = whole and set(train.state_names) <= {*simulation.equations, *equations}
    for part, data in (("training", train), *([("test", test)] if test is not None else [])):
        missing = [
            *(name for name in train.columns if name not in data.columns),
            *(name for name in train.output_names if name not in data.output_names),
        ]
        if missing:
            raise InputError(f"The {part} data have no {missing[0]!r}, which the training data have: add it.")
        short = [name for name, n in zip(data.run_names, data.run_lengths, strict=True) if n < 2]
        if free_runs and whole and short:
            raise InputError(
                f"Run {short[0]!r} of the {part} data has one row, and a free run needs two: leave that run out, or "
                "the free runs with free_runs=False."
            )
    if test is not None:
        require_units_of(test, train)
    if isinstance(model.noise, Noise):
        for name in equations:
            check_asked(model.noise, model.equation_rows(train, name))
    if free_runs and whole:
        require_traceable(simulation, ", or leave the free runs out with free_runs=False")
