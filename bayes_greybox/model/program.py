"""The probabilistic program: simulation + sparse dictionary + orthogonal discrepancy, as a NumPyro model."""

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

from bayes_greybox.data.trajectories import Trajectories, require_measured
from bayes_greybox.model.estimate.near import at_estimate, near_estimate
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.hidden_states import HiddenState, read_starts
from bayes_greybox.physics.parameters import Parameter, moved_to, read_parameters
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.named_formulas import NamedFormulas
from bayes_greybox.physics.simulation.protocol import RightHandSide, Simulation
from bayes_greybox.physics.simulation.reading import (
    named_outputs,
    not_known,
    readable,
    simulation_of,
    with_states,
)
from bayes_greybox.physics.terms import Dictionary, Term, stating, terms_of
from bayes_greybox.physics.units import check_units, slope_unit, target_unit
from bayes_greybox.running.errors import InputError

from .assemble import assemble
from .coefficient import StatedTerms, by_block, centred, read_coefficients, stated_terms, used_states
from .design import Design
from .equation import Equation
from .estimate.evidence import LEAST_FLOOR
from .gp.discrepancy import OrthogonalGP
from .noise.asked import Noise, find_noise, is_number, noise_record
from .noise.noise_model import PROCESS
from .priors import Prior, SpikeAndSlab
from .rows.equation_rows import EquationRows, block_name
from .rows.kinds import AsMeasured
from .rows.row_kind import RowKind
from .sampling_program import SamplingProgram
from .sites import Sites


