"""Silverbox, a measured electronic oscillator with a hardening spring: what a linear dictionary leaves to f.

BAYES_GREYBOX_DATA=folder python -m pytest -n 0 -m slow tests/benchmarks/test_silverbox.py -s
"""

import os

import numpy as np
import pytest

import bayes_greybox as bg

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("BAYES_GREYBOX_DATA" not in os.environ, reason="BAYES_GREYBOX_DATA names no folder of data"),
]


@pytest.fixture(scope="module")
def train() -> bg.Trajectories:
    parts = bg.load_dataset("silverbox", remove_offset=True)
    return parts["multisine_train"].differentiate("bandlimited", rates={"y": "v"}, band=200.0)


def fitted(train: bg.Trajectories, terms: list[str]) -> bg.Fit:
    model = bg.GreyBox(
        simulation={"y": "v"},
        dictionary={"v": terms},
        discrepancy=bg.OrthogonalGP(variables=("y", "v")),
    )
    return model.fit(train, seed=0, progress=False)


def test_the_discrepancy_is_the_hardening_spring_and_a_cubic_term_takes_it_over(train, capsys):
    linear, cubic = fitted(train, ["y", "v", "u"]), fitted(train, ["y", "v", "u", "y**3"])
    shares = [fit.discrepancy().loc["v", "discrepancy"] for fit in (linear, cubic)]
    grid = linear.discrepancy_grid(variables=("y",))
    inside = grid.inside
    # −k₃ (y³ − its least-squares line): the cubic that is left after the linear terms
    y = grid.axes[0][inside]
    shape = np.polynomial.Polynomial.fit(y, grid.mean[inside], 3).convert().coef
    k3 = -cubic.inclusion().loc[("v", "y**3"), "mean"]
    with capsys.disabled():
        print(
            f"\ndiscrepancy share {shares[0]:.4f} -> {shares[1]:.4f}; y**3 coefficient of f {shape[3]:.3g}, of the "
            f"dictionary {-k3:.3g}; inclusion {cubic.inclusion()['inclusion'].to_dict()}\n{linear.verdict}\n"
            f"{cubic.verdict}"
        )
    assert linear.verdict.ok and cubic.verdict.ok
    assert shape[3] < 0 and abs(shape[3] + k3) < 0.2 * k3
    assert shares[1] < 0.5 * shares[0]
    assert cubic.inclusion().loc[("v", "y**3"), "inclusion"] > 0.99


PUBLISHED = {"multisine_test": 0.301, "arrow": 0.60, "arrow_no_extrapolation": 0.259}
"""Smallest free-run errors in mV that Champneys et al. (2024, arXiv:2405.10779) collect."""


def test_from_the_voltage_alone_free_runs_are_no_worse_than_published_ones(capsys):
    """Nothing is differentiated: samples of y and u, and terms that earlier studies of rates found."""
    parts = bg.load_dataset("silverbox", remove_offset=True)
    model = bg.GreyBox(
        simulation={"y": "v"},
        dictionary={"v": ["y", "v", "u", "1", "y**2", "y**3", "v*abs(v)"]},
        discrepancy=None,
        prior=bg.Normal(),
        rows=bg.TrajectoryRows(substeps=3),
    )
    fit = model.fit(parts["multisine_train"], seed=0, progress=False)
    with capsys.disabled():
        print(f"\n{fit.verdict}\n{fit.summary().loc['v', ['mean', 'sd']].to_string()}")
    assert fit.verdict.ok
    for name, published in PUBLISHED.items():
        path = fit.simulate(parts[name], draws=20).states["y"].mean
        # The first 50 samples are left out, as the benchmark's authors ask.
        error = 1e3 * np.sqrt(np.mean((path - parts[name].states["y"])[50:] ** 2))
        with capsys.disabled():
            print(f"| {name} | {error:.3f} mV (published: {published}) |")
        assert error <= published
