"""The study of one equation: what explains its gap, and what speaks against that."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.units import target_unit

from .answer.amendment import Amendment, Remainder
from .answer.checks.adequacy import Check, check_explanation
from .answer.checks.contradictions import contradictions, noise_as_force, with_noisy_states
from .answer.checks.ends import at_ends
from .answer.checks.filtered import rounded_off
from .answer.checks.linearity import check_linearity
from .answer.checks.motion import MotionCheck
from .answer.coefficients import Coefficients, draw_coefficients, plain, sensor_errors
from .answer.doubt import Doubt
from .answer.equation_study import EquationStudy
from .answer.finding import Finding, decide, rivals
from .answer.mirrored import mirrors
from .answer.weighed import Mirror
from .answer.where import GapField, gap_map, gap_trace, where_table
from .evidence.odds import Odds
from .evidence.sufficient_statistics import SufficientStatistics
from .suspects.channels import Rate
from .suspects.samples import Smoother, known_rates
from .weighing.aligned import Aligned
from .weighing.alignment import align
from .weighing.path.follow import follow
from .weighing.path.near import Near
from .weighing.sets import RECALIBRATED, Sets
from .weighing.told import told
from .weighing.worlds import World, worlds

DRAWS = 2000
"""Posterior draws of the coefficients behind tables and bands."""

ON_PATH = 0.1
"""Draws with the path's own value of an inner parameter, over those with the commonest, from which on it is taken."""

WITHIN, MOST_WITHIN = 3.0, 0.5
"""A path is within a sensor's range by more than so many standard deviations of its noise; it speaks against an answer
at more than this share of the samples at which the sensor was at its end."""

JITTER = "change of {}"
"""What noise grows with where the time stamps jitter: that of the rate, or of an output."""


def study_equation(
    model: Program, train: Trajectories, name: str, effects: Sequence[BoundEffect], odds: Odds, most: int, seed: int,
    settle: bool, say: Callable[[str], None],
) -> EquationStudy:  # fmt: skip
    """Study one equation: what explains it, then the gap before and after on the training data.

    Args:
        model: The model before.
        train: Training data.
        name: The learned state.
        effects: Effects bound to columns.
        odds: Prior probabilities.
        most: Largest number of effects added.
        seed: Seed of the coefficients' draws.
        settle: Whether finalists are settled by bridge sampling where that is needed.
        say: Told in words what is being done.
    """
    aligned, found = _weighed(model, train, name, effects, odds, most, seed if settle else None, say)
    model = aligned.with_inputs(model)
    train = model.rows.complete(train, name, model.simulator(train))
    bounded = _within(aligned, train)
    unit, unit_of_time = target_unit(name, train), train.units.get("t", "")

    mirrored: dict[str, Mirror] = {}

    def decided(doubts: Sequence[Doubt]) -> tuple[Finding, list[Check]]:
        finding = decide(found, doubts, mirrored)
        # An answer that doubts brought may have a lag that no answer before had.
        if fresh := mirrors(model, train, name, finding, mirrored, say):
            mirrored.update(fresh)
            finding = decide(found, doubts, mirrored)
        rest = finding.world.leaves_rest(finding.explanation)
        checks = [] if rest else check_explanation(finding.world, finding.explanation, unit_of_time)
        finding = with_noisy_states(finding, aligned, unit)
        if finding.verdict == "no gap" and aligned.late:
            finding = replace(finding, verdict="instrument")
        said = [*bounded, *(check.text for check in checks if not check.ok)]
        said += rounded_off(finding.world.evaluations.statistics, finding.base)
        return finding.capped(said), checks

    finding, checks = decided(())
    say("mapping the gap")
    amendment = _amendment(finding, aligned, train, seed)
    judged: dict[str, list[MotionCheck]] = {}
    denials: list[Doubt] = []
    while finding.kind not in judged and not (judged and finding.kind == "unknown"):
        # Each answer is judged by its own motion before it is said; what denies one stays.
        judged[finding.kind], doubts = contradictions(model, train, aligned, amendment, finding, odds)
        for rival in rivals(finding) if aligned.rates_measured else ():
            # So is what stands beside it: a wrong mass and the gain of a rate's sensor differ in nothing else.
            if rival.kind not in judged:
                changed = _amendment(rival, aligned, train, seed)
                judged[rival.kind], more = contradictions(model, train, aligned, changed, rival, odds)
                denials += [doubt for doubt in more if doubt.denies]
        denials += [doubt for doubt in doubts if doubt.denies]
        others = [doubt for doubt in doubts if not doubt.denies] + noise_as_force(finding, aligned)
        if not denials and not others:
            break
        finding, checks = decided([*denials, *others])
        amendment = _amendment(finding, aligned, train, seed)
    motion = judged.get(finding.kind, next(iter(judged.values())))
    statistics, evaluator = finding.world.evaluations.statistics, finding.world.evaluations.evaluator
    coefficients = amendment.after
    finding = finding.capped([*(check.text for check in motion if not check.ok), *at_ends(statistics, coefficients)])
    if finding.open_ended:
        # Where not all of it has a name, the model after holds what remains as f.
        amendment = replace(amendment, discrepancy=Remainder.of(statistics, evaluator, coefficients))
    changed = [k for k, i in enumerate(coefficients.indices) if statistics.columns[i].kind != "free"]
    taken = [*(coefficients.indices[k] for k in changed), *coefficients.suspects]
    sizes = np.concatenate([coefficients.draws.mean(axis=0)[changed], coefficients.suspect_draws.mean(axis=0)])
    before, after = GapField.of(statistics, evaluator), GapField.of(statistics, evaluator, taken, sizes)
    threshold = min(before.sigma, amendment.sigma)
    trace = gap_trace(aligned.data, before, after, threshold, unit)
    drawn = gap_map(aligned.data, before, after, statistics.variables[:2], threshold, unit)
    where = where_table(aligned.data, statistics.variables, trace)
    rest = finding.open_ended or finding.world.leaves_rest(finding.explanation)
    linear = [] if rest else check_linearity(amendment, statistics, train.input_names)
    return EquationStudy(aligned, finding, (*checks, *motion, *linear), coefficients, amendment, drawn, trace, where)


