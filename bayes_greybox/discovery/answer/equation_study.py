"""The study of one equation, and the tables that show it."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.decision.decide import Place, Verdict
from bayes_greybox.discovery.decision.probabilities import EFFECTS, STOPS, UNKNOWN_KIND, Probabilities, Share
from bayes_greybox.discovery.grid.points import LATENT_FORCE, LAW, MEMORY
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.linearise.source import Source
from bayes_greybox.discovery.regressors.columns import Column
from bayes_greybox.discovery.regressors.regressors import CORRECTION, Regressors
from bayes_greybox.discovery.sensor_errors.channels import fault_kind
from bayes_greybox.discovery.ties import likeliest_first
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import coefficient_unit, target_unit
from bayes_greybox.running.errors import InputError

from .advice import ANOTHER_SENSOR, how_to_tell_apart
from .amendment import Amendment
from .checks import Check
from .coefficients import Coefficients
from .instrument import instrument_table
from .interval import INTERVAL_ENDS, INTERVAL_REACH
from .where import GapMap, GapTrace

FRACTIONAL_POWER = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹]⋅")
"""Power in a unit that is not whole."""

MOMENTS = ("mean", "sd", "lower", "upper")

EFFECT_COLUMNS = (
    "equation", "slug", "name", "expression", "probability", *MOMENTS, "unit", "tied_with", "inner", "hidden",
    "quantity", "status", "reverse", "agreement", "family",
)  # fmt: skip

UNUSUAL = "the opposite of what such an effect usually does"
"""Words for a reversed effect where the catalogue has none of its own."""

KINDS_IN_WORDS = {LAW: "a law of the states", LATENT_FORCE: "something in time", MEMORY: "something that remembers"}
"""Kinds of discrepancy, in words."""


@dataclass(frozen=True)
class EquationStudy:
    """The study of one equation; its source also removes sensor errors from other data of the same sensors."""

    source: Source
    near: Near
    verdict: Verdict
    checks: tuple[Check, ...]
    coefficients: Coefficients
    amendment: Amendment
    map: GapMap
    trace: GapTrace
    where: pd.DataFrame

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
        """Return the number of rows that count."""
        return self.regressors.rows.n_white

    def tables(self, data: Trajectories) -> dict[str, pd.DataFrame]:
        """Return the tables that a study has of all its equations, by name."""
        return {
            "effects": self.effects(data), "hypotheses": self.hypotheses(), "memory": self.memory(),
            "quantities": self.quantities(), "instrument": self.instrument(data), "checks": self.check_table(),
            "corrections": self.corrections(data), "where": self.where, "rounds": self.ladder(),
        }  # fmt: skip

    def effects(self, data: Trajectories) -> pd.DataFrame:
        """Return effects of the answer, with their probabilities there, then their rivals, then all others."""
        rows = [self._added_row(data, k, place) for k, place in enumerate(self.verdict.places)]
        return pd.DataFrame([*rows, *self._other_rows(data)], columns=list(EFFECT_COLUMNS))

    def _added_row(self, data: Trajectories, k: int, place: Place) -> dict[str, Any]:
        # Each draw has its own values of nonlinear parameters, and with them its own column.
        inner, n_own = self.coefficients.inner[:, k].tolist(), self.coefficients.n_own
        draws = self.coefficients.draws[:, n_own + k] * np.array([self._in_units(i) for i in inner])
        columns = [self.near.column(i) for i in inner]
        column = columns[0]
        mean_values = {name: float(np.mean([each.inner[name] for each in columns])) for name in column.inner}
        moments = (float(np.mean(draws)), float(np.std(draws)), *map(float, np.quantile(draws, INTERVAL_ENDS)))
        row = self._row(data, column, mean_values, place.share, moments)
        return row | {"tied_with": place.tied, "status": "added", "reverse": self._reverse(column, draws)}

    def _other_rows(self, data: Trajectories) -> Iterator[dict[str, Any]]:
        by_effect, by_place, places = self.probabilities.by_effect, self.probabilities.by_place, self.verdict.places
        # The same effect on other columns may stand in its place as others do.
        moved = {name: by_place[name] for place in places for name in place.tied if name in by_place}
        rivals = {name for place in places for name in place.tied} if self.verdict.code == "one of" else set()
        least = self.probabilities.criteria.tied * max((share.probability for share in by_effect.values()), default=0.0)
        tied = [name for name, share in by_effect.items() if not places and share.probability >= least]
        for name, share in {**moved, **by_effect}.items():
            likeliest = None if name in {place.slug for place in places} else self._likeliest(name)
            if likeliest is not None:
                column, mean, sd = likeliest
                row = self._row(data, column, column.inner, share, _interval(mean, sd))
                others = tuple(other for other in tied if other != name) if name in tied else ()
                yield row | {"tied_with": others, "status": "one of" if name in rivals else ""}

    def _row(
        self, data: Trajectories, column: Column, inner: Mapping[str, float], share: Share, moments: Sequence[float]
    ) -> dict[str, Any]:
        effect = column.effect
        assert effect is not None
        return {
            "equation": self.equation, "slug": effect.slug, "name": effect.name, "expression": effect.text(inner),
            "hidden": effect.hidden(inner), "probability": share.probability,
            **dict(zip(MOMENTS, moments, strict=True)), "unit": self._unit(data, column.formula),
            "inner": {parameter: float(value) for parameter, value in inner.items()},
            "quantity": ", ".join(sorted(set(effect.names.values()))), "reverse": "",
            "agreement": share.agreement, "family": effect.effect.family,
        }  # fmt: skip

    def hypotheses(self) -> pd.DataFrame:
        """Return no gap, recalibration, instrument, unknown, and each set of effects; probabilities sum to one."""
        p = self.probabilities
        rows = {name: [value, -np.inf, np.nan, 0.0] for name, value in p.by_kind.items() if name in STOPS}
        for h in self.near.weighed.hypotheses:
            row = rows.setdefault(self.called(h), [0.0, -np.inf, np.nan, 0.0])
            if p.effects(h):
                row[0] += h.probability * max(trust for _, trust in p.members(h, "effect"))
            row[3] += h.agreement
            if h.log_weight > row[1]:
                row[1:3] = h.log_weight, self._share_left(h)
        order = likeliest_first(rows, lambda name: rows[name][0])
        names = ["probability", "log_evidence", "share_left", "agreement"]
        return pd.DataFrame([rows[name] for name in order], self._index("hypothesis", order), names)

    def quantities(self) -> pd.DataFrame:
        """Return the columns that a missing law depends on, whatever its name, by probability."""
        shares = {name: share for name, share in self.probabilities.by_quantity.items() if share.probability > 0}
        index = self._index("quantity", shares)
        return pd.DataFrame(list(shares.values()), index, ["probability", "agreement"], dtype=float)

    def memory(self) -> pd.DataFrame:
        """Return the probabilities of the kinds of discrepancy, then of the laws that remember."""
        p = self.probabilities
        rows = [(text, p.by_discrepancy[kind], kind, "") for kind, text in KINDS_IN_WORDS.items()]
        for name, value in p.by_memory.items():
            if value > 0:
                kind, _, channel = name.partition(" of ")
                rows.append((name, value, kind, channel))
        names, *values = zip(*rows, strict=True)
        columns = dict(zip(("probability", "kind", "channel"), values, strict=True))
        return pd.DataFrame(columns, self._index("memory", names))

    def instrument(self, data: Trajectories) -> pd.DataFrame:
        """Return the suspected errors of the measurement."""
        return instrument_table(self.source, self.near, self.verdict, self.coefficients, data)

    def check_table(self) -> pd.DataFrame:
        """Return the checks of the answer's hypothesis."""
        names, rows = ["p", "khat", "ok", "text"], [(c.p, c.khat, c.ok, c.text) for c in self.checks]
        return pd.DataFrame(rows, self._index("check", [c.name for c in self.checks]), names)

    def corrections(self, data: Trajectories) -> pd.DataFrame:
        """Return the changes of the simulation's coefficients and parameters: how likely, and how large if so."""
        rows, by_correction = [], self.probabilities.by_correction
        for index in self.regressors.of_kind(CORRECTION):
            column, unit = self.near.column(index), self._in_units(index)
            share, moments = by_correction[column.called], _interval(*self._correction(index), unit)
            term, named = column.formula, bool(column.parameter)
            about = (self.equation, term.name, column.nominal, share.probability)
            own = self.source.model.parameters[column.parameter].unit or "" if named else self._unit(data, term)
            rows.append((*about, *moments, own, share.agreement, named))
        columns = ["equation", "term", "nominal", "probability", *MOMENTS, "unit", "agreement", "parameter"]
        return pd.DataFrame(rows, columns=columns).set_index(["equation", "term"])

    def _correction(self, index: int) -> tuple[float, float]:
        """Return the scaled mean and standard deviation of a correction over the hypotheses that have it."""
        places = [(h, h.members.index(index)) for h in self.near.weighed.hypotheses if index in h.members]
        if not places:
            return 0.0, 0.0
        weight = np.array([h.probability for h, _ in places])
        weight = weight / weight.sum() if weight.sum() > 0 else np.full(len(places), 1 / len(places))
        means, sds = (np.array(x) for x in zip(*((h.mean[k], h.sd[k]) for h, k in places), strict=True))
        mean = float(weight @ means)
        return mean, float(np.sqrt(weight @ (sds**2 + (means - mean) ** 2)))

    def ladder(self) -> pd.DataFrame:
        """Return the likeliest sets with no effect, with one, with two, and so on."""
        p, every, rows, before = self.probabilities, self.near.weighed.hypotheses, [], Counter()
        for size in range(max((len(p.effects(h)) for h in every), default=0) + 1):
            of_size = [h for h in every if len(p.effects(h)) == size]
            mass = sum(h.probability for h in of_size)
            if not of_size or (size > len(self.verdict.places) + 1 and mass < 1e-3):
                continue
            names: dict[str, float] = {}
            for h in of_size:
                names[self.called(h)] = names.get(self.called(h), 0.0) + h.probability
            ordered = [*sorted(names.items(), key=lambda item: -round(item[1], 9)), ("", np.nan)]
            (top, probability), (second, q) = ordered[:2]
            likeliest = next(h for h in of_size if self.called(h) == top)
            now = Counter(self._slugs(likeliest))
            rows.append({
                "equation": self.equation, "round": size + 1, "verdict": top,
                "added": " + ".join(sorted((now - before).elements())), "probability": probability,
                "runner_up": second, "runner_up_probability": q, "share_left": self._share_left(likeliest),
            })  # fmt: skip
            before = now
        return pd.DataFrame(rows).set_index(["equation", "round"])

    def called(self, hypothesis: Hypothesis) -> str:
        """Return a hypothesis's name in the tables."""
        kind = self.probabilities.kind_of(hypothesis)
        if kind == EFFECTS:
            return " + ".join(sorted(self._slugs(hypothesis)))
        return kind if self.probabilities.remains(hypothesis) <= self.probabilities.criteria.missing else UNKNOWN_KIND

    def ties(self, data: Trajectories) -> list[dict[str, Any]]:
        """Return tied effects and the experiment that would tell them apart."""
        ties = []
        for place in self.verdict.places:
            rivals = [each for name in place.tied if (each := self._likeliest(name)) is not None]
            if rivals or any(map(fault_kind, place.tied)):
                own, advice = self._likeliest(place.label), ANOTHER_SENSOR
                if rivals and own is not None:
                    curves = [(column.formula, mean) for column, mean, _ in (own, *rivals)]
                    advice = how_to_tell_apart(curves, self.amendment.sigma, data)
                ties.append({"equation": self.equation, "slugs": (place.slug, *place.tied), "advice": advice})
        return ties

    def _slugs(self, hypothesis: Hypothesis) -> list[str]:
        columns = [self.near.column(i) for i in hypothesis.members]
        return [column.effect.slug for column in columns if column.effect is not None]

    def _likeliest(self, name: str) -> tuple[Column, float, float] | None:
        """Return the column of an effect, by slug or label, with its coefficient where it is likeliest."""
        columns, table = self.regressors.columns, self.near.weighed.table
        named = [i for i, c in enumerate(columns) if c.effect is not None and name in (c.effect.slug, c.effect.label)]
        if not named:
            return None
        places = [(h, k, i) for h in self.near.weighed.hypotheses for k, i in enumerate(h.members) if i in named]
        if places:
            h, k, index = places[0]
            mean, sd = float(h.mean[k]), float(h.sd[k])
        else:
            index, y = named[0], table.target
            x = table.columns[:, index]
            mean, sd = float(x @ y / (x @ x)), float(np.std(y) / np.sqrt(x @ x))
        return columns[index], mean * self._in_units(index), sd * abs(self._in_units(index))

    def _share_left(self, hypothesis: Hypothesis) -> float:
        return min(hypothesis.left**2 / self.near.weighed.gap_square, 1.0)

    def _in_units(self, index: int) -> float:
        return self.regressors.target_scale / self.near.column(index).scale

    def _index(self, name: str, values: Sequence[str] | Mapping[str, Any]) -> pd.MultiIndex:
        return pd.MultiIndex.from_arrays([[self.equation] * len(values), list(values)], names=("equation", name))

    def _reverse(self, column: Column, draws: Float[np.ndarray, " n_draw"]) -> str:
        """Return the meaning of an effect whose coefficient surely has the unusual sign; "" of all others."""
        assert column.effect is not None
        if not column.sign or np.mean(column.sign * draws < 0) <= self.probabilities.criteria.reversed:
            return ""
        return column.effect.effect.reverse or UNUSUAL

    def _unit(self, data: Trajectories, term: Term) -> str:
        unit = unit_if_known(target_unit(self.equation, data), term, data)
        # That of a power which is learned is another one for each of its values.
        return "" if FRACTIONAL_POWER.search(unit or "") else unit


def unit_if_known(target: str, term: Term, data: Trajectories) -> str:
    """Return the unit of a term's coefficient; "" if the numbers of a simulation's expression carry unwritten units."""
    try:
        return coefficient_unit(target, term, term.units(data.units))
    except InputError:
        return ""


def _interval(mean: float, sd: float, unit: float = 1.0) -> tuple[float, ...]:
    low, high = sorted(((mean - INTERVAL_REACH * sd) * unit, (mean + INTERVAL_REACH * sd) * unit))
    return mean * unit, sd * abs(unit), low, high
