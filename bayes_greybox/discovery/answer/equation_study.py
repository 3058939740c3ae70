"""What was found out about one equation, and the tables that show it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.ranges import sign_of
from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics
from bayes_greybox.discovery.evidence.ties import likeliest_first
from bayes_greybox.discovery.suspects.channels import is_fault
from bayes_greybox.discovery.weighing.aligned import Aligned
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import coefficient_unit, target_unit

from .amendment import Amendment
from .checks.adequacy import Check
from .coefficients import Coefficients, alone
from .finding import TIED, Finding, elsewhere
from .instrument import instrument_table
from .weighed import STOPS, quantity
from .where import GapMap, GapTrace

KEYS = ("equation", "memory")
"""Index of the table of what forces remember."""

TAIL = 0.05
"""Probability on either side of the intervals in tables."""

REVERSED = 0.95
"""Probability of the other sign than an effect's usual one from which on that is said."""

UNUSUAL = "the opposite of what such an effect usually does"
"""What is said of it where the catalogue has no words for that."""

ANOTHER_SENSOR = "show the sensor a motion that is known, or measure with another one beside it"
"""Advice where only a fault of the sensor does the same as an effect: no range of the data tells them apart."""


@dataclass(frozen=True)
class EquationStudy:
    """Everything found out about one equation."""

    aligned: Aligned
    finding: Finding
    checks: tuple[Check, ...]
    coefficients: Coefficients
    amendment: Amendment
    map: GapMap
    trace: GapTrace
    where: pd.DataFrame

    @property
    def evaluations(self) -> Evaluations:
        """Evidence in the world of the finding."""
        return self.finding.world.evaluations

    @property
    def statistics(self) -> SufficientStatistics:
        """Products in the world of the finding."""
        return self.evaluations.statistics

    @property
    def counted(self) -> int:
        """Rows that count under the noise of the finding: without those that are left out, as white numbers."""
        return self.statistics.rows.n_white

    def effects(self, data: Trajectories) -> pd.DataFrame:
        """Effects of the answer, those that could stand in their places, then all others.

        Those of the answer, and the same on other columns, have the probability to act there; others to act anywhere.
        """
        rows, done = [], set()
        places = self.finding.places
        for k, place in enumerate(places):
            column = len(self.coefficients.indices) - len(places) + k
            # Each draw has its own inner parameter, and with it its own column.
            inner = self.coefficients.inner[:, k]
            scales = np.array([self._in_units(int(i)) for i in inner])
            draws = self.coefficients.draws[:, column] * scales
            values = [self.statistics.columns[int(i)].inner for i in inner]
            row = self._row(data, place.index, place.probability, draws, place.tied, values, "added")
            rows.append({**row, "reverse": self._reverse(place.index, draws)})
            done.add(place.slug)
        probabilities = self.finding.weighed.by_effect
        best = max(probabilities.values(), default=0.0)
        # The same effect on other columns may stand in its place as others do.
        by_place = self.finding.weighed.by_place
        moved = {name: by_place[name] for place in places for name in place.tied if elsewhere(name, place.slug)}
        instead = {name for place in places for name in place.tied} if self.finding.verdict == "one of" else set()
        for name, p in {**moved, **probabilities}.items():
            if name in done:
                continue
            index = self.evaluations.best_of(name)
            mean, sd = alone(self.evaluations, index)
            draws = self._in_units(index) * (mean + sd * np.array([-1.6448536, 0.0, 1.6448536]))
            tied = () if places or p < TIED * best else tuple(
                n for n, q in probabilities.items() if n != name and q >= TIED * best
            )  # fmt: skip
            status = "one of" if name in instead else ""
            row = self._row(data, index, p, draws, tied, [self.statistics.columns[index].inner], status)
            rows.append({**row, "sd": abs(self._in_units(index)) * sd, "lower": min(draws), "upper": max(draws)})
        columns = ["equation", "slug", "name", "expression", "probability", "mean", "sd", "lower", "upper", "unit"]
        columns += ["tied_with", "inner", "hidden", "quantity", "status", "reverse"]
        return pd.DataFrame(rows, columns=columns)

    def hypotheses(self) -> pd.DataFrame:
        """No gap, recalibration, instrument, unknown, and each set of effects; probabilities sum to one."""
        weighed = self.finding.weighed
        found: dict[str, list[float]] = {
            name: [p, -np.inf, np.nan] for name, p in weighed.by_kind.items() if name in STOPS
        }
        top = weighed.worlds[0].offset
        for world, e, p, share in weighed.items:
            name = self.called(world, e)
            entry = found.setdefault(name, [0.0, -np.inf, np.nan])
            if e.effects:
                entry[0] += weighed.counted(world, e, p, share)
            value = e.log_evidence + world.offset - top
            if value > entry[1]:
                entry[1], entry[2] = value, 0.0 if not np.isfinite(share) else share
        rows = [
            {
                "equation": self.statistics.equation, "hypothesis": name, "probability": p,
                "log_evidence": found[name][1], "share_left": found[name][2],
            }
            for name, p in likeliest_first({name: entry[0] for name, entry in found.items()}).items()
        ]  # fmt: skip
        return pd.DataFrame(rows).set_index(["equation", "hypothesis"])

    def _named(self, world: Any, e: Any) -> str:
        return " + ".join(sorted(world.evaluations.name(i) for i in e.effects))

    def quantities(self) -> pd.DataFrame:
        """What a law that is missing is a function of, whatever its name."""
        found = self.finding.weighed.by_quantity
        rows = [(self.statistics.equation, ", ".join(names)) for names in found]
        keys = pd.MultiIndex.from_tuples(rows, names=("equation", "quantity"))
        return pd.DataFrame({"probability": list(found.values())}, index=keys, dtype=float)

    def memory(self) -> pd.DataFrame:
        """What a force without a name remembers."""
        found = self.finding.weighed.by_memory
        keys = pd.MultiIndex.from_tuples([(self.statistics.equation, name) for name in found], names=KEYS)
        return pd.DataFrame({"probability": list(found.values())}, index=keys, dtype=float)

    def instrument(self, data: Trajectories) -> pd.DataFrame:
        """Suspects about the measurement."""
        return instrument_table(self.aligned, self.finding, self.coefficients, data)

    def check_table(self) -> pd.DataFrame:
        """Checks of the explanation that the study settled on."""
        rows = [
            {
                "equation": self.statistics.equation,
                "check": c.name,
                "p": c.p,
                "khat": c.khat,
                "ok": c.ok,
                "text": c.text,
            }
            for c in self.checks
        ]
        return pd.DataFrame(rows, columns=["equation", "check", "p", "khat", "ok", "text"]).set_index(
            ["equation", "check"]
        )

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
                    "term": column.formula.name,
                    "nominal": column.nominal,
                    "probability": float(np.mean(draws != 0)),
                    **_moments(draws),
                    "unit": self._unit(data, column.formula),
                }
            )
        names = ["equation", "term", "nominal", "probability", "mean", "sd", "lower", "upper", "unit"]
        return pd.DataFrame(rows, columns=names).set_index(["equation", "term"])

    def ladder(self) -> pd.DataFrame:
        """The likeliest sets with no effect, with one, with two, and so on."""
        weighed, rows, before = self.finding.weighed, [], Counter()
        most = max((len(e.effects) for _, e, _, _ in weighed.items), default=0)
        for size in range(most + 1):
            own = [(w, e, p, s) for w, e, p, s in weighed.items if len(e.effects) == size]
            if not own or (size > len(self.finding.places) + 1 and sum(p for *_, p, _ in own) < 1e-3):
                continue
            names: dict[str, float] = {}
            for w, e, p, share in own:
                name = self.called(w, e)
                names[name] = names.get(name, 0.0) + weighed.counted(w, e, p, share)
            (top, p), *rest = likeliest_first(names).items()
            second, q = rest[0] if rest else ("", np.nan)
            # The likeliest of those that are called so: what stands in a row is of one explanation.
            world, e = next((w, x) for w, x, _, _ in own if self.called(w, x) == top)
            now = Counter(world.evaluations.name(i) for i in e.effects)
            rows.append(
                {
                    "equation": self.statistics.equation, "round": size + 1, "verdict": top,
                    "added": " + ".join(sorted((now - before).elements())), "probability": p, "runner_up": second,
                    "runner_up_probability": q,
                    "share_left": world.share_left(e) if world.leaves_rest(e) else self._unexplained(world, e),
                }
            )  # fmt: skip
            before = now
        return pd.DataFrame(rows).set_index(["equation", "round"])

    def called(self, world: Any, e: Any) -> str:
        """What the tables call an explanation."""
        return self._named(world, e) if e.effects else self.finding.weighed.kind(world, e)

    def _unexplained(self, world: Any, e: Any) -> float:
        """Share of the gap's square that an explanation's columns leave, less the noise; NaN where there is no gap."""
        noise = float(np.mean(self.coefficients.sigma)) ** 2
        residual = world.residual(e)
        if 1.0 - noise < 2 * np.sqrt(2 / len(residual)):
            return np.nan
        return float(np.clip((np.mean(residual**2) - noise) / (1.0 - noise), 0.0, 1.0))

    def ties(self, data: Trajectories) -> list[dict[str, Any]]:
        """Tied effects and the experiment that would tell them apart."""
        found = []
        for place in self.finding.places:
            weighed = self.finding.weighed
            rivals = [
                self.evaluations.best_of(name)
                for name in place.tied
                if name in weighed.by_effect or elsewhere(name, place.slug)
            ]
            if rivals or any(map(is_fault, place.tied)):
                advice = _advice(self, place.index, rivals, data) if rivals else ANOTHER_SENSOR
                found.append(
                    {"equation": self.statistics.equation, "slugs": (place.slug, *place.tied), "advice": advice}
                )
        return found

    def _in_units(self, index: int) -> float:
        return self.statistics.target_scale / self.statistics.columns[index].scale

    def _reverse(self, index: int, draws: Float[np.ndarray, " n_draw"]) -> str:
        """What an effect does whose coefficient surely has the other sign than it usually has; "" of all others."""
        column = self.statistics.columns[index]
        sign = sign_of(column)
        if not sign or np.mean(sign * draws < 0) <= REVERSED:
            return ""
        assert column.effect is not None
        return column.effect.effect.reverse or UNUSUAL

    def _unit(self, data: Trajectories, term: Term) -> str:
        try:
            return coefficient_unit(target_unit(self.statistics.equation, data), term, term.units(data.units))
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
            "expression": column.effect.text(values), "hidden": column.effect.hidden(values), "probability": p,
            **_moments(draws), "unit": self._unit(data, column.formula), "tied_with": tied, "inner": values,
            "quantity": ", ".join(quantity(self.finding.world, index)), "status": status, "reverse": "",
        }  # fmt: skip


