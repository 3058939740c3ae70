"""The missing-effect study: hypotheses, answer, gap before and after. It does not sample the extended model."""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import date
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.derivative_rows import row_warnings
from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.loading import CatalogueSpec, load_catalogue
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_rows
from bayes_greybox.running.stages import stage, stages

from .answer.amendment import Amendment
from .answer.checks import other_sizes
from .answer.equation_study import EquationStudy
from .answer.explained import Explained, explained
from .answer.free_runs import FreePath, FreeRuns
from .answer.gap import gap_rows
from .answer.where import GapMap, GapTrace
from .decision.criteria import Criteria
from .decision.reasons import Reason
from .decision.vetoes import verdict_of
from .equation import Question, study_equation
from .extended import corrected_data, extended_program
from .odds import Odds
from .regressors.regressors import CORRECTION_SCALE
from .sensor_errors.channels import DELAY_STEPS, GAIN_SD, OFFSET_SD, ZERO_SD
from .subject import Subject, check_settings

log = logging.getLogger(__name__)

Findings = Mapping[str, EquationStudy]
"""Studies by equation."""

BySlug = dict[tuple[str, str], str]
"""Reasons or roles by equation and slug."""

TABLES = (
    "effects", "hypotheses", "memory", "quantities", "instrument", "checks", "corrections", "where", "gap", "rounds"
)  # fmt: skip
"""Tables of a study's record."""

NO_CATALOGUE = "none"
"""Catalogue in the settings of a study that weighed no effect."""


@dataclass(frozen=True)
class StudySettings:
    """Settings of a study, as in `find_missing_effects`."""

    catalogue: CatalogueSpec = "mechanical"
    roles: Mapping[str, str | Sequence[str]] | None = None
    effects_at_most: int = 3
    negligible: float = Criteria.negligible
    odds: Odds | None = None
    free_runs: bool = True
    interpolation: str | Sequence[str] | None = None
    seed: int = 0
    settle: bool = True

    def __post_init__(self) -> None:
        check_settings(self.effects_at_most, self.negligible, self.odds, self.interpolation)

    @property
    def criteria(self) -> Criteria:
        """Return the deciding thresholds."""
        return Criteria(negligible=self.negligible)

    @property
    def prior(self) -> Odds:
        """Return the prior probabilities of the hypotheses."""
        return self.odds or Odds()

    @property
    def weighing(self) -> dict[str, Any]:
        """Return the settings that draws of the extended model depend on, besides those of its sampler."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name not in ("seed", "settle")}


@dataclass(frozen=True)
class StudyResult:
    """The effects that a simulation lacks, with the evidence.

    Attributes:
        base, model: The user's model, and the extended one, with the added effects and all terms as dictionary.
        fit: NUTS posterior of the extended model; None if it was not sampled.
        corrected: The training data, corrected for sensor errors, to fit the extended model to.
        verdict: One of `decide.VERDICTS`.
        effects: All weighed effects, best first: equation, slug, name, expression, probability, mean, sd, lower,
            upper, unit, tied_with, inner, hidden (rates of hidden states by name), quantity (columns it depends on),
            status ("added"; "one of" for a rival; or ""), reverse (meaning of an added effect whose coefficient surely
            has the other sign; else ""), agreement (probability averaged over bagged records), family.
        hypotheses: Explanations by (equation, hypothesis): no gap, recalibrate, instrument, unknown, and sets of
            effects; with agreement, and probabilities that sum to one.
        memory: Probability, by (equation, memory), that the discrepancy is a law of the states, something in time, or
            something that remembers; then of each law that remembers.
        quantities: Probability and agreement, by (equation, quantity), that a law of these columns alone is missing.
        instrument: Sensor errors: equation, suspect, channel, probability, mean, sd, lower, upper, unit, samples (of a
            delay), lower_samples, upper_samples, status ("in the model" or ""), text.
        checks: Checks of the answer's hypothesis, by (equation, check): p (NaN for linearity), khat (only
            for linearity), ok, text.
        against, reasons: Reasons against the verdict, in words and coded.
        warnings: Warnings about the data, the rates and the settings, in words.
        corrections: Corrections of the simulation by (equation, term): probability, agreement and size.
        where: Regions of states and windows of time with a large gap.
        gap: Errors before and after, by (data, metric, variable).
        rounds: The likeliest set with no effect, one, two and so on, by (equation, round).
        ties: Effects that the data cannot tell apart, and an experiment that would.
        maps, traces: Gap over states, and along time, by equation.
        paths: Free runs by state.
        left_out, lacking_roles: Reasons against weighing effects, and roles without a column, by (equation, slug).
        settings: Seed, catalogue, prior odds, thresholds, versions and seconds.
        amendments: Coefficients before and after, by equation.
        config: Text of the configuration file of the study; empty if there is none.
        explanations: Predictions of the likely hypotheses of each equation for future data.
        counted: Number of rows that count, by equation, without those where a sensor was clipped.
        verdicts: Verdict of each equation by itself.
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
        """Return the criteria that decided the study; today's where its file does not say."""
        recorded = self.settings.get("thresholds", {})
        return Criteria(**{each.name: recorded[each.name] for each in fields(Criteria) if each.name in recorded})

    def checkable(self, equation: str) -> bool:
        """Return whether an equation has enough rows to check its residuals."""
        return self.counted.get(equation, self.train.n_obs) >= self.criteria.checked_rows

    def record(self) -> dict[str, Any]:
        """Return verdict, tables and settings as plain values, ready for JSON."""
        return {
            "verdict": self.verdict, "against": list(self.against), "warnings": list(self.warnings),
            **{name: plain_rows(getattr(self, name)) for name in TABLES}, "ties": self.ties,
            "left_out": [{"equation": e, "slug": s, "reason": why} for (e, s), why in self.left_out.items()],
            "settings": dict(self.settings),
        }  # fmt: skip


