"""What speaks against an answer that the rows do not show: samples that move otherwise, and noise left on states."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.discovery.answer.doubt import Doubt, contradicted
from bayes_greybox.discovery.answer.finding import Finding
from bayes_greybox.discovery.answer.gap.table import RATE_DRAWS
from bayes_greybox.discovery.answer.weighed import EFFECTS
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.suspects.channels import calibrated, slope_along
from bayes_greybox.discovery.weighing.aligned import Aligned
from bayes_greybox.model.program import Program

from .motion import ModelledRate, MotionCheck, check_motion

NEARBY = 1e-3
"""Change of a sensor's error that derivatives by it are taken over."""

SAID = {
    "no gap": "the simulation",
    "instrument": "the simulation, with sensors put right,",
    "recalibrate": "the simulation with its coefficients put right",
    "unknown": "the simulation",
    EFFECTS: "the model with what was found",
}
"""What says how the studied state moves, by the kind of answer."""

REGRESSORS, AS_LARGE = 0.3, 2.0
"""What noise on states does to the rate, over the residuals, from which on it is held against a verdict; and the gap
over it up to which the gap is nothing else."""


def contradictions(
    model: Program, train: Trajectories, aligned: Aligned, amendment: Amendment, finding: Finding, odds: Odds
) -> tuple[list[MotionCheck], list[Doubt]]:
    """Whether states move as the states that are their rates say, and a studied one as the amended model says.

    Args:
        model: The model before.
        train: Measurements as they came.
        aligned: The same with states smoothed and delays undone.
        amendment: The model after.
        finding: The answer.
        odds: Prior odds.

    Returns:
        The checks; and of those that fail, how likely that is no chance, and what it does to the studied rate.
    """
    name, scale = amendment.statistics.equation, amendment.statistics.target_scale
    if not aligned.rates_measured:
        # What was computed from the samples agrees with them.
        return [], []
    sensors = amendment.sensors
    measured = aligned.moved(train)
    data = calibrated(measured, name, sensors, train)
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
        )
        for check in checks
        if not check.ok and (x := check.state)
    ]
    if not finding.open_ended and not train.is_output(name):
        # An output says how no state moves.
        draws, found = amendment.rates(data.columns, RATE_DRAWS)[1], amendment.after
        values, moved = simulation.on(data, name) + draws.mean(axis=0), np.zeros_like(draws)
        pick = amendment.pick(RATE_DRAWS)
        for k, (sensor, size) in enumerate(sensors.items()):
            if not size:
                continue
            # A sensor is as uncertain as a coefficient: it turns all samples of its channel, and the rate with them.
            apart = found.suspect_draws[pick, k] / found.suspect_draws[:, k].mean() - 1
            nearby = calibrated(measured, name, {**sensors, sensor: (1 + NEARBY) * size}, train)
            draws = draws + np.outer(apart, simulation.on(nearby, name) - simulation.on(data, name)) / NEARBY
            moved = moved + np.outer(apart, nearby.column(name) - data.column(name)) / NEARBY
        own = ModelledRate(values, by_noise(aligned.rate), SAID[finding.kind], draws, moved)
        for check in check_motion(data, {name: own}, noise, unit):
            checks.append(check)
            if not check.ok:
                force_of_it = check.departure / check.span / scale
                doubts.append(Doubt(contradicted(check.p, odds.suspect), force_of_it, finding.kind))
    return checks, doubts


def with_noisy_states(finding: Finding, aligned: Aligned, unit: str) -> Finding:
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
    names, rows = ", ".join(aligned.sample_noise), world.evaluations.statistics.rows
    size = f"{spurious * scale:.2g} {unit_text(unit)}".rstrip()
    like = f"{size} of {rows.equation}" if rows.output else f"a force of {size}"
    return finding.capped([f"noise on the samples of {names} acts like {like}"])


def noise_as_force(finding: Finding, aligned: Aligned) -> list[Doubt]:
    """What the noise left on states does to the rate, where that is much beside the residuals: no effect is smaller."""
    spurious = aligned.spurious / finding.world.evaluations.statistics.target_scale
    return [Doubt(1.0, spurious)] if finding.places and spurious > REGRESSORS * _left(finding) else []


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
