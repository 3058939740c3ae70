"""The study of one equation: its statistics, what was found, and the tables and maps that show it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import coefficient_unit, derivative_unit

from .coefficients import Coefficients, alone, draw_coefficients, plain
from .evaluations import Evaluations
from .gap import Amendment
from .hypotheses import Contest
from .odds import Odds
from .rounds import STOPS, TIED, Finding, search
from .sufficient_statistics import SufficientStatistics, sufficient_statistics
from .where import GapField, GapMap, GapTrace, gap_map, gap_trace, where_table

DRAWS = 2000
"""Posterior draws of the coefficients behind tables and bands."""

TAIL = 0.05
"""Probability on either side of the intervals in tables."""


@dataclass(frozen=True)
class EquationStudy:
    """Everything found out about one equation."""

    statistics: SufficientStatistics
    evaluations: Evaluations
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
            values = [self.statistics.columns[int(i)].inner for i in inner]
            rows.append(
                self._row(data, index, self.finding.probability[k], draws, self.finding.ties[k], values, "added")
            )
            added.add(self.evaluations.name(index))
        probabilities = self.finding.first.probabilities()
        best = max((p for name, p in probabilities.items() if name not in STOPS), default=0.0)
        for name, p in probabilities.items():
            if name in STOPS or name in added:
                continue
            index = self.finding.first.best(name).best
            if index is not None:
                mean, sd = alone(self.evaluations, index)
                draws = self._in_units(index) * (mean + sd * np.array([-1.6448536, 0.0, 1.6448536]))
                tied = () if p < TIED * best else tuple(
                    n for n, q in probabilities.items() if n not in (*STOPS, name) and q >= TIED * best
                )  # fmt: skip
                inner = [self.statistics.columns[index].inner]
                row = self._row(data, index, p, draws, tied, inner, "")
                rows.append({**row, "sd": abs(self._in_units(index)) * sd, "lower": min(draws), "upper": max(draws)})
        columns = ["equation", "slug", "name", "expression", "probability", "mean", "sd", "lower", "upper", "unit"]
        return pd.DataFrame(rows, columns=[*columns, "tied_with", "inner", "status"])

    def hypotheses(self) -> pd.DataFrame:
        """Explanations of the first round."""
        first = self.finding.first
        rows = [
            {
                "equation": self.statistics.equation,
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
            column = self.statistics.columns[index]
            if column.kind != "correction":
                continue
            draws = self.coefficients.draws[:, place] * self._in_units(index)
            rows.append(
                {
                    "equation": self.statistics.equation,
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
                    "equation": self.statistics.equation, "round": number, "verdict": top, "added": step.added,
                    "probability": p, "runner_up": second, "runner_up_probability": q, "share_left": step.share_left,
                }
            )  # fmt: skip
        return pd.DataFrame(rows).set_index(["equation", "round"])

    def ties(self, data: Trajectories) -> list[dict[str, Any]]:
        """Tied effects and the experiment that would tell them apart."""
        found = []
        for k, index in enumerate(self.finding.base):
            if self.finding.ties[k]:
                slugs = (self.evaluations.name(index), *self.finding.ties[k])
                rivals = [self.evaluations.best_of(slug) for slug in self.finding.ties[k]]
                found.append(
                    {"equation": self.statistics.equation, "slugs": slugs, "advice": _advice(self, index, rivals, data)}
                )
        return found

    def _in_units(self, index: int) -> float:
        return self.statistics.target_scale / self.statistics.columns[index].scale

    def _unit(self, data: Trajectories, term: Term) -> str:
        try:
            return coefficient_unit(derivative_unit(self.statistics.equation, data.units), term, data.units)
        except InputError:
            # The numbers of a simulation's expression carry units that nobody wrote.
            return ""

    def _row(self, data: Trajectories, index: int, p: float, draws: np.ndarray, tied, inner: list, status: str) -> dict:
        column = self.statistics.columns[index]
        assert column.effect is not None
        names = list(column.inner)
        values = {n: float(np.mean([v[n] for v in inner])) for n in names}
        return {
            "equation": self.statistics.equation, "slug": column.effect.slug, "name": column.effect.name,
            "expression": column.effect.text(values) if values else column.effect.text(), "probability": p,
            **_moments(draws), "unit": self._unit(data, column.term), "tied_with": tied, "inner": values,
            "status": status,
        }  # fmt: skip


def study_equation(
    model: Program, train: Trajectories, name: str, effects: Sequence[BoundEffect], odds: Odds, most: int, seed: int,
    settle: bool, say: Callable[[str], None],
) -> EquationStudy:  # fmt: skip
    """Study one equation: rounds, then the gap before and after on the training data.

    Args:
        model: The model before.
        train: Training data.
        name: The learned state.
        effects: Effects bound to columns.
        odds: Prior probabilities.
        most: Largest number of effects added.
        seed: Seed of the coefficients' draws.
        settle: Whether finalists are settled by bridge sampling where that is needed.
        say: Told in words what is being done.
    """
    statistics = sufficient_statistics(model, train, name, effects)
    evaluator = Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    evaluations = Evaluations(statistics, odds, evaluator)
    finding = search(Contest(evaluations), most, seed if settle else None, say)
    say("mapping the gap")
    corrected = finding.verdict not in ("no gap", "unknown")
    coefficients = draw_coefficients(evaluations, finding.base, DRAWS, seed)
    if not corrected:
        # Nothing is missing, or nothing that has a name: the model after is the model before, whatever small weight
        # corrections keep.
        coefficients = coefficients._replace(draws=coefficients.draws * _free_only(statistics, coefficients))
    indices, beta = list(coefficients.indices), coefficients.draws.mean(axis=0)
    changed = [k for k, i in enumerate(indices) if statistics.columns[i].kind != "free"]
    before = GapField.of(statistics, evaluator)
    after = GapField.of(statistics, evaluator, [indices[k] for k in changed], beta[changed])
    sigma = float(np.mean(coefficients.sigma)) * statistics.target_scale
    threshold = min(before.sigma, sigma)
    unit = derivative_unit(name, train.units)
    trace = gap_trace(train, before, after, threshold, unit)
    amendment = Amendment(statistics, plain(evaluations), coefficients, sigma)
    drawn = gap_map(train, before, after, statistics.variables[:2], threshold, unit)
    where = where_table(train, statistics.variables, trace)
    return EquationStudy(statistics, evaluations, finding, coefficients, amendment, drawn, trace, where)


def _free_only(statistics: SufficientStatistics, coefficients: Coefficients) -> np.ndarray:
    return np.array([float(statistics.columns[i].kind == "free") for i in coefficients.indices])


def _moments(draws: np.ndarray) -> dict[str, float]:
    low, high = np.quantile(draws, [TAIL, 1 - TAIL])
    return {"mean": float(np.mean(draws)), "sd": float(np.std(draws)), "lower": float(low), "upper": float(high)}


def _advice(found: EquationStudy, index: int, rivals: Sequence[int], data: Trajectories) -> str:
    """Where beyond the data two tied effects part, each with its own best coefficient."""
    statistics = found.statistics
    effect = statistics.columns[index].effect
    assert effect is not None
    variables = sorted({c for i in (index, *rivals) for c in statistics.columns[i].term.symbols} & set(data.columns))
    parted = []
    for v in variables:
        low, top = float(np.min(data.column(v))), float(np.max(np.abs(data.column(v))))
        for reach in (1.25, 1.5, 2.0, 3.0, 5.0):
            columns = {n: np.full(41, np.median(c)) for n, c in data.columns.items()}
            columns[v] = np.linspace(-reach * top if low < 0 else low, reach * top, 41)
            curves = [
                alone(found.evaluations, i)[0] * statistics.evaluate([i], columns)[:, 0] for i in (index, *rivals)
            ]
            apart = max(float(np.max(np.abs(curves[0] - other))) for other in curves[1:])
            if np.isfinite(apart) and apart * statistics.target_scale > 4 * found.amendment.sigma:
                unit = f" {data.unit(v)}" if data.unit(v) and data.unit(v) != "1" else ""
                parted.append((reach, f"measure up to |{v}| = {reach * top:.3g}{unit} (the data reach {top:.3g})"))
                break
    if not parted:
        return (
            "More data of the same kind, or less noise: within five times the data's range the effects hardly differ."
        )
    return f"To tell them apart, {min(parted)[1]}: there they differ by more than four noise standard deviations."
