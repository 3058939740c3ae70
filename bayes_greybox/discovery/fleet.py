"""What a fleet of studies says together: assets by their gap, and what they lack, pooled over those that lack it."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.criticism.pooling import Pooled, pooled

SHARE = "unexplained share"
"""Metric by which assets are ranked."""

ADDED, POSSIBLE = "added", "one of"
"""Status of an effect that is in a study's model, and of one that could stand in the place of another."""

ALIKE = 1.25
"""Largest over smallest value of an inner parameter up to which coefficients beside it are of one kind."""

_NAME = re.compile(r"[^\W\d]\w*")

FAILED = "failed"
"""Verdict on an asset that could not be studied."""

ONE_CAUSE = 0.9
"""Share of the assets with a gap from which on what they lack is one cause; and the probability from which on its
coefficient is said to be one, or to differ."""


@dataclass(frozen=True)
class Shared:
    """An effect that several assets lack.

    Attributes:
        equation, slug, name, expression, unit: The effect, and the unit of its coefficient.
        inner: Range over the assets of each inner parameter.
        assets: Those in whose amended model it is.
        possible: Those whose data do not tell it from what is in their model.
        mean, sd: Its coefficient in each of the assets; NaN where it is not known.
        whole: The coefficients together; None where one alone is known, or inner parameters differ too much for their
            coefficients to be of one kind.
    """

    equation: str
    slug: str
    name: str
    expression: str
    unit: str
    inner: Mapping[str, tuple[float, float]]
    assets: tuple[str, ...]
    possible: tuple[str, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    whole: Pooled | None


@dataclass(frozen=True)
class AssetStudy:
    """What came of one asset.

    Attributes:
        asset: Its name.
        verdict: Of its study; "failed" where there is none.
        lacks: Names of the effects that were added to its model.
        gap: Unexplained share before, of held-out data where there are any; NaN where it is not known.
        left: The same after.
        sentence: What its study says, or why there is none.
        converged: Whether the sampler did; None where nothing was sampled.
    """

    asset: str
    verdict: str
    lacks: tuple[str, ...]
    gap: float
    left: float
    sentence: str
    converged: bool | None

    @property
    def failed(self) -> bool:
        """Whether it could not be studied."""
        return self.verdict == FAILED


@dataclass(frozen=True)
class Fleet:
    """Studies of many assets.

    Attributes:
        assets: The largest gap first, those that failed last.
        shared: Effects, those that most assets lack first.
    """

    assets: tuple[AssetStudy, ...]
    shared: tuple[Shared, ...]

    @property
    def studied(self) -> tuple[AssetStudy, ...]:
        """Assets whose study did not fail."""
        return tuple(each for each in self.assets if not each.failed)

    @property
    def failed(self) -> tuple[AssetStudy, ...]:
        """The others."""
        return tuple(each for each in self.assets if each.failed)

    @property
    def with_gap(self) -> int:
        """Number of assets that lack something or whose coefficients are off."""
        return sum(each.verdict not in ("no gap", "instrument") for each in self.studied)

    @property
    def converged(self) -> bool:
        """Whether the sampler converged wherever it ran."""
        return all(each.converged is not False for each in self.studied)

    @property
    def causes(self) -> tuple[Shared, ...]:
        """Effects that nearly every asset with a gap lacks, or may lack as well as what was found; two surely."""
        return tuple(
            each
            for each in self.shared
            if len(each.assets) > 1 and len({*each.assets, *each.possible}) >= ONE_CAUSE * self.with_gap
        )

    def table(self) -> pd.DataFrame:
        """The assets as a table, indexed by asset."""
        rows = [{**asdict(each), "lacks": ", ".join(each.lacks)} for each in self.assets]
        return pd.DataFrame(rows, columns=[field.name for field in fields(AssetStudy)]).set_index("asset")


def fleet_of(records: Mapping[str, Mapping[str, Any]], failed: Mapping[str, str]) -> Fleet:
    """Put studies together.

    Args:
        records: Of studies, as in summary.json, by asset.
        failed: Reasons of those that were not studied.
    """
    found = [_study(name, record) for name, record in records.items()]
    found += [AssetStudy(name, FAILED, (), math.nan, math.nan, reason, None) for name, reason in failed.items()]
    found.sort(key=lambda each: (each.failed, -_size(each.gap), each.asset))
    return Fleet(tuple(found), tuple(_shared(records)))


def _study(name: str, record: Mapping[str, Any]) -> AssetStudy:
    gap = [row for row in record["gap"] if row["metric"] == SHARE]
    own = [row for row in gap if row["data"] == "test"] or gap
    worst = max(own, key=lambda row: _size(row["before"]), default={"before": math.nan, "after": math.nan})
    fit = record.get("convergence")
    lacks = tuple(effect["name"] for effect in _added(record))
    before, after, ok = _number(worst["before"]), _number(worst["after"]), None if fit is None else bool(fit["ok"])
    return AssetStudy(name, record["verdict"], lacks, before, after, record["sentence"], ok)


def _shared(records: Mapping[str, Mapping[str, Any]]) -> list[Shared]:
    """Effects by equation, name, columns and unit, those that most assets have first."""
    sure: dict[tuple, dict[str, Mapping[str, Any]]] = {}
    possible: dict[tuple, list[str]] = {}
    for name, record in records.items():
        for effect in record["effects"]:
            columns = tuple(sorted(set(_NAME.findall(effect["expression"]))))
            key = (effect["equation"], effect["slug"], columns, effect["unit"] or "")
            if effect["status"] == ADDED:
                sure.setdefault(key, {})[name] = effect
            elif effect["status"] == POSSIBLE:
                possible.setdefault(key, []).append(name)
    found = [_of_effect(key, each, possible.get(key, [])) for key, each in sure.items()]
    return sorted(found, key=lambda each: (-len(each.assets), each.equation, each.slug))


def _of_effect(key: tuple, each: Mapping[str, Mapping[str, Any]], possible: Sequence[str]) -> Shared:
    first = next(iter(each.values()))
    mean, sd = (np.array([_number(effect[name]) for effect in each.values()]) for name in ("mean", "sd"))
    values = {name: [float(effect["inner"][name]) for effect in each.values()] for name in first["inner"]}
    inner = {name: (min(own), max(own)) for name, own in values.items()}
    known = np.isfinite(mean) & np.isfinite(sd) & (sd > 0)
    alike = all(high <= ALIKE * low for low, high in inner.values())
    whole = pooled(mean[known].tolist(), sd[known].tolist()) if alike and known.sum() > 1 and known.all() else None
    return Shared(
        key[0], key[1], first["name"], first["expression"], key[3], inner, tuple(each), tuple(possible),
        tuple(mean.tolist()), tuple(sd.tolist()), whole,
    )  # fmt: skip


def _added(record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [effect for effect in record["effects"] if effect["status"] == ADDED]


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _size(value: Any) -> float:
    """For ordering: what is not known comes after what is."""
    number = _number(value)
    return -1.0 if math.isnan(number) else number
