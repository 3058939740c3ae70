"""The missing-effect study: gap, where, what, honesty, add, show."""

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from threadpoolctl import threadpool_limits

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.greybox import Fit, GreyBox
from bayes_greybox.inference.evidence import Evaluator
from bayes_greybox.inference.netcdf import versions
from bayes_greybox.model.simulation import Simulation
from bayes_greybox.physics.effects import BoundEffect, CatalogueSpec, load_catalogue
from bayes_greybox.physics.roles import bind_catalogue, roles_of, unbound
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import coefficient_unit, derivative_unit

from .gap import Amendment, FreePath, gap_rows
from .hypotheses import Coefficients, Contest, Odds
from .rounds import NEGLIGIBLE, STOPS, SUBSTANTIAL, TIED, Finding, search
from .table import CORRECTION_SCALE, GapTable, gap_table
from .where import GapField, GapMap, GapTrace, gap_map, gap_trace, where_table

DRAWS = 2000
"""Posterior draws of the coefficients behind tables and bands."""

TAIL = 0.05
"""Probability on either side of the intervals in tables."""

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

    def record(self) -> dict[str, Any]:
        """Verdict, tables and settings as plain values, ready for JSON."""
        tables = ("effects", "hypotheses", "corrections", "where", "gap", "rounds")
        plain = {name: json.loads(getattr(self, name).reset_index().to_json(orient="records")) for name in tables}
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
        catalogue: "mechanical", "fluid", "population", "electrical", "all", a TOML file of your own, or a list of these.
        roles: Columns by role where the package should not guess.
        seed: Seed of everything random.
        effects_at_most: Largest number of effects added to one equation.
        odds: Prior probabilities of the explanations.
        settle: Whether to sample the amended model by NUTS and the finalists' evidence by bridge sampling.
        free_runs: Whether to integrate simulation and amended model over the data.
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
    loaded = load_catalogue(catalogue)
    seconds: dict[str, float] = {}
    findings: dict[str, _Equation] = {}
    console = Console(stderr=True, quiet=not progress)
    with threadpool_limits(1), console.status("Missing effects") as status:
        left_out: dict[tuple[str, str], str] = {}
        for name in equations:
            say: Callable[[str], None] = lambda text, name=name: status.update(f"{name}: {text}")
            say("reading the data")
            columns = roles_of(model.simulation, train.state_names, train.input_names, name, roles, train.units)
            left_out |= {(name, slug): why for slug, why in unbound(loaded, columns, train.units).items()}
            bound = bind_catalogue(loaded, columns, train.units)
            findings[name] = _study_equation(model, train, name, bound, odds, effects_at_most, seed, say)
            left_out |= {(name, slug): why for slug, why in findings[name].table.left_out.items()}
        seconds["explain"] = time.perf_counter() - started
        status.update("measuring the gap before and after")
        start = time.perf_counter()
        amendments = {name: found.amendment for name, found in findings.items()}
        parts = [("train", train), *([("test", test)] if test is not None else [])]
        measured = [gap_rows(model, amendments, data, part, free_runs) for part, data in parts]
        seconds["gap"] = time.perf_counter() - start
    gap = pd.concat([table for table, _ in measured])
    amended = amended_model(model, train, findings)
    fit = None
    if settle:
        start = time.perf_counter()
        fit = amended.fit(train, draws=draws, tune=tune, chains=chains, seed=seed, progress=progress)
        amended, seconds["sample"] = fit.model, time.perf_counter() - start
    seconds["total"] = time.perf_counter() - started
    verdict = max((found.finding.verdict for found in findings.values()), key=ORDER.index)
    effects = pd.concat([found.effects(train) for found in findings.values()], ignore_index=True)
    return Study(
        base=model,
        model=amended if isinstance(amended, GreyBox) else GreyBox(**vars(amended)),
        fit=fit,
        train=train,
        test=test,
        verdict=verdict,
        sentence=_sentence(findings, verdict, effects, gap),
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
            "catalogue": catalogue
            if isinstance(catalogue, str)
            else [str(c) for c in np.atleast_1d(np.array(catalogue, object))],
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
    )


