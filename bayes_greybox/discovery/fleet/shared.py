"""Studies of a fleet together: assets by their gap, and effects that they lack, pooled over the assets."""

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, NamedTuple

import pandas as pd

from bayes_greybox.discovery.decision.criteria import CRITERIA
from bayes_greybox.discovery.decision.probabilities import INSTRUMENT, RECALIBRATE, UNKNOWN_KIND
from bayes_greybox.discovery.sensor_errors.channels import fault_kind
from bayes_greybox.physics.units import same_unit
from bayes_greybox.running.errors import InputError

from .pooling import Pooled, pooled

SHARE, FAILED = "unexplained share", "failed"
"""Metric by which assets are ranked, and verdict on an asset that could not be studied."""

ADDED = "added"
"""Status of an effect that is in a study's model."""

LACKING = ("named", "one of", "partly named", UNKNOWN_KIND)
"""Verdicts on an asset that lacks something."""

ONE_CAUSE = 0.9
"""Share of the lacking assets from which on it is one cause, and probability that its coefficient is one, or
differs."""

_NUMBER = re.compile(r"(?<![\w.])\d+\.?\d*(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class Shared:
    """An effect that several assets lack, or may lack.

    Attributes:
        expression: Formula; numbers that differ between the assets are nonlinear parameters by their names.
        unit: Unit of the coefficient; "" if it is not known, or differs.
        inner: Range over the assets of each nonlinear parameter.
        assets: Assets that surely lack it.
        possible: Assets that may lack it: their data do not tell it from something else.
        likely: Probability of the effect in each possible asset to whose model it was added.
        faults: Faults of sensors that may stand in its place in these, such as "delay of F".
        expressions, units, mean, sd: Formula, unit and coefficient in each of `assets`; NaN if it is not known.
        whole: Pooled coefficient; None if there is one alone, or if they cannot be pooled.
    """

    equation: str
    slug: str
    name: str
    expression: str
    unit: str
    one_unit: bool
    inner: Mapping[str, tuple[float, float]]
    assets: tuple[str, ...]
    possible: tuple[str, ...]
    likely: Mapping[str, float]
    faults: tuple[str, ...]
    expressions: tuple[str, ...]
    units: tuple[str, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    whole: Pooled | None

    @property
    def differing(self) -> tuple[str, ...]:
        """Return nonlinear parameters that differ too much for the coefficients beside them to be of one kind."""
        # Up to a quarter apart, coefficients beside them are of one kind.
        return tuple(name for name, (low, high) in self.inner.items() if high > 1.25 * low)

    @property
    def unsized(self) -> tuple[str, ...]:
        """Return assets whose coefficient has no mean, or no standard deviation above zero: none is pooled with it."""
        sizes = zip(self.assets, self.mean, self.sd, strict=True)
        return tuple(asset for asset, mean, sd in sizes if not (math.isfinite(mean) and 0 < sd < math.inf))


@dataclass(frozen=True)
class AssetStudy:
    """Outcome of one asset: verdict ("failed" if it could not be studied), what it lacks or may lack, and a sentence.

    `gap` and `left` are the unexplained share before and after, of held-out data if there are any; NaN if not known.
    `converged` is None if nothing was sampled.
    """

    asset: str
    verdict: str
    lacks: tuple[str, ...]
    may_lack: tuple[str, ...]
    gap: float
    left: float
    sentence: str
    converged: bool | None

    @property
    def failed(self) -> bool:
        """Return whether the asset could not be studied."""
        return self.verdict == FAILED


@dataclass(frozen=True)
class Fleet:
    """Studies of many assets."""

    assets: tuple[AssetStudy, ...]
    shared: tuple[Shared, ...]

    @property
    def studied(self) -> tuple[AssetStudy, ...]:
        """Return assets whose study did not fail."""
        return tuple(each for each in self.assets if not each.failed)

    @property
    def failed(self) -> tuple[AssetStudy, ...]:
        """Return assets whose study failed."""
        return tuple(each for each in self.assets if each.failed)

    @property
    def lacking(self) -> int:
        """Return the number of assets that lack something."""
        return sum(each.verdict in LACKING for each in self.studied)

    @property
    def recalibrated(self) -> int:
        """Return the number of assets that lack nothing, but whose coefficients are off."""
        return sum(each.verdict == RECALIBRATE for each in self.studied)

    @property
    def mismeasured(self) -> int:
        """Return the number of assets that lack nothing, but whose measurement is at fault."""
        return sum(each.verdict == INSTRUMENT for each in self.studied)

    @property
    def converged(self) -> bool:
        """Return whether the sampler converged wherever it ran."""
        return all(each.converged is not False for each in self.studied)

    @property
    def causes(self) -> tuple[Shared, ...]:
        """Return effects that nearly all lacking assets lack or may lack, two of them surely."""
        return tuple(each for each in self._of_nearly_all() if len(each.assets) > 1)

    @property
    def suspected(self) -> tuple[Shared, ...]:
        """Return effects that nearly all lacking assets lack or may lack, no two of them surely."""
        return tuple(each for each in self._of_nearly_all() if len(each.assets) < 2)

    def _of_nearly_all(self) -> list[Shared]:
        least = ONE_CAUSE * self.lacking
        return [each for each in self.shared if len({*each.assets, *each.possible}) >= least]

    def table(self) -> pd.DataFrame:
        """Return the assets as a table, indexed by asset."""
        table = pd.DataFrame(map(asdict, self.assets), columns=[field.name for field in fields(AssetStudy)])
        names = {column: table[column].map(", ".join) for column in ("lacks", "may_lack")}
        return table.assign(**names).set_index("asset")


def fleet_of(records: Mapping[str, Mapping[str, Any]], failed: Mapping[str, str]) -> Fleet:
    """Put studies together."""
    assets = [_study(name, record) for name, record in records.items()]
    assets += [AssetStudy(name, FAILED, (), (), math.nan, math.nan, reason, None) for name, reason in failed.items()]
    assets.sort(key=lambda each: (each.failed, -_size(each.gap), each.asset))
    return Fleet(tuple(assets), tuple(_shared(records)))


def _study(name: str, record: Mapping[str, Any]) -> AssetStudy:
    rows = [row for row in record["gap"] if row["metric"] == SHARE]
    rows = [row for row in rows if row["data"] == "test"] or rows
    worst = max(rows, key=lambda row: _size(row["before"]), default={"before": None, "after": None})
    added = [effect for effect in record["effects"] if effect["status"] == ADDED]
    lacks = tuple(effect["name"] for effect in added if _sure(record, effect))
    may_lack = tuple(effect["name"] for effect in added if not _sure(record, effect))
    fit, before, after = record.get("convergence"), _number(worst["before"]), _number(worst["after"])
    ok = None if fit is None else bool(fit["ok"] or fit.get("short"))
    return AssetStudy(name, record["verdict"], lacks, may_lack, before, after, record["sentence"], ok)


class _Lack(NamedTuple):
    asset: str
    effect: Mapping[str, Any]
    sure: bool

    @property
    def added(self) -> bool:
        return self.effect["status"] == ADDED


def _sure(record: Mapping[str, Any], effect: Mapping[str, Any]) -> bool:
    """Return whether an asset lacks an effect for sure, and not only in its likeliest model."""
    named = effect["status"] == ADDED and record["verdict"] in LACKING and record["verdict"] != UNKNOWN_KIND
    # Beside it something else may be one of several.
    return named and _number(effect["probability"]) >= CRITERIA.named


def _shared(records: Mapping[str, Mapping[str, Any]]) -> list[Shared]:
    """Return effects by equation, name, formula and nonlinear parameters, those that most assets have first."""
    groups: dict[tuple, list[list[_Lack]]] = defaultdict(list)
    for name, record in records.items():
        # A tied effect is possible, whatever its status in an older study.
        tied = defaultdict(set)
        for effect in record["effects"]:
            if effect["status"] == ADDED:
                tied[effect["equation"]].update(effect["tied_with"])
        for effect in record["effects"]:
            if effect["status"] not in (ADDED, "one of") and effect["slug"] not in tied[effect["equation"]]:
                continue
            alike = groups[effect["equation"], effect["slug"], tuple(sorted(effect["inner"])), _formula(effect)[0]]
            group = next((group for group in alike if _one_formula(group[0].effect, effect)), None)
            if group is None:
                alike.append(group := [])
            group.append(_Lack(name, effect, _sure(record, effect)))
    every = [group for alike in groups.values() for group in alike]
    effects = [_of_effect(group) for group in every if any(each.added for each in group)]
    return sorted(effects, key=lambda each: (-len(each.assets), -len(each.likely), each.equation, each.slug))


def _formula(effect: Mapping[str, Any]) -> tuple[str, tuple[float, ...]]:
    """Return an effect's formula, with the rates of its hidden states, without numbers; and the numbers."""
    text = "; ".join([effect["expression"], *(effect.get("hidden") or {}).values()])
    return "".join(_NUMBER.sub("#", text).split()), tuple(map(float, _NUMBER.findall(text)))


def _one_formula(first: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether formulas that are equal without numbers differ in numbers of nonlinear parameters alone."""
    pairs = zip(_formula(first)[1], _formula(other)[1], strict=True)
    return all(a == b or _parameter((a, b), (first, other)) for a, b in pairs)


def _parameter(numbers: Sequence[float], effects: Sequence[Mapping[str, Any]]) -> str:
    """Return the nonlinear parameter with these values, one in each effect, to the digits of formulas; "" for none."""
    for name in effects[0]["inner"]:
        values = (float(f"{float(effect['inner'][name]):.4g}") for effect in effects)
        if all(a == b for a, b in zip(numbers, values, strict=True)):
            return name
    return ""


def _common(effects: Sequence[Mapping[str, Any]]) -> str:
    """Return the formula of effects, with names of nonlinear parameters in the place of numbers that differ."""
    numbers = zip(*(_NUMBER.findall(effect["expression"]) for effect in effects), strict=True)
    written = (own[0] if len({*own}) == 1 else _parameter([*map(float, own)], effects) or own[0] for own in numbers)
    return _NUMBER.sub(lambda _: next(written), effects[0]["expression"])


def _of_effect(group: Sequence[_Lack]) -> Shared:
    sure = [each for each in group if each.sure]
    likely = [each for each in group if each.added and not each.sure]
    shown = [each.effect for each in sure or likely]
    first, units = shown[0], [effect["unit"] or "" for effect in shown]
    one_unit = all(_one_unit(units[0], unit) for unit in units)
    values = {name: [float(effect["inner"][name]) for effect in shown] for name in first["inner"]}
    shared = Shared(
        equation=first["equation"],
        slug=first["slug"],
        name=first["name"],
        expression=_common(shown),
        unit=units[0] if one_unit else "",
        one_unit=one_unit,
        inner={name: (min(own), max(own)) for name, own in values.items()},
        assets=tuple(each.asset for each in sure),
        possible=tuple(each.asset for each in group if not each.sure),
        likely={each.asset: float(each.effect["probability"]) for each in likely},
        faults=tuple(dict.fromkeys(tied for each in likely for tied in filter(fault_kind, each.effect["tied_with"]))),
        expressions=tuple(each.effect["expression"] for each in sure),
        units=tuple(each.effect["unit"] or "" for each in sure),
        mean=tuple(_number(each.effect["mean"]) for each in sure),
        sd=tuple(_number(each.effect["sd"]) for each in sure),
        whole=None,
    )
    if len(sure) < 2 or not one_unit or shared.differing or shared.unsized:
        return shared
    return replace(shared, whole=pooled(shared.mean, shared.sd))


def _one_unit(first: str, other: str) -> bool:
    """Return whether two units are one, however they are written; an unknown unit equals no known one."""
    try:
        return first == other or bool(first and other and same_unit(first, other, "a coefficient"))
    except InputError:
        return False


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _size(value: Any) -> float:
    number = _number(value)
    return -1.0 if math.isnan(number) else number
