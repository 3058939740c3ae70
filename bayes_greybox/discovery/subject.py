"""The subject of a study: its equations, its data, and the effects that can act in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral, Real
from typing import Any

import numpy as np

from bayes_greybox.data.samples.averaging import averaged, longest_block
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.noise.asked import Noise, check_asked
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effect_tables import nearest
from bayes_greybox.physics.catalogue.effects import BoundEffect, Effect
from bayes_greybox.physics.catalogue.pairs import pairs_in_data
from bayes_greybox.physics.catalogue.roles import Columns, bind_catalogue, roles_of, unbound, unplayed_roles
from bayes_greybox.physics.integration.adaptive_steps import check_interpolation
from bayes_greybox.physics.simulation.code import require_traceable
from bayes_greybox.physics.simulation.reading import NO_STATES, readable
from bayes_greybox.physics.units import check_units, require_units_of
from bayes_greybox.running.errors import InputError

from .answer.equation_study import EquationStudy
from .decision.criteria import FEWEST_ROWS
from .odds import Odds


@dataclass(frozen=True)
class Subject:
    """Models and data of a study: the user's model as `given`, and about the means of stated coefficients.

    The data have all states and rates that terms are evaluated on.
    """

    given: Program
    model: Program
    equations: tuple[str, ...]
    train: Trajectories
    test: Trajectories | None
    block: int = 1
    held: bool = False

    @classmethod
    def of(cls, model: Program, train: Trajectories, test: Trajectories | None, free_runs: bool) -> "Subject":
        """Return model and data that can be studied; others are refused."""
        model = model.on(train)
        train, test = model.started(train), None if test is None else model.started(test)
        given = _at_estimate(model, train)
        model = given.centred()
        if not model.rows.studied:
            raise InputError(
                f"A study does not weigh explanations on {type(model.rows).__name__}: give "
                "GreyBox(rows=bg.TrajectoryRows()), or rates from data.differentiate(); or let "
                "GreyBox(dictionary=...).fit choose among candidate terms."
            )
        equations = studied_equations(model, train)
        check_data(model, equations, train, test, free_runs)
        block = longest_block(train, test)
        test = None if test is None else averaged(test, block)
        return cls(given, model, equations, averaged(train, block), test, block)._completed()

    def with_inputs(self, findings: Mapping[str, EquationStudy]) -> "Subject":
        """Return the same with the interpolation of inputs that the studies of its equations arrived at."""
        given, model = self.given, self.model
        for study in findings.values():
            given, model = study.source.with_inputs(given), study.source.with_inputs(model)
        if model is self.model:
            return self
        # The path between the samples is another one.
        return replace(self, given=given, model=model, held=True)._completed()

    def _completed(self) -> "Subject":
        """Return the same with the states and rates that terms are evaluated on."""

        def completed(data: Trajectories) -> Trajectories:
            for name in self.equations:
                data = self.model.rows.complete(data, name, self.model.simulator(data))
            return data

        return replace(self, train=completed(self.train), test=None if self.test is None else completed(self.test))

    @cached_property
    def pairs(self) -> Any:
        """Return position and speed by the data, for a simulation that cannot be read."""
        return None if readable(self.model.simulation) else pairs_in_data(self.model.simulator(self.train), self.train)

    def bound(
        self, name: str, catalogue: Sequence[Effect], roles: Mapping[str, str | Sequence[str]] | None
    ) -> tuple[tuple[BoundEffect, ...], dict[str, str], dict[str, str]]:
        """Return the effects on the columns of an equation; reasons against others, and roles unplayed, by slug."""
        train, model = self.train, self.model
        formulas = model.simulation if readable(model.simulation) else None
        of_data = Columns(train.state_names, train.input_names, train.output_names, train.units)
        columns = roles_of(formulas, of_data, name, roles, self.pairs)
        # A force may be measured as that of a machine or as that on it.
        effects = [effect.either_way() for effect in catalogue] if train.is_output(name) else catalogue
        left_out = dict(unbound(effects, columns, train.units))
        bound, taken = [], {*train.columns, *model.states(train)}
        no_path = "" if readable(model.simulation) else NO_STATES
        if not (model.rows.follows_path or train.is_output(name)):
            no_path = (
                "it remembers, and rows of rates follow no path along which that can be said: give samples, "
                'GreyBox(rows=bg.TrajectoryRows()), in a file [rows] kind = "trajectory"'
            )
        # Each of several outputs has hidden states of its own.
        mark = name if len(self.equations) > 1 else ""
        for effect in bind_catalogue(effects, columns, train.units):
            effect = replace(effect, mark=mark) if effect.effect.hidden else effect
            if no_path and effect.effect.hidden:
                left_out[effect.slug] = no_path
            elif taken & set(effect.hidden()):
                left_out[effect.slug] = (
                    "the model or the data have a state with the name of its hidden state: the effect is in the model "
                    "already"
                )
            else:
                bound.append(effect)
        return tuple(bound), left_out, unplayed_roles(effects, columns)


def _at_estimate(model: Program, train: Trajectories) -> Program:
    """Return a model whose learned parameters are linearised at their estimate, where nothing is missing."""
    if not model.named.curved:
        return model
    try:
        return replace(model, parameters=model.near(train)[0].parameters)
    except (InputError, np.linalg.LinAlgError):
        # A model that lacks much may have no estimate: the study starts at what is stated.
        return model


def studied_equations(model: Program, data: Trajectories) -> tuple[str, ...]:
    """Return the equations of a study, if any: those of the dictionary, or all that the simulation does not meet."""
    if model.dictionary:
        if len(model.equations) > len(model.blocks):
            raise InputError(
                f"A study on rows of samples looks at one equation, not at {', '.join(model.equations)} together: "
                "leave one in GreyBox(dictionary=...) and put what is known of the others into the simulation. Their "
                "coefficients can be estimated together by GreyBox.fit."
            )
        return model.equations
    simulation = model.simulator(data)
    if model.rows.follows_path:
        equations = tuple(name for name in simulation.equations if not simulation.kinematic(name))
        if len(equations) != 1:
            raise InputError(
                f"A study of samples looks at one equation, and the simulation has {len(equations) or 'none'} that "
                "could lack something: name the one in question with an empty list of terms, "
                f"GreyBox(dictionary={{{(equations or simulation.states)[0]!r}: []}}, ...), or give rates: "
                "derivatives=..., or data.differentiate()."
            )
        return equations
    names = (*data.derivative_names, *data.output_names)
    equations = tuple(name for name in names if not simulation.kinematic(name))
    # Which equations of a function are kinematic cannot be read off it; but the data meet them exactly.
    missed = tuple(name for name in equations if not model.equation_rows(data, name).nothing_left)
    if equations and not missed:
        what = "output" if all(data.is_output(name) for name in equations) else "derivative"
        raise InputError(f"The simulation equals every measured {what} exactly: there is nothing to look for.")
    if not equations:
        raise InputError(
            "There is no equation to study: the data have no measured derivative of a state whose equation is more "
            "than another state; give derivatives=..., or compute them with data.differentiate()."
        )
    return missed


def check_settings(effects_at_most: Any, negligible: Any, odds: Any, interpolation: Any) -> None:
    """Refuse settings that no data can have."""
    if isinstance(effects_at_most, bool) or not isinstance(effects_at_most, Integral) or effects_at_most < 1:
        raise InputError(f"effects_at_most={effects_at_most!r} must be a whole number, at least 1.")
    if isinstance(negligible, bool) or not isinstance(negligible, Real) or not 0 <= float(negligible) < 1:
        raise InputError(f"negligible={negligible!r} must be a share of the modelled rate, from 0 to below 1.")
    if odds is not None and not isinstance(odds, Odds):
        raise InputError(f"odds is {type(odds).__name__}: give bg.Odds(...), such as bg.Odds(no_gap=0.5).")
    if interpolation is not None:
        check_interpolation(interpolation)


def check_data(
    model: Program, equations: Sequence[str], train: Trajectories, test: Trajectories | None, free_runs: bool
) -> None:
    """Refuse data that the search, or the gap and the fit after it, could not use."""
    check_units({}, train.units, train.derivative_names, train.time_name)
    if train.n_obs < FEWEST_ROWS:
        raise InputError(
            f"The training data have {train.n_obs} rows, on which nothing can be told from noise: give at least "
            f"{FEWEST_ROWS}."
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
