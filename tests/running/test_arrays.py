"""Arrays on their way to JAX: the same numbers, their own memory, and nothing compiled."""

import jax
import numpy as np

from bayes_greybox.running.arrays import on_device


def test_numbers_and_types_are_kept_and_memory_is_not_shared():
    given = {"real": np.linspace(0.0, 1.0, 1000), "whole": np.arange(3), "truth": np.array([True, False])}
    before = {name: value.copy() for name, value in given.items()}
    found = on_device(given)
    given["real"][:] = 7.0
    for name, value in before.items():
        assert isinstance(found[name], jax.Array) and found[name].dtype == value.dtype
        np.testing.assert_array_equal(found[name], value)


def test_no_program_is_compiled_for_a_shape():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if event.endswith("backend_compile_duration") else None
    )
    on_device((np.zeros((2, 3, 5, 7, 11)), np.zeros((13, 17), int), 1.0))
    assert compiled == []
    # The listener hears what is compiled.
    jax.jit(lambda x: x + 23)(1.0)
    assert compiled
