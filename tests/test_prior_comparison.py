"""Several priors on the same data in one call."""

import numpy as np
import pytest

import bayes_greybox as bg


def oscillator(n=120):
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, (2, n))
    rates = {"v": -(y**3) + 0.05 * rng.standard_normal(n), "y": v + 0.1 * rng.standard_normal(n)}
    return bg.Trajectories.from_arrays(np.arange(n) * 0.1, states={"y": y, "v": v}, derivatives=rates)


DICTIONARY = {"v": ["y", "v", "y**3"], "y": ["v", "y", "y**3"]}
"""As many terms for each: equations of one shape share their programs."""

MODEL = bg.GreyBox(dictionary=DICTIONARY, discrepancy=None)


@pytest.mark.slow
def test_priors_are_fitted_compared_and_set_side_by_side(capsys):
    data = oscillator()
    own = {"Narrow": bg.Laplace(scale=0.1), "RegularisedHorseshoe": None, "Laplace": None, "Normal": None}
    result = bg.compare_priors(
        MODEL, data, own, scheme="block", block=10, max_refits=0, draws=50, tune=100, chains=2, seed=3, progress=False
    )
    assert capsys.readouterr().out == ""
    assert list(result.fits) == ["SpikeAndSlab", "Narrow"]
    assert result.fits["Narrow"].model.prior == bg.Laplace(scale=0.1)
    assert set(result.comparison.index) == set(result.fits)
    assert result.comparison.attrs["folds"] == "12 blocks of up to 10 rows"
    assert list(result.inclusion.index) == [(name, term) for name, terms in DICTIONARY.items() for term in terms]
    for name, fit in result.fits.items():
        np.testing.assert_array_equal(result.inclusion[name]["mean"], fit.inclusion()["mean"])
    # Only a spike-and-slab prior has an inclusion probability; the others keep their own name for it.
    assert [name for name in result.fits if "inclusion" in result.inclusion[name]] == ["SpikeAndSlab"]
    assert (result.probability.loc[("v", "y**3")] > 0.99).all()
    # Every equation has its own folds, and the elpd is the sum over all of them.
    validated = bg.cross_validate(result.fits["Narrow"], "block", block=10, max_refits=0)
    assert validated.equation.tolist() == [0] * 12 + [1] * 12
    assert validated.elpd == pytest.approx(result.comparison.loc["Narrow", "elpd"], rel=1e-12)
    shown = repr(result)
    assert "12 blocks" in shown and "P(included)" in shown and all(name in shown for name in result.fits)


def test_what_is_no_prior_or_no_comparison_is_refused_before_anything_is_sampled():
    data = oscillator(20)
    with pytest.raises(bg.InputError, match=r"priors\['mine'\] = 0.5 is not a prior"):
        bg.compare_priors(MODEL, data, {"mine": 0.5})
    none = dict.fromkeys(["SpikeAndSlab", "Laplace", "Normal"])
    with pytest.raises(bg.InputError, match="at least two priors, not 1"):
        bg.compare_priors(MODEL, data, none)
    with pytest.raises(bg.InputError, match="the data have one"):
        bg.compare_priors(MODEL, data, scheme="trajectory")
