"""The missing-effect study: gap, where, what, honesty, add, show. It samples nothing of the amended model."""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.data.samples.averaging import averaged, longest_block
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.model.rows.row_warnings import row_warnings
from bayes_greybox.physics.catalogue.loading import CatalogueSpec, load_catalogue
from bayes_greybox.physics.catalogue.pairs import pairs_in_data
from bayes_greybox.physics.catalogue.roles import bind_catalogue, roles_of, unbound, unplayed_roles
from bayes_greybox.physics.simulation.reading import NO_STATES, readable
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_rows
from bayes_greybox.running.stages import stage, stages

from .amended import amended_program, corrected_data
from .answer.amendment import Amendment
from .answer.checks.adequacy import FEWEST
from .answer.checks.sizes import other_sizes
from .answer.equation_study import EquationStudy
from .answer.explained import Explained, explained
from .answer.gap.free_runs import FreePath, FreeRuns
from .answer.gap.table import gap_rows
from .answer.where import GapMap, GapTrace
from .decision.criteria import Criteria
from .decision.reasons import Reason
from .equation import Question, study_equation
from .odds import Odds
from .refusals import check_data, check_rows, check_settings
from .regressors.regressors import CORRECTION_SCALE, Regressors
from .studied import studied_equations
from .suspects.channels import DELAY_STEPS, GAIN_SD, OFFSET_SD, ZERO_SD
from .verdict import verdict_of

log = logging.getLogger(__name__)

IN_MODEL = "the model or the data have a state with the name of its hidden state: the effect is in the model already"
"""Why an effect that a study found before is not weighed again."""

NO_CATALOGUE = "none"
"""What the settings of a study have for a catalogue where no effect was to be weighed."""

HELD_INPUTS = (
    "The samples are likelier with inputs that are held from each sample to the next than with lines or splines "
    "between them, and so they were taken. Say what they do: GreyBox(rows=bg.TrajectoryRows(interpolation=...)), in a "
    'file [rows] kind = "trajectory" with interpolation.'
)

AVERAGED = (
    "The sensors are read much more often than anything moves, so neighbouring samples were averaged, {m} at a time; "
    "all that this loses is noise. The study is about these averages, and a delay in samples counts them."
)


