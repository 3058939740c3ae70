"""What a fleet of studies says together: assets by their gap, and what they lack, pooled over those that lack it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.criticism.pooling import Pooled, pooled

SHARE = "unexplained share"
"""Metric by which assets are ranked."""

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
        assets: Those in whose amended model it is.
        mean, sd: Its coefficient in each.
        whole: The coefficients together; None where one asset alone has it.
    """

    equation: str
    slug: str
    name: str
    expression: str
    unit: str
    assets: tuple[str, ...]
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
    def cause(self) -> Shared | None:
        """The effect that nearly every asset with a gap lacks; None where there is no such one, or one asset alone."""
        first = next(iter(self.shared), None)
        if first is None or len(first.assets) < 2 or len(first.assets) < ONE_CAUSE * self.with_gap:
            return None
        return first

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


def _shared(records: Mapping[str, Mapping[str, Any]]) -> Iterator[Shared]:
    found: dict[tuple[str, str, str], list[tuple[str, Mapping[str, Any]]]] = {}
    for name, record in records.items():
        for effect in _added(record):
            found.setdefault((effect["equation"], effect["slug"], effect["unit"]), []).append((name, effect))
    for (equation, slug, unit), each in sorted(found.items(), key=lambda item: (-len(item[1]), item[0])):
        first = each[0][1]
        mean, sd = (tuple(float(effect[key]) for _, effect in each) for key in ("mean", "sd"))
        together = pooled(mean, sd) if len(each) > 1 and _poolable(mean, sd) else None
        names = tuple(name for name, _ in each)
        yield Shared(equation, slug, first["name"], first["expression"], unit, names, mean, sd, together)


def _poolable(mean: Sequence[float], sd: Sequence[float]) -> bool:
    return bool(np.all(np.isfinite(mean)) and np.all(np.isfinite(sd)) and np.all(np.asarray(sd) > 0))


def _added(record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [effect for effect in record["effects"] if effect["status"] == "added"]


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _size(value: Any) -> float:
    """For ordering: what is not known comes after what is."""
    number = _number(value)
    return -1.0 if math.isnan(number) else number
