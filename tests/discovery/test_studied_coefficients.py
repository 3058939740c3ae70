"""Studies of models whose own dictionary has priors of single coefficients."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from tiny_equation import CUBE, on, tiny_data, tiny_model

import bayes_greybox as bg
from bayes_greybox.discovery.grid.log_evidence import log_evidences
from bayes_greybox.discovery.grid.points import NO_DISCREPANCY
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.discovery.linearise.near import Near, Point
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.discovery.linearise.visits import table_of
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.model.priors import Coefficient

DICTIONARY = {"x": ["x", "x**2"]}


def stated_model(**stated):
    names = {"linear": "x", "square": "x**2"}
    coefficients = {"x": {names[key]: prior for key, prior in stated.items()}}
    return tiny_model(simulation={"x": "0"}, dictionary=DICTIONARY, coefficients=coefficients)


def near_of(model, data):
    rows = RateRows(model.centred(), data, "x", [on(CUBE)]).near(Point())
    return Near(rows, weigh(table_of(rows), Odds(), Reach(effects=1), rows.floor))


def test_a_normal_prior_is_in_the_evidence():
    """log p(y) of the dense normal with mean −x and the prior's covariance, by columns, over a grid of σ."""
    data = tiny_data(hidden=lambda x: 0.5 * x**3)
    near = near_of(stated_model(linear=Coefficient(mean=-1.2, sd=0.3), square=Coefficient(mean=0.0, sd=0.05)), data)
    own = near.regressors.of_kind("free")
    assert [near.column(i).formula.name for i in own] == ["x", "x**2"]
    x, rate, scale = data.columns["x"], data.derivatives["x"], near.regressors.target_scale
    assert scale == pytest.approx(np.sqrt(np.mean((rate + 1.2 * x) ** 2)))
    Phi, u = np.column_stack([x, x**2]), np.linspace(-8, 2, 401)
    logs = [
        multivariate_normal(
            (-1.2 * x) / scale, (Phi * [0.3**2, 0.05**2]) @ Phi.T / scale**2 + np.exp(v) * np.eye(len(x))
        ).logpdf(rate / scale)
        for v in u
    ]  # fmt: skip
    expected = np.logaddexp.reduce(logs) + np.log(u[1] - u[0])
    found = log_evidences(near.weighed.grid, near.weighed.precision, [own], near.weighed.floor)[0]
    plain = next(k for k, point in enumerate(near.weighed.grid.points) if point.kind == NO_DISCREPANCY)
    # Laplace's approximation of σ: a few hundredths of a nat at 60 rows.
    assert found[plain] == pytest.approx(expected, abs=0.1)


def test_a_fixed_coefficient_is_as_in_the_simulation():
    data = tiny_data(hidden=lambda x: 0.5 * x**3)
    fixed = near_of(stated_model(linear=Coefficient(fixed=-1.0)), data)
    known = near_of(tiny_model(simulation=lambda t, x, u: -x, dictionary={"x": ["x**2"]}), data)
    names = [[c.called for c in near.regressors.columns] for near in (fixed, known)]
    assert names[0] == names[1]
    for one, other in zip(fixed.weighed.hypotheses, known.weighed.hypotheses, strict=True):
        assert one.members == other.members and one.log_weight == pytest.approx(other.log_weight, rel=1e-9)


@pytest.mark.slow
def test_a_study_names_what_is_missing_beside_them():
    # With 80 rows of this seed |x|^2.75 follows them better than x³ by three nats, and the study says so.
    data = tiny_data(hidden=lambda x: 2.0 * x**3, n=160)
    model = stated_model(linear=Coefficient(mean=-1.0, sd=0.1), square=Coefficient(fixed=0.0))
    study = bg.find_missing_effects(
        bg.GreyBox(**{name: getattr(model, name) for name in model.__dataclass_fields__}),
        data,
        roles={"position": "x"},
        settle=False,
        free_runs=False,
        progress=False,
    )
    best = study.effects.iloc[0]
    assert best["slug"] == "cubic-stiffness" and abs(best["mean"] - 2.0) < 4.5 * best["sd"]
    assert study.base.coefficients == study.model.coefficients == model.coefficients
    assert set(study.model.dictionaries(data)["x"].names) == {"x", "x**3"}
    assert study.model.simulator(data).on(data, "x") == pytest.approx(np.zeros(160))
    # The equation has the whole coefficient, not what is left of it beside its mean.
    (linear,) = [term for term in studied_system(study).learned["x"].terms if term.name == "x"]
    assert abs(linear.value.mean + 1.0) < 4.5 * 0.1 and linear.stated == Coefficient(mean=-1.0, sd=0.1)
    x = np.linspace(-1, 1, 5)[:, None]
    cube = next(term.value.mean for term in studied_system(study).learned["x"].terms if term.name != "x")
    expected = linear.value.mean * x + cube * x**3
    np.testing.assert_allclose(study.to_callable()(0.0, x), expected, rtol=1e-9)
    assert np.allclose(study.to_callable(draws=50)(0.0, x).mean(axis=0), expected, atol=0.1)


def test_the_extended_model_has_what_terms_state_in_its_own_terms():
    data = tiny_data(hidden=lambda x: 2.0 * x**3, n=80)
    terms = [bg.Term("x", prior=(-1.0, 0.1)), bg.Term("x**2", fixed=0.0)]
    model = bg.GreyBox({"x": terms}, simulation={"x": "0"})
    study = bg.find_missing_effects(model, data, roles={"position": "x"}, settle=False, free_runs=False, progress=False)
    assert study.model.coefficients == model.coefficients == bg.GreyBox(study.model.dictionary).coefficients


def test_bounds_are_refused_with_the_remedy():
    with pytest.raises(
        bg.InputError, match=r"no closed form with bounds on a coefficient, as on 'x' of 'x'.*mean and sd"
    ):
        stated_model(linear=Coefficient(sign=-1)).centred()


@pytest.mark.slow
def test_a_wrong_coefficient_is_not_hidden_behind_a_late_sensor():
    """A rate that is late, and a loss of 0.65 where the simulation has 0.5: putting the sensor right is not all."""
    fine = np.arange(0.0, 60.0, 0.01)
    power, ambient = 1 + 0.5 * np.sin(0.7 * fine) + 0.4 * np.sin(1.9 * fine + 1), 1 + 0.3 * np.sin(0.4 * fine)
    state = np.full_like(fine, 2.0)
    for k in range(len(fine) - 1):
        state[k + 1] = state[k] + 0.01 * (power[k] - 0.65 * (state[k] - ambient[k]))
    rate, row = power - 0.65 * (state - ambient), np.arange(30, 6000, 10)
    data = bg.Trajectories.from_arrays(
        fine[row],
        states={"T": state[row]},
        derivatives={"T": rate[row - 15] + 0.01 * np.random.default_rng(1).normal(size=len(row))},
        inputs={"P": power[row], "Ta": ambient[row]},
    )
    model = bg.GreyBox(simulation={"T": "P - 0.5*(T - Ta)"})
    study = bg.find_missing_effects(model, data, settle=False, progress=False)
    assert study.verdict == "recalibrate"
    assert study.corrections.loc[("T", "T"), "mean"] == pytest.approx(-0.15, abs=0.01)
    said = str(study)
    assert "T in d(T)/dt should have −0.65" in said and "P in d(T)/dt should" not in said
    assert "d(T)/dt is 0.15" in said and "late" in said, "what is wrong with the sensor is said as well"