def investigate(
    model: Program,
    train: Trajectories,
    test: Trajectories | None = None,
    settings: StudySettings | None = None,
    progress: bool = True,
) -> StudyResult:
    """Find the effects that a simulation lacks, and the model with them added, which is not sampled yet.

    Arguments are those of `find_missing_effects`.

    Raises:
        InputError: Data, model or catalogue that cannot be used; the message names the remedy.
    """
    started, settings = time.perf_counter(), settings or StudySettings()
    subject = Subject.of(model, train, test, settings.free_runs)
    # Without a catalogue, sensor errors, corrections and f have no rivals.
    catalogue = () if settings.catalogue in ([], ()) else load_catalogue(settings.catalogue)
    with threadpool_limits(1), stages(progress), stage("Weighing explanations") as line:

        def say(text: str) -> None:
            line.advance(0, text)
            log.info(text)

        findings, left_out, lacking = _findings(subject, settings, catalogue, say)
        subject = subject.with_inputs(findings)
        explained_at = time.perf_counter()
        say("measuring the gap before and after")
        gap, paths, lost = _measured_gap(subject, findings, settings)
        measured_at = time.perf_counter()
    seconds = {"explain": explained_at - started, "gap": measured_at - explained_at, "total": measured_at - started}
    warnings = tuple(_study_warnings(subject, findings, settings, lost))
    about = {**_recorded(findings, settings, bool(catalogue)), "seconds": seconds}
    notes = {"left_out": left_out, "lacking_roles": lacking, "paths": paths, "settings": about, "warnings": warnings}
    return _result(subject, findings, gap, lost, settings.criteria, **notes)


def _recorded(findings: Findings, settings: StudySettings, with_catalogue: bool) -> dict[str, Any]:
    in_words = str(settings.catalogue) if with_catalogue else NO_CATALOGUE
    return {
        "seed": settings.seed,
        "catalogue": settings.catalogue if isinstance(settings.catalogue, str) else in_words,
        "effects_at_most": settings.effects_at_most,
        "prior odds": asdict(settings.prior),
        "thresholds": {
            "gap": "one noise standard deviation, or that of the gap where it is larger",
            **asdict(settings.criteria),
            "delay (prior SD, sampling steps)": DELAY_STEPS,
            "gain (prior SD)": GAIN_SD,
            "offset of a rate (prior SD over its RMS)": OFFSET_SD,
            "offset of a state or an input (prior SD over its RMS)": ZERO_SD,
            "correction (prior SD over the coefficient)": CORRECTION_SCALE,
        },
        "rest beside the answer": {name: study.verdict.remains for name, study in findings.items()},
        "agree in practice": {name: study.verdict.negligible for name, study in findings.items()},
        # Sensor errors that share their column with another or a correction, and its change by one standard deviation.
        "same as": {
            name: {key: {"what": twin, "change": own.changes[key]} for key, twin in own.twins.items()}
            for name, own in ((name, study.regressors) for name, study in findings.items())
        },
        "versions": versions(),
        "date": date.today().isoformat(),
    }


def _findings(
    subject: Subject, settings: StudySettings, catalogue: Sequence[Effect], report: Callable[[str], None]
) -> tuple[dict[str, EquationStudy], BySlug, BySlug]:
    """Return each equation's study; by equation and slug, why effects were left out, and the roles they lack."""
    findings: dict[str, EquationStudy] = {}
    left_out: BySlug = {}
    lacking: BySlug = {}
    odds = settings.prior.of_each(len(subject.equations))
    for name in subject.equations:

        def say(text: str, name: str = name) -> None:
            report(f"{name}: {text}")

        say("reading the data")
        bound, reasons, unplayed = subject.bound(name, catalogue, settings.roles)
        limits = settings.effects_at_most, settings.seed, settings.criteria
        question = Question(subject.model, subject.train, name, bound, odds, *limits)
        findings[name] = study_equation(question, say)
        for slug, why in {**reasons, **findings[name].regressors.left_out}.items():
            left_out[name, slug] = why
        lacking |= {(name, slug): role for slug, role in unplayed.items()}
    return findings, left_out, lacking