def studied_equations(model: GreyBox, data: Trajectories) -> tuple[str, ...]:
    """Equations a study looks at: those of the model's dictionary, or all whose measured rate the simulation misses.

    Raises:
        InputError: There is none.
    """
    if model.dictionary:
        return model.equations
    simulation = Simulation.of(model.simulation, data.state_names, data.input_names)
    kinematic = [n for n, e in simulation.expressions.items() if e.is_Symbol and e.name in data.state_names]
    found = tuple(name for name in data.derivative_names if name not in kinematic)
    if not found:
        raise InputError(
            "There is no equation to study: the data have no measured derivative of a state whose equation is more than "
            "another state; give derivatives=..., or compute them with data.differentiate()."
        )
    return found


def amended_model(model: GreyBox, data: Trajectories, findings: "Mapping[str, _Equation]") -> GreyBox:
    """The model with the simulation's terms and the found effects as its dictionary."""
    dictionary: dict[str, list[Term]] = {}
    for name, found in findings.items():
        table = found.table
        own = [table.columns[i].term for i in (*table.of_kind("free"), *table.of_kind("correction"))]
        added = [table.columns[i].term for i in found.finding.base]
        # A dictionary needs a term; an offset is the least that can be asked for.
        dictionary[name] = [*own, *added] or [Term("1")]
    return replace(model, dictionary=dictionary)


