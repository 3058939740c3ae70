"""Several inner parameters of one effect: their mode alone where the effect is out of reach, else a cloud around it."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_equation import DEAD_ZONE, WIDTH, tiny_evaluations

from bayes_greybox.discovery.evidence.clouds import POINTS
from bayes_greybox.discovery.evidence.inner_parameters import FAR, refine

SHAPE = replace(WIDTH, name="bend", meaning="bend", low=0.2, high=5.0, unit_of="")
BENT_ZONE = replace(
    DEAD_ZONE, slug="bent-zone", expression="sign(r)*max(abs(r) - gap, 0)*exp(-(bend*r)**2)", inner=(WIDTH, SHAPE)
)


def bent(x):
    return -np.sign(x) * np.maximum(np.abs(x) - 0.3, 0) * np.exp(-(x**2))


def refined(level):
    """Log evidence summed over all values of both inner parameters, and how many values were added."""
    known = tiny_evaluations([BENT_ZONE], bent, noise=0.02, n=200)
    group = known.statistics.of_kind("effect")
    found = refine(known, (), group, level)
    log_z = np.array([v.all for v in known.parametric([(i,) for i in found])])
    return float(np.logaddexp.reduce(log_z)), len(found) - len(group)


@pytest.fixture(scope="module")
def whole():
    """As refined where nothing is said of what matters."""
    return refined(-np.inf)


def test_an_effect_within_reach_gets_a_cloud(whole):
    total, added = whole
    assert added >= POINTS // 2
    assert refined(total) == whole


def test_one_far_below_gets_its_mode_alone_which_weighs_as_laplace_has_it(whole):
    total, added = refined(whole[0] + FAR + 10.0)
    assert added == 1
    # A ridge of two parameters is no parabola, but what is left out is far less than what says that it is far.
    assert total == pytest.approx(whole[0], abs=2.0)