@dataclass(frozen=True)
class Program(SamplingProgram):
    """ẋ_i = g_i(x, u) + Φ_i(x, u)ᵀ θ_i + f_i(x, u) + ε, ε ~ N(0, σ² R), for each learned state i.

    The equation of an output has the output itself in place of ẋ_i.

    Attributes:
        dictionary: Candidate terms by learned state or output: strings, `Term`s (which may state priors of their
            coefficients), `polynomial(...)`, or a mix.
        simulation: The known part: expressions by state or output, a callable (t, x, u) -> dx/dt, or a
            `bg.FMU`; None: zero.
        prior: Prior on θ.
        discrepancy: The Gaussian process f, or None to leave it out.
        noise_floor: Least σ over the RMS of the target, which keeps the likelihood of noise-free data finite. The
            data's own rounding is added to it in quadrature.
        noise: Prior scale of σ over the RMS of the target: σ² = floor² + s², s ~ HalfNormal(`noise`); or a `Noise`,
            which may also be correlated, depend on the state or have heavy tails.
        rows: Kind of the rows of an equation; by default rates at time stamps, or outputs, if the data have any, else
            samples of a path.
        coefficients: Priors of single coefficients by equation and term, in user's units, which replace or limit
            `prior`; those stated by terms of the dictionary are added. A term whose coefficient is fixed belongs to the
            simulation, and f need not be orthogonal to it.
        parameters: Numbers with names in the formulas of the simulation, `{"m": bg.Parameter(2.0, sd=0.1), "k": 30.0}`.
            With a standard deviation one is learned, and its posterior stands among the coefficients; see `Parameter`.
        starts: Where hidden states start, on rows of rates and outputs, which need to know it: a number, the column
            that has the value there, or a parameter, `{"soc": 1.0}`.
    """

    dictionary: Mapping[str, Any] = field(default_factory=dict)
    simulation: Mapping[str, str] | RightHandSide | FMU | None = None
    prior: Prior = field(default_factory=SpikeAndSlab)
    discrepancy: OrthogonalGP | None = field(default_factory=OrthogonalGP)
    noise_floor: float = 1e-4
    noise: float | Noise = 1.0
    rows: RowKind = field(default_factory=AsMeasured)
    coefficients: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    starts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.dictionary, Mapping):
            raise InputError(
                "GreyBox(dictionary=...) must map each learned state to its candidate terms, for example "
                "{'ydot': ['y', 'y**3']}."
            )
        # Iterators are read once, here.
        if any(isinstance(terms, Iterator) for terms in self.dictionary.values()):
            lists = {name: [*each] if isinstance(each, Iterator) else each for name, each in self.dictionary.items()}
            object.__setattr__(self, "dictionary", lists)
        object.__setattr__(self, "coefficients", read_coefficients(self.coefficients, self.dictionary))
        object.__setattr__(self, "parameters", read_parameters(self.parameters))
        object.__setattr__(self, "starts", read_starts(self.starts))
        if isinstance(self.prior, type) or not isinstance(self.prior, Prior):
            raise InputError(f"GreyBox(prior={self.prior!r}) is not a prior: give one such as bg.Laplace(scale=0.5).")
        if not (self.discrepancy is None or isinstance(self.discrepancy, OrthogonalGP)):
            raise InputError(
                f"GreyBox(discrepancy={self.discrepancy!r}) must be bg.OrthogonalGP(...), or None to leave f out."
            )
        if isinstance(self.rows, type) or not isinstance(self.rows, RowKind):
            raise InputError(f"GreyBox(rows={self.rows!r}) must be a kind of rows, such as bg.DerivativeRows().")
        if not LEAST_FLOOR <= self.noise_floor < 1:
            raise InputError(
                f"GreyBox(noise_floor={self.noise_floor:g}) must lie between {LEAST_FLOOR:g} and 1: below that range, "
                "rounding decides which terms are likely."
            )
        n_equation = len(self.equations)
        if not self.rows.linear and not self.rows.shared and n_equation > 1:
            raise InputError(f"{type(self.rows).__name__} learn one equation, not {n_equation}.")
        if self.rows.shared and n_equation > 1 and self.discrepancy is not None:
            raise InputError(
                f"Rows of samples for {n_equation} equations cannot have a discrepancy: the samples "
                "do not show in which equation it acts. Use GreyBox(discrepancy=None), leave one equation in the "
                "dictionary, or give rates: derivatives=..., or data.differentiate()."
            )
        if not isinstance(self.noise, Noise) and not (is_number(self.noise) and 0 < self.noise < math.inf):
            raise InputError(f"GreyBox(noise={self.noise!r}) must be a positive number, or bg.Noise(...).")

    @cached_property
    def equations(self) -> tuple[str, ...]:
        """Learned states and outputs: those of the dictionary, and those with parameters that are learned."""
        return tuple(dict.fromkeys((*self.dictionary, *self.named.learned)))

    @cached_property
    def named(self) -> NamedFormulas:
        """Formulas with named parameters."""
        return NamedFormulas.of(self.simulation, self.parameters, self.starts)

    @property
    def blocks(self) -> dict[str, tuple[str, ...]]:
        """Learned states by block: each has its own rows, or all share them."""
        if self.rows.shared and self.equations:
            return {block_name(self.equations): self.equations}
        return {name: (name,) for name in self.equations}

    def block_of(self, equation: str | None) -> str:
        """Return the block of an equation, or with that name; the first, if None."""
        for block, equations in self.blocks.items():
            if equation in (None, block, *equations):
                return block
        raise InputError(f"There is no equation {equation!r}; the model learns {', '.join(self.equations)}.")

    def dictionaries(self, data: Trajectories) -> dict[str, Dictionary]:
        """Return the terms with coefficients to learn, by learned state, checked against the data's names and units."""
        if not self.equations:
            named = (*data.derivative_names, *data.state_names, *data.output_names)[0]
            variable = (*data.state_names, *data.input_names)[0]
            raise InputError(
                "The model has no dictionary, so there is nothing to fit: give "
                f"GreyBox(dictionary={{{named!r}: [{variable!r}]}}) or look for what the simulation misses with "
                "bg.find_missing_effects(model, data)."
            )
        states, outputs = self.states(data), data.output_names
        for equation in self.equations:
            if equation in self.starts:
                raise InputError(
                    f"{equation!r} is a hidden state that follows from its start: nothing in its equation can be "
                    "learned. Give it as a state of the data, or its parameters without a standard deviation."
                )
            if equation not in (*states, *outputs):
                near = difflib.get_close_matches(equation, (*states, *outputs), n=1)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                raise InputError(
                    f"The dictionary has an equation for {equation!r}, {not_known(equation, states, outputs, hint)}."
                )
        parsed = {equation: self.stated(equation, data) for equation in self.equations}
        terms = {equation: stated.all.terms for equation, stated in parsed.items()}
        check_units(terms, data.units, data.derivative_names, data.time_name)
        for equation, stated in parsed.items():
            if not stated.learned:
                raise InputError(
                    f"Every coefficient of {equation!r} is fixed, so there is nothing to learn: free one, or write the "
                    "terms into simulation=... and leave the equation out of the dictionary."
                )
        return {equation: Dictionary(stated.learned) for equation, stated in parsed.items()}

    def stated(self, equation: str, data: Trajectories) -> StatedTerms:
        """Return the terms of one equation with the priors stated for their coefficients."""
        slopes, terms = self.named.learned.get(equation, {}), self.dictionary.get(equation, ())
        if slopes:
            target = target_unit(equation, data)
            own = [Term(e, p, slope_unit(target, self.parameters[p].unit), parameter=p) for p, e in slopes.items()]
            terms = [*terms_of(terms), *own]
        return stated_terms(terms, self._priors(equation), (*self.states(data), *data.input_names), equation)

    def _priors(self, equation: str) -> dict[str, Coefficient]:
        """Return the stated priors of single coefficients of an equation, and those of its parameters."""
        parameters = {p: self.parameters[p].prior for p in self.named.learned.get(equation, {})}
        return {**self.coefficients.get(equation, {}), **parameters}

    @property
    def stating(self) -> bool:
        """True if priors of single coefficients or parameters are stated."""
        return any(self.coefficients.values()) or bool(self.named.learned)

    def learns(self, equation: str) -> bool:
        """Return True if an equation has terms or parameters with coefficients to learn."""
        return bool(self.dictionary.get(equation, ())) or equation in self.named.learned

    def along_parameters(self: "AnyProgram") -> "AnyProgram":
        """Return the model with rows near the values of its learned parameters, where they are linear only near one."""
        slopes = [(name, p, e) for name, each in self.named.learned.items() for p, e in each.items()]
        if self.rows.linear or not slopes:
            return self
        around = [(Term(e, p), self.parameters[p].here) for _, p, e in slopes]
        return replace(self, rows=self.rows.around(around, [name for name, *_ in slopes]))

    @property
    def prior_text(self) -> str:
        """The prior in words: its name, and the priors of single coefficients, `Normal (y N(-2, 0.1²); y**3 ≤ 0)`."""
        of = {name: f" of {name}" if len(self.equations) > 1 else "" for name in self.equations}
        stated = "; ".join(f"{term}{of[name]} {prior}" for name in of for term, prior in self._priors(name).items())
        return type(self.prior).__name__ + (f" ({stated})" if stated else "")

    @property
    def sites(self) -> Sites:
        """Names of the variables of each block of equations, in the model and in results."""
        return Sites(self.blocks)

    def centred(self) -> "Program":
        """Return the model with means of coefficients moved into its simulation; of learned parameters only changes."""
        if not self.coefficients and not self.named.learned:
            return self
        parameters = {name: replace(each, change=each.learned) for name, each in self.parameters.items()}
        # Priors stated by terms are in `coefficients`.
        dictionary = {
            name: [term.plain for term in terms_of(terms)] if stating(terms) else terms
            for name, terms in self.dictionary.items()
        }
        return replace(self, dictionary=dictionary, coefficients=centred(self.coefficients), parameters=parameters)

    def at(self: "AnyProgram", values: Mapping[str, float]) -> "AnyProgram":
        """Return the model with formulas linearised at values of their parameters; the others stay where they are."""
        return replace(self, parameters=moved_to(self.parameters, values)) if values else self

    def with_values(self: "AnyProgram", values: Mapping[str, float]) -> "AnyProgram":
        """Return the model with parameters that are numbers: these values, and those that the others have."""
        given = {p: Parameter(values.get(p, each.value), unit=each.unit) for p, each in self.parameters.items()}
        return replace(self, parameters=given) if given else self

    def simulator(self, data: Trajectories, lacking: bool = False) -> Simulation:
        """Return the simulation with fixed-coefficient terms, parsed with the names of the data.

        If `lacking`, the data may lack outputs that the model was fitted to: a name that is not a state is then one.
        """
        states, outputs, given = self.states(data), data.output_names, self.simulation
        if lacking:
            outputs = tuple(name for name in (*outputs, *named_outputs(given)) if name not in states)
        simulation = simulation_of(given, states, data.input_names, outputs, data.units, self.parameters, self.starts)
        stating = dict.fromkeys((*self.coefficients, *self.named.learned))
        return simulation.beside({name: self.stated(name, data).known for name in stating})

    def states(self, data: Trajectories) -> tuple[str, ...]:
        """Return the measured states, then hidden ones: those with a start, and those that rows allow to be hidden."""
        twice = next((name for name in self.starts if name in data.columns and name not in data.computed), None)
        if twice is not None:
            raise InputError(f"{twice!r} has a start, as a hidden state has, and is measured: leave it out of starts.")
        started = tuple(name for name in self.starts if name not in data.columns)
        if started and not self.rows.linear:
            raise InputError(
                f"The start of {started[0]!r} is for rows of rates and outputs: on rows of samples hidden states start "
                "anywhere, and where they do is found. Leave starts out, or give rates or outputs."
            )
        rates = self.simulation
        if readable(rates):
            rates = {**(rates or {}), **dict.fromkeys(used_states(self.dictionary, rates or {}, data.columns), "")}
        return (*data.state_names, *started, *self.rows.hidden(rates, data))

    def remembering(self: "AnyProgram", states: Sequence[HiddenState], data: Trajectories) -> "AnyProgram":
        """Return the model with more hidden states in its simulation; f does not depend on them."""
        if not states:
            return self
        discrepancy = self.discrepancy
        if discrepancy is not None and discrepancy.variables is None:
            discrepancy = replace(discrepancy, variables=(*self.states(data), *data.input_names))
        simulation = with_states(self.simulation, states)
        if self.rows.linear:
            starts = {**self.starts, **{state.name: state.start or state.rest for state in states}}
            return replace(self, simulation=simulation, discrepancy=discrepancy, starts=starts)
        starts = {state.name: state.start for state in states if state.start}
        rows = self.rows.resting({state.name: state.unit_of for state in states}, starts)
        return replace(self, simulation=simulation, discrepancy=discrepancy, rows=rows)

    def started(self, data: Trajectories) -> Trajectories:
        """Return the data with the hidden states that have a start, along what was measured."""
        if {*self.starts} <= {*data.columns}:
            return data
        return self.rows.complete_all(data, self.equations, self.simulator(data, lacking=True))

    def complete(self, data: Trajectories) -> Trajectories:
        """Return the data with every state and the learned rates at every sample, completed by the kind of rows."""
        require_measured(data)
        for equations in self.blocks.values():
            data = self.rows.complete_all(data, equations, self.simulator(data, lacking=True))
        return data

    def equation_rows(self, data: Trajectories, equation: str) -> EquationRows:
        """Return the rows of one equation, or of a block: measurements, simulated values, and noise."""
        return self.rows.shared_rows(data, self.blocks.get(equation, (equation,)), self.simulator(data))

    def assemble(self, data: Trajectories) -> dict[str, Equation]:
        """Read the data into rows, frames and designs by block: all the work that grows with the rows."""
        require_measured(data)
        dictionaries = by_block(self.blocks, self.dictionaries(data))
        rows = {equation: self.equation_rows(data, equation) for equation in dictionaries}
        models = self._find_noise(rows, dictionaries)
        rows = {equation: replace(r, noise=models[equation].noise) if models else r for equation, r in rows.items()}
        return {
            block: assemble(rows[block], dictionary, self.discrepancy, self.noise_floor, self.priors_of(block, data))
            for block, dictionary in dictionaries.items()
        }

    def priors_of(self, block: str, data: Trajectories) -> list[Coefficient | None]:
        """Return the priors of single coefficients of a block, term by term; None where only the model's applies."""
        each = [self.stated(equation, data) for equation in self.blocks[block]]
        return [stated.priors.get(term.name) for stated in each for term in stated.learned]

    def on(self: "AnyProgram", data: Trajectories) -> "AnyProgram":
        """Return the model with rows of the kind that suits training data, unless that kind was given."""
        require_measured(data)
        return replace(self, rows=self.rows.chosen(data))

    def near(self, data: Trajectories) -> "tuple[Program, Trajectories]":
        """Return the model with rows near its estimate on training data (see `near_estimate`), and completed data."""
        model = self.on(data)
        if model.named.curved:
            model = at_estimate(model, data, lambda each: each if each.rows.linear else near_estimate(each, data))
        elif not model.rows.linear:
            model = near_estimate(model, data)
        return model, model.started(data) if model.rows.linear else model.complete(data)

    def with_noise_found(self, data: Trajectories) -> "tuple[Program, Trajectories]":
        """Return the model and the training data, which carry R, with the noise parameters held fixed."""
        if not isinstance(self.noise, Noise) or self.noise.white:
            return self, data
        fresh = replace(self, noise=replace(self.noise, found=None))
        dictionaries = by_block(fresh.blocks, fresh.dictionaries(data))
        models = fresh._find_noise({name: fresh.equation_rows(data, name) for name in dictionaries}, dictionaries)
        noise = {**data.noise, **{name: model.noise.sensors for name, model in models.items()}}
        moved = [about["intensity"] for model in models.values() if (about := model.about.get(PROCESS))]
        rows = self.rows.moved_by(moved[0]) if moved else self.rows
        found = replace(self.noise, found={name: noise_record(model) for name, model in models.items()})
        return replace(fresh, rows=rows, noise=found), replace(data, noise=noise)

    def _find_noise(self, rows: Mapping[str, EquationRows], dictionaries: Mapping[str, Dictionary]) -> dict[str, Any]:
        """Return the noise model by equation; empty if the rows already have theirs."""
        if not isinstance(self.noise, Noise) or self.noise.white or self.noise.found is not None:
            return {}
        settings = self.discrepancy, self.noise_floor
        return {name: find_noise(self.noise, rows[name], terms, *settings) for name, terms in dictionaries.items()}

    def designs(self, data: Trajectories) -> dict[str, Design]:
        """Return the argument of `numpyro_model`: one design per equation."""
        return {name: equation.design for name, equation in self.assemble(data).items()}


AnyProgram = TypeVar("AnyProgram", bound=Program)
