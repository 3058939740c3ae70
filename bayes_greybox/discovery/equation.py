"""The study of one equation: what explains its gap, and the gap before and after on the training data."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.units import target_unit
from bayes_greybox.running.errors import InputError

from .answer.amendment import Amendment, Remainder
from .answer.checks.adequacy import Check, check_hypothesis
from .answer.checks.ends import at_ends
from .answer.checks.filtered import rounded_off
from .answer.checks.linearity import check_linearity
from .answer.coefficients import Coefficients, draw_coefficients, sensor_errors, without_sensors
from .answer.equation_study import EquationStudy
from .answer.where import Along, Gap, gap_map, gap_trace, where_table
from .decision import reasons
from .decision.criteria import Criteria
from .decision.decide import Verdict, decide
from .decision.probabilities import Probabilities
from .grid.hypotheses import Hypothesis
from .grid.search import Reach
from .linearise.near import Near, Point
from .linearise.rates import RateRows
from .linearise.samples import SampleRows
from .linearise.settle import settle, weighed_on
from .linearise.source import Source
from .odds import Odds
from .regressors.regressors import FREE, Regressors
from .suspects.channels import DELAY

DRAWS = 2000
"""Posterior draws of the coefficients behind tables and bands."""

ON_PATH = 0.1
"""Draws with the path's own value of a nonlinear parameter, over those with the commonest, that keep it."""


@dataclass(frozen=True)
class Question:
    """Data, model and settings of the study of one equation.

    Attributes:
        model: The model before.
        train: Training data.
        name: The learned state, or the output.
        effects: Effects bound to columns.
        odds: Prior probabilities.
        most: Largest number of effects added.
        seed: Seed of everything random.
        criteria: Numbers that decide.
    """

    model: Program
    train: Trajectories
    name: str
    effects: Sequence[BoundEffect]
    odds: Odds
    most: int
    seed: int
    criteria: Criteria


def study_equation(question: Question, say: Callable[[str], None]) -> EquationStudy:
    """Return the study of one equation.

    Args:
        question: What is asked.
        say: Told in words what is being done.
    """
    train, name, criteria, seed = question.train, question.name, question.criteria, question.seed
    source, near = _settled(question, say)
    rows, regressors = near.rows, near.regressors
    rate = rows.rate(rows.data)
    # Where zero is of a sensor is nobody's business; that of a rate is.
    rate = rate - np.mean(rate) if regressors.rows.output else rate
    rate_size = float(np.sqrt(np.mean(rate**2))) / regressors.target_scale
    verdict = decide(Probabilities(near.weighed, criteria), rate_size, bool(source.late))
    settled = without_sensors(near, verdict)
    checks = [] if verdict.open_ended else check_hypothesis(near, settled, train.units.get("t", ""))
    members = [i for i in settled.members if regressors.columns[i].effect is not None]
    doubts = {
        reasons.ROWS: source.doubts(rows),
        reasons.CHECK: [check.text for check in checks if not check.ok],
        reasons.UNSEEN_SHAPE: rounded_off(regressors, members),
    }
    verdict = verdict.against([reasons.Reason(code, text) for code, texts in doubts.items() for text in texts])
    say("mapping the gap")
    coefficients = draw_coefficients(near, verdict, DRAWS, seed)
    ends = at_ends(regressors, coefficients, criteria)
    verdict = verdict.against([reasons.Reason(reasons.END_OF_RANGE, text) for text in ends])
    amendment = _amendment(source, near, verdict, coefficients, train)
    linear: list[Check] = []
    if not verdict.open_ended:
        linear = list(check_linearity(amendment, regressors, train.input_names))
    unit, along = target_unit(name, train), _along(near)
    before, after = _gap(near, near.weighed.before), _gap(near, settled)
    # Samples of a displacement tell a force less well than their sensor's noise is small.
    threshold = max(amendment.sigma, float(np.median(before.sd)))
    trace = gap_trace(along, before, after, threshold, unit)
    drawn = gap_map(train, along, before, after, regressors.variables[:2], threshold, unit)
    where = where_table(train, along, regressors.variables, trace)
    return EquationStudy(
        source, near, verdict, (*checks, *linear), coefficients, amendment, drawn, trace, where, criteria
    )  # fmt: skip