@dataclass(frozen=True)
class StudyResult:
    """What is missing from a simulation, with the evidence.

    Attributes:
        base: The model that was given.
        model: The amended model: the terms of the simulation and the effects that were found, as a dictionary.
        fit: NUTS posterior of the amended model; None where it was not sampled.
        train: Data the study learned from.
        test: Data it did not.
        corrected: The training data with what was found of the sensors undone, which the amended model is fitted to.
        verdict: One of `decide.VERDICTS`.
        effects: All effects that were weighed, best first: equation, slug, name, expression, probability, mean, sd,
            lower, upper, unit, tied_with, inner, hidden (rates of its hidden states by name), quantity (columns that it
            is a function of), status ("added"; "one of" for what could stand in its place; or ""), reverse (of an added
            one whose coefficient surely has the other sign than usual: what that means; else ""), agreement (the
            probability averaged over bagged records), family ("" of an effect that is its own).
        hypotheses: Explanations by (equation, hypothesis): no gap, recalibrate, instrument, unknown, and sets of
            effects; their probabilities sum to one. With agreement.
        memory: Probability that what has no name is a law of the states, something in time, or something that
            remembers; then of what is remembered; by (equation, memory).
        quantities: Probability and agreement that a law of these columns alone is missing, of one name, of several or
            of none, by (equation, quantity); none in files of before.
        instrument: Suspects about the measurement: equation, suspect, channel, probability, mean, sd, lower, upper,
            unit, samples (of a delay), lower_samples, upper_samples, status ("in the model" or ""), text.
        checks: Checks of the explanation that was settled on, by (equation, check): p (NaN of linearity),
            khat (of linearity alone), ok, text.
        against: What speaks against the verdict, in words.
        warnings: What the filter that computed the rates makes of them, with figures.
        corrections: The simulation's own coefficients by (equation, term): probability and agreement that one is off,
            and by how much if it is.
        where: Regions and windows.
        gap: Before and after, by (data, metric, variable).
        rounds: The likeliest set with no effect, with one, with two, by (equation, round).
        ties: Effects that the data cannot tell apart, and what would.
        maps: Gap over states, by equation.
        traces: Gap along time, by equation.
        paths: Free runs by state.
        left_out: Effects that were not weighed, by (equation, slug), with the reason.
        settings: Seed, catalogue, prior odds, thresholds, versions and seconds.
        amendments: Coefficients before and after, by equation.
        config: Text of the configuration file that asked for it; empty where none did.
        explanations: What the likely explanations of each equation say of data to come; none in files of before.
        counted: Rows that count, by equation, without those at which a sensor was at its end; none in files of before.
        reasons: Coded reasons against the verdict, whose texts `against` has.
        verdicts: Verdict of each equation by itself; none in files of before.
        lacking_roles: Roles that no column plays, by the (equation, slug) of the effects that need them.
    """

    base: Program
    model: Program
    fit: Posterior | None
    train: Trajectories
    test: Trajectories | None
    corrected: Trajectories
    verdict: str
    effects: pd.DataFrame
    hypotheses: pd.DataFrame
    memory: pd.DataFrame
    instrument: pd.DataFrame
    checks: pd.DataFrame
    against: tuple[str, ...]
    warnings: tuple[str, ...]
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
    config: str = ""
    explanations: Mapping[str, tuple[Explained, ...]] = field(default_factory=dict)
    counted: Mapping[str, int] = field(default_factory=dict)
    quantities: pd.DataFrame = field(default_factory=pd.DataFrame)
    reasons: tuple[Reason, ...] = ()
    verdicts: Mapping[str, str] = field(default_factory=dict)
    lacking_roles: Mapping[tuple[str, str], str] = field(default_factory=dict)

    @property
    def criteria(self) -> Criteria:
        """Criteria that the study was decided with; those of today where its file does not say."""
        recorded = self.settings.get("thresholds", {})
        return Criteria(**{each.name: recorded[each.name] for each in fields(Criteria) if each.name in recorded})

    def checkable(self, equation: str) -> bool:
        """Whether an equation has rows enough to check its residuals on."""
        return self.counted.get(equation, self.train.n_obs) >= FEWEST

    def record(self) -> dict[str, Any]:
        """Verdict, tables and settings as plain values, ready for JSON."""
        tables = (
            "effects", "hypotheses", "memory", "quantities", "instrument", "checks", "corrections", "where", "gap",
            "rounds",
        )  # fmt: skip
        plain = {name: plain_rows(getattr(self, name)) for name in tables}
        left_out = [{"equation": e, "slug": s, "reason": r} for (e, s), r in self.left_out.items()]
        return {
            "verdict": self.verdict, "against": list(self.against), "warnings": list(self.warnings),
            **plain, "ties": self.ties, "left_out": left_out,
            "settings": dict(self.settings),
        }  # fmt: skip


