"""Noise that hangs together in time, and noise of unequal rows, against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.data.noise.banded import fir_noise
from bayes_greybox.data.noise.files import noise_from_dict
from bayes_greybox.data.noise.spectral import SpectralNoise
from bayes_greybox.data.noise.state_space import StateSpaceNoise, transition
from bayes_greybox.data.noise.weighted import WeightedNoise, WhiteNoise
from bayes_greybox.data.rates.filters import filter_taps
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

RNG = np.random.default_rng(0)
EVEN = np.arange(40) * 0.1
UNEVEN = np.cumsum(RNG.uniform(0.02, 0.4, 25))
RUNS = {
    "even": (EVEN,),
    "uneven": (UNEVEN,),
    "several": (EVEN, UNEVEN, np.array([3.0]), np.array([1.0, 1.1]), EVEN[:7]),
    "one row": (np.array([2.0]),),
    "two rows": (np.array([2.0, 2.5]),),
    "even to the last step": (np.append(EVEN, EVEN[-1] + 0.7),),
    "a hole": (np.append(EVEN, EVEN + 9.0),),
}
STATE_SPACE = {
    f"{name}, {process}, white {white:g}": StateSpaceNoise(times, process, 0.6, white)
    for name, times in RUNS.items()
    for process in ("exponential", "matern32")
    for white in (0.0, 0.2, 1.0)
}
LENGTHS = (40, 25)
INNER = {
    "white": WhiteNoise(LENGTHS),
    "banded": fir_noise(filter_taps(1, window=9, polyorder=4), 1, LENGTHS, (0.1, 0.05)),
    "state space": StateSpaceNoise((EVEN, UNEVEN), "matern32", 0.6, 0.1),
}
WEIGHTED = {f"weighted {name}": WeightedNoise(inner, RNG.uniform(0.2, 3.0, 65)) for name, inner in INNER.items()}
NOISES = {**STATE_SPACE, **WEIGHTED}


@pytest.mark.parametrize("kind", NOISES)
def test_the_noise_is_its_dense_matrix(kind):
    noise = NOISES[kind]
    R, W = noise.covariance(), noise.whiten(np.eye(noise.n_obs))
    assert noise.square and not noise.local
    np.testing.assert_allclose(W @ R @ W.T, np.eye(len(R)), atol=1e-8)
    np.testing.assert_allclose(noise.whiten_transpose(np.eye(len(R))), W.T, atol=1e-10 * np.abs(W).max())
    assert noise.log_det == pytest.approx(np.linalg.slogdet(R)[1], abs=1e-7)
    precision = W.T @ W
    size = np.abs(precision).max()
    np.testing.assert_allclose(noise.precision_diagonal(), np.diag(precision), rtol=1e-9)
    for width in (1, 5, 50):
        band = noise.precision_band(width)
        for k in range(width):
            diagonal = np.diag(precision, k) if k < len(R) else np.zeros(0)
            expected = np.append(diagonal, np.zeros(min(k, len(R))))
            np.testing.assert_allclose(band[:, k], expected, atol=1e-9 * size)


@pytest.mark.parametrize("kind", NOISES)
def test_draws_have_the_covariance(kind):
    noise = NOISES[kind]
    # Draws are linear in what they are made of: B Bᵀ = R.
    B = noise.correlated(np.eye(noise.n_obs)).T
    np.testing.assert_allclose(B @ B.T, noise.covariance(), atol=1e-9)


@pytest.mark.parametrize("kind", [*WEIGHTED, "several, exponential, white 0.2", "several, matern32, white 0"])
def test_restriction_is_the_submatrix(kind):
    noise = NOISES[kind]
    lengths = noise.run_lengths
    bounds = [(5, 30), (0, 0)] if len(lengths) == 2 else [(5, 30), (0, 10), (0, 1), (0, 0), (0, 7)]
    starts = np.cumsum([0, *lengths])[:-1]
    rows = np.concatenate([np.arange(s + a, s + b) for s, (a, b) in zip(starts, bounds, strict=True)])
    part = noise.restrict(bounds)
    assert part.run_lengths == tuple(b - a for a, b in bounds if b > a)
    expected = noise.scale**2 * noise.covariance()[np.ix_(rows, rows)]
    np.testing.assert_allclose(part.scale**2 * part.covariance(), expected, atol=1e-12)


@pytest.mark.parametrize("kind", NOISES)
def test_record_round_trip(kind):
    noise = replace(NOISES[kind], scale=2.5)
    back = noise_from_dict(noise.to_dict())
    assert type(back) is type(noise) and back.scale == 2.5 and back.run_lengths == noise.run_lengths
    np.testing.assert_array_equal(back.covariance(), noise.covariance())


def test_an_unknown_kind_lists_those_that_there_are():
    with pytest.raises(InputError, match='"pink" is unknown; the kinds are "white".*"state space", "weighted"'):
        noise_from_dict({"kind": "pink"})


def test_weights_before_a_filter_without_its_mean_keep_what_it_keeps():
    inner = SpectralNoise(1, LENGTHS, (0.1, 0.05), (12, 8))
    noise = WeightedNoise(inner, np.full(65, 2.0))
    assert noise.white_lengths == inner.white_lengths != noise.run_lengths
    white = RNG.standard_normal((3, noise.n_white))
    assert noise.sequences(white)[1:] == inner.sequences(white)[1:]
    W = noise.whiten(np.eye(65))
    np.testing.assert_allclose(W @ noise.covariance() @ W.T, np.eye(noise.n_white), atol=1e-9)


def test_rows_much_closer_than_the_time_scale_lose_no_digits():
    for x in (1e-6, 1e-3, 0.1, 3.0):
        A, Q, _ = transition("matern32", np.array([x / np.sqrt(3)]))
        # ∫ of the impulse response's squares: Q₀₀ ~ 4x³/3 for small steps
        grid = np.linspace(0, x, 20_001)
        response = np.array([grid, 1 - grid]) * np.exp(-grid)
        exact = 4 * np.trapezoid(response[:, None] * response, grid, axis=-1)
        np.testing.assert_allclose(Q[0], exact, rtol=1e-6)
    noise = StateSpaceNoise((np.arange(2000) * 1e-5,), "matern32", 1.0, 0.0)
    assert np.isfinite(noise.log_det) and np.all(np.isfinite(noise.whiten(np.ones((2000, 1)))))


@pytest.mark.parametrize(
    ("process", "scale", "white"), [("pink", 1.0, 0.1), ("exponential", 0.0, 0.1), ("matern32", 1.0, 1.5)]
)
def test_what_is_no_noise_is_refused(process, scale, white):
    with pytest.raises(InputError, match="noise"):
        StateSpaceNoise((EVEN,), process, scale, white)


@pytest.mark.parametrize("sd", [np.ones(3), np.zeros(65), np.full(65, np.inf)])
def test_what_are_no_standard_deviations_is_refused(sd):
    with pytest.raises(InputError, match="one finite standard deviation"):
        WeightedNoise(WhiteNoise(LENGTHS), sd)


def test_a_long_record_is_whitened_by_a_filter_with_constant_coefficients():
    times = np.arange(20_000) * 0.01
    for process in ("exponential", "matern32"):
        noise = StateSpaceNoise((times,), process, 0.3, 0.2)
        drawn = noise.correlated(np.random.default_rng(1).standard_normal((1, len(times))))
        white = noise.whiten(drawn.T)
        np.testing.assert_allclose(white[:, 0], np.random.default_rng(1).standard_normal(len(times)), atol=1e-8)


@pytest.mark.parametrize("kind", WEIGHTED)
def test_trajectories_carry_the_noise_through_their_metadata_and_splits(kind):
    noise, x = WEIGHTED[kind], [RNG.standard_normal(n) for n in LENGTHS]
    data = Trajectories.from_arrays([EVEN, UNEVEN], states={"x": x}, derivatives={"x": x})
    data = replace(data, noise={"x": noise})
    back = Trajectories.from_frame(data.to_frame(), **data.metadata())
    np.testing.assert_array_equal(back.row_noise("x").covariance(), noise.covariance())
    part = data.take(1).row_noise("x")
    np.testing.assert_allclose(part.scale**2 * part.covariance(), noise.scale**2 * noise.covariance()[40:, 40:])