def _settled(question: Question, say: Callable[[str], None]) -> tuple[Source, Near]:
    """Return the hypotheses on rows near the likeliest; of two ways that inputs go between samples, the likelier."""
    model, train, name, odds = question.model, question.train, question.name, question.odds
    reach = Reach(effects=question.most)

    def settled(source: Source, start: Point) -> tuple[Source, Near]:
        return source, settle(source.near, source.quantities, start, odds, reach, question.seed, say)

    if model.rows.rates_measured:
        return settled(RateRows(model, train, name, question.effects), Point())
    found = settled(SampleRows(model, train, name, question.effects), Point())
    if model.rows.interpolation is not None or not train.input_names:
        return found
    say("following the path with inputs that are held")
    held = replace(model, rows=model.rows.held())
    point = found[1].point_of(found[1].likeliest)
    # A delay is what lines between samples of held inputs look like.
    start = replace(point, sensors={s: size for s, size in point.sensors.items() if s.kind != DELAY}, shapes=())
    # That inputs are held has the prior odds of any error of a channel.
    least = found[1].log_evidence - math.log(odds.suspect) + math.log1p(-odds.suspect)
    try:
        rows = held.rows.complete(train, name, held.simulator(train))
        source = SampleRows(held, rows, name, question.effects)
        near = weighed_on(source.near(replace(start, window=found[1].window)), odds, reach, question.seed)
        # Nothing has moved there yet: it may become likelier by as much as hypotheses that are kept.
        again = settled(source, start) if near.log_evidence > least - reach.window else found
    except (InputError, np.linalg.LinAlgError):
        return found
    return again if again[1].log_evidence > least else found


def _amendment(
    source: Source, near: Near, verdict: Verdict, coefficients: Coefficients, train: Trajectories
) -> Amendment:
    """Return the model after: coefficients of an answer, sensors put right, and f where something is left."""
    regressors, point = near.regressors, near.rows.point
    sensors = sensor_errors(regressors, coefficients)

    def put_right(data: Trajectories) -> Trajectories:
        return source.put_right(data, point, sensors, train)

    sigma = float(np.mean(coefficients.sigma)) * regressors.target_scale
    alike, hidden = _of_one_memory(regressors, coefficients, point.hidden)
    forced = (
        near.weighed.grid.points[verdict.hypothesis.point].kind == "time" and not near.rows.model.rows.rates_measured
    )
    amendment = Amendment(
        regressors, _free_alone(regressors), coefficients, sigma, None, put_right, source.row_kind(point), sensors,
        train, hidden, alike, regressors.rows.gain, forced,
    )  # fmt: skip
    if verdict.open_ended and near.weighed.table.law.rows.shape[1]:
        remainder = Remainder.of(near, verdict.hypothesis, coefficients)
        amendment = replace(amendment, discrepancy=remainder)
    return amendment


def _free_alone(regressors: Regressors) -> np.ndarray:
    """Return the coefficients of the user's own terms with nothing else in the model, scaled."""
    white = regressors.rows.whiten(np.column_stack([regressors.target, regressors.at_rows(regressors.of_kind(FREE))]))
    return np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-12)[0]


def _along(near: Near) -> Along:
    """Return the samples that the latent force is known at."""
    rows = near.regressors.rows
    n = len(np.unique(rows.sample))
    columns = {name: column[:n] for name, column in rows.at_rows().items()}
    return Along(rows.equation, rows.time[:n], rows.run[:n], columns)


def _gap(near: Near, hypothesis: Hypothesis) -> Gap:
    """Return the smoothed latent force beside a hypothesis, user's units."""
    mean, sd = near.weighed.latent_force(hypothesis)
    scale = near.regressors.target_scale
    return Gap(scale * mean, scale * sd)


def _of_one_memory(
    regressors: Regressors, coefficients: Coefficients, known: Sequence[HiddenState]
) -> tuple[np.ndarray, tuple[HiddenState, ...]]:
    """Return draws that share the hidden states of each effect, and all hidden states of the model after.

    A hidden state has one rate in a model: that of the path where draws have it, else the commonest among them.

    Args:
        regressors: Of the equation.
        coefficients: Draws, each with values of nonlinear parameters of its own.
        known: Hidden states of the path.
    """
    hidden, alike = {state.name: state for state in known}, np.arange(len(coefficients.draws))
    for inner in coefficients.inner.T:
        columns, count = np.unique(inner[alike], return_counts=True)
        states = {int(i): regressors.columns[i].formula.states for i in columns}
        if not any(states.values()):
            continue
        # Of many values drawn around a mode none has much.
        share = dict(zip(map(int, columns), count / np.max(count), strict=True))
        on_path = [
            i
            for i, own in states.items()
            if share[i] >= ON_PATH and all(hidden.get(state.name) == state for state in own)
        ]
        chosen = on_path[0] if on_path else int(columns[np.argmax(count)])
        hidden |= {state.name: state for state in states[chosen]}
        alike = alike[inner[alike] == chosen]
    return alike, tuple(hidden.values())
