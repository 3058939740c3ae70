"""Comparison of models: differences, weights, and refusal of what cannot be compared."""

import numpy as np
import pytest
from fabricated import fabricate, oscillator
from sampled_oscillator import SIMULATION, sampled

from bayes_greybox.criticism.cross_validation.compare import compare, comparison_table, stacking_weights, tied
from bayes_greybox.criticism.cross_validation.cross_validate import cross_validate
from bayes_greybox.criticism.cross_validation.loo import Loo
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampling import sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.priors import Normal
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.model.rows.weak_rows import WeakRows
from bayes_greybox.running.errors import InputError

FULL = Program(dictionary={"v": ["y", "v", "y**3"]}, discrepancy=OrthogonalGP(features=6))
BARE = Program(dictionary={"v": ["y", "v"]}, discrepancy=None)


def result(pointwise, notes=()):
    n = len(pointwise)
    return Loo(
        elpd=float(np.sum(pointwise)),
        se=float(np.sqrt(n * np.var(pointwise, ddof=1))),
        p_eff=1.0,
        worst_k=0.1,
        n_bad=0,
        threshold=0.7,
        pointwise=np.asarray(pointwise, float),
        khat=np.full(n, 0.1),
        refitted=np.zeros(n, bool),
        equation=np.zeros(n, int),
        row=np.arange(n),
        r_eff=(1.0,),
        notes=tuple(notes),
    )


def fits(data, draws=100):
    return {
        "bare": fabricate(BARE, data, draws=draws, seed=1),
        "full": fabricate(FULL, data, draws=draws, seed=2),
    }


def test_table_of_known_pointwise_values():
    rng = np.random.default_rng(0)
    a = rng.standard_normal(50)
    b = a + 0.3 + 0.1 * rng.standard_normal(50)
    table = comparison_table({"a": result(a), "b": result(b, ["beware"])})
    columns = ["elpd", "se", "elpd_diff", "diff_se", "p_eff", "weight", "worst_k", "refits"]
    assert list(table.columns) == columns
    assert list(table.index) == ["b", "a"]
    assert table.loc["b", "elpd_diff"] == 0 and table.loc["b", "diff_se"] == 0
    np.testing.assert_allclose(table.loc["a", "elpd_diff"], np.sum(a - b))
    # paired: the scatter of a and b themselves cancels
    np.testing.assert_allclose(table.loc["a", "diff_se"], np.sqrt(50 * np.var(a - b, ddof=1)))
    assert table.loc["a", "diff_se"] < 0.2 * table.loc["a", "se"]
    assert table.attrs["notes"] == ["b: beware"]


def test_ties_are_noted_and_clear_differences_are_not():
    a = np.random.default_rng(0).standard_normal(50)
    (note,) = comparison_table({"a": result(a), "b": result(a + 0.01)}).attrs["notes"]
    assert "4 nats" in note
    noisy = a + 0.2 + 3 * np.random.default_rng(1).standard_normal(50)
    assert abs(np.sum(noisy - a)) > 4
    (note,) = comparison_table({"a": result(a), "b": result(noisy)}).attrs["notes"]
    assert "twice its standard error" in note
    clear = comparison_table({"a": result(a), "b": result(a + 1)})
    assert clear.attrs["notes"] == [] == tied(clear)
    # Every model that is not told from the best one, whether second or not.
    three = comparison_table({"a": result(a), "b": result(a + 1), "c": result(a + 1.01)})
    assert tied(three) == ["b"] and len(three.attrs["notes"]) == 1


