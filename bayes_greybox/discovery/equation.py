"""The study of one equation: hypotheses on its gap, the answer, and the gap before and after on training data."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.integration.adaptive_steps import between_samples_of_runs
from bayes_greybox.physics.units import target_unit
from bayes_greybox.running.errors import InputError

from .answer.amendment import Amendment, Remainder
from .answer.checks import Check, at_ends, check_hypothesis, check_linearity, rounded_off
from .answer.coefficients import Coefficients, draw_coefficients, sensor_errors, without_sensors
from .answer.equation_study import EquationStudy
from .answer.where import Along, Gap, gap_map, gap_trace, where_table
from .decision import reasons as codes
from .decision.criteria import Criteria
from .decision.decide import Verdict, decide
from .decision.probabilities import Probabilities
from .decision.reasons import Reason
from .grid.points import LATENT_FORCE
from .grid.sets import Reach
from .grid.weigh import Hypothesis
from .linearise.near import Near, Point
from .linearise.rates import RateRows
from .linearise.samples import SampleRows
from .linearise.settle import settle
from .linearise.source import Source
from .linearise.standing import LIKELIER
from .linearise.visits import Weigher
from .odds import Odds
from .regressors.regressors import FREE, Regressors
from .sensor_errors.channels import DELAY
from .sensor_errors.kinematics import sizes_of


@dataclass(frozen=True)
class Question:
    """Data, model and settings of the study of an equation, of a state or an output; `most` effects may be added."""

    model: Program
    train: Trajectories
    name: str
    effects: Sequence[BoundEffect]
    odds: Odds
    most: int
    seed: int
    criteria: Criteria


def study_equation(question: Question, say: Callable[[str], None]) -> EquationStudy:
    """Return the study of one equation."""
    train, criteria = question.train, question.criteria
    source, near = _settled(question, say)
    rate = near.rows.rate(near.rows.data)
    # The zero of a sensor is arbitrary; that of a rate is not.
    rate = rate - np.mean(rate) if near.regressors.rows.output else rate
    rate_size = float(np.sqrt(np.mean(rate**2))) / near.regressors.target_scale
    verdict = decide(Probabilities(near.weighed, criteria), rate_size, bool(source.known))
    settled = without_sensors(near, verdict)
    say("mapping the gap")
    coefficients = draw_coefficients(near, verdict, 2000, question.seed)
    checks: list[Check] = []
    if not verdict.open_ended:
        checks = check_hypothesis(near, settled, train.units.get("t", ""), criteria)
    effects = [i for i in settled.members if near.column(i).effect is not None]
    against = {
        codes.ROWS: source.doubts(near.rows),
        codes.CHECK: [check.text for check in checks if not check.ok],
        codes.UNSEEN_SHAPE: rounded_off(near.regressors, effects, criteria),
        codes.END_OF_RANGE: at_ends(near.regressors, coefficients, criteria),
    }
    verdict = verdict.against([Reason(code, text) for code, texts in against.items() for text in texts])
    amendment = _amendment(source, near, verdict, coefficients, train)
    if not verdict.open_ended:
        checks = [*checks, *check_linearity(amendment, near.regressors, train.input_names)]
    unit, variables, rows = target_unit(question.name, train), near.regressors.variables, near.regressors.rows
    n = len(np.unique(rows.sample))
    along = Along(rows.equation, rows.time[:n], rows.run[:n], {name: x[:n] for name, x in rows.at_rows().items()})
    before, after = _gap(near, near.weighed.before), _gap(near, settled)
    # Samples of a displacement tell a force less well than their sensor's noise is small.
    threshold = max(amendment.sigma, float(np.median(before.sd)))
    trace = gap_trace(along, before, after, threshold, unit)
    drawn = gap_map(train, along, before, after, variables[:2], threshold, unit)
    where = where_table(train, along, variables, trace)
    return EquationStudy(source, near, verdict, tuple(checks), coefficients, amendment, drawn, trace, where)


def _settled(question: Question, say: Callable[[str], None]) -> tuple[Source, Near]:
    """Return the hypotheses on rows near the likeliest; of the ways that inputs go between samples, the likeliest."""
    model, train, name, odds = question.model, question.train, question.name, question.odds
    kind = SampleRows if model.rows.follows_path else RateRows
    given = Weigher(kind(model, train, name, question.effects), odds, Reach(effects=question.most), question.seed)
    visit = settle(given, Point(), say)
    as_given, near = (given.source, visit.near), visit.near
    remembers = model.rows.follows_path or train.computed or any(each.effect.hidden for each in question.effects)
    if model.rows.interpolation is not None or not train.input_names or not remembers:
        return as_given
    say("weighing again with inputs that are held")
    point = near.point_of(near.likeliest)
    # Lines between samples of held inputs look like a delay, or lead to a hypothesis that is far from the right one.
    found = replace(point, sensors={s: size for s, size in point.sensors.items() if s.kind != DELAY}, shapes=())
    plain = replace(found, added=(), parameters={}, sensors={})
    starts = [found, plain] if found.added or found.parameters or found.sensors else [plain]
    weighed: list[tuple[float, float, Weigher, Point]] = []
    for between, stays in _held(train):
        held = replace(model, rows=model.rows.between(between))
        # That inputs are held has the prior odds of any error of a channel, or is as likely as not: rounding does not
        # decide it. Regressors along a path that follows noise flatter hypotheses which nobody followed: those are
        # compared that rows are near.
        least = visit.log_weight + (LIKELIER if stays else math.log(1 / odds.suspect - 1))
        # Along some inputs no path is found.
        with suppress(InputError, np.linalg.LinAlgError):
            rows = held.rows.complete(train, name, held.simulator(train))
            for start in starts:
                weigher = replace(given, source=kind(held, rows, name, question.effects))
                first = weigher.near(replace(start, window=near.window))
                weighed.append((first.log_evidence - least, least, weigher, start))
    gained, least, weigher, start = max(weighed, key=lambda each: each[0], default=(-math.inf, 0.0, given, found))
    # Nothing has moved there yet: it may become likelier by as much as hypotheses that are kept.
    if gained > -given.reach.window:
        with suppress(InputError, np.linalg.LinAlgError):
            again = settle(weigher, start, say)
            return (weigher.source, again.near) if again.log_weight > least else as_given
    return as_given


def _held(train: Trajectories) -> list[tuple[str | tuple[str, ...], bool]]:
    """Return interpolations with held inputs (all, each, those that do not look smooth), and whether these mostly stay.

    A heater is switched by a clock and holds; the weather, sampled with it, goes on between its samples.
    """
    samples = train.samples or train
    parts = [samples.run == run for run in range(samples.n_run)]
    inputs = samples.matrix(samples.input_names)
    kinds = between_samples_of_runs([(samples.time[part], inputs[part]) for part in parts])
    stays = np.concatenate([np.diff(inputs[part], axis=0) == 0 for part in parts]).mean(axis=0) > 0.5
    n, rough = len(kinds), tuple(kind != "cubic" for kind in kinds)
    choices = dict.fromkeys([(True,) * n, *(tuple(k == one for k in range(n)) for one in range(n)), rough])
    return [
        ("zoh" if all(held) else tuple("zoh" if each else "cubic" for each in held), bool(np.all(stays[list(held)])))
        for held in choices
        if any(held)
    ]


def _amendment(source: Source, near: Near, verdict: Verdict, after: Coefficients, train: Trajectories) -> Amendment:
    """Return the model after: coefficients of an answer, sensors put right, and f if the answer is open-ended."""
    regressors, point = near.regressors, near.rows.point
    sensors = sensor_errors(regressors, after)
    alike, hidden = _of_one_memory(regressors, after, point.hidden)
    through = source.model.named.moved_through(point.parameters)
    moved = {name: point.parameters[name] for name in through}
    named = source.model.at(moved).named
    own = [regressors.columns[i] for i in after.indices[: after.n_own]]
    slopes = {state.name: state for column in own if column.term is not None for state in column.formula.states}
    # Where hidden states follow the value that was found, the whole change is that and what is left of it.
    known = [(column.formula, -through[column.parameter]) for column in own if column.parameter in through]
    in_time = near.weighed.grid.points[verdict.hypothesis.point].kind == LATENT_FORCE
    remainder = None
    if verdict.open_ended and near.weighed.table.law.rows.shape[1]:
        remainder = Remainder.of(near, verdict.hypothesis, after)
    return Amendment(
        statistics=regressors,
        before=regressors.least_squares(regressors.of_kind(FREE))[0],
        after=after,
        sigma=float(np.mean(after.sigma)) * regressors.target_scale,
        discrepancy=remainder,
        corrected=lambda data: source.put_right(data, point, sensors, train, (*hidden, *slopes.values())),
        rows=source.row_kind(point),
        sensors=sizes_of(source.known) | sensors,
        clock=train,
        hidden=hidden,
        alike=alike,
        gain=regressors.rows.gain,
        forced=in_time and near.rows.model.rows.follows_path,
        parameters=moved,
        slopes=tuple(slopes.values()),
        remainder=(*named.remainder(regressors.equation, point.parameters), *known),
    )


def _gap(near: Near, hypothesis: Hypothesis) -> Gap:
    mean, sd = near.weighed.latent_force(hypothesis)
    scale = near.regressors.target_scale
    return Gap(scale * mean, scale * sd)


def _of_one_memory(
    regressors: Regressors, coefficients: Coefficients, path_states: Sequence[HiddenState]
) -> tuple[np.ndarray, tuple[HiddenState, ...]]:
    """Return draws that share the hidden states of each effect, of the path or the commonest, and these states."""
    hidden, alike = {state.name: state for state in path_states}, np.arange(len(coefficients.draws))
    for inner in coefficients.inner.T:
        columns, count = np.unique(inner[alike], return_counts=True)
        states = {int(i): regressors.columns[i].formula.states for i in columns}
        if not any(states.values()):
            continue
        # Of many values drawn around a mode none is common.
        share = dict(zip(map(int, columns), count / np.max(count), strict=True))
        of_path = {i for i, own in states.items() if all(hidden.get(state.name) == state for state in own)}
        # The path's own values stay unless next to no draw has them.
        on_path = [i for i in states if share[i] >= 0.1 and i in of_path]
        chosen = on_path[0] if on_path else int(columns[np.argmax(count)])
        hidden |= {state.name: state for state in states[chosen]}
        alike = alike[inner[alike] == chosen]
    return alike, tuple(hidden.values())