def investigate(
    model: Program,
    train: Trajectories,
    test: Trajectories | None = None,
    *,
    catalogue: CatalogueSpec = "mechanical",
    roles: Mapping[str, str | Sequence[str]] | None = None,
    seed: int = 0,
    effects_at_most: int = 3,
    negligible: float = Criteria.negligible,
    odds: Odds | None = None,
    settle: bool = True,
    free_runs: bool = True,
    interpolation: str | Sequence[str] | None = None,
    progress: bool = True,
) -> StudyResult:
    """Find what a simulation lacks, and the model with it added.

    The simulation is believed: the coefficients of its additive terms change only where the data say so. Terms of the
    model's dictionary are free: their coefficients are learned in every explanation. Explanations are weighed by their
    evidence (see `grid`), all beside an unknown force in time and a law of the states.

    Args:
        model: Simulation, and the terms whose coefficients are to be learned anyway.
        train: Measurements with the rates of the equations in question, or with the outputs.
        test: Measurements that no explanation is weighed on; they may only speak against the answer.
        catalogue: As for `find_missing_effects`, as are the settings that follow.
        roles: Columns by role.
        seed: Seed of everything random.
        effects_at_most: Largest number of effects added to one equation.
        negligible: See `Criteria`.
        odds: Prior probabilities of the explanations.
        settle: Without effect: the evidence is summed over the noise grid, and needs no sampling.
        free_runs: Whether to integrate simulation and amended model over the data.
        interpolation: Of the inputs between samples in free runs.
        progress: Whether to show progress.

    Returns:
        The result, whose amended model is not sampled yet.

    Raises:
        InputError: Data, model or catalogue that cannot be used; the message names what and the remedy.
    """
    started = time.perf_counter()
    check_settings(effects_at_most, negligible, odds, interpolation)
    odds, criteria = odds or Odds(), Criteria(negligible=negligible)
    given = model.on(train)
    model = given.centred()
    check_rows(model)
    equations = studied_equations(model, train)
    check_data(model, equations, train, test, free_runs)
    block = longest_block(train, test)
    train, test = averaged(train, block), None if test is None else averaged(test, block)
    train, test = _completed(model, equations, train), None if test is None else _completed(model, equations, test)
    # Without a catalogue suspects, corrections and f are weighed against nothing.
    loaded = () if catalogue in ([], ()) else load_catalogue(catalogue)
    seconds: dict[str, float] = {}
    findings: dict[str, EquationStudy] = {}
    formulas = model.simulation if readable(model.simulation) else None
    pairs = None if readable(model.simulation) else pairs_in_data(model.simulator(train), train)
    with threadpool_limits(1), stages(progress), stage("Weighing explanations") as line:
        left_out: dict[tuple[str, str], str] = {}
        lacking: dict[tuple[str, str], str] = {}
        for name in equations:

            def say(text: str, name: str = name) -> None:
                line.say(f"{name}: {text}")
                log.info("%s: %s", name, text)

            say("reading the data")
            columns = roles_of(
                formulas, train.state_names, train.input_names, name, roles, train.units, pairs,
                train.output_names,
            )  # fmt: skip
            # A force may be measured as that of a machine or as that on it.
            known = [effect.either_way() for effect in loaded] if train.is_output(name) else loaded
            left_out |= {(name, slug): why for slug, why in unbound(known, columns, train.units).items()}
            lacking |= {(name, slug): role for slug, role in unplayed_roles(known, columns).items()}
            bound = bind_catalogue(known, columns, train.units)
            if why := _memoryless(model, train, name):
                left_out |= {(name, effect.slug): why for effect in bound if effect.effect.hidden}
                bound = tuple(effect for effect in bound if not effect.effect.hidden)
            taken = {*train.columns, *model.states(train)}
            known_already = [effect for effect in bound if taken & set(effect.hidden())]
            left_out |= {(name, effect.slug): IN_MODEL for effect in known_already}
            bound = tuple(effect for effect in bound if effect not in known_already)
            each = odds.of_each(len(equations))
            question = Question(model, train, name, bound, each, effects_at_most, seed, criteria)
            findings[name] = study_equation(question, say)
            left_out |= {(name, slug): why for slug, why in findings[name].regressors.left_out.items()}
        asked, model = model, _with_inputs(model, findings)
        if model is not asked:
            # The path between the samples is another one.
            given, train = _with_inputs(given, findings), _completed(model, equations, train)
            test = None if test is None else _completed(model, equations, test)
        seconds["explain"] = time.perf_counter() - started
        line.say("measuring the gap before and after")
        log.info("measuring the gap before and after")
        start = time.perf_counter()
        amendments = {name: found.amendment for name, found in findings.items()}
        parts = [("train", train), *([("test", test)] if test is not None else [])]
        moving = {name: amendment for name, amendment in amendments.items() if not train.is_output(name)}
        runs = FreeRuns(model, moving, interpolation) if free_runs else None
        measured, lost = [], []
        for part, data in parts:
            try:
                measured.append(gap_rows(model, amendments, data, part, runs))
            except InputError as error:
                # The answer stands, but not against them.
                if part == "train" or model.rows.rates_measured:
                    raise
                lost = [f"The amended model could not be compared with held-out data: {error}"]
        seconds["gap"] = time.perf_counter() - start
    seconds["total"] = time.perf_counter() - started
    gap = pd.concat([table for table, _ in measured])
    filtered = equations if train.filter is not None else ()
    warnings = tuple(
        text for name in filtered for text in row_warnings(model.rows, train, name, model.simulator(train))
    )
    held = (() if model is asked else (HELD_INPUTS,)) + ((AVERAGED.format(m=block),) if block > 1 else ())
    counted = {name: found.counted for name, found in findings.items()}
    sizes = (text for found in findings.values() for text in other_sizes(found.regressors))
    said = _said_of(model, train, counted, settle)
    warnings = (*sizes, *held, *said, *lost, *model.simulator(train).warnings, *warnings)
    unfollowed = ("no path of the amended model follows held-out samples",) if lost else ()
    labels = {name: train.target_label(name) for name in findings}
    verdict, reasons = verdict_of({name: found.verdict for name, found in findings.items()}, gap, unfollowed, labels)
    return StudyResult(
        base=given,
        model=amended_program(given, findings, train),
        fit=None,
        train=train,
        test=test,
        corrected=corrected_data(train, findings),
        verdict=verdict,
        effects=pd.concat([found.effects(train) for found in findings.values()], ignore_index=True),
        hypotheses=pd.concat([found.hypotheses() for found in findings.values()]),
        memory=pd.concat([found.memory() for found in findings.values()]),
        quantities=pd.concat([found.quantities() for found in findings.values()]),
        instrument=pd.concat([found.instrument(train) for found in findings.values()], ignore_index=True),
        checks=pd.concat([found.check_table() for found in findings.values()]),
        against=tuple(each.text for each in reasons),
        warnings=warnings,
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
            "catalogue": catalogue if isinstance(catalogue, str) else str(catalogue) if loaded else NO_CATALOGUE,
            "effects_at_most": effects_at_most,
            "prior odds": asdict(odds),
            "thresholds": {
                "gap": "one noise standard deviation, or that of the gap where it is larger",
                **asdict(criteria),
                "delay (prior SD, sampling steps)": DELAY_STEPS,
                "gain (prior SD)": GAIN_SD,
                "offset of a rate (prior SD over its RMS)": OFFSET_SD,
                "offset of a state or an input (prior SD over its RMS)": ZERO_SD,
                "correction (prior SD over the coefficient)": CORRECTION_SCALE,
            },
            "rest beside the answer": {name: found.verdict.remains for name, found in findings.items()},
            "agree in practice": {name: found.verdict.negligible for name, found in findings.items()},
            "same as": {name: _same(found.regressors) for name, found in findings.items()},
            "versions": versions(),
            "seconds": seconds,
        },
        amendments=amendments,
        explanations={name: explained(found) for name, found in findings.items()},
        counted=counted,
        reasons=reasons,
        verdicts={name: found.verdict.code for name, found in findings.items()},
        lacking_roles=lacking,
    )


