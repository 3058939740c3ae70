"""Inner parameters that may lie beyond the catalogue's range."""

import numpy as np
import pytest
from tiny_equation import DEAD_ZONE, tiny_evaluations

from bayes_greybox.discovery.answer.checks.ends import at_ends
from bayes_greybox.discovery.answer.coefficients import draw_coefficients
from bayes_greybox.discovery.evidence.inner_parameters import refine


def dead_zone(gap):
    """The catalogue has gaps from 0.1 to 0.9."""
    known = tiny_evaluations(
        [DEAD_ZONE], lambda x: -np.sign(x) * np.maximum(np.abs(x) - gap, 0), simulation=lambda t, x, u: [-x[0]], n=200
    )
    group = refine(known, (), tuple(known.statistics.of_kind("effect")))
    return at_ends(known.statistics, draw_coefficients(known, group[:1], 500, seed=0))


@pytest.mark.parametrize("gap", [0.2, 0.5])
def test_a_value_within_the_range_is_at_no_end(gap):
    assert dead_zone(gap) == []


def test_a_value_beyond_the_range_is_said_to_be_at_its_end():
    (said,) = dead_zone(0.02)
    assert said.startswith("width of dead zone is at the smallest value that was tried")
