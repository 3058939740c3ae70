"""A study in codes and numbers: reports put them into words, and decide nothing."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from bayes_greybox.criticism import discrepancy

from .answer.gap import SHARE, within_noise
from .answer.instrument import IN_MODEL
from .answer.interval import INTERVAL_REACH
from .answer.where import GapMap, GapTrace
from .decision.criteria import CRITERIA, Criteria
from .decision.probabilities import INSTRUMENT, NO_GAP, STOPS, UNKNOWN_KIND
from .decision.vetoes import FREE_RUN, NAMES_ALONE, worsened
from .learned import shown_corrections
from .linearise.near import LARGEST_ERROR
from .sensor_errors import bends
from .sensor_errors.channels import DELAY, DEPARTURE, DRIFT, GAIN, NOISE, OFFSET, STATES
from .sensor_errors.noisy_inputs import noisy_inputs
from .study import StudyResult

LEAST_CLOSED, SAME_MAP = 1e-4, 0.01
"""A gap that changes by less than this share of it is as it was; so are maps, of what counts as a gap."""

GIVEN_ROLES = ("position", "stored", "velocity", "level", "population", "state", "current")
"""Roles whose column may well be in the data where none was recognised; another body's need not be there."""

QUANTITY = "quantity"
"""Kind of what remains that is a law of known columns, whatever its name."""


def rows_of(table: pd.DataFrame, key: str, level: int | str = 0) -> pd.DataFrame:
    """Return the rows of a table whose index has a value at a level, without that level; none where it has none."""
    return table.xs(key, level=level) if key in table.index.get_level_values(level) else table.iloc[:0].droplevel(level)


def added(study: StudyResult) -> np.ndarray:
    """Return the row numbers of the effects that were added to the model."""
    return np.flatnonzero((study.effects["status"] == "added").to_numpy()) if len(study.effects) else np.zeros(0, int)


def _added_to(study: StudyResult, equation: str) -> pd.DataFrame:
    chosen = study.effects.iloc[added(study)]
    return chosen[chosen["equation"] == equation]


def marked(study: StudyResult, equation: str) -> tuple[list[str], list[str]]:
    """Return the slugs of the effects that were added to an equation, and of those tied with them."""
    chosen = _added_to(study, equation)
    return list(chosen["slug"]), [slug for slugs in chosen["tied_with"] for slug in slugs]


def together(slugs: Iterable[str]) -> str:
    """Return the name of a set of effects in the tables of a study."""
    return " + ".join(sorted(slugs))


def answer(study: StudyResult, equation: str) -> str:
    """Return the hypothesis that the study settled on for an equation: a set of effects, or a code of `STOPS`."""
    chosen, _ = marked(study, equation)
    if chosen:
        return together(chosen)
    if len(study.maps) <= 1 and study.verdict in STOPS:
        return study.verdict
    if study.verdicts.get(equation) in STOPS:
        return study.verdicts[equation]
    # Files of before have the verdict of the whole study alone.
    rows = rows_of(study.hypotheses, equation)
    alone = {name: p for name, p in zip(rows.index, rows["probability"], strict=True) if name in STOPS}
    return max(alone, key=lambda name: alone[name], default=study.verdict)


def tied_sets(study: StudyResult, equation: str) -> list[str]:
    """Return the sets that are tied with an equation's answer: another effect in the place of one of its own."""
    chosen = _added_to(study, equation)
    return [
        together([*(slug for slug in chosen["slug"] if slug != own), other])
        for own, others in zip(chosen["slug"], chosen["tied_with"], strict=True)
        for other in others
    ]


def probability_of_answer(study: StudyResult) -> float:
    """Return the probability of a verdict without effects, as the product over the equations that have it."""
    total = 1.0
    for name in study.maps:
        if study.settings.get("agree in practice", {}).get(name):
            # What remains is too small to ask whether it is there.
            continue
        known = rows_of(study.hypotheses, name)["probability"].to_dict()
        own = answer(study, name)
        if own == study.verdict and own in known:
            # A sensor that was late was put right before hypotheses were weighed: no gap then says the same.
            late = known.get(NO_GAP, 0.0) if own == INSTRUMENT else 0.0
            total *= known[own] + (late if late > known[own] else 0.0)
    return total


