"""The families, one module each: what is broken, how the sensors do it, and what would be right to say of it."""

from collections.abc import Mapping

from benchmarks.hidden_effects.assumptions.case import Family

from .measurement import (
    bent_sensors,
    correlated,
    delay,
    filtered,
    heavy_tails,
    noisy_states,
    sensor,
    state_dependent,
)
from .physics import for_a_moment, memory, missing_state, other_laws, smooth_friction, together

FAMILIES: Mapping[str, Family] = {
    module.FAMILY.name: module.FAMILY
    for module in (
        delay,
        noisy_states,
        filtered,
        correlated,
        state_dependent,
        heavy_tails,
        sensor,
        memory,
        smooth_friction,
        together,
        missing_state,
        bent_sensors,
        for_a_moment,
        other_laws,
    )
}
"""All families by name."""