def _weighed(
    model: Program, train: Trajectories, name: str, effects: Sequence[BoundEffect], odds: Odds, most: int,
    seed: int | None, say: Callable[[str], None],
) -> tuple[Aligned, list[World]]:  # fmt: skip
    """Explanations under every noise that matters, on data freed of what their sensors were found to do."""

    def under_every_noise(aligned: Aligned) -> list[World]:
        aligned.evaluations.seed = seed
        quantities = _quantities(model, aligned.data, aligned.sets, aligned.rate)
        return told(worlds(aligned.sets, quantities, say, aligned.noise), aligned.sets)

    if not model.rows.rates_measured:

        def quantities(near: Near) -> dict[str, np.ndarray]:
            return _quantities(model, near.data, near.base, near.rate)

        aligned = follow(quantities, model, train, name, effects, odds, most, say)
        return aligned, under_every_noise(aligned)
    smooth = Smoother(train, known_rates(model.simulator(train), train))
    aligned = align(model, train, name, effects, odds, most, say, smooth=smooth)
    found = under_every_noise(aligned)
    if aligned.delays and found[0].model.names:
        # Under the wrong noise a delay may have been found that the right one knows nothing of.
        again = align(model, train, name, effects, odds, most, say, (found[0].model.noise, aligned.used), smooth)
        if again.delays != aligned.delays:
            aligned, found = again, under_every_noise(again)
    return aligned, found