def test_stacking_weights_of_problems_with_known_answers():
    # Each row is impossible under one of two models: Σ log w_k is largest at the shares of the rows.
    share = np.where(np.arange(100)[:, None] < 30, [0.0, -60.0], [-60.0, 0.0])
    np.testing.assert_allclose(stacking_weights(share), [0.3, 0.7], atol=1e-5)
    worse = np.array([[-1.0, -1.5, -2.0]] * 20)
    np.testing.assert_allclose(stacking_weights(worse), [1, 0, 0], atol=1e-6)
    # n₁ rows with ratio r, n₂ rows with ratio 1/r: w₁ = (n₁ r − n₂)/((n₁ + n₂)(r − 1)).
    r, n1, n2 = 3.0, 60, 40
    pair = np.concatenate([np.tile([np.log(r), 0.0], (n1, 1)), np.tile([0.0, np.log(r)], (n2, 1))]) - 700.0
    np.testing.assert_allclose(stacking_weights(pair)[0], (n1 * r - n2) / (100 * (r - 1)), atol=1e-5)


def test_differences_do_not_depend_on_units():
    metres = compare(fits(oscillator(30)), max_refits=0)
    millimetres = compare(fits(oscillator(30, unit=1000.0)), max_refits=0)
    assert abs(metres["elpd_diff"].iloc[1]) > 1
    np.testing.assert_allclose(millimetres["elpd_diff"], metres["elpd_diff"], rtol=1e-9)
    np.testing.assert_allclose(millimetres["diff_se"], metres["diff_se"], rtol=1e-9)
    np.testing.assert_allclose(millimetres["weight"], metres["weight"], atol=1e-6)
    # a density of 1000 y is 1000 times smaller
    np.testing.assert_allclose(millimetres["elpd"], metres["elpd"] - 30 * np.log(1000), rtol=1e-9)


@pytest.mark.parametrize("scheme", ["block", "future"])
def test_all_models_leave_out_the_same_folds(scheme):
    pair = fits(oscillator(40))
    table = compare(pair, scheme, max_refits=0)
    alone = {name: cross_validate(fit, scheme, max_refits=0) for name, fit in pair.items()}
    longest = max(result.block for result in alone.values())
    assert table.attrs["scheme"] == scheme and table.attrs["block"] == longest
    assert sum("were chosen" in note for note in table.attrs["notes"]) == 1
    for name, fit in pair.items():
        result = cross_validate(fit, scheme, block=longest, max_refits=0)
        assert table.attrs["folds"] == result.words
        assert table.loc[name, "elpd"] == pytest.approx(result.elpd, rel=1e-12)


@pytest.fixture(scope="module")
def two_orders():
    """One model, sampled with its equations in either order."""
    rng, plain = np.random.default_rng(0), oscillator(40)
    data = Trajectories.from_arrays(
        plain.time,
        states=dict(plain.states),
        derivatives={"v": plain.derivatives["v"], "y": plain.column("v") + 3 * rng.standard_normal(40) ** 3},
    )
    terms = {"v": ("y", "v"), "y": ("v",)}
    return {
        name: sample_posterior(
            Program(dictionary={equation: terms[equation] for equation in order}, prior=Normal(), discrepancy=None),
            data,
            Sampling(draws=200, tune=200, chains=1),
            progress=False,
        )
        for name, order in {"v first": ("v", "y"), "y first": ("y", "v")}.items()
    }


@pytest.mark.parametrize("scheme", ["loo", "future"])
def test_rows_are_compared_with_themselves_in_whatever_order_models_list_their_equations(two_orders, scheme):
    table = compare(two_orders, scheme, max_refits=0)
    # The two are one model: nothing but the draws tells them apart.
    assert abs(table["elpd_diff"].iloc[1]) < 1
    assert table["diff_se"].iloc[1] < 0.05 * table["se"].iloc[1]


SAMPLED = {"simulation": SIMULATION, "discrepancy": None, "prior": Normal()}
NEAR = {"spring": (("y**3", -0.3),), "damper": (("v", -0.4),)}
"""Models that rows are near: the samples are divided by another number in each."""


