import numpy as np
import pytest
from differentiation import differentiation_matrix
from scipy.linalg import block_diag

import bayes_greybox as bg
from bayes_greybox.data.noise.banded import BandedNoise, fir_noise
from bayes_greybox.data.noise.files import noise_from_dict
from bayes_greybox.data.noise.spectral import SpectralNoise
from bayes_greybox.data.rates.filters import filter_taps
from bayes_greybox.running.errors import InputError

LENGTHS, STEPS = (40, 25), (0.1, 0.05)


def banded(order=2, share=0.05, window=9):
    return fir_noise(filter_taps(order, window=window, polyorder=4), order, LENGTHS, STEPS, share)


def spectral(order=1, share=0.05):
    return SpectralNoise(order, LENGTHS, STEPS, (12, 8), share)


KINDS = {"banded": banded(), "first derivative": banded(1), "spectral": spectral(), "second": spectral(2)}


@pytest.mark.parametrize("kind", KINDS)
def test_whitening_turns_the_covariance_into_the_identity(kind):
    noise = KINDS[kind]
    covariance, w = noise.covariance(), noise.whiten(np.eye(noise.n_obs))
    assert w.shape == (noise.n_white, noise.n_obs)
    np.testing.assert_allclose(w @ covariance @ w.T, np.eye(noise.n_white), atol=1e-10)
    np.testing.assert_allclose(noise.whiten_transpose(np.eye(noise.n_white)), w.T, atol=1e-12)
    precision = np.linalg.pinv(covariance, rcond=1e-10, hermitian=True)
    np.testing.assert_allclose(w.T @ w, precision, atol=1e-9 * np.abs(precision).max())
    np.testing.assert_allclose(noise.precision_diagonal(), np.diag(precision), rtol=1e-9)
    for width in (5, 30):
        band = noise.precision_band(width)
        for k in range(width):
            expected = np.append(np.diag(precision, k), np.zeros(k))
            np.testing.assert_allclose(band[:, k], expected, atol=1e-9 * np.abs(precision).max())


@pytest.mark.parametrize("kind", KINDS)
def test_mean_diagonal_is_one_and_log_det_is_that_of_the_kept_part(kind):
    noise = KINDS[kind]
    covariance = noise.covariance()
    assert np.mean(np.diag(covariance)) == pytest.approx(1.0, abs=1e-12)
    eigenvalues = np.linalg.eigvalsh(covariance)[-noise.n_white :]
    assert noise.log_det == pytest.approx(np.sum(np.log(eigenvalues)), abs=1e-8)
    assert noise.square == (noise.n_white == len(covariance))


def test_log_det_of_a_square_noise_is_slogdet():
    assert banded().log_det == pytest.approx(np.linalg.slogdet(banded().covariance())[1], abs=1e-9)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_banded_covariance_is_exactly_the_filter_times_its_transpose(order):
    share, window = 0.05, 9
    noise = banded(order, share, window)
    blocks = [
        differentiation_matrix(n + window - 1, h, order, window=window, polyorder=4)
        for n, h in zip(LENGTHS, STEPS, strict=True)
    ]
    filtered = block_diag(*(g @ g.T for g in blocks))
    assert noise.scale**2 == pytest.approx(np.mean(np.diag(filtered)), rel=1e-12)
    # The white share keeps the variance of every row.
    expected = (1.0 - share) * filtered + share * np.diag(np.diag(filtered))
    np.testing.assert_allclose(noise.scale**2 * noise.covariance(), expected, atol=1e-12 * noise.scale**2)


@pytest.mark.parametrize("order", [1, 2])
def test_spectral_covariance_is_exactly_the_filter_times_its_transpose(order):
    noise = spectral(order, share=1e-12)
    bands = [kept / (n * h) for kept, n, h in zip(noise.kept, LENGTHS, STEPS, strict=True)]
    blocks = [
        differentiation_matrix(n, h, order, "spectral", band=b) for n, h, b in zip(LENGTHS, STEPS, bands, strict=True)
    ]
    filtered = block_diag(*(g @ g.T for g in blocks))
    np.testing.assert_allclose(noise.scale**2 * noise.covariance(), filtered, atol=1e-9 * noise.scale**2)


