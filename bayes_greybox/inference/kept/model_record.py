"""A model as plain values, and the model again."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.priors import PRIORS, CustomPrior
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide
from bayes_greybox.physics.simulation.reading import simulation_from, simulation_record
from bayes_greybox.physics.terms import Term

from .lost import LostRows, lost_program


def describe(model: Program, data: Trajectories) -> dict[str, Any]:
    """A model as plain values: the inverse of `rebuild`.

    Args:
        model: Model.
        data: Data that it was fitted to, whose names its expressions use.
    """
    # A study may learn an equation of which it was given no term.
    stated = {equation: model.stated(equation, data) for equation in model.equations if model.dictionary[equation]}
    terms = {
        equation: [
            {"expression": to_text(t.expr), "name": t.name, "unit": t.unit, **_stated(t)} for t in part.all.terms
        ]
        for equation, part in stated.items()
    }
    own = {equation: {term: c.record() for term, c in part.priors.items()} for equation, part in stated.items()}
    return {
        "dictionary": {equation: terms.get(equation, []) for equation in model.equations},
        "simulation": simulation_record(model.simulation),
        "prior": _describe_part(model.prior, _class_names(PRIORS)),
        "discrepancy": None if model.discrepancy is None else dataclasses.asdict(model.discrepancy),
        "rows": _describe_part(model.rows, ROW_KINDS),
        "noise_floor": model.noise_floor,
        "noise": dataclasses.asdict(model.noise) if isinstance(model.noise, Noise) else model.noise,
        "coefficients": {equation: priors for equation, priors in own.items() if priors},
    }


def rebuild(record: Mapping[str, Any], simulation: RightHandSide | FMU | None = None) -> Program:
    """A model from `describe`.

    Raises:
        InputError: If the simulation was a function and none is given.
    """
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
    )


def _stated(term: Term) -> dict[str, Any]:
    """What a term states of its own coefficient."""
    said = {key: getattr(term, key) for key in ("sign", "prior", "fixed", "bounds")}
    return {key: value for key, value in said.items() if value is not None}


def _class_names(registry: Mapping[str, type]) -> dict[str, type]:
    """The classes of a registry by their names, which stand in files for the priors since the first one."""
    return {kind.__name__: kind for kind in registry.values()}


def _describe_part(part: Any, kinds: Mapping[str, type]) -> dict[str, Any]:
    """A part of a model as plain values: its kind and its fields, or the name only of a class of the user's own."""
    for kind, known in kinds.items():
        if type(part) is known:
            return {"kind": kind, **dataclasses.asdict(part)}
    # It may be called as one of the package's is.
    return {"kind": f"own {type(part).__name__}"}


def _rebuild_part(record: Mapping[str, Any], kinds: Mapping[str, type], lost: Any) -> Any:
    """A part of a model from `_describe_part`.

    Args:
        record: Its kind and its fields.
        kinds: Classes by kind.
        lost: What stands for a class of the user's own.
    """
    fields = _fields(record)
    kind = fields.pop("kind")
    return kinds[kind](**fields) if kind in kinds else lost


def _fields(record: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a class, which has tuples where JSON has lists."""

    def plain(value: Any) -> Any:
        return tuple(plain(each) for each in value) if isinstance(value, list) else value

    return {key: plain(value) for key, value in record.items()}
