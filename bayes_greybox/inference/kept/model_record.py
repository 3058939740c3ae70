"""Models as plain values, and back."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.priors import PRIORS, CustomPrior
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.physics.parameters import Parameter
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide, Simulation
from bayes_greybox.physics.simulation.reading import simulation_from, simulation_record
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError


def lost_program(n_term: int) -> Any:
    """Stand in for the program of a `CustomPrior`, which a file cannot hold, and raise InputError."""
    raise InputError(
        "The model's prior was a Python program, which a file cannot hold: build the model again to sample from it."
    )


@dataclasses.dataclass(frozen=True)
class LostRows(RowKind):
    """Placeholder for rows of a user-defined kind."""

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Refuse to build rows."""
        raise InputError(
            "The model's rows were of a class of your own, which a file cannot hold: build the model again and fit it."
        )


def describe(model: Program, data: Trajectories) -> dict[str, Any]:
    """Return a model as plain values, the inverse of `rebuild`; its expressions use the names of the data."""
    # A study may learn an equation that it was given no terms for.
    stated = {equation: model.stated(equation, data) for equation, terms in model.dictionary.items() if terms}
    terms = {
        equation: [_term_record(term) for term in part.all.terms if not term.parameter]
        for equation, part in stated.items()
    }
    priors = {
        equation: {term: c.record() for term, c in part.priors.items() if term not in model.parameters}
        for equation, part in stated.items()
    }
    return {
        "dictionary": {equation: terms.get(equation, []) for equation in model.dictionary},
        "simulation": simulation_record(model.simulation),
        "prior": _describe_part(model.prior, _class_names(PRIORS)),
        "discrepancy": None if model.discrepancy is None else dataclasses.asdict(model.discrepancy),
        "rows": _describe_part(model.rows, ROW_KINDS),
        "noise_floor": model.noise_floor,
        "noise": dataclasses.asdict(model.noise) if isinstance(model.noise, Noise) else model.noise,
        "coefficients": {equation: each for equation, each in priors.items() if each},
        "starts": dict(model.starts),
        "parameters": {name: dataclasses.asdict(each) for name, each in model.parameters.items()},
    }


def rebuild(record: Mapping[str, Any], simulation: RightHandSide | FMU | None = None) -> Program:
    """Return the model of a record from `describe`; raise InputError if it lacks the function of the simulation."""
    gp, noise = record["discrepancy"], record["noise"]
    return Program(
        dictionary={name: tuple(Term(**term) for term in terms) for name, terms in record["dictionary"].items()},
        simulation=simulation_from(record["simulation"], simulation),
        prior=_rebuild_part(record["prior"], _class_names(PRIORS), CustomPrior(lost_program)),
        discrepancy=None if gp is None else OrthogonalGP(**_fields(gp)),
        # Files from before there were kinds of rows have none.
        rows=_rebuild_part(record.get("rows", {"kind": "derivative"}), ROW_KINDS, LostRows()),
        noise_floor=record["noise_floor"],
        noise=Noise(**noise) if isinstance(noise, Mapping) else noise,
        # Files from before there were any have none.
        coefficients={
            equation: {term: Coefficient(**fields) for term, fields in priors.items()}
            for equation, priors in record.get("coefficients", {}).items()
        },
        starts=record.get("starts", {}),
        parameters={name: Parameter(**_fields(each)) for name, each in record.get("parameters", {}).items()},
    )


def _term_record(term: Term) -> dict[str, Any]:
    """Return a term with the settings of the coefficient that it carries itself."""
    settings = {key: getattr(term, key) for key in ("sign", "prior", "fixed", "bounds")}
    stated = {key: value for key, value in settings.items() if value is not None}
    return {"expression": to_text(term.expr), "name": term.name, "unit": term.unit, **stated}


def _class_names(registry: Mapping[str, type]) -> dict[str, type]:
    """Return the classes of a registry by class name, under which files have priors since the first version."""
    return {kind.__name__: kind for kind in registry.values()}


def _describe_part(part: Any, kinds: Mapping[str, type]) -> dict[str, Any]:
    """Return a part of a model as its kind and fields; for a user-defined class only the name."""
    for kind, known in kinds.items():
        if type(part) is known:
            return {"kind": kind, **dataclasses.asdict(part)}
    # The prefix tells it from a class of the package with the same name.
    return {"kind": f"own {type(part).__name__}"}


def _rebuild_part(record: Mapping[str, Any], kinds: Mapping[str, type], lost: Any) -> Any:
    """Return a part of a model from `_describe_part`, or `lost` in place of a user-defined class."""
    fields = _fields(record)
    kind = fields.pop("kind")
    return kinds[kind](**fields) if kind in kinds else lost


def _fields(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a class, with tuples in place of JSON's lists."""

    def plain(value: Any) -> Any:
        return tuple(plain(each) for each in value) if isinstance(value, list) else value

    return {key: plain(value) for key, value in record.items()}