@dataclass(frozen=True)
class _Equation:
    """Everything found out about one equation."""

    table: GapTable
    contest: Contest
    finding: Finding
    coefficients: Coefficients
    amendment: Amendment
    map: GapMap
    trace: GapTrace
    where: pd.DataFrame

    def effects(self, data: Trajectories) -> pd.DataFrame:
        """Effects that were added, then all others of the first round."""
        rows, added = [], set()
        for k, index in enumerate(self.finding.base):
            place = len(self.coefficients.indices) - len(self.finding.base) + k
            draws = self._in_units(index) * self.coefficients.draws[:, place]
            # Each draw has its own inner parameter, and with it its own column.
            inner = self.coefficients.inner[:, k]
            scales = np.array([self._in_units(int(i)) for i in inner])
            draws = draws / self._in_units(index) * scales
            values = [self.table.columns[int(i)].inner for i in inner]
            rows.append(
                self._row(data, index, self.finding.probability[k], draws, self.finding.ties[k], values, "added")
            )
            added.add(self.contest.name(index))
        probabilities = self.finding.first.probabilities()
        best = max((p for name, p in probabilities.items() if name not in STOPS), default=0.0)
        for name, p in probabilities.items():
            if name in STOPS or name in added:
                continue
            index = self.finding.first.best(name).best
            if index is not None:
                mean, sd = self.contest.alone(index)
                draws = self._in_units(index) * (mean + sd * np.array([-1.6448536, 0.0, 1.6448536]))
                tied = () if p < TIED * best else tuple(
                    n for n, q in probabilities.items() if n not in (*STOPS, name) and q >= TIED * best
                )  # fmt: skip
                inner = [self.table.columns[index].inner]
                row = self._row(data, index, p if not self.finding.base else p, draws, tied, inner, "")
                rows.append({**row, "sd": abs(self._in_units(index)) * sd, "lower": min(draws), "upper": max(draws)})
        columns = ["equation", "slug", "name", "expression", "probability", "mean", "sd", "lower", "upper", "unit"]
        return pd.DataFrame(rows, columns=[*columns, "tied_with", "inner", "status"])

    def hypotheses(self) -> pd.DataFrame:
        """Explanations of the first round."""
        first = self.finding.first
        rows = [
            {
                "equation": self.table.equation,
                "hypothesis": name,
                "probability": p,
                "log_evidence": first.best(name).log_evidence,
                "share_left": first.best(name).share_left,
            }
            for name, p in first.probabilities().items()
        ]
        return pd.DataFrame(rows).set_index(["equation", "hypothesis"])

    def corrections(self, data: Trajectories) -> pd.DataFrame:
        """Changes of the simulation's own coefficients."""
        rows = []
        for place, index in enumerate(self.coefficients.indices):
            column = self.table.columns[index]
            if column.kind != "correction":
                continue
            draws = self.coefficients.draws[:, place] * self._in_units(index)
            rows.append(
                {
                    "equation": self.table.equation,
                    "term": column.term.name,
                    "nominal": column.nominal,
                    "probability": float(np.mean(draws != 0)),
                    **_moments(draws),
                    "unit": self._unit(data, column.term),
                }
            )
        names = ["equation", "term", "nominal", "probability", "mean", "sd", "lower", "upper", "unit"]
        return pd.DataFrame(rows, columns=names).set_index(["equation", "term"])

    def ladder(self) -> pd.DataFrame:
        """The rounds."""
        rows = []
        for number, step in enumerate(self.finding.steps, start=1):
            (top, p), *rest = step.probabilities.items()
            second, q = rest[0] if rest else ("", np.nan)
            rows.append(
                {
                    "equation": self.table.equation, "round": number, "verdict": top, "added": step.added,
                    "probability": p, "runner_up": second, "runner_up_probability": q, "share_left": step.share_left,
                }
            )  # fmt: skip
        return pd.DataFrame(rows).set_index(["equation", "round"])

    def ties(self, data: Trajectories) -> list[dict[str, Any]]:
        """Tied effects and the experiment that would tell them apart."""
        found = []
        for k, index in enumerate(self.finding.base):
            if self.finding.ties[k]:
                slugs = (self.contest.name(index), *self.finding.ties[k])
                rivals = [self.contest.best_of(slug) for slug in self.finding.ties[k]]
                found.append(
                    {"equation": self.table.equation, "slugs": slugs, "advice": _advice(self, index, rivals, data)}
                )
        return found

    def _in_units(self, index: int) -> float:
        return self.table.target_scale / self.table.columns[index].scale

    def _unit(self, data: Trajectories, term: Term) -> str:
        try:
            return coefficient_unit(derivative_unit(self.table.equation, data.units), term, data.units)
        except InputError:
            # The numbers of a simulation's expression carry units that nobody wrote.
            return ""

    def _row(self, data: Trajectories, index: int, p: float, draws: np.ndarray, tied, inner: list, status: str) -> dict:
        column = self.table.columns[index]
        assert column.effect is not None
        names = list(column.inner)
        values = {n: float(np.mean([v[n] for v in inner])) for n in names}
        return {
            "equation": self.table.equation, "slug": column.effect.slug, "name": column.effect.name,
            "expression": column.effect.text(values) if values else column.effect.text(), "probability": p,
            **_moments(draws), "unit": self._unit(data, column.term), "tied_with": tied, "inner": values,
            "status": status,
        }  # fmt: skip


def _study_equation(
    model: GreyBox, train: Trajectories, name: str, effects: Sequence[BoundEffect], odds: Odds, most: int, seed: int,
    say: Callable[[str], None],
) -> _Equation:  # fmt: skip
    table = gap_table(model, train, name, effects)
    evaluator = Evaluator(table.noise, table.prior)
    contest = Contest(table, odds, evaluator)
    finding = search(contest, most, say)
    say("mapping the gap")
    corrected = finding.verdict != "no gap"
    coefficients = contest.draws(finding.base, DRAWS, seed)
    if not corrected:
        # Nothing is missing: the model after is the model before, whatever small weight the others keep.
        coefficients = coefficients._replace(draws=coefficients.draws * _free_only(table, coefficients))
    indices, beta = list(coefficients.indices), coefficients.draws.mean(axis=0)
    changed = [k for k, i in enumerate(indices) if table.columns[i].kind != "free"]
    before = GapField.of(table, evaluator)
    after = GapField.of(table, evaluator, [indices[k] for k in changed], beta[changed])
    sigma = float(np.mean(coefficients.sigma)) * table.target_scale
    threshold = min(before.sigma, sigma)
    unit = derivative_unit(name, train.units)
    trace = gap_trace(before, after, threshold, unit)
    amendment = Amendment(table, contest.plain(), coefficients, sigma)
    drawn = gap_map(before, after, table.variables[:2], threshold, unit)
    return _Equation(table, contest, finding, coefficients, amendment, drawn, trace, where_table(before, trace))


