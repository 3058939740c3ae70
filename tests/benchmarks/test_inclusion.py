"""The complete dictionary on the paper's oscillator with 2 % noise: active terms found, the others left out.

python -m pytest -n 0 -m slow tests/benchmarks/test_inclusion.py -s
"""

import numpy as np
import pytest

import bayes_greybox as bg

TERMS = ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]
TRUTH = {"y**3": -1.0, "ydot**3": -0.2}
IDLE = [term for term in TERMS if term not in TRUTH]


SEEDS = (0, 1, 2)
MISSES = 2
"""Of six true coefficients, each in its 90 % interval with that probability, more are missed once in sixty times."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("prior", "column"),
    [(bg.SpikeAndSlab(), "inclusion"), (bg.Laplace(), "outside_rope"), (bg.RegularisedHorseshoe(), "outside_rope")],
    ids=["spike-and-slab", "laplace", "horseshoe"],
)
def test_active_terms_are_in_and_the_others_out(prior, column, capsys):
    missed = []
    for seed in SEEDS:
        data = bg.systems.oscillator().simulate(t=np.linspace(0, 100, 1001), noise=0.02, seed=seed)
        fit = bg.GreyBox(dictionary={"ydot": TERMS}, prior=prior).fit(data, draws=500, tune=500, progress=False)
        table = fit.inclusion().loc["ydot"]
        with capsys.disabled():
            print(f"\n| {type(prior).__name__} | {seed} | " + " | ".join(f"{p:.4f}" for p in table[column]) + " |")
        assert (table.loc[list(TRUTH), column] >= 0.99).all()
        assert (table.loc[IDLE, column] <= 0.05).all()
        inside = {t: table.loc[t, "lower"] <= value <= table.loc[t, "upper"] for t, value in TRUTH.items()}
        missed += [(seed, term) for term, covered in inside.items() if not covered]
    with capsys.disabled():
        print(f"outside their 90 % intervals (seed, term): {missed or 'none'}")
    assert len(missed) <= MISSES
