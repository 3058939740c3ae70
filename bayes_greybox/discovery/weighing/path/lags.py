"""A lag of an input beside its delay: each is weighed on rows near itself.

An input that arrives late is first taken for one that lags, since effects are looked for before errors of sensors, and
along the path of a lag a delay fits worse than it does along its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayes_greybox.data.errors import InputError
from bayes_greybox.discovery.evidence.columns import Column, Nearer
from bayes_greybox.discovery.suspects.channels import DELAY, ChannelSuspect

from .near import Near, acting, errors, estimate, evidence_of, inner_values

TURNS = 4
"""How often rows are taken anew near a delay."""

STAYS = 0.5
"""Nats by which its evidence changes no more where it is found."""


class _Delayed(NamedTuple):
    """A delay in the place of a lag, on rows near it."""

    near: Near
    names: list[str]
    log_evidence: float


def weigh_lags(near: Near, taken: Callable[[Near], Near], settled: Callable[[Near], Near]) -> Near:
    """The likelier of a lag of an input and its delay, the other one on equal footing with it.

    Args:
        near: The explanation that stays.
        taken: From an explanation to the likeliest one on rows near it.
        settled: From an explanation to the one that stays.
    """
    core, columns = near.sets.likeliest(), near.sets.statistics.columns
    for lag in [columns[i] for i in core if _late(columns[i])]:
        suspect = _delay_of(_late(lag), near)
        if suspect is None:
            continue
        delayed = _delayed(near, taken, lag, suspect)
        if delayed is None:
            continue
        names = _beside(near, lag) + [lag.called]
        own = evidence_of(near, _places(near.sets.statistics.columns, names, near))
        if delayed.log_evidence > own:
            near = settled(delayed.near)
            _raise(near, names, lag.called, own)
        else:
            _raise(near, delayed.names, suspect.key, delayed.log_evidence)
    return near


def _late(column: Column) -> str:
    """The input that an effect has arrive late; empty where it has none."""
    if column.effect is None:
        return ""
    return column.effect.names.get(column.effect.effect.nominal, "")


def _beside(near: Near, lag: Column) -> list[str]:
    """What stands beside a lag in the likeliest set, but for delays."""
    columns = [near.sets.statistics.columns[i] for i in near.sets.likeliest()]
    return [column.called for column in columns if column.called != lag.called and not _is_delay(column)]


def _is_delay(column: Column) -> bool:
    return column.suspect is not None and column.suspect.kind == DELAY


def _delay_of(name: str, near: Near) -> ChannelSuspect | None:
    """The delay of an input among the suspects; of the only input that of the only sensor is the same."""
    known = {c.suspect.channel: c.suspect for c in near.base.statistics.columns if c.suspect and _is_delay(c)}
    samples = near.data.samples or near.data
    if len(samples.state_names) == len(samples.input_names) == 1:
        return known.get(name, known.get(samples.state_names[0]))
    return known.get(name)


def _delayed(near: Near, taken: Callable[[Near], Near], lag: Column, suspect: ChannelSuspect) -> _Delayed | None:
    """A delay in the place of a lag, on rows near itself; None where no path with it is near the samples."""
    if len(lag.inner) != 1:
        return None
    names = [*_beside(near, lag), suspect.key]
    lagging = {state.name for state in lag.formula.states}
    found = tuple((term, value) for term, value in near.found if not lagging & {state.name for state in term.states})
    (time,) = lag.inner.values()
    # What acts late was recorded early; a sensor that is late shows the same of all inputs at once.
    late = -time if suspect.channel in near.data.input_names else time
    sensors = {each: size for each, size in near.sensors.items() if each.kind != DELAY} | {suspect: late}
    before, best = near._replace(found=found, sensors=sensors), None
    for _ in range(TURNS):
        try:
            here = taken(before)
            at = _places(here.sets.statistics.columns, names, before)
            columns, values, _ = estimate(here.sets, at)
            value = evidence_of(here, at)
        except (InputError, LookupError, np.linalg.LinAlgError):
            break
        before = here._replace(
            found=acting(columns, values), sensors=errors(columns, values), inner=inner_values(columns)
        )
        stays = best is not None and abs(value - best.log_evidence) < STAYS
        if best is None or value > best.log_evidence:
            best = _Delayed(before, names, value)
        if stays:
            break
    return best


def _places(columns: Sequence[Column], names: Sequence[str], near: Near) -> tuple[int, ...]:
    """Columns of these names; of an effect with inner parameters the one on the path, or the first.

    Raises:
        LookupError: There is none.
    """
    every: dict[str, int] = {}
    for i, column in enumerate(columns):
        if column.kind not in ("effect", "suspect"):
            continue
        name = column.called
        if name not in every or column.inner == near.inner.get(name):
            every[name] = i
    return tuple(sorted(every[name] for name in names))


def _raise(near: Near, names: Sequence[str], name: str, there: float) -> None:
    """Put an explanation on these rows on equal footing with what it is on its own."""
    try:
        core = _places(near.sets.statistics.columns, names, near)
    except LookupError:
        return
    nearer = Nearer(max(there - evidence_of(near, core), 0.0), frozenset(names) - {name})
    for sets in {id(each): each for each in (near.base, near.sets)}.values():
        columns = sets.statistics.columns
        for i, column in enumerate(columns):
            if column.kind in ("effect", "suspect") and column.called == name:
                columns[i] = replace(column, nearer=nearer)
        sets.reweigh()
