"""Laws next to what was found along a path: each is weighed on rows near itself, and gains alone."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_oscillator import SIMULATION, sampled

import bayes_greybox as bg
from bayes_greybox.discovery.weighing.path import follow as follow_module
from bayes_greybox.physics.catalogue.loading import load_catalogue

FEW = [
    replace(e, confusions=())
    for e in load_catalogue("mechanical")
    if e.slug in ("stribeck-friction", "cubic-stiffness")
]


def study(hidden, monkeypatch, noise=0.01, seed=0):
    """A study of samples, and the columns of laws that it weighed along the path."""
    kept = []

    def weighed(near, taken):
        weigh_laws(near, taken)
        kept.extend(c for c in near.base.statistics.columns if c.kind == "law")

    weigh_laws = follow_module.weigh_laws
    monkeypatch.setattr(follow_module, "weigh_laws", weighed)
    rows, small = bg.TrajectoryRows(interpolation="cubic"), bg.OrthogonalGP(variables=("y", "v"), features=5)
    model = bg.GreyBox(simulation=SIMULATION, rows=rows, discrepancy=small)
    given = {"odds": bg.Odds(noise=1e-6), "free_runs": False, "settle": False, "progress": False}
    return bg.find_missing_effects(model, sampled(hidden, noise=noise, n=250, seed=seed), catalogue=FEW, **given), kept


@pytest.mark.slow
def test_a_law_next_to_a_bent_effect_is_followed_along_a_path_of_its_own(monkeypatch):
    """A viscous force that stalls is no Stribeck friction, however near its curve: it begins without a jump."""
    found, laws = study(lambda y, v: -0.9 * v * np.exp(-((v / 0.5) ** 4)), monkeypatch)
    assert found.verdict == "unknown" and "another law" in found.sentence
    gained = {c.called: c.nearer for c in laws if c.nearer is not None}
    assert gained and all(nearer.gain >= 0 and nearer.beside == frozenset() for nearer in gained.values())
    assert all(c.log_weight <= 0 for c in laws if c.inner)


@pytest.mark.slow
def test_a_bent_effect_is_none_of_the_laws_next_to_it(monkeypatch):
    found, _ = study(lambda y, v: -0.3 * np.tanh(v / 1e-3) * np.exp(-((v / 0.4) ** 2)), monkeypatch)
    assert found.effects.iloc[0]["slug"] == "stribeck-friction"
    assert found.effects.iloc[0]["probability"] > 0.9


@pytest.mark.slow
def test_laws_next_to_an_effect_are_weighed_beside_a_bent_one_too(monkeypatch):
    hidden = lambda y, v: -0.5 * y**3 - 0.3 * np.tanh(v / 1e-3) * np.exp(-((v / 0.4) ** 2))  # noqa: E731
    _, laws = study(hidden, monkeypatch)
    assert any(not c.inner for c in laws) and any(c.inner for c in laws)
