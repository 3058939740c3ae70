"""Products under every kind of noise point, against the dense matrix R."""

import numpy as np
import pytest

from bayes_greybox.discovery.grid.latent_force import ForcedRates
from bayes_greybox.discovery.grid.log_evidence import discrepancy_basis, gram, law_variances
from bayes_greybox.discovery.grid.points import (
    LATENT_FORCE,
    LAW,
    MEMORY,
    NO_DISCREPANCY,
    SENSOR_NOISE,
    NoiseGrid,
    NoisePoint,
)
from bayes_greybox.discovery.grid.table import EFFECT, Features, Regressor, RegressorTable

N, K, M = 30, 3, 6
RNG = np.random.default_rng(0)
SPREAD = np.exp(0.2 * RNG.standard_normal(N))
FORCE = ForcedRates(0.1 * np.arange(N), np.zeros(N), 1.0, SPREAD, 0.1)
LAWS = Features(RNG.standard_normal((N, M)), RNG.standard_normal((N, M)))
ELEMENTS = Features(RNG.standard_normal((N, 2)), RNG.standard_normal((N, 2)))
TABLE = RegressorTable(
    tuple(Regressor(EFFECT, f"e{k}", f"e{k}", 1.0) for k in range(K)), RNG.standard_normal(N),
    *(RNG.standard_normal((N, K)),) * 2, FORCE, np.zeros(N, int), LAWS, np.arange(1.0, M + 1)[:, None],
    {"relaxation of x": ELEMENTS},
)  # fmt: skip
Z = np.column_stack([TABLE.target, TABLE.columns])
RATIOS = np.array([0.1, 1.0, 10.0])


def dense(point, spread=SPREAD):
    """R of a point: features of f have the prior variances of a kernel, elements of a memory equal ones."""
    noise = np.diag(spread**2)
    if point.kind == NO_DISCREPANCY:
        return noise
    if point.kind in (LAW, MEMORY):
        own = LAWS if point.kind == LAW else ELEMENTS
        variances = np.exp(-0.5 * (np.arange(1.0, M + 1) * point.scale) ** 2) if point.kind == LAW else np.ones(2)
        size = np.mean(own.acting**2 @ variances)
        return noise + point.ratio**2 * (own.rows * variances / size) @ own.rows.T
    x = np.abs(FORCE.time[:, None] - FORCE.time) / point.scale
    kernel = np.exp(-x) if point.kind == SENSOR_NOISE else (1 + np.sqrt(3) * x) * np.exp(-np.sqrt(3) * x)
    return noise + point.ratio**2 * kernel


POINTS = (
    NoisePoint(NO_DISCREPANCY), NoisePoint(LATENT_FORCE, 2.0, 0.5), NoisePoint(LATENT_FORCE, 0.1, 0.5),
    NoisePoint(SENSOR_NOISE, 1.5, 0.2),
    NoisePoint(LAW, 3.0, 0.7), NoisePoint(LAW, 0.2, 0.7), NoisePoint(LAW, 3.0, 0.3),
    NoisePoint(MEMORY, 2.0, memory="relaxation of x"), NoisePoint(NO_DISCREPANCY, shape=1),
    NoisePoint(LAW, 3.0, 0.7, shape=1),
)  # fmt: skip


def test_products_and_determinants_are_those_of_dense_algebra():
    other = np.linspace(0.5, 2.0, N)
    found = gram(TABLE, POINTS, (FORCE, FORCE.weighted(other)))
    assert found.points == POINTS and found.n_obs == N
    for point, products, log_det in zip(POINTS, found.products, found.log_det, strict=True):
        R = dense(point, SPREAD * other if point.shape else SPREAD)
        np.testing.assert_allclose(products, Z.T @ np.linalg.solve(R, Z), rtol=1e-8, atol=1e-8)
        assert log_det == pytest.approx(np.linalg.slogdet(R)[1], abs=1e-8)


@pytest.mark.parametrize("point", [POINTS[4], POINTS[7]], ids=["law", "memory"])
def test_the_posterior_of_a_discrepancy_is_that_of_dense_regression(point):
    basis = discrepancy_basis(TABLE, point)
    white = TABLE.target / SPREAD
    prior = dense(point) - np.diag(SPREAD**2)
    smoothed = basis.features @ basis.posterior(white[:, None], point.ratio)
    np.testing.assert_allclose(smoothed[:, 0] * SPREAD, prior @ np.linalg.solve(dense(point), TABLE.target), atol=1e-8)
    # Acting at the samples its standard deviation is one on average.
    assert np.mean(np.sum(basis.acting**2, axis=1)) == pytest.approx(1.0)


def test_the_mean_variance_of_f_at_the_samples_is_one():
    for length in (0.3, 1.2):
        assert np.mean(LAWS.acting**2 @ law_variances(TABLE, length)) == pytest.approx(1.0)


def test_each_kind_of_point_has_prior_probability_one_and_a_sensors_noise_that_of_a_suspect():
    points = NoiseGrid(6.0, 0.1, RATIOS, RATIOS, 0.05, True, ("relaxation of x", "backlash of x")).points((0.0, -1.0))
    for shape, log_prior in ((0, 0.0), (1, -1.0)):
        total = {
            kind: np.sum(np.exp([p.log_prior for p in points if p.kind == kind and p.shape == shape]))
            for kind in (NO_DISCREPANCY, SENSOR_NOISE, LATENT_FORCE, LAW, MEMORY)
        }
        # Under a shape of the noise that was found, neither a correlation nor a memory is weighed besides.
        plain = float(shape == 0)
        share = {NO_DISCREPANCY: 0.95, SENSOR_NOISE: 0.05 * plain, LATENT_FORCE: 1.0, LAW: 1.0, MEMORY: plain}
        assert total == pytest.approx({kind: value * np.exp(log_prior) for kind, value in share.items()})
    assert not {p.kind for p in NoiseGrid(6.0, 0.1, RATIOS, RATIOS, law=False).points()} & {LAW, MEMORY}


def test_time_scales_below_a_step_are_white_noise():
    scales = {p.scale for p in NoiseGrid(1.0, 0.1, RATIOS, RATIOS).points() if p.kind == LATENT_FORCE}
    assert scales == {0.2, 1.0, 4.0}
    # Of a motion of a few steps the step itself is left.
    assert {p.scale for p in NoiseGrid(1.0, 9.0, RATIOS, RATIOS).points() if p.kind == LATENT_FORCE} == {9.0}
