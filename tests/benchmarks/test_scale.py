"""Cost against the number of rows: a fit costs the same at a thousand rows and at a million.

python -m pytest -n 0 -m slow tests/benchmarks/test_scale.py -s
"""

import time
import tracemalloc

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.inference.sampling import sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.algebra.compression import FACTOR_CHUNK, triangular_factor


def noisy_oscillator(n_obs: int) -> bg.Trajectories:
    """Accelerations −y³ − 0.2 ẏ³ with 2 % noise at random states, so that a million rows need no integration."""
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, n_obs), rng.uniform(-0.7, 0.7, n_obs)
    a = -(y**3) - 0.2 * v**3
    a += 0.02 * a.std() * rng.standard_normal(n_obs)
    return bg.Trajectories.from_arrays(np.arange(n_obs) * 1e-3, states={"y": y, "ydot": v}, derivatives={"ydot": a})


@pytest.mark.slow
def test_a_fit_of_a_million_rows_costs_what_a_thousand_cost(capsys):
    model = bg.GreyBox(dictionary={"ydot": ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]}, prior=bg.Laplace())
    seconds, passes = {}, {}
    for n_obs in (1000, 1_000_000):
        data = noisy_oscillator(n_obs)
        start = time.perf_counter()
        equations = model.assemble(data)
        passes[n_obs] = time.perf_counter() - start
        times = []
        for _ in range(2):
            start = time.perf_counter()
            sample_posterior(model, data, Sampling(draws=500, tune=500, chains=2), progress=False, equations=equations)
            times.append(time.perf_counter() - start)
        seconds[n_obs] = min(times)
    ratio = seconds[1_000_000] / seconds[1000]
    with capsys.disabled():
        print(
            f"\nfit at 10^3 rows {seconds[1000]:.1f} s, at 10^6 rows {seconds[1_000_000]:.1f} s: {ratio:.2f}x; "
            f"statistics {passes[1000]:.1f} s and {passes[1_000_000]:.1f} s"
        )
    assert ratio <= 1.5


@pytest.mark.slow
def test_the_statistics_pass_runs_at_the_rate_of_a_matrix_product(capsys):
    """One pass over 2^20 rows of 107 columns against FᵀG for the same shapes, chunk by chunk, best of ten each."""
    rng = np.random.default_rng(0)
    n_obs, n_column = 2**20, 107
    left, right = rng.standard_normal((2, FACTOR_CHUNK, n_column))

    def product() -> float:
        start = time.perf_counter()
        total = np.zeros((n_column, n_column))
        for _ in range(n_obs // FACTOR_CHUNK):
            total += left.T @ right
        return time.perf_counter() - start

    def statistics() -> float:
        start = time.perf_counter()
        triangular_factor(lambda index: left[: len(index)], n_obs)
        return time.perf_counter() - start

    pairs = [(product(), statistics()) for _ in range(10)]
    fastest_product, fastest_pass = (min(column) for column in zip(*pairs, strict=True))
    with capsys.disabled():
        print(f"\nmatrix product {fastest_product:.2f} s, statistics {fastest_pass:.2f} s")
    assert fastest_pass <= 2 * fastest_product


@pytest.mark.slow
def test_memory_of_the_statistics_is_bounded_by_a_chunk():
    rng = np.random.default_rng(0)
    tracemalloc.start()
    triangular_factor(lambda index: rng.standard_normal((len(index), 50)), 40 * FACTOR_CHUNK)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # A block, its whitened copy and the sample that preconditions it; all rows at once would be forty blocks.
    assert peak < 6 * FACTOR_CHUNK * 50 * 8
