"""The study of one equation: what explains its gap, and what speaks against that."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.units import derivative_unit

from .answer.adequacy import Check, check_explanation
from .answer.amendment import Amendment, Remainder
from .answer.coefficients import Coefficients, draw_coefficients, plain
from .answer.doubt import Doubt, contradicted
from .answer.equation_study import EquationStudy
from .answer.finding import Finding, decide
from .answer.gap import RATE_DRAWS
from .answer.motion import ModelledRate, MotionCheck, check_motion
from .answer.where import GapField, gap_map, gap_trace, where_table
from .evidence.odds import Odds
from .evidence.sufficient_statistics import SufficientStatistics
from .suspects.channels import ChannelSuspect, Rate, calibrated, slope_along
from .suspects.samples import Smoother, known_rates
from .weighing.alignment import Aligned, align
from .weighing.along_path import Near, follow
from .weighing.sets import RECALIBRATED, Sets
from .weighing.worlds import World, worlds

DRAWS = 2000
"""Posterior draws of the coefficients behind tables and bands."""

REGRESSORS, AS_LARGE = 0.3, 2.0
"""What noise on states does to the rate, over the residuals, from which on it is held against a verdict; and the gap
over it up to which the gap is nothing else."""

JITTER = "change of the rate"
"""What noise grows with where the time stamps jitter."""


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
    unit, unit_of_time = derivative_unit(name, train.units), train.units.get("t", "")

    def decided(doubts: Sequence[Doubt]) -> tuple[Finding, list[Check]]:
        finding = decide(found, doubts)
        rest = finding.world.leaves_rest(finding.explanation)
        checks = [] if rest else check_explanation(finding.world, finding.explanation, unit_of_time)
        finding = _with_noisy_states(finding, aligned, unit)
        if finding.verdict == "no gap" and aligned.late:
            finding = replace(finding, verdict="instrument")
        said = [check.text for check in checks if not check.ok]
        return finding.capped(said), checks

    finding, checks = decided(())
    say("mapping the gap")
    amendment = _amendment(finding, aligned, train, seed)
    motion, doubts = _motion(model, train, aligned, amendment, finding, odds)
    doubts += _noise_as_force(finding, aligned)
    if doubts:
        finding, checks = decided(doubts)
        finding = finding.capped([check.text for check in motion if not check.ok])
        amendment = _amendment(finding, aligned, train, seed)
    statistics, evaluator = finding.world.evaluations.statistics, finding.world.evaluations.evaluator
    coefficients = amendment.after
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
    return EquationStudy(aligned, finding, (*checks, *motion), coefficients, amendment, drawn, trace, where)


def _weighed(
    model: Program, train: Trajectories, name: str, effects: Sequence[BoundEffect], odds: Odds, most: int,
    seed: int | None, say: Callable[[str], None],
) -> tuple[Aligned, list[World]]:  # fmt: skip
    """Explanations under every noise that matters, on data freed of what their sensors were found to do."""

    def under_every_noise(aligned: Aligned) -> list[World]:
        aligned.evaluations.seed = seed
        return worlds(aligned.sets, _quantities(model, aligned.data, aligned.sets, aligned.rate), say, aligned.noise)

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
    coefficients = draw_coefficients(evaluations, finding.base, DRAWS, seed, (*suspects, *memory), remainder)
    # What remembers is fitted beside them, and no part of the model after.
    coefficients = coefficients.first_suspects(len(suspects))
    if not finding.base and finding.explanation.kind != RECALIBRATED:
        # Nothing is missing, or nothing that has a name: the model after is the model before, whatever small weight
        # corrections keep.
        coefficients = coefficients._replace(draws=coefficients.draws * _free_only(statistics, coefficients))
    sensors = _sensors(statistics, coefficients)

    def put_right(data: Trajectories) -> Trajectories:
        return aligned.put_right(data, sensors, train)

    sigma = float(np.mean(coefficients.sigma)) * statistics.target_scale
    return Amendment(statistics, plain(evaluations), coefficients, sigma, None, put_right, aligned.rows)


def _sensors(statistics: SufficientStatistics, coefficients: Coefficients) -> dict[ChannelSuspect, float]:
    """Mean sizes of the suspects in the model, in their units."""
    return {
        suspect: float(size) * statistics.target_scale / statistics.columns[i].scale
        for i, size in zip(coefficients.suspects, coefficients.suspect_draws.mean(axis=0), strict=True)
        if (suspect := statistics.columns[i].suspect) is not None
    }


def _with_noisy_states(finding: Finding, aligned: Aligned, unit: str) -> Finding:
    """What the noise left on states says against the finding; a gap no larger than it is the instrument's."""
    world, scale = finding.world, finding.world.evaluations.statistics.target_scale
    spurious, left = aligned.spurious / scale, _left(finding)
    if finding.verdict == "unknown":
        gap = np.sqrt(max(float(np.mean(world.residual(world.bare) ** 2)) - left**2, 0.0))
        if spurious > REGRESSORS * left and gap < AS_LARGE * spurious:
            return replace(finding, verdict="instrument")
    if finding.places and _size(finding) < spurious:
        # What noise on states does may well be what the names explain.
        return replace(finding, verdict="instrument", places=())
    if not spurious > REGRESSORS * left:
        return finding
    names = ", ".join(aligned.sample_noise)
    return finding.capped(
        [f"noise on the samples of {names} acts like a force of {spurious * scale:.2g} {unit}".rstrip()]
    )