def _same(regressors: Regressors) -> dict[str, dict[str, Any]]:
    """Suspects that do what another does, or a coefficient that is off, and by how much, of one standard deviation."""
    return {key: {"what": other, "change": regressors.changes[key]} for key, other in regressors.twins.items()}


def _with_inputs(model: AnyProgram, findings: Mapping[str, EquationStudy]) -> AnyProgram:
    """A model with what inputs do between their samples as the studies of its equations found it."""
    for found in findings.values():
        model = found.source.with_inputs(model)
    return model


def _memoryless(model: Program, data: Trajectories, equation: str) -> str:
    """Why effects with memory cannot be weighed; empty where they can."""
    if data.is_output(equation):
        return "it remembers, and rows of an output follow no path: what it did before is not in them"
    if model.rows.rates_measured:
        return (
            "it remembers, and rows of rates follow no path along which that can be said: give samples, "
            'GreyBox(rows=bg.TrajectoryRows()), in a file [rows] kind = "trajectory"'
        )
    return "" if readable(model.simulation) else NO_STATES


def _completed(model: Program, equations: Sequence[str], data: Trajectories) -> Trajectories:
    """Data with the states and rates that terms are evaluated on."""
    for name in equations:
        data = model.rows.complete(data, name, model.simulator(data))
    return data


def _said_of(model: Program, train: Trajectories, counted: Mapping[str, int], settle: bool) -> list[str]:
    """What a study does not do with what it was given, in words."""
    said = []
    for name, n in counted.items():
        if n < FEWEST:
            fewer = f" of {train.n_obs}" if n < train.n_obs else ""
            rows = f"{n} rows" if n == train.n_obs else f"The {n}{fewer} rows that count"
            of = f" of {train.target_label(name)}" if len(counted) > 1 else ""
            said.append(
                f"{rows} are too few to check residuals{of} on: below {FEWEST} neither their whiteness nor the shape "
                "of the noise was tested."
            )
    if isinstance(model.noise, Noise) and not model.noise.white:
        where = "" if settle else ", and nothing was sampled (settle=False)"
        said.append(
            "The noise that GreyBox(noise=bg.Noise(...)) asks for concerns the posterior of the amended model "
            f"only{where}: the study weighs noise of its own accord."
        )
    return said