def test_samples_compare_whatever_model_the_rows_are_near():
    data, made = sampled(lambda y, v: -0.3 * y**3, n=60), {}
    noise = 0.02 * np.std(data.states["y"])
    for name, added in NEAR.items():
        model = Program({"v": ["y**3", "v"]}, rows=TrajectoryRows(added=added), **SAMPLED)
        whole = model.complete(data)
        (equation,) = model.assemble(whole).values()
        unit = equation.frame.target_scale * equation.rows.gain
        sd = np.ones((2, 20, 2)) * 3.0
        known = np.full((2, 20), noise / unit)
        made[name] = fabricate(model, whole, draws=20, sigma=known, prior_sd=sd)
    gains = [each.equations["v"].rows.gain for each in made.values()]
    assert max(gains) > 1.05 * min(gains)
    table = compare(made, max_refits=0)
    # In the unit of the sensor: that of noise of its size, to a nat or so a coefficient, start and standard deviation.
    assert abs(table["elpd"]["spring"] + 60 * np.log(noise * np.sqrt(2 * np.pi * np.e))) < 20


def test_rows_that_mix_samples_by_their_models_are_refused():
    data, made = sampled(lambda y, v: -0.3 * y**3, n=60), {}
    data = Trajectories.from_arrays(
        data.time,
        states={"y": data.states["y"], "v": np.gradient(data.states["y"], data.time)},
        inputs=dict(data.inputs),
    )
    for name, added in NEAR.items():
        model = Program({"v": ["y**3", "v"]}, rows=WeakRows(added=added, added_to=("v",)), **SAMPLED)
        made[name] = fabricate(model, model.complete(data), draws=20)
    with pytest.raises(InputError, match="mix the same samples in different ways.*TrajectoryRows"):
        compare(made)


def test_fits_that_have_not_converged_are_named():
    table = compare(fits(oscillator(30)), max_refits=0)
    assert any("bare has not converged" in note for note in table.attrs["notes"])


def test_rows_weighed_by_their_residuals_are_not_ranked_among_others():
    data, made = oscillator(30), {}
    for name, tails in {"normal": None, "heavy": 4.0}.items():
        model, whole = Program(BARE.dictionary, discrepancy=None, noise=Noise(tails=tails)).with_noise_found(data)
        made[name] = fabricate(model, whole, draws=100)
    with pytest.raises(InputError, match="'heavy' has Noise\\(tails=...\\), which weighs .* 'normal' has not"):
        compare(made, max_refits=0)
    for scheme in ("loo", "block", "future"):
        judged = {name: cross_validate(fit, scheme, refit=None) for name, fit in made.items()}
        assert any("its own residual" in note for note in judged["heavy"].notes)
        assert not any("its own residual" in note for note in judged["normal"].notes)
    # Where the data speak against heavy tails, no row is weighed.
    sought, whole = Program(BARE.dictionary, discrepancy=None, noise=Noise(tails="fit")).with_noise_found(data)
    assert len(compare(made | {"heavy": fabricate(sought, whole, draws=100)}, max_refits=0)) == 2


def test_what_cannot_be_compared_is_refused():
    pair = fits(oscillator(20), draws=2)
    with pytest.raises(InputError, match="at least two"):
        compare({"bare": pair["bare"]})
    with pytest.raises(InputError, match="'loo', 'block'"):
        compare(pair, scheme="rows")
    with pytest.raises(InputError, match="the data have one"):
        compare(pair, scheme="trajectory")
    with pytest.raises(InputError, match="20 rows against 25"):
        compare(pair | {"full": fabricate(FULL, oscillator(25))})
    with pytest.raises(InputError, match="the derivative of 'v' differs by up to"):
        compare(pair | {"full": fabricate(FULL, oscillator(20, seed=1))})
    data = pair["bare"].data
    later = Trajectories.from_arrays(data.time + 1, states=dict(data.states), derivatives={"v": data.derivatives["v"]})
    with pytest.raises(InputError, match="'bare' and 'full'.*time differs by up to 1"):
        compare(pair | {"full": fabricate(FULL, later)})
    y = Trajectories.from_arrays(
        data.time,
        states=dict(data.states),
        derivatives={"v": data.derivatives["v"], "y": data.derivatives["v"]},
    )
    both = Program(dictionary={"v": ["y"], "y": ["v"]}, discrepancy=None)
    with pytest.raises(InputError, match="same equations"):
        compare(pair | {"both": fabricate(both, y)})
