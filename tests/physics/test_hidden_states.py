"""Hidden states along known paths: they are what a solver of the whole equations gives."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_greybox.physics.hidden_states as module
from bayes_greybox.physics.hidden_states import HiddenState, along
from bayes_greybox.running.errors import InputError

STEP = 0.05

TOLD = 1e-3
"""Error over the size of a hidden state: a tenth of the finest noise that its force is weighed under."""


def path(t):
    return np.sin(t) + 0.4 * np.sin(2.7 * t + 1.0), np.cos(t) + 0.4 * 2.7 * np.cos(2.7 * t + 1.0)


def columns(t):
    y, v = path(t)
    return {"y": y, "v": v}


def solved(rate, t, start):
    tight = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "max_step": STEP / 2}
    return solve_ivp(lambda time, z: rate(*path(time), z), (t[0], t[-1]), start, t_eval=t, **tight).y


def bouc_wen(limit):
    return (HiddenState("z", f"v - (abs(v)*z + v*abs(z))/(2*{limit!r})", "y"),)


@pytest.mark.parametrize(
    ("states", "rate", "start"),
    [
        (bouc_wen(0.3), lambda y, v, z: [v - (abs(v) * z[0] + v * abs(z[0])) / 0.6], [0.0]),
        ((HiddenState("z", "v - z/0.7", "y"),), lambda y, v, z: [v - z[0] / 0.7], [0.0]),
        # Stiff: it changes within a small part of a step where the motion is fast.
        ((HiddenState("z", "v - abs(v)*z/0.07", "y"),), lambda y, v, z: [v - abs(v) * z[0] / 0.07], [0.0]),
        (
            (HiddenState("z", "w", "y"), HiddenState("w", "-2.25*(z - y) - 0.15*(w - v)", "v")),
            lambda y, v, z: [z[1], -2.25 * (z[0] - y) - 0.15 * (z[1] - v)],
            [0.0, 0.0],
        ),
    ],
    ids=["bouc-wen", "maxwell", "stiff", "absorber"],
)
def test_hidden_states_are_those_of_a_tight_solver(states, rate, start):
    t = STEP * np.arange(800)
    (found,) = along([states], t, columns(t), np.arange(len(t)) == 0)
    for z, exact in zip(found.values(), solved(rate, t, start), strict=True):
        np.testing.assert_allclose(z, exact, atol=TOLD * np.max(np.abs(exact)))


def test_several_numbers_at_once_are_each_alone():
    t = STEP * np.arange(200)
    fresh = np.arange(len(t)) == 0
    together = along([bouc_wen(0.2), bouc_wen(0.5), bouc_wen(1.1)], t, columns(t), fresh)
    for limit, found in zip((0.2, 0.5, 1.1), together, strict=True):
        alone = along([bouc_wen(limit)], t, columns(t), fresh)[0]["z"]
        np.testing.assert_allclose(found["z"], alone, atol=TOLD * np.max(np.abs(alone)))
    assert np.max(np.abs(together[0]["z"] - together[2]["z"])) > 0.1


def test_one_program_follows_paths_of_any_length(monkeypatch):
    traced, real = [], module._Rates.__call__
    monkeypatch.setattr(module._Rates, "__call__", lambda self, *given: traced.append(1) or real(self, *given))
    monkeypatch.setattr(module, "PROGRAM_STEPS", 64)

    def followed(n):
        t, states = STEP * np.arange(n), (HiddenState("z", "v - abs(v)*z/0.3 - 0.1*z", "y"),)
        return along([states], t, columns(t), np.arange(n) == 0)[0]["z"]

    n = 228
    longest, once = followed(n), len(traced)
    for shorter in (65, 64, 40, 2, 1):
        # But for the last step: a cubic needs a node beyond it.
        np.testing.assert_array_equal(followed(shorter)[:-1], longest[: shorter - 1])
    assert len(traced) == once > 0
    exact = solved(lambda y, v, z: [v - abs(v) * z[0] / 0.3 - 0.1 * z[0]], STEP * np.arange(n), [0.0])[0]
    np.testing.assert_allclose(longest, exact, atol=TOLD * np.max(np.abs(exact)))


def test_each_run_starts_at_rest_or_where_the_column_says():
    t = STEP * np.arange(200)
    twice, fresh = np.concatenate([t, t]), np.isin(np.arange(400), (0, 200))
    both = {name: np.concatenate([x, x]) for name, x in columns(t).items()}
    (found,) = along([bouc_wen(0.4)], twice, both, fresh)
    assert found["z"][0] == found["z"][200] == 0.0
    np.testing.assert_allclose(found["z"][200:], found["z"][:200], atol=1e-12)
    (moved,) = along([bouc_wen(0.4)], twice, {**both, "z": np.full(400, 0.1)}, fresh)
    assert moved["z"][0] == moved["z"][200] == 0.1


def test_what_moves_along_starts_where_the_path_does():
    t = 0.4 + STEP * np.arange(300)
    start = [float(x[0]) for x in path(t)]
    rates = HiddenState("z", "w", "y", start="y"), HiddenState("w", "-2.25*(z - y) - 0.15*(w - v)", "v", start="v")
    twice, fresh = np.concatenate([t, t]), np.isin(np.arange(600), (0, 300))
    (found,) = along([rates], twice, columns(twice), fresh)
    exact = solved(lambda y, v, z: [z[1], -2.25 * (z[0] - y) - 0.15 * (z[1] - v)], t, start)
    for z, each in zip(found.values(), exact, strict=True):
        np.testing.assert_allclose(z, np.concatenate([each, each]), atol=TOLD * np.max(np.abs(each)))
    assert abs(found["w"][0]) > 0.1


def test_an_input_that_leaps_is_felt_from_then_on():
    """A lag behind a step: 1 - exp(-(t - 2)/tau), where the time of the leap stands twice."""
    t = np.sort(np.append(np.linspace(0.0, 6.0, 61), 2.0))
    u = (np.arange(len(t)) >= np.flatnonzero(t == 2.0)[1]).astype(float)
    (found,) = along([(HiddenState("z", "(u - z)/0.5", "u"),)], t, {"u": u}, np.arange(len(t)) == 0)
    exact = np.where(t >= 2.0, 1 - np.exp(-np.clip(t - 2.0, 0, None) / 0.5), 0.0)
    np.testing.assert_allclose(found["z"], exact, atol=1e-4)


def test_names_and_rates_that_formulas_cannot_have_are_refused():
    with pytest.raises(InputError, match="sin"):
        HiddenState("sin", "v", "y")
    with pytest.raises(InputError):
        HiddenState("z", "v -* z", "y")
