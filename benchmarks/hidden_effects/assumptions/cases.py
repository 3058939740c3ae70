"""The list of cases: what every family tries, each without and with a hidden effect, all from one seed."""

import zlib
from collections.abc import Iterator
from dataclasses import replace
from itertools import count

import numpy as np

from .case import AssumptionCase, Family, Setting
from .families import FAMILIES
from .hosts import EFFECTS, own_rows

LOWEST_RATIO, HIGHEST_RATIO = 3.0, 30.0
"""Range of the ratio of effect over noise, log-uniform."""

USUAL_SHARE = 0.5
"""No effect is asked to have more than this share of the RMS of the rate that it is a part of."""

EDGY = ("coulomb-friction", "brush-drop")
"""Effects that bring a system to rest, which no smooth motion follows, unless they are small."""

EDGY_SHARE, EDGY_LEVEL = 0.12, 0.03
"""Largest share of these, and largest noise at which they are hidden; of the share, also with an unusual sign."""

PAIR_LOWEST, PAIR_SHARE = 8.0, 0.35
"""The same for two effects at once, of which much may cancel."""

UNUSUAL = 3
"""Every so many hidden effects one has the sign that feeds energy in, or pushes away, if little of it can be seen."""


def assumption_cases(seed: int = 0) -> tuple[AssumptionCase, ...]:
    """Return all cases of broken assumptions."""
    return tuple(case for place, family in enumerate(FAMILIES.values()) for case in _cases(family, place, seed))


def _cases(family: Family, place: int, seed: int) -> Iterator[AssumptionCase]:
    # Families start at different effects, so that a breach does not always meet the same one.
    turns = count(place)
    labels: dict[str, int] = {}
    for setting in family.settings():
        for hides in (False, True) if setting.bare else (True,):
            rows = setting.rows or own_rows(setting.host)
            case = AssumptionCase(
                family.name, setting.breach, setting.size, setting.host, (), (), (), setting.noise, rows, seed=0
            )
            if hides:
                effects, signs = _hidden(setting, next(turns), family.level(case))
                case = replace(case, effects=effects, signs=signs, ratios=(0.0,) * len(effects))
            # From what the case is, not from its place: a longer list leaves the others as they are.
            label = (
                f"{seed} {case.family} {case.breach} {case.size} {case.host} {case.effects} {case.noise} {case.rows}"
            )
            labels[label] = labels.get(label, 0) + 1
            number = zlib.crc32(f"{label} {labels[label]}".encode())
            yield replace(case, seed=number, ratios=_ratios(family, case, number))


def _hidden(setting: Setting, turn: int, level: float) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return effects and signs: those that the setting says, or the host's next one."""
    pool = [slug for slug in EFFECTS[setting.host] if level <= EDGY_LEVEL or slug not in EDGY]
    effects = setting.effects or (pool[turn % len(pool)],)
    usual = 1.0 if turn % UNUSUAL == UNUSUAL - 1 and level <= EDGY_LEVEL else -1.0
    return effects, setting.signs or (usual,) * len(effects)


def _ratios(family: Family, case: AssumptionCase, number: int) -> tuple[float, ...]:
    level, several = family.level(case), len(case.effects) > 1
    low = PAIR_LOWEST if several else LOWEST_RATIO
    rng = np.random.default_rng((number, 1))
    ratios = []
    for slug, sign in zip(case.effects, case.signs, strict=True):
        delicate = not several and (slug in EDGY or sign > 0)
        share = PAIR_SHARE if several else EDGY_SHARE if delicate else USUAL_SHARE
        high = max(1.2 * low, min(HIGHEST_RATIO, share / level))
        ratios.append(float(np.exp(rng.uniform(np.log(low), np.log(high)))))
    return tuple(ratios)