def _measured_gap(
    subject: Subject, findings: Findings, settings: StudySettings
) -> tuple[pd.DataFrame, Mapping[str, FreePath], list[str]]:
    """Return the gap table, the free runs, and the reason if held-out data could not be compared."""
    train, model = subject.train, subject.model
    amendments = {name: study.amendment for name, study in findings.items()}
    moving = {name: amendment for name, amendment in amendments.items() if not train.is_output(name)}
    runs = FreeRuns(model, moving, settings.interpolation) if settings.free_runs else None
    table, paths = gap_rows(model, amendments, train, "train", runs, settings.criteria)
    if subject.test is None:
        return table, paths, []
    try:
        held_out, paths = gap_rows(model, amendments, subject.test, "test", runs, settings.criteria)
    except InputError as error:
        if not model.rows.follows_path:
            raise
        # The answer stands, without this comparison.
        return table, paths, [f"The extended model could not be compared with held-out data: {error}"]
    return pd.concat([table, held_out]), paths, []


def _result(
    subject: Subject, findings: Findings, gap: pd.DataFrame, lost: Sequence[str], criteria: Criteria, **notes: Any
) -> StudyResult:
    train, studies = subject.train, list(findings.values())
    tables = [study.tables(train) for study in studies]
    numbered = {name for name, table in tables[0].items() if isinstance(table.index, pd.RangeIndex)}
    verdicts = {name: study.verdict for name, study in findings.items()}
    labels = {name: train.target_label(name) for name in findings}
    against = ["no path of the extended model follows held-out samples" for _ in lost]
    verdict, reasons = verdict_of(verdicts, gap, against, labels, criteria)
    parts = {name: [each[name] for each in tables] for name in tables[0]}
    joined: dict[str, Any] = {name: pd.concat(part, ignore_index=name in numbered) for name, part in parts.items()}
    return StudyResult(
        base=subject.given,
        model=extended_program(subject.given, findings, train),
        fit=None,
        train=train,
        test=subject.test,
        corrected=corrected_data(train, findings),
        verdict=verdict,
        against=tuple(reason.text for reason in reasons),
        gap=gap,
        ties=[tie for study in studies for tie in study.ties(train)],
        maps={name: study.map for name, study in findings.items()},
        traces={name: study.trace for name, study in findings.items()},
        amendments={name: study.amendment for name, study in findings.items()},
        explanations={name: explained(study) for name, study in findings.items()},
        counted={name: study.counted for name, study in findings.items()},
        reasons=reasons,
        verdicts={name: verdict.code for name, verdict in verdicts.items()},
        **joined,
        **notes,
    )


def _held(subject: Subject) -> str:
    between, names = subject.model.rows.interpolation, subject.train.input_names
    if between is None or isinstance(between, str):
        return "inputs were"
    held = [name for name, kind in zip(names, between, strict=True) if kind == "zoh"]
    return f"{', '.join(held)} {'were' if len(held) > 1 else 'was'}"


def _study_warnings(
    subject: Subject, findings: Findings, settings: StudySettings, lost: Sequence[str]
) -> Iterator[str]:
    """Yield warnings about units, inputs, averages, few rows, requested noise, held-out data, simulation and rates."""
    train, fewest, noise = subject.train, settings.criteria.checked_rows, subject.model.noise
    for study in findings.values():
        yield from other_sizes(study.regressors)
    if subject.held:
        yield (
            "The samples are likelier with inputs held from each sample to the next than with lines or splines between "
            f"them, so {_held(subject)} held. State what they do: GreyBox(rows=bg.{type(subject.model.rows).__name__}"
            "(interpolation=...)), or in a file interpolation in [rows]."
        )
    if subject.block > 1:
        yield (
            "The sensors are read much more often than anything moves, so neighbouring samples were averaged, "
            f"{subject.block} at a time; this loses only noise. The study is about these averages, and a delay in "
            "samples counts averages."
        )
    for name, study in findings.items():
        if study.counted < fewest:
            fewer = f" of {train.n_obs}" if study.counted < train.n_obs else ""
            some = f"The {study.counted}{fewer} rows that count"
            rows = f"{train.n_obs} rows" if study.counted == train.n_obs else some
            of = f" of {train.target_label(name)}" if len(findings) > 1 else ""
            yield (
                f"{rows} are too few to check residuals{of}: below {fewest} neither their whiteness nor the shape of "
                "the noise is tested."
            )
    if isinstance(noise, Noise) and not noise.white:
        unsampled = "" if settings.settle else ", and nothing was sampled (settle=False)"
        yield (
            "The noise in GreyBox(noise=bg.Noise(...)) applies only to the posterior of the extended model"
            f"{unsampled}: the study weighs noise by itself."
        )
    yield from lost
    simulation = subject.model.simulator(train)
    yield from simulation.warnings
    for name in subject.equations if train.filter is not None else ():
        yield from row_warnings(subject.model.rows, train, name, simulation)
