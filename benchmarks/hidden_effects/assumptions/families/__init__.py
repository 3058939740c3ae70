"""The families: the assumption that is broken, how the sensors do it, and the right answers."""

from collections.abc import Mapping

from benchmarks.hidden_effects.assumptions.case import Family

from . import for_a_moment, forces, noises, sensors

FAMILIES: Mapping[str, Family] = {
    family.name: family
    for family in (
        sensors.DELAY,
        noises.NOISY_STATES,
        sensors.FILTERED_RATES,
        noises.CORRELATED_NOISE,
        noises.STATE_DEPENDENT_NOISE,
        noises.HEAVY_TAILS,
        sensors.SENSOR,
        forces.MEMORY,
        forces.SMOOTH_FRICTION,
        forces.ONLY_TOGETHER,
        forces.MISSING_STATE,
        sensors.BENT_SENSORS,
        for_a_moment.FOR_A_MOMENT,
        forces.OTHER_LAWS,
    )
}
"""All families by name; those that came later follow those that were there."""
