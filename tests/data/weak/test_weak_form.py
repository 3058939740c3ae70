"""Test functions and local cubics: integrals by parts, and windows that samples ask for."""

import numpy as np
import pytest

from bayes_greybox.data.weak.weak_form import HALF_WIDTHS, Bumps, LocalFits, bump, chosen_half_widths, stretches


def times(kind, n=401):
    rng = np.random.default_rng(0)
    return np.linspace(0, 10, n) if kind == "even" else np.sort(rng.uniform(0, 10, n))


@pytest.mark.parametrize(("kind", "within"), [("even", 1e-8), ("uneven", 2e-3)])
def test_integration_by_parts(kind, within):
    # On uneven steps the cubic between samples errs by (3/128) h⁴ x'''' at most: 2e-3 at the widest steps here.
    t = times(kind)
    x, rate = np.sin(2 * t) + 0.3 * np.cos(5 * t), 2 * np.cos(2 * t) - 1.5 * np.sin(5 * t)
    bumps = Bumps.along(t, stretches(t, [len(t)]), 0.5)
    assert len(bumps) > 60
    np.testing.assert_allclose(bumps.values @ rate, -(bumps.slopes @ x), atol=within)
    np.testing.assert_allclose(bumps.values @ np.ones(len(t)), 1.0, atol=1e-6)
    np.testing.assert_allclose(bumps.slopes @ np.ones(len(t)), 0.0, atol=1e-5)
    np.testing.assert_allclose(t[bumps.sample], bumps.centre, atol=np.max(np.diff(t)))


def test_a_bump_is_its_own_slope_integrated():
    u = np.linspace(-1.2, 1.2, 4001)
    value, slope = bump(u, 2.0)
    np.testing.assert_allclose(np.gradient(value, 2.0 * u), slope, atol=1e-4)
    assert np.trapezoid(value, 2.0 * u) == pytest.approx(1.0, rel=1e-9)
    assert np.all(value[np.abs(u) > 1] == 0)


def test_no_bump_reaches_over_a_gap_or_into_another_run():
    t = np.concatenate([np.linspace(0, 5, 101), np.linspace(9, 12, 61), np.linspace(0, 2, 41), [0.0, 0.05]])
    lengths = [162, 41, 2]
    parts = stretches(t, lengths)
    assert [(part.run, part.rows) for part in parts] == [
        (0, (0, 101)),
        (0, (101, 162)),
        (1, (162, 203)),
        (2, (203, 205)),
    ]
    bumps = Bumps.along(t, parts, 0.6)
    for table in (bumps.values.toarray(), bumps.slopes.toarray()):
        for row, own in zip(table, bumps.run, strict=True):
            used = np.flatnonzero(row)
            (part,) = [p for p in parts if p.rows[0] <= used[0] < p.rows[1]]
            assert used[-1] < part.rows[1] and part.run == own
    assert set(bumps.run.tolist()) == {0, 1}


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_local_cubics_reproduce_cubics(kind):
    t = times(kind, 200)
    fits = LocalFits.of(t, stretches(t, [150, 50]) if kind == "even" else stretches(t, [200]), 6)
    x = 1 + t - 0.5 * t**2 + 0.1 * t**3
    np.testing.assert_allclose(fits.smooth(x), x, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(fits.rate(x), 1 - t + 0.3 * t**2, rtol=1e-4, atol=1e-4)


def test_stretches_shorter_than_a_window_are_followed_as_far_as_they_go():
    t = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 0.0])
    fits = LocalFits.of(t, stretches(t, [3, 2, 1]), 4)
    x = np.array([1.0, 4.0, 9.0, 2.0, 5.0, 7.0])
    np.testing.assert_allclose(fits.smooth(x), x, atol=1e-9)


def test_the_window_is_the_one_with_the_least_error():
    t = np.linspace(0, 20, 2001)
    x = np.column_stack([np.sin(t), np.sin(6 * t)])
    noisy = x + 0.1 * np.random.default_rng(0).standard_normal(x.shape)
    parts = stretches(t, [len(t)])
    chosen = chosen_half_widths(t, noisy, np.array([0.1, 0.1]), parts)
    for k, half_width in enumerate(chosen):
        errors = {
            m: float(np.mean((LocalFits.of(t, parts, m).smooth(noisy[:, k]) - x[:, k]) ** 2))
            for m in HALF_WIDTHS
            if 8 * (2 * m + 1) < len(t)
        }
        assert errors[half_width] < 1.3 * min(errors.values())
    assert chosen[1] < chosen[0]
