"""Nonlinear parameters that may lie beyond the catalogue's range."""

import numpy as np
import pytest
from tiny_equation import DEAD_ZONE, tiny_data, tiny_study_of

from bayes_greybox.discovery.answer.checks import at_ends


def dead_zone(gap):
    """The catalogue has gaps from 0.1 to 0.9."""
    data = tiny_data(lambda x: -np.sign(x) * np.maximum(np.abs(x) - gap, 0), n=200)
    study = tiny_study_of([DEAD_ZONE], data, simulation=lambda t, x, u: [-x[0]])
    assert [place.slug for place in study.verdict.places] == ["dead-zone"]
    said = at_ends(study.regressors, study.coefficients, study.probabilities.criteria)
    assert set(said) <= {reason.text for reason in study.verdict.reasons}
    return said


@pytest.mark.parametrize("gap", [0.2, 0.5])
def test_a_value_within_the_range_is_at_no_end(gap):
    assert dead_zone(gap) == []


def test_a_value_beyond_the_range_is_said_to_be_at_its_end():
    (said,) = dead_zone(0.02)
    assert said.startswith("width of dead zone is at the smallest value that was tried")
