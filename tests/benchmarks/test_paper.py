"""The seed paper's experiment: complete and partial dictionary, orthogonal and plain kernel, 0 … 100 s.

NMSE is mean((a − â)²)/var(a) of the posterior mean acceleration â against the true, noise-free acceleration a at
the 1001 sampled times. The paper gives neither its definition nor its sampling; its figures are the bars here.

    python -m pytest -n 0 -m slow tests/benchmarks/test_paper.py -s
"""

import numpy as np
import pytest

import bayes_greybox as bg

COMPLETE = ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]
PARTIAL = [term for term in COMPLETE if term != "y**3"]
PUBLISHED = {
    ("complete", "projected"): 3.9e-5,
    ("complete", "none"): 1.0e-3,
    ("partial", "projected"): 1.4e-5,
    ("partial", "none"): 8.9e-5,
}


def run(dictionary: str, variant: str, noise: float):
    system = bg.systems.oscillator()
    t = np.linspace(0, 100, 1001)
    model = bg.GreyBox(
        simulation={"y": "ydot"},
        dictionary={"ydot": COMPLETE if dictionary == "complete" else PARTIAL},
        prior=bg.Laplace(),
        discrepancy=bg.OrthogonalGP(variant=variant),
    )
    fit = model.fit(system.simulate(t=t, noise=noise, seed=1), chains=4, seed=0, progress=False)
    return fit, fit.predict(system.simulate(t=t, noise=0.0)).nmse()["ydot"]


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("variant", ["projected", "none"])
@pytest.mark.parametrize("dictionary", ["complete", "partial"])
def test_predicts_the_acceleration_as_well_as_the_paper(dictionary, variant, noise, capsys):
    fit, nmse = run(dictionary, variant, noise)
    summary, shares = fit.summary(), fit.discrepancy().loc["ydot"]
    active = [term for (_, term), row in fit.inclusion().iterrows() if row["outside_rope"] > 0.5]
    with capsys.disabled():
        print(
            f"\n| {dictionary} | {variant} | {noise:.0%} | {nmse:.1e} | {PUBLISHED[dictionary, variant]:.1e} | "
            f"{', '.join(active)} | {shares['discrepancy']:.4f} | {summary['r_hat'].max():.3f} | "
            f"{summary['ess_bulk'].min():.0f} | {int(fit.idata['sample_stats']['diverging'].sum())} |"
        )
    assert nmse <= PUBLISHED[dictionary, variant]
    if variant == "projected":
        assert fit.verdict.ok, fit.verdict
        # What is missing can be no term of the dictionary: the two true terms are found, less y³ if it is not offered.
        assert {"ydot**3"} <= set(active)


@pytest.mark.slow
def test_finds_the_oscillators_terms_from_its_displacement_alone(capsys):
    t = np.linspace(0, 100, 1001)
    y = bg.systems.oscillator().simulate(t=t, noise=0.0).states["y"]
    shown = y + 0.02 * np.std(y) * np.random.default_rng(1).standard_normal(len(y))
    model = bg.GreyBox(
        simulation={"y": "ydot"},
        dictionary={"ydot": COMPLETE},
        prior=bg.SpikeAndSlab(),
        discrepancy=None,
        rows=bg.TrajectoryRows(),
    )
    data = bg.Trajectories.from_arrays(t, states={"y": shown})
    fit = model.fit(data, chains=2, draws=500, tune=500, seed=0, progress=False)
    table = fit.inclusion().loc["ydot"]
    with capsys.disabled():
        print(f"\n{table[['mean', 'lower', 'upper', 'inclusion']].to_string()}")
    assert fit.verdict.ok
    for term, truth in (("y**3", -1.0), ("ydot**3", -0.2)):
        assert table.loc[term, "inclusion"] > 0.95
        assert table.loc[term, "lower"] <= truth <= table.loc[term, "upper"]
    assert (table.drop(["y**3", "ydot**3"])["inclusion"] < 0.05).all()