def _noise_as_force(finding: Finding, aligned: Aligned) -> list[Doubt]:
    """What the noise left on states does to the rate, where that is much beside the residuals: no effect is smaller."""
    spurious = aligned.spurious / finding.world.evaluations.statistics.target_scale
    return [Doubt(1.0, spurious, own=False)] if finding.places and spurious > REGRESSORS * _left(finding) else []


def _left(finding: Finding) -> float:
    """RMS of the residual but for a process in time, which is in it and no noise; scaled units."""
    world = finding.world
    return float(np.sqrt(np.mean(world.residual(finding.explanation) ** 2) * (1 - world.model.process_share)))


def _size(finding: Finding) -> float:
    """RMS of the effects of the answer, scaled units."""
    world, e = finding.world, finding.explanation
    known = world.evaluations
    inside = [k for k, i in enumerate(known.indices(e.columns)) if i in e.effects]
    effects = known.statistics.at_rows([known.indices(e.columns)[k] for k in inside])
    return float(np.sqrt(np.mean((effects @ world.coefficients(e)[0][inside]) ** 2)))


def _motion(
    model: Program, train: Trajectories, aligned: Aligned, amendment: Amendment, finding: Finding, odds: Odds
) -> tuple[list[MotionCheck], list[Doubt]]:
    """Whether states move as the states that are their rates say, and the studied one as the amended model says.

    And of those that do not, how likely that is no chance, and what it does to the studied rate.
    """
    name, scale = amendment.statistics.equation, amendment.statistics.target_scale
    if not aligned.rates_measured:
        # What was computed from the samples agrees with them.
        return [], []
    sensors = _sensors(amendment.statistics, amendment.after)
    data = calibrated(aligned.moved(train), name, sensors, train)
    simulation, left = model.simulator(data), {k: noise.left for k, noise in aligned.sample_noise.items()}
    # What smoothing leaves is less than the noise, but known only roughly: no sensor is blamed for that.
    noise = {k: found.sd for k, found in aligned.sample_noise.items()}
    unit, ones = train.units.get("t", ""), np.ones(data.n_obs)

    def force(state: str) -> float:
        """RMS of the change of the studied rate by a unit of a state."""
        return float(np.sqrt(np.mean(slope_along(data, aligned.rate, state, ones) ** 2)))

    def by_noise(rate: Callable[[Trajectories], np.ndarray]) -> float:
        square = sum(s**2 * np.mean(slope_along(data, rate, x, ones) ** 2) for x, s in left.items())
        return float(np.sqrt(square))

    others, measured_by = {}, {}
    for state in data.state_names:
        if state != name and simulation.kinematic(state):
            rate = partial(simulation.on, state=state)
            (term, _), *_ = simulation.additive_terms(state)
            others[state], measured_by[state] = ModelledRate(rate(data), by_noise(rate), term.name), term.name
    checks = check_motion(data, others, noise, unit)
    doubts = [
        # Which of the two sensors is wrong is not known: the worse for the answer.
        Doubt(
            contradicted(check.p, odds.suspect),
            max(force(x) * check.departure, force(measured_by[x]) * check.departure / check.span) / scale,
            own=False,
        )
        for check in checks
        if not check.ok and (x := check.state)
    ]
    if not finding.open_ended:
        draws = amendment.rates(data.columns, RATE_DRAWS)[1]
        sd = float(np.hypot(np.sqrt(np.mean(np.var(draws, axis=0))), by_noise(aligned.rate)))
        own = ModelledRate(simulation.on(data, name) + draws.mean(axis=0), sd, "the model with what was found")
        for check in check_motion(data, {name: own}, noise, unit):
            checks.append(check)
            if not check.ok:
                doubts.append(Doubt(contradicted(check.p, odds.suspect), check.departure / check.span / scale, True))
    return checks, doubts


def _quantities(model: Program, data: Trajectories, sets: Sets, rate: Rate) -> dict[str, np.ndarray]:
    """What the noise of the rows may grow with."""
    name, operator = sets.statistics.equation, sets.statistics.rows.operator
    simulated = model.simulator(data).on(data, name)
    found = {**data.columns, f"simulated d({name})/dt": simulated, **_changing(data, rate)}
    return found if operator is None else {key: values[operator.sample] for key, values in found.items()}


def _changing(data: Trajectories, rate: Callable[[Trajectories], np.ndarray]) -> dict[str, np.ndarray]:
    """How fast the modelled rate changes: what jitter of the time stamps turns into noise."""
    values, runs = rate(data), [data.run == r for r in dict.fromkeys(data.run.tolist())]
    if any(np.sum(own) < 2 for own in runs):
        return {}
    return {JITTER: np.concatenate([np.gradient(values[own], data.time[own]) for own in runs])}


def _free_only(statistics: SufficientStatistics, coefficients: Coefficients) -> np.ndarray:
    return np.array([float(statistics.columns[i].kind == "free") for i in coefficients.indices])