def probability_missing(study: StudyResult, equations: Iterable[str] | None = None) -> float:
    """Return the probability that something is missing in some equation, of all or of these."""
    nothing = 1.0
    for name in study.hypotheses.index.unique(0) if equations is None else equations:
        known = rows_of(study.hypotheses, name)["probability"].to_dict()
        nothing *= sum(known.get(each, 0.0) for each in STOPS if each != UNKNOWN_KIND)
    return 1.0 - nothing


def shown_part(study: StudyResult) -> str:
    """Return the part of the data that the gap is summed up on: "test" where there are held-out data, or "train"."""
    return "test" if "test" in study.gap.index.get_level_values(0) else "train"


def free_run_part(gap: pd.DataFrame) -> str:
    """Return the part of the data that free runs are judged on: "train" also where held-out states are at rest."""
    runs = rows_of(gap, FREE_RUN, "metric").dropna(subset=["before"])
    return "test" if "test" in runs.index.get_level_values("data") else "train"


def free_run_errors(gap: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of the free runs by state that moves; empty where none were integrated."""
    return rows_of(rows_of(gap, FREE_RUN, "metric").dropna(subset=["before"]), free_run_part(gap), "data")


def worse_runs(gap: pd.DataFrame, criteria: Criteria = CRITERIA) -> tuple[str, ...]:
    """Return the states whose free run gets worse."""
    return tuple(name for _, metric, name in worsened(gap, criteria) if metric == FREE_RUN)


def not_helped(gap: pd.DataFrame, criteria: Criteria = CRITERIA) -> tuple[str, ...]:
    """Return the states whose free run, on the mean, is no better after than before, though not surely worse."""
    errors, worse = free_run_errors(gap), worse_runs(gap, criteria)
    every = zip(errors.index, errors["after"], errors["before"], strict=True)
    return tuple(str(name) for name, after, before in every if not after < before and name not in worse)


@dataclass(frozen=True)
class GapChange:
    """Change of the unexplained share, summed over the equations.

    The code is "none shown", "none before", "unchanged", "wider" or "closed"; `after` is what has a name alone leaves.
    Rows that got worse, and states whose free run does not get better, are beside it.
    """

    code: str
    part: str
    before: float
    after: float
    worse: tuple[tuple[str, str, str], ...]
    idle: tuple[str, ...]


def rows_by_part(study: StudyResult) -> dict[str, int]:
    """Return the number of rows of training and held-out data."""
    return {"train": study.train.n_obs, **({} if study.test is None else {"test": study.test.n_obs})}


def gap_change(gap: pd.DataFrame, criteria: Criteria = CRITERIA, n_rows: Mapping[str, int] | None = None) -> GapChange:
    """Return the change of the gap, on held-out data if rates are there; rates need `n_rows` to have noise."""
    shares = gap.xs(SHARE, level="metric")[["before", "after"]]
    # f, which takes up anything, has no name and was not added.
    if NAMES_ALONE in gap.index.get_level_values("metric"):
        alone = gap.xs(NAMES_ALONE, level="metric")[["before", "after"]]
        shares = pd.concat([alone, shares.loc[shares.index.difference(alone.index)]])
    # A state at rest has no rate to explain a share of.
    shares = shares.dropna()
    parts = shares.index.get_level_values("data")
    part = "test" if "test" in parts else "train"
    before, after = (float(value) for value in shares[parts == part].sum())
    variables = shares.index.get_level_values("variable")
    names = {name for name, where in zip(variables, parts, strict=True) if where == part}
    noise = len(names) > 0 and all(within_noise(gap, part, name, (n_rows or {}).get(part)) for name in names)
    if before <= after < LEAST_CLOSED or (noise and 0 < after <= before):
        code = "none shown"
    elif not before > 0:
        code = "none before"
    elif abs(1 - after / before) < LEAST_CLOSED:
        code = "unchanged"
    else:
        code = "wider" if after > before else "closed"
    return GapChange(code, part, before, after, worsened(gap, criteria), not_helped(gap, criteria))


def is_denied(study: StudyResult) -> bool:
    """Return whether a smaller gap closes nothing: what fills it has no name, or a free run is no better for it."""
    if study.verdict in (UNKNOWN_KIND, NO_GAP):
        return True
    runs = worsened(study.gap, study.criteria), not_helped(study.gap, study.criteria)
    return bool(added(study).size and any(runs))


@dataclass(frozen=True)
class Statement:
    """One statement about what is missing without a name, of columns or a channel; "" if that is not known.

    Its kind is `QUANTITY`, one of the noise grid (law, time, memory) or of a memory (hysteresis, relaxation, drift).
    """

    kind: str
    of: str
    probability: float


def remainders(study: StudyResult, equation: str) -> list[Statement]:
    """Return the likely statements about what has no name in an equation, the most specific alone."""
    rows, least = rows_of(study.memory, equation).to_dict("records"), study.criteria.missing
    likely = [row for row in rows if row["probability"] > least]
    found = [Statement(row["kind"], row["channel"], float(row["probability"])) for row in likely]
    # A memory of one channel says more than that something remembers.
    specific = [each for each in found if each.of]
    if answer(study, equation) == UNKNOWN_KIND and len(study.quantities):
        # Several effects of one quantity may be one law that has no name: the law is sure, its name is not.
        table = rows_of(study.quantities, equation)
        laws = zip(map(str, table.index), map(float, table["probability"]), strict=True)
        named = [Statement(QUANTITY, of, p) for of, p in laws if of and p > least]
        specific = [*named, *specific]
    return specific or found


def support(gap: GapMap) -> Bool[np.ndarray, "*grid"]:
    """Return where the grid of a gap map lies within the data, as for the figures of a fit."""
    return discrepancy.support(np.reshape(gap.samples, (-1, len(gap.variables))), gap.axes)


def changed(gap: GapMap) -> bool:
    """Return whether the maps of the gap before and after differ."""
    return not np.allclose(gap.after, gap.before, rtol=0.0, atol=SAME_MAP * gap.threshold)


def trace_bands(trace: GapTrace) -> tuple[Float[np.ndarray, "3 n_obs"], Float[np.ndarray, "3 n_obs"]]:
    """Return mean, lower and upper end of the 90 % bands of the gap along time, before and after."""

    def band(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
        return np.stack([mean, mean - INTERVAL_REACH * sd, mean + INTERVAL_REACH * sd])

    return band(trace.before, trace.before_sd), band(trace.after, trace.after_sd)


def corrections_above(study: StudyResult, least: float) -> list[dict[str, Any]]:
    """Return the corrections more probable than `least` that have a sign: one beside a gain may come to zero."""
    table = study.corrections
    likely = (table["probability"] > least) & (table["lower"] * table["upper"] >= 0)
    return shown_corrections(study)[likely].reset_index().to_dict("records")


def unclear_sign(table: pd.DataFrame) -> Bool[np.ndarray, " n_row"]:
    """Return which corrections of a table may have either sign: likely there, they are no sure corrections."""
    lower, upper, mean, sd = (table[name].to_numpy() for name in ("lower", "upper", "mean", "sd"))
    return ((lower < 0.0) & (upper > 0.0)) | (sd > np.abs(mean))


@dataclass(frozen=True)
class CommonFactor:
    """Coefficients of an equation that are all off by one factor, and gains of the whole rate that do the same."""

    equation: str
    factor: float
    rows: Sequence[Mapping[str, Any]]
    gains: Sequence[Mapping[str, Any]]


def by_common_factor(study: StudyResult, off: Sequence[Mapping[str, Any]]) -> Iterator[CommonFactor | Mapping]:
    """Yield corrections one by one, but those of an equation that are all off by one factor together."""
    for name, count in Counter(row["equation"] for row in off).items():
        rows = [row for row in off if row["equation"] == name]
        # A parameter may stand anywhere in a formula.
        if any(row.get("parameter") or not row["nominal"] for row in rows):
            yield from rows
            continue
        ratios = [row["mean"] / row["nominal"] for row in rows]
        mean = sum(ratios) / len(ratios)
        whole = count == len(rows_of(study.corrections, name)) > 1
        # Within a tenth, relative changes are by one factor.
        if not whole or max(ratios) - min(ratios) > 0.1 * abs(mean):
            yield from rows
            continue
        # What a sensor does to one channel does not do what this does; that of the whole rate does.
        key = (name, GAIN, study.train.target_label(name))
        gains = [
            row for row in study.instrument.to_dict("records")
            if (row.get("equation"), row.get("suspect"), row.get("channel")) == key
            and row["status"] != IN_MODEL and row["probability"] >= study.criteria.tied
        ]  # fmt: skip
        yield CommonFactor(name, 1 + mean, rows, gains)


def same_as(study: StudyResult, equation: str) -> dict[str, dict[str, Any]]:
    """Return the sensor errors that do what another one, or a coefficient that is off, does; none in older files."""
    return dict(study.settings.get("same as", {}).get(equation, {}))


def channels_weighed(study: StudyResult) -> dict[str, list[str]]:
    """Return the channels of each kind of sensor error that was weighed, but for those with the column of another."""
    if not study.settings.get("prior odds"):
        return {}
    data, twins = study.train, [same_as(study, name) for name in study.maps]
    states, inputs = data.state_names, data.input_names
    rates = [data.target_label(name) for name in study.maps]
    # A rate that a filter computed, and a state that is one, have no sensor of their own.
    if (computed := data.filter) is not None:
        rates = [data.target_label(name) for name in study.maps if not computed.one_sensor(name)]
        states = tuple(name for name in states if computed.source(name) == name)
    # Rows of samples have sensors whose readings are no straight line.
    sampled = computed is None and not set(study.maps) & set(data.derivatives)
    bending = (data.samples or data).state_names if sampled else ()
    found = {
        DELAY: [*rates, *([STATES] if inputs else []), *(states if len(states) > 1 else ()), *inputs],
        **dict.fromkeys((GAIN, OFFSET), [*rates, *states, *inputs]),
        DRIFT: rates,
        # Along a path the integration smooths an input's noise: it is weighed on rates and outputs only.
        NOISE: [error.channel for error in noisy_inputs(data)] if data.samples is None else [],
        **dict.fromkeys(bends.BEND_ERRORS, bending),
        DEPARTURE: dict.fromkeys(
            row["channel"] for row in study.instrument.to_dict("records") if row["suspect"] == DEPARTURE
        ),
    }
    return {
        kind: [channel for channel in names if not all(f"{kind} of {channel}" in each for each in twins)]
        for kind, names in found.items()
        if names
    }


def sensors_like(study: StudyResult, row: Mapping[str, Any]) -> list[str]:
    """Return the sensor errors that do the same as a wrong coefficient and are small enough for one."""
    key, size = f"recalibration of {row['term']}", abs(row["mean"])
    alike = {name: other for name, other in same_as(study, row["equation"]).items() if other["what"] == key}
    return [name for name, other in alike.items() if size <= LARGEST_ERROR * abs(other["change"])]


def not_weighed(study: StudyResult) -> dict[str, int]:
    """Return the number of effects that were not weighed for want of a role that can be given, by role."""
    slugs = {role: {slug for (_, slug), own in study.lacking_roles.items() if own == role} for role in GIVEN_ROLES}
    return {role: len(own) for role, own in slugs.items() if own}


def added_draws(study: StudyResult, place: int) -> Float[np.ndarray, " n_draw"] | None:
    """Return posterior draws of the coefficient of an added effect; None where the model was not sampled."""
    if study.fit is None:
        return None
    equations = study.effects.iloc[added(study)]["equation"]
    equation = equations.iloc[place]
    after = int(np.sum(equations.iloc[place:] == equation))
    theta = study.fit.idata["posterior"][study.fit.sites[equation].theta].to_numpy()
    return theta[..., theta.shape[-1] - after].ravel()


def sampler_contradictions(study: StudyResult) -> list[tuple[Mapping[str, Any], float, float]]:
    """Return the added effects whose coefficient the sampler puts elsewhere: row of the table, its mean and its SD."""
    found = []
    for place, row in enumerate(study.effects.iloc[added(study)].to_dict("records")):
        draws = added_draws(study, place)
        if draws is None or not np.isfinite(row["mean"]):
            continue
        mean, sd = float(np.mean(draws)), float(np.std(draws))
        if abs(mean - row["mean"]) > 3.0 * max(sd, float(row["sd"])):
            found.append((row, mean, sd))
    return found
