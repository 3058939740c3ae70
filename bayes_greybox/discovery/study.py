"""The missing-effect study: gap, where, what, honesty, add, show."""

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import pandas as pd
from rich.console import Console
from threadpoolctl import threadpool_limits

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.records import plain_rows
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.greybox import Fit, GreyBox
from bayes_greybox.inference.netcdf import versions
from bayes_greybox.model.assemble import nothing_left
from bayes_greybox.model.simulation import Simulation
from bayes_greybox.physics.effects import CatalogueSpec, load_catalogue
from bayes_greybox.physics.roles import bind_catalogue, roles_of, unbound
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import check_units

from .equation import EquationStudy, study_equation
from .gap import Amendment, FreePath, gap_rows
from .odds import Odds
from .rounds import NEGLIGIBLE, SUBSTANTIAL, TIED
from .sentence import sentence
from .table import CORRECTION_SCALE
from .where import GapMap, GapTrace

ORDER = ("no gap", "recalibrate", "named", "partly named", "unknown")
"""Verdicts; of several equations the last one in this order speaks for the study."""


@dataclass(frozen=True)
class Study:
    """What is missing from a simulation, with the evidence.

    Attributes:
        base: The model that was given.
        model: The amended model: the terms of the simulation and the effects that were found, as a dictionary.
        fit: NUTS posterior of the amended model; None with `settle=False`.
        train: Data the study learned from.
        test: Data it did not.
        verdict: "no gap", "recalibrate", "named", "partly named" or "unknown".
        sentence: The verdict in one sentence.
        effects: All effects that were weighed, best first: equation, slug, name, expression, probability, mean, sd,
            lower, upper, unit, tied_with, inner, status ("added" or "").
        hypotheses: Explanations of the first round by (equation, hypothesis).
        corrections: The simulation's own coefficients by (equation, term).
        where: Regions and windows.
        gap: Before and after, by (data, metric, variable).
        rounds: The ladder, by (equation, round).
        ties: Effects that the data cannot tell apart, and what would.
        maps: Gap over states, by equation.
        traces: Gap along time, by equation.
        paths: Free runs by state.
        left_out: Effects that were not weighed, by (equation, slug), with the reason.
        settings: Seed, catalogue, prior odds, thresholds, versions and seconds.
        amendments: Coefficients before and after, by equation.
    """

    base: GreyBox
    model: GreyBox
    fit: Fit | None
    train: Trajectories
    test: Trajectories | None
    verdict: str
    sentence: str
    effects: pd.DataFrame
    hypotheses: pd.DataFrame
    corrections: pd.DataFrame
    where: pd.DataFrame
    gap: pd.DataFrame
    rounds: pd.DataFrame
    ties: list[dict[str, Any]]
    maps: Mapping[str, GapMap]
    traces: Mapping[str, GapTrace]
    paths: Mapping[str, FreePath]
    left_out: Mapping[tuple[str, str], str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    amendments: Mapping[str, Amendment] = field(default_factory=dict)

    def free_run(self, data: Trajectories, interpolation: str | Sequence[str] | None = None) -> dict[str, FreePath]:
        """Free runs of the model before and after over other data, by state.

        Args:
            data: Times, starts and inputs to follow.
            interpolation: Of the inputs between samples, as in `find_missing_effects`.

        Raises:
            InputError: A state has no equation to integrate.
        """
        paths = gap_rows(self.base, self.amendments, data, "", True, interpolation)[1]
        if not paths:
            raise InputError("A state of the data has no equation to integrate: add it to the simulation.")
        return paths

    def record(self) -> dict[str, Any]:
        """Verdict, tables and settings as plain values, ready for JSON."""
        tables = ("effects", "hypotheses", "corrections", "where", "gap", "rounds")
        plain = {name: plain_rows(getattr(self, name)) for name in tables}
        left_out = [{"equation": e, "slug": s, "reason": r} for (e, s), r in self.left_out.items()]
        return {
            "verdict": self.verdict, "sentence": self.sentence, **plain, "ties": self.ties, "left_out": left_out,
            "settings": dict(self.settings),
        }  # fmt: skip

    def save(self, path: str | os.PathLike) -> None:
        """Write the amended model's posterior and the study's tables to one netCDF file; it opens with `bg.load`.

        Raises:
            InputError: The study has no posterior (settle=False); the destination cannot be written.
        """
        if self.fit is None:
            raise InputError("This study has no posterior to save: run find_missing_effects with settle=True.")
        self.fit.idata.attrs["missing_effects"] = json.dumps(self.record(), default=float)
        self.fit.save(path)

    def to_html(self, path: str | os.PathLike) -> None:
        """Write the report as one self-contained page."""
        # The page is made two rooms further on; the study only points there.
        import importlib

        importlib.import_module("bayes_greybox.report.study_page").study_html(self, path)

    def __repr__(self) -> str:
        """The verdict in words."""
        return f"Study: {self.verdict}\n{self.sentence}"


def find_missing_effects(
    model: GreyBox,
    train: Trajectories,
    test: Trajectories | None = None,
    *,
    catalogue: CatalogueSpec = "mechanical",
    roles: Mapping[str, str | Sequence[str]] | None = None,
    seed: int = 0,
    effects_at_most: int = 3,
    odds: Odds | None = None,
    settle: bool = True,
    free_runs: bool = True,
    interpolation: str | Sequence[str] | None = None,
    draws: int = 1000,
    tune: int = 1000,
    chains: int = 4,
    progress: bool = True,
) -> Study:
    """Find what a simulation lacks: where it disagrees with the data, which effect is missing, and the gap after.

    The simulation is believed: the coefficients of its additive terms change only where the data say so. Terms of the
    model's dictionary are free: their coefficients are learned in every explanation. Explanations are weighed by their
    evidence (see `inference.evidence`), all with a Gaussian process that can take what they leave over.

    Args:
        model: Simulation, and the terms whose coefficients are to be learned anyway. `model.discrepancy` says what f
            depends on.
        train: Measurements with the rates of the equations in question.
        test: Measurements that no decision is made on.
        catalogue: "mechanical", "fluid", "population", "electrical", "all", a TOML file of your own, or a list of
            these.
        roles: Columns by role where the package should not guess.
        seed: Seed of everything random.
        effects_at_most: Largest number of effects added to one equation.
        odds: Prior probabilities of the explanations.
        settle: Whether to sample the amended model by NUTS, and, where importance sampling is unsure of a finalist's
            evidence, to find that by NUTS and bridge sampling.
        free_runs: Whether to integrate simulation and amended model over the data.
        interpolation: Of the inputs between samples in free runs: "linear", "cubic" or "zoh" (held), for all or one
            for each. By default each input's own, linear or cubic, whichever foretells its samples better.
        draws: Draws a chain of the amended model.
        tune: Warm-up iterations of each chain.
        chains: Chains.
        progress: Whether to show progress.

    Raises:
        InputError: Data, model or catalogue that cannot be used; the message names what and the remedy.
    """
    started = time.perf_counter()
    odds = odds or Odds()
    equations = studied_equations(model, train)
    _check_data(model, equations, train, test, free_runs)
    loaded = load_catalogue(catalogue)
    seconds: dict[str, float] = {}
    findings: dict[str, EquationStudy] = {}
    console = Console(stderr=True, quiet=not progress)
    with threadpool_limits(1), console.status("Missing effects") as status:
        left_out: dict[tuple[str, str], str] = {}
        for name in equations:

            def say(text: str, name: str = name) -> None:
                status.update(f"{name}: {text}")

            say("reading the data")
            columns = roles_of(model.simulation, train.state_names, train.input_names, name, roles, train.units)
            left_out |= {(name, slug): why for slug, why in unbound(loaded, columns, train.units).items()}
            bound = bind_catalogue(loaded, columns, train.units)
            findings[name] = study_equation(model, train, name, bound, odds, effects_at_most, seed, settle, say)
            left_out |= {(name, slug): why for slug, why in findings[name].table.left_out.items()}
        seconds["explain"] = time.perf_counter() - started
        status.update("measuring the gap before and after")
        start = time.perf_counter()
        amendments = {name: found.amendment for name, found in findings.items()}
        parts = [("train", train), *([("test", test)] if test is not None else [])]
        measured = [gap_rows(model, amendments, data, part, free_runs, interpolation) for part, data in parts]
        seconds["gap"] = time.perf_counter() - start
    gap = pd.concat([table for table, _ in measured])
    amended = amended_model(model, train, findings)
    fit = None
    if settle:
        start = time.perf_counter()
        fit = amended.fit(train, draws=draws, tune=tune, chains=chains, seed=seed, progress=progress)
        # The fit's own model: it may have been given more features.
        amended, seconds["sample"] = replace(amended, discrepancy=fit.model.discrepancy), time.perf_counter() - start
    seconds["total"] = time.perf_counter() - started
    verdict = max((found.finding.verdict for found in findings.values()), key=ORDER.index)
    effects = pd.concat([found.effects(train) for found in findings.values()], ignore_index=True)
    return Study(
        base=model,
        model=amended,
        fit=fit,
        train=train,
        test=test,
        verdict=verdict,
        sentence=sentence(findings, verdict, effects, gap),
        effects=effects,
        hypotheses=pd.concat([found.hypotheses() for found in findings.values()]),
        corrections=pd.concat([found.corrections(train) for found in findings.values()]),
        where=pd.concat([found.where for found in findings.values()], ignore_index=True),
        gap=gap,
        rounds=pd.concat([found.ladder() for found in findings.values()]),
        ties=[tie for found in findings.values() for tie in found.ties(train)],
        maps={name: found.map for name, found in findings.items()},
        traces={name: found.trace for name, found in findings.items()},
        paths=measured[-1][1],
        left_out=left_out,
        settings={
            "seed": seed,
            "catalogue": catalogue if isinstance(catalogue, str) else str(catalogue),
            "effects_at_most": effects_at_most,
            "prior odds": asdict(odds),
            "thresholds": {
                "gap": "one noise standard deviation",
                "tie (share of the best probability)": TIED,
                "named below this share left to f": NEGLIGIBLE,
                "unknown above this share left to f": SUBSTANTIAL,
                "correction (prior SD over the coefficient)": CORRECTION_SCALE,
            },
            "versions": versions(),
            "seconds": seconds,
        },
        amendments=amendments,
    )


def studied_equations(model: GreyBox, data: Trajectories) -> tuple[str, ...]:
    """Equations a study looks at: those of the model's dictionary, or all whose measured rate the simulation misses.

    Raises:
        InputError: There is none.
    """
    if model.dictionary:
        return model.equations
    simulation = Simulation.of(model.simulation, data.state_names, data.input_names)
    kinematic = [n for n, e in simulation.expressions.items() if e.is_Symbol and str(e) in data.state_names]
    found = tuple(name for name in data.derivative_names if name not in kinematic)
    # Which equations of a function are kinematic cannot be read off it; but the data meet them exactly.
    rates = data.derivatives
    left = tuple(name for name in found if not nothing_left(rates[name] - simulation.on(data, name), rates[name]))
    if found and not left:
        raise InputError("The simulation equals every measured derivative exactly: there is nothing to look for.")
    if not found:
        raise InputError(
            "There is no equation to study: the data have no measured derivative of a state whose equation is more "
            "than another state; give derivatives=..., or compute them with data.differentiate()."
        )
    return left


def amended_model(model: GreyBox, data: Trajectories, findings: Mapping[str, EquationStudy]) -> GreyBox:
    """The model with the simulation's terms and the found effects as its dictionary."""
    dictionary: dict[str, list[Term]] = {}
    for name, found in findings.items():
        table = found.table
        own = [table.columns[i].term for i in (*table.of_kind("free"), *table.of_kind("correction"))]
        added = [table.columns[i].term for i in found.finding.base]
        # A dictionary needs a term; an offset is the least that can be asked for.
        dictionary[name] = [*own, *added] or [Term("1")]
    return replace(model, dictionary=dictionary)


def _check_data(
    model: GreyBox, equations: Sequence[str], train: Trajectories, test: Trajectories | None, free_runs: bool
) -> None:
    """Refuse before the search what the search or the gap after it could not use."""
    check_units({}, train.units, train.derivative_names, train.time_name)
    whole = callable(model.simulation) or set(train.state_names) <= {*(model.simulation or {}), *equations}
    for part, data in (("training", train), *([("test", test)] if test is not None else [])):
        missing = [name for name in train.columns if name not in data.columns]
        if missing:
            raise InputError(f"The {part} data have no {missing[0]!r}, which the training data have: add it.")
        short = [name for name, n in zip(data.run_names, data.run_lengths, strict=True) if n < 2]
        if free_runs and whole and short:
            raise InputError(
                f"Run {short[0]!r} of the {part} data has one row, and a free run needs two: leave that run out, or "
                "the free runs with free_runs=False."
            )