def _amendment(finding: Finding, aligned: Aligned, train: Trajectories, seed: int) -> Amendment:
    """The model after, without what remains: coefficients of a finding, and sensors put right."""
    evaluations, statistics = finding.world.evaluations, finding.world.evaluations.statistics
    suspects = finding.explanation.suspects
    memory = finding.explanation.memory
    remainder = finding.remainder if finding.explanation.leaves_rest and not memory else 0.0
    # A verdict on the simulation's own coefficients is one on which of them are off: its draws are given that.
    right = finding.kind in ("no gap", "instrument")
    coefficients = draw_coefficients(
        evaluations, finding.base, DRAWS, seed, (*suspects, *memory), remainder, some=finding.kind == "recalibrate",
        none=right,
    )  # fmt: skip
    # What remembers without a name is fitted beside them, and no part of the model after.
    coefficients = coefficients.without_memory(statistics, len(suspects))
    if not finding.base and finding.explanation.kind != RECALIBRATED:
        # Nothing is missing, or nothing that has a name: the model after is the model before, whatever small weight
        # corrections keep.
        coefficients = coefficients._replace(draws=coefficients.draws * _free_only(statistics, coefficients))
    sensors = sensor_errors(statistics, coefficients)

    def put_right(data: Trajectories) -> Trajectories:
        return aligned.put_right(data, sensors, train)

    sigma = float(np.mean(coefficients.sigma)) * statistics.target_scale
    alike, hidden = _of_one_memory(statistics, coefficients, aligned.hidden)
    return Amendment(
        statistics, plain(evaluations), coefficients, sigma, None, put_right, aligned.rows, sensors, train, hidden,
        alike, statistics.rows.gain, statistics.rows.noise.moved,
    )  # fmt: skip


def _of_one_memory(
    statistics: SufficientStatistics, coefficients: Coefficients, known: Sequence[HiddenState]
) -> tuple[np.ndarray, tuple[HiddenState, ...]]:
    """Draws that share the hidden states of each effect, and all hidden states of the model after.

    A hidden state has one rate in a model: that of the path where draws have it, else the commonest among them.

    Args:
        statistics: Of the equation.
        coefficients: Draws, each with inner parameters of its own.
        known: Hidden states of the path.
    """
    hidden, alike = {state.name: state for state in known}, np.arange(len(coefficients.draws))
    for inner in coefficients.inner.T:
        columns, count = np.unique(inner[alike], return_counts=True)
        states = {int(i): statistics.columns[i].formula.states for i in columns}
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


def _within(aligned: Aligned, train: Trajectories) -> list[str]:
    """Sensors that were at their end while the path was not, in words: what was left out there was no clipping."""
    if aligned.rates_measured:
        return []
    samples = train.samples or train
    names = samples.state_names
    noise = dict(zip(names, sample_noise(samples.time, samples.matrix(names), samples.run_lengths), strict=True))
    said = []
    for name, rows in aligned.clipped.items():
        end, path = samples.states[name][rows], aligned.shown(name)[rows]
        inside = np.where(end == np.max(samples.states[name]), end - path, path - end) > WITHIN * noise[name]
        if np.mean(inside) > MOST_WITHIN:
            said.append(f"{name} stays at the end of its sensor's range at samples where its path does not reach it")
    return said


def _quantities(model: Program, data: Trajectories, sets: Sets, rate: Rate) -> dict[str, np.ndarray]:
    """What the noise of the rows may grow with."""
    name, operator = sets.statistics.equation, sets.statistics.rows.operator
    simulated = model.simulator(data).on(data, name)
    what = f"simulated {sets.statistics.rows.label}"
    found = {**data.columns, what: simulated, **_changing(data, name, rate)}
    return found if operator is None else {key: values[operator.sample] for key, values in found.items()}


def _changing(data: Trajectories, name: str, rate: Callable[[Trajectories], np.ndarray]) -> dict[str, np.ndarray]:
    """How fast the modelled rate, or output, changes: what jitter of the time stamps turns into noise."""
    values, runs = rate(data), [data.run == r for r in dict.fromkeys(data.run.tolist())]
    if any(np.sum(own) < 2 for own in runs):
        return {}
    what = JITTER.format(data.target_in_words(name, article="the "))
    return {what: np.concatenate([np.gradient(values[own], data.time[own]) for own in runs])}


def _free_only(statistics: SufficientStatistics, coefficients: Coefficients) -> np.ndarray:
    return np.array([float(statistics.columns[i].kind == "free") for i in coefficients.indices])