@pytest.mark.parametrize("method", ["savgol", "bandlimited", "spectral"])
def test_covariance_is_that_of_differentiated_white_noise(method):
    # 20,000 records of white noise. An entry of the sample covariance has standard error
    # sqrt((R_ii R_jj + R_ij²) / n) at most sqrt(2/n); with 60² entries and a bound of 6 standard errors,
    # the false-failure rate is below 3600 × 2e-9 = 7e-6.
    rng = np.random.default_rng(1)
    n_record, n = 20_000, 60
    settings = {
        "savgol": {"window": 11},
        "bandlimited": {"band": 4.0, "window": 11},
        "spectral": {"band": 3.0},
    }
    wave = bg.Trajectories.from_arrays(np.arange(n) * 0.1, states={"y": np.sin(2 * np.pi * np.arange(n) / 60)})
    unit = wave.differentiate(method, rates={"y": "v"}, white_share=1e-9, **settings[method])
    noise = unit.noise["v"]
    polyorder = {"polyorder": 4} if method == "savgol" else {}
    g = differentiation_matrix(n, 0.1, 2, method, **settings[method], **polyorder)
    samples = 0.3 * rng.standard_normal((n_record, n)) @ g.T / (0.3 * noise.scale)
    empirical = samples.T @ samples / n_record
    expected = noise.covariance()
    error = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n_record)
    assert np.max(np.abs(empirical - expected) / error) < 6.0


@pytest.mark.parametrize("noise", [banded(), banded(1)])
def test_restriction_is_the_submatrix(noise):
    rows = np.r_[5:30, 40:50]
    part = noise.restrict([(5, 30), (0, 10)])
    expected = noise.scale**2 * noise.covariance()[np.ix_(rows, rows)]
    np.testing.assert_allclose(part.scale**2 * part.covariance(), expected, rtol=1e-12, atol=1e-12)
    assert np.mean(np.diag(part.covariance())) == pytest.approx(1.0)


@pytest.mark.parametrize("noise", [banded(), spectral(2)])
def test_a_whole_run_keeps_its_block(noise):
    part = noise.restrict([(0, 0), (0, 25)])
    expected = noise.scale**2 * noise.covariance()[40:, 40:]
    np.testing.assert_allclose(part.scale**2 * part.covariance(), expected, rtol=1e-10, atol=1e-10)
    assert part.run_lengths == (25,)


def test_a_spectral_record_cannot_be_cut():
    with pytest.raises(InputError, match="whole periodic records.*split the measured data first"):
        spectral().restrict([(0, 20), (0, 25)])


@pytest.mark.parametrize("kind", KINDS)
def test_record_round_trip(kind):
    noise = KINDS[kind]
    back = noise_from_dict(noise.to_dict())
    np.testing.assert_array_equal(back.covariance(), noise.covariance())
    assert back.scale == noise.scale


def test_a_run_shorter_than_the_filter_is_still_covered():
    noise = fir_noise(filter_taps(1, window=15), 1, (4, 30), (0.1, 0.1))
    w = noise.whiten(np.eye(34))
    np.testing.assert_allclose(w @ noise.covariance() @ w.T, np.eye(34), atol=1e-10)


def test_long_records_stay_banded():
    # A dense covariance of these rows would take 80 GB.
    n = 100_000
    noise = BandedNoise(banded().autocorrelation, (n,), np.ones(1), 1.0)
    assert noise.whiten(np.ones((n, 2))).shape == (n, 2)
    assert noise.precision_diagonal()[n // 2] == pytest.approx(
        BandedNoise(banded().autocorrelation, (400,), np.ones(1), 1.0).precision_diagonal()[200], rel=1e-6
    )


def test_bad_records_are_named():
    with pytest.raises(InputError, match="white_share must be above 0"):
        banded(share=0.0)
    with pytest.raises(InputError, match='kind "pink" is unknown'):
        noise_from_dict({"kind": "pink"})
