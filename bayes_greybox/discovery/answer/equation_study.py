"""What was found out about one equation, and the tables that show it."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.decision.decide import Verdict
from bayes_greybox.discovery.decision.probabilities import EFFECTS, STOPS, Probabilities, Share
from bayes_greybox.discovery.grid.hypotheses import Hypothesis
from bayes_greybox.discovery.grid.noise_grid import LAW, MEMORY, TIME
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.linearise.source import Source
from bayes_greybox.discovery.regressors.columns import Column
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.discovery.suspects.channels import is_fault
from bayes_greybox.discovery.suspects.memory import kind_and_channel
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import coefficient_unit, target_unit
from bayes_greybox.running.errors import InputError

from .amendment import Amendment
from .checks.adequacy import Check
from .coefficients import Coefficients
from .instrument import instrument_table
from .interval import REACH, TAIL
from .where import GapMap, GapTrace

FRACTION = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹]⋅")
"""Power in a unit that is not whole."""

KEYS = ("equation", "memory")
"""Index of the table of what remains."""

UNUSUAL = "the opposite of what such an effect usually does"
"""Words for a reversed effect where the catalogue has none of its own."""

ANOTHER_SENSOR = "show the sensor a motion that is known, or measure with another one beside it"
"""Advice where only a fault of the sensor does the same as an effect: no range of the data tells them apart."""

REMAINS = {LAW: "a law of the states", TIME: "something in time", MEMORY: "something that remembers"}
"""Kinds of what has no name, in words."""


@dataclass(frozen=True)
class EquationStudy:
    """Everything found out about one equation.

    Attributes:
        source: Makes the rows, and puts other data of the same sensors right.
        near: Hypotheses on the rows near the likeliest of them.
        verdict: The verdict.
        checks: Checks of the hypothesis that was settled on.
        coefficients: Draws of the model after.
        amendment: The model after.
        map: Gap over states.
        trace: Gap along time.
        where: Regions and windows.
        criteria: Numbers that decided.
    """

    source: Source
    near: Near
    verdict: Verdict
    checks: tuple[Check, ...]
    coefficients: Coefficients
    amendment: Amendment
    map: GapMap
    trace: GapTrace
    where: pd.DataFrame
    criteria: Criteria

    @property
    def regressors(self) -> Regressors:
        """Return the regressors of the equation."""
        return self.near.regressors

    @property
    def equation(self) -> str:
        """Return the learned state or output."""
        return self.regressors.equation

    @property
    def probabilities(self) -> Probabilities:
        """Return the probabilities of the hypotheses."""
        return self.verdict.probabilities

    @property
    def counted(self) -> int:
        """Return the rows that count."""
        return self.regressors.rows.n_white

    def effects(self, data: Trajectories) -> pd.DataFrame:
        """Return effects of the answer, those that could stand in their places, then all others.

        Those of the answer, and the same on other columns, have the probability to act there; others to act anywhere.
        """
        rows, done, places = [], set(), self.verdict.places
        labels = list(self.verdict.labels)
        for k, place in enumerate(places):
            # Each draw has its own values of nonlinear parameters, and with them its own column.
            inner = self.coefficients.inner[:, k]
            scales = np.array([self._in_units(int(i)) for i in inner])
            draws = self.coefficients.draws[:, len(self.coefficients.indices) - len(labels) + k] * scales
            values = [self.near.column(int(i)).inner for i in inner]
            column = self.near.column(int(inner[0]))
            row = self._row(data, column, place.share, _moments(draws), place.tied, values, "added")
            rows.append({**row, "reverse": self._reverse(column, draws)})
            done.add(place.slug)
        by_effect, by_place = self.probabilities.by_effect, self.probabilities.by_place
        best = max((share.probability for share in by_effect.values()), default=0.0)
        # The same effect on other columns may stand in its place as others do.
        moved = {name: by_place[name] for place in places for name in place.tied if name in by_place}
        instead = {name for place in places for name in place.tied} if self.verdict.code == "one of" else set()
        for name, share in {**moved, **by_effect}.items():
            if name in done:
                continue
            found = self._likeliest(name)
            if found is None:
                continue
            column, mean, sd = found
            low, high = sorted((mean - REACH * sd, mean + REACH * sd))
            moments = {"mean": mean, "sd": sd, "lower": low, "upper": high}
            tied = () if places or share.probability < self.criteria.tied * best else tuple(
                other for other, each in by_effect.items()
                if other != name and each.probability >= self.criteria.tied * best
            )  # fmt: skip
            rows.append(
                self._row(data, column, share, moments, tied, [column.inner], "one of" if name in instead else "")
            )
        columns = ["equation", "slug", "name", "expression", "probability", "mean", "sd", "lower", "upper", "unit"]
        columns += ["tied_with", "inner", "hidden", "quantity", "status", "reverse", "agreement", "family"]
        return pd.DataFrame(rows, columns=columns)

    def hypotheses(self) -> pd.DataFrame:
        """Return no gap, recalibration, instrument, unknown, and each set of effects; probabilities sum to one."""
        p = self.probabilities
        found = {name: [value, -np.inf, np.nan, 0.0] for name, value in p.by_kind.items() if name in STOPS}
        gap = self.near.weighed.gap_square
        for h in self.near.weighed.hypotheses:
            name = self.called(h)
            entry = found.setdefault(name, [0.0, -np.inf, np.nan, 0.0])
            if p.effects(h):
                entry[0] += h.probability * max(trust for *_, trust in p.members(h, "effect"))
            entry[3] += h.agreement
            if h.log_weight > entry[1]:
                entry[1], entry[2] = h.log_weight, min(h.left**2 / gap, 1.0)
        order = sorted(found.items(), key=lambda item: -round(item[1][0], 6))
        rows = [
            {
                "equation": self.equation, "hypothesis": name, "probability": probability, "log_evidence": log_evidence,
                "share_left": share, "agreement": agreement,
            }
            for name, (probability, log_evidence, share, agreement) in order
        ]  # fmt: skip
        return pd.DataFrame(rows).set_index(["equation", "hypothesis"])

    def quantities(self) -> pd.DataFrame:
        """Return what a law that is missing is a function of, whatever its name."""
        found = {name: share for name, share in self.probabilities.by_quantity.items() if share.probability > 0}
        keys = pd.MultiIndex.from_tuples([(self.equation, name) for name in found], names=("equation", "quantity"))
        values = {
            "probability": [s.probability for s in found.values()],
            "agreement": [s.agreement for s in found.values()],
        }
        return pd.DataFrame(values, index=keys, dtype=float)

    def memory(self) -> pd.DataFrame:
        """Return the probabilities of what has no name: a law of the states, something in time, or what remembers.

        `kind` and `channel` say the same as the index, as codes; a whole kind has no channel.
        """
        p = self.probabilities
        found = {REMAINS[kind]: p.by_discrepancy[kind] for kind in REMAINS}
        memories = {name: value for name, value in p.by_memory.items() if value > 0}
        codes = [*((kind, "") for kind in REMAINS), *map(kind_and_channel, memories)]
        found |= memories
        keys = pd.MultiIndex.from_tuples([(self.equation, name) for name in found], names=KEYS)
        table = pd.DataFrame({"probability": list(found.values())}, index=keys, dtype=float)
        return table.assign(kind=[kind for kind, _ in codes], channel=[channel for _, channel in codes])

    def instrument(self, data: Trajectories) -> pd.DataFrame:
        """Return what is suspected of the measurement."""
        return instrument_table(self.source, self.near, self.verdict, self.coefficients, data)

    def check_table(self) -> pd.DataFrame:
        """Return the checks of the hypothesis that the study settled on."""
        rows = [
            {"equation": self.equation, "check": c.name, "p": c.p, "khat": c.khat, "ok": c.ok, "text": c.text}
            for c in self.checks
        ]
        columns = ["equation", "check", "p", "khat", "ok", "text"]
        return pd.DataFrame(rows, columns=columns).set_index(["equation", "check"])

    def corrections(self, data: Trajectories) -> pd.DataFrame:
        """Return the changes of the simulation's own coefficients: how likely, and how large if there is one."""
        rows, by_correction = [], self.probabilities.by_correction
        for index in self.regressors.of_kind("correction"):
            column = self.near.column(index)
            share = by_correction[column.called]
            moments = self._corrected(index)
            rows.append(
                {
                    "equation": self.equation, "term": column.formula.name, "nominal": column.nominal,
                    "probability": share.probability, **moments, "unit": self._unit(data, column.formula),
                    "agreement": share.agreement,
                }
            )  # fmt: skip
        names = ["equation", "term", "nominal", "probability", "mean", "sd", "lower", "upper", "unit", "agreement"]
        return pd.DataFrame(rows, columns=names).set_index(["equation", "term"])

    def _corrected(self, index: int) -> dict[str, float]:
        """Return the moments of a correction, averaged over the hypotheses that have it."""
        own = [(h, h.members.index(index)) for h in self.near.weighed.hypotheses if index in h.members]
        if not own:
            return {"mean": 0.0, "sd": 0.0, "lower": 0.0, "upper": 0.0}
        weight = np.array([h.probability for h, _ in own])
        weight = weight / weight.sum() if weight.sum() > 0 else np.full(len(own), 1 / len(own))
        means, sds = (np.array(x) for x in zip(*((h.mean[k], h.sd[k]) for h, k in own), strict=True))
        mean = float(weight @ means)
        sd = float(np.sqrt(weight @ (sds**2 + (means - mean) ** 2)))
        unit = self._in_units(index)
        low, high = sorted(((mean - REACH * sd) * unit, (mean + REACH * sd) * unit))
        return {"mean": mean * unit, "sd": sd * abs(unit), "lower": low, "upper": high}

    def ladder(self) -> pd.DataFrame:
        """Return the likeliest sets with no effect, with one, with two, and so on."""
        p, rows, before = self.probabilities, [], Counter()
        every = self.near.weighed.hypotheses
        gap = self.near.weighed.gap_square
        most = max((len(p.effects(h)) for h in every), default=0)
        for size in range(most + 1):
            own = [h for h in every if len(p.effects(h)) == size]
            mass = sum(h.probability for h in own)
            if not own or (size > len(self.verdict.places) + 1 and mass < 1e-3):
                continue
            names: dict[str, float] = {}
            for h in own:
                names[self.called(h)] = names.get(self.called(h), 0.0) + h.probability
            (top, probability), *rest = sorted(names.items(), key=lambda item: -round(item[1], 9))
            second, q = rest[0] if rest else ("", np.nan)
            likeliest = next(h for h in own if self.called(h) == top)
            now = Counter(self._slugs(likeliest))
            rows.append(
                {
                    "equation": self.equation, "round": size + 1, "verdict": top,
                    "added": " + ".join(sorted((now - before).elements())), "probability": probability,
                    "runner_up": second, "runner_up_probability": q, "share_left": min(likeliest.left**2 / gap, 1.0),
                }
            )  # fmt: skip
            before = now
        return pd.DataFrame(rows).set_index(["equation", "round"])

    def called(self, hypothesis: Hypothesis) -> str:
        """Return what the tables call a hypothesis."""
        says = self.probabilities.says(hypothesis)
        if says == EFFECTS:
            return " + ".join(sorted(self._slugs(hypothesis)))
        return says if self.probabilities.remains(hypothesis) <= self.criteria.missing else "unknown"

    def _slugs(self, hypothesis: Hypothesis) -> list[str]:
        columns = [self.near.column(i) for i in hypothesis.members]
        return [column.effect.slug for column in columns if column.effect is not None]

    def ties(self, data: Trajectories) -> list[dict[str, Any]]:
        """Return tied effects and the experiment that would tell them apart."""
        found = []
        for place in self.verdict.places:
            rivals = [each for name in place.tied if (each := self._likeliest(name)) is not None]
            if rivals or any(map(is_fault, place.tied)):
                own = self._likeliest(place.label)
                advice = ANOTHER_SENSOR if not rivals or own is None else self._advice([own, *rivals], data)
                found.append({"equation": self.equation, "slugs": (place.slug, *place.tied), "advice": advice})
        return found

    def _likeliest(self, name: str) -> tuple[Column, float, float] | None:
        """Return the column of an effect, by slug or on its columns, with its coefficient where it is likeliest.

        One that is in no hypothesis has its first column, and the coefficient that it has alone.
        """
        columns = self.regressors.columns
        for h in self.near.weighed.hypotheses:
            for k, i in enumerate(h.members):
                effect = columns[i].effect
                if effect is not None and name in (effect.slug, effect.label):
                    return columns[i], float(h.mean[k]) * self._in_units(i), float(h.sd[k]) * abs(self._in_units(i))
        own = [i for i, c in enumerate(columns) if c.effect is not None and name in (c.effect.slug, c.effect.label)]
        if not own:
            return None
        table = self.near.weighed.table
        x, y = table.columns[:, own[0]], table.target
        mean, sd = float(x @ y / (x @ x)), float(np.std(y) / np.sqrt(x @ x))
        return columns[own[0]], mean * self._in_units(own[0]), sd * abs(self._in_units(own[0]))

    def _advice(self, tied: Sequence[tuple[Column, float, float]], data: Trajectories) -> str:
        """Return where beyond the data tied effects part, each with its own coefficient."""
        columns = [column for column, *_ in tied]
        if any(column.formula.states for column in columns):
            # No curve over the states tells what remembers from what does not.
            return (
                "To tell them apart, measure at other amplitudes and other frequencies: what remembers depends on how "
                "far and how fast the motion went before."
            )
        variables = sorted({c for column in columns for c in column.formula.symbols} & set(data.columns))
        parted = []
        for v in variables:
            low, top = float(np.min(data.column(v))), float(np.max(np.abs(data.column(v))))
            for reach in (1.25, 1.5, 2.0, 3.0, 5.0):
                at = {n: np.full(41, np.median(c)) for n, c in data.columns.items()}
                at[v] = np.linspace(-reach * top if low < 0 else low, reach * top, 41)
                curves = [mean * np.asarray(column.formula.evaluate(at)) for column, mean, _ in tied]
                apart = max(float(np.max(np.abs(curves[0] - other))) for other in curves[1:])
                if np.isfinite(apart) and apart > 4 * self.amendment.sigma:
                    unit = f" {unit_text(data.unit(v))}" if unit_text(data.unit(v)) else ""
                    parted.append((reach, f"measure up to |{v}| = {reach * top:.3g}{unit} (the data reach {top:.3g})"))
                    break
        if not parted:
            return (
                "More data of the same kind, or less noise: within five times the data's range the effects hardly "
                "differ."
            )
        return f"To tell them apart, {min(parted)[1]}: there they differ by more than four noise standard deviations."

    def _in_units(self, index: int) -> float:
        return self.regressors.target_scale / self.near.column(index).scale

    def _reverse(self, column: Column, draws: Float[np.ndarray, " n_draw"]) -> str:
        """Return what an effect does whose coefficient surely has the other sign than usual; "" of all others."""
        assert column.effect is not None
        if not column.sign or np.mean(column.sign * draws < 0) <= self.criteria.reversed:
            return ""
        return column.effect.effect.reverse or UNUSUAL

    def _unit(self, data: Trajectories, term: Term) -> str:
        try:
            unit = coefficient_unit(target_unit(self.equation, data), term, term.units(data.units))
        except InputError:
            # The numbers of a simulation's expression carry units that nobody wrote.
            return ""
        # That of a power which is learned is another one for each of its values.
        return "" if FRACTION.search(unit or "") else unit

    def _row(
        self, data: Trajectories, column: Column, share: Share, moments: dict[str, float], tied: Sequence[str],
        inner: Sequence[Any], status: str,
    ) -> dict[str, Any]:  # fmt: skip
        assert column.effect is not None
        values = {name: float(np.mean([each[name] for each in inner])) for name in column.inner}
        effect = column.effect
        return {
            "equation": self.equation, "slug": effect.slug, "name": effect.name, "expression": effect.text(values),
            "hidden": effect.hidden(values), "probability": share.probability, **moments,
            "unit": self._unit(data, column.formula), "tied_with": tied, "inner": values,
            "quantity": ", ".join(sorted(set(effect.names.values()))), "status": status, "reverse": "",
            "agreement": share.agreement, "family": effect.effect.family,
        }  # fmt: skip


def _moments(draws: np.ndarray) -> dict[str, float]:
    low, high = np.quantile(draws, [TAIL, 1 - TAIL])
    return {"mean": float(np.mean(draws)), "sd": float(np.std(draws)), "lower": float(low), "upper": float(high)}