def _moments(draws: np.ndarray) -> dict[str, float]:
    low, high = np.quantile(draws, [TAIL, 1 - TAIL])
    return {"mean": float(np.mean(draws)), "sd": float(np.std(draws)), "lower": float(low), "upper": float(high)}


def _advice(found: EquationStudy, index: int, rivals: Sequence[int], data: Trajectories) -> str:
    """Where beyond the data two tied effects part, each with its own best coefficient."""
    statistics = found.statistics
    effect = statistics.columns[index].effect
    assert effect is not None
    if any(statistics.columns[i].formula.states for i in (index, *rivals)):
        # No curve over the states tells what remembers from what does not.
        return (
            "To tell them apart, measure at other amplitudes and other frequencies: what remembers depends on how far "
            "and how fast the motion went before."
        )
    variables = sorted({c for i in (index, *rivals) for c in statistics.columns[i].formula.symbols} & set(data.columns))
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
                unit = f" {unit_text(data.unit(v))}" if unit_text(data.unit(v)) else ""
                parted.append((reach, f"measure up to |{v}| = {reach * top:.3g}{unit} (the data reach {top:.3g})"))
                break
    if not parted:
        return (
            "More data of the same kind, or less noise: within five times the data's range the effects hardly differ."
        )
    return f"To tell them apart, {min(parted)[1]}: there they differ by more than four noise standard deviations."