def _free_only(table: GapTable, coefficients: Coefficients) -> np.ndarray:
    return np.array([float(table.columns[i].kind == "free") for i in coefficients.indices])


def _moments(draws: np.ndarray) -> dict[str, float]:
    low, high = np.quantile(draws, [TAIL, 1 - TAIL])
    return {"mean": float(np.mean(draws)), "sd": float(np.std(draws)), "lower": float(low), "upper": float(high)}


def _advice(found: _Equation, index: int, rivals: Sequence[int], data: Trajectories) -> str:
    """Where beyond the data two tied effects part, each with its own best coefficient."""
    table = found.table
    effect = table.columns[index].effect
    assert effect is not None
    variables = sorted({c for i in (index, *rivals) for c in table.columns[i].term.symbols} & set(data.columns))
    parted = []
    for v in variables:
        top = float(np.max(np.abs(data.column(v))))
        for reach in (1.25, 1.5, 2.0, 3.0, 5.0):
            columns = {n: np.full(41, np.median(c)) for n, c in data.columns.items()}
            columns[v] = np.linspace(-reach * top, reach * top, 41)
            curves = [found.contest.alone(i)[0] * table.rows([i], columns)[:, 0] for i in (index, *rivals)]
            apart = max(float(np.max(np.abs(curves[0] - other))) for other in curves[1:])
            if np.isfinite(apart) and apart * table.target_scale > 4 * found.amendment.sigma:
                unit = f" {data.unit(v)}" if data.unit(v) and data.unit(v) != "1" else ""
                parted.append((reach, f"measure up to |{v}| = {reach * top:.3g}{unit} (the data reach {top:.3g})"))
                break
    if not parted:
        return (
            "More data of the same kind, or less noise: within five times the data's range the effects hardly differ."
        )
    return f"To tell them apart, {min(parted)[1]}: there they differ by more than four noise standard deviations."


def _sentence(findings: Mapping[str, _Equation], verdict: str, effects: pd.DataFrame, gap: pd.DataFrame) -> str:
    part = "test" if "test" in gap.index.get_level_values("data") else "train"
    where = "held-out data" if part == "test" else "the training data"
    shares = gap.xs((part, "unexplained share"), level=("data", "metric"))
    before, after = shares["before"].sum(), shares["after"].sum()
    closed = f"closes {100 * (1 - after / before):.0f} % of the gap on {where}" if before > 0 else "leaves no gap"
    if verdict == "no gap":
        return "Nothing is missing: simulation and measurements agree to within the noise."
    if verdict == "recalibrate":
        names = [n for n, found in findings.items() if found.finding.verdict == "recalibrate"]
        worst = []
        for n in names:
            table = findings[n].corrections(findings[n].table.data)
            chosen = table[table["probability"] > 0.5]
            worst += [
                f"{term} in d({n})/dt {row['nominal'] + row['mean']:.4g} instead of {row['nominal']:.4g}"
                for (_, term), row in chosen.iterrows()
            ]
        listed = "; ".join(worst) or "which one the data cannot say"
        return (
            f"No effect is missing; coefficients of the simulation are off ({listed}), and setting them right {closed}."
        )
    added = effects[effects["status"] == "added"]
    said = [
        f"{row['name'].lower()} in d({row['equation']})/dt (probability {row['probability']:.2f}"
        + (f", not to be told from {', '.join(row['tied_with'])}" if row["tied_with"] else "")
        + ")"
        for _, row in added.iterrows()
    ]
    if verdict == "named":
        return f"The simulation lacks {' and '.join(said)}; adding it {closed}."
    if verdict == "partly named":
        return f"The simulation lacks {' and '.join(said)}, and something else that the catalogue does not have; adding it {closed}."
    return "Something is missing that the catalogue does not have; the maps show its shape."
