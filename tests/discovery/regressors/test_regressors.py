"""Which regressors an equation has, with their values, scales and priors."""

import numpy as np
import pytest

from bayes_greybox.data.noise.banded import BandedNoise
from bayes_greybox.data.noise.spectral import SpectralNoise
from bayes_greybox.data.noise.weighted import WhiteNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.linearise.source import LAW_FEATURES, regressors_of
from bayes_greybox.discovery.regressors.columns import Values
from bayes_greybox.discovery.regressors.regressors import COLLINEAR, CORRECTION_SCALE, Regressors
from bayes_greybox.discovery.sensor_errors.channels import GAIN, OFFSET, ChannelSuspect
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

N = 24
WHITE = WhiteNoise((N,))
FILTERED = BandedNoise(
    autocorrelation=np.array([1.0, 0.5, 0.1]), run_lengths=(10, 14), run_variances=np.array([0.8, 8 / 7]), scale=1.0
)
PERIODIC = SpectralNoise(order=1, run_lengths=(10, 14), steps=(0.1, 0.1), kept=(4, 5))
NOISES = pytest.mark.parametrize("noise", [WHITE, FILTERED, PERIODIC], ids=["white", "filtered", "periodic"])


def some_rows(noise=WHITE, seed=0):
    rng = np.random.default_rng(seed)
    columns = {"x": rng.uniform(-1, 1, N), "u": rng.uniform(-1, 1, N)}
    run = np.repeat(np.arange(len(noise.run_lengths)), noise.run_lengths)
    return EquationRows("x", columns, rng.standard_normal(N), np.zeros(N), noise, 0.1 * np.arange(N), run)


def empty(rows):
    """Regressors on some rows, two features along each of x and u and no columns yet."""
    return Regressors(("x", "u"), np.zeros(2), np.ones(2), HilbertBasis(2.0, (2, 2)), rows=rows)


def terms(*formulas):
    return [(Term(formula), {}) for formula in formulas]


def effect(formula, slug="some-effect", inner=()):
    return Effect(slug=slug, name="Some effect", domain="test", expression=formula, inner=inner)


def offered(bound, **inner):
    return bound.term(inner), {"effect": bound, "inner": inner}


def regressors_made(hidden, effects, n=50, simulation=None, **model):
    """Regressors of ẋ = −x + u + hidden with 5 % noise."""
    rng = np.random.default_rng(3)
    x, u = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    rate = -x + u + hidden(x) + 0.05 * rng.standard_normal(n)
    data = Trajectories.from_arrays(np.arange(n) * 0.1, states={"x": x}, inputs={"u": u}, derivatives={"x": rate})
    simulation = {"x": "-x + u"} if simulation is None else simulation
    program = Program(simulation=simulation, discrepancy=OrthogonalGP(features=3), **model)
    return regressors_of(program, data, "x", effects)


# Values


@NOISES
def test_columns_and_the_target_have_unit_size(noise):
    found = empty(some_rows(noise))
    found.add("free", terms("x", "u**2", "1 + x*u"))
    x, u = found.rows.columns["x"], found.rows.columns["u"]
    X = np.column_stack([x, u**2, 1 + x * u])
    scale = np.sqrt(np.mean(X**2, axis=0))
    np.testing.assert_allclose(found.at_rows([0, 1, 2]), X / scale)
    assert [column.scale for column in found.columns] == pytest.approx(scale.tolist())
    assert np.sqrt(np.mean(found.target**2)) == pytest.approx(1.0)
    np.testing.assert_allclose(found.features(), np.asarray(found.basis(np.column_stack([x, u]))))


@NOISES
def test_columns_in_several_calls_are_columns_in_one(noise):
    together, apart = empty(some_rows(noise)), empty(some_rows(noise))
    together.add("effect", terms("x", "u**2", "x*u"))
    for formula in ("x", "u**2", "x*u"):
        apart.add("effect", terms(formula))
    np.testing.assert_allclose(apart.values, together.values)


def test_columns_after_one_that_was_left_out_keep_their_values():
    through, straight = empty(some_rows()), empty(some_rows())
    bound = effect("3*r", "left-out").bind({"r": "x"})
    for found, extra in ((through, [offered(bound)]), (straight, [])):
        found.add("free", terms("x"))
        found.add("effect", [*extra, *terms("u**2")])
        found.add("effect", terms("x*u"))
    assert "left-out" in through.left_out and len(through.columns) == through.values.shape[1] == 3
    np.testing.assert_allclose(through.values, straight.values)


def test_the_columns_do_not_depend_on_the_units():
    def scaled(unit):
        rows = some_rows()
        columns = {name: unit * column for name, column in rows.columns.items()}
        found = empty(EquationRows("x", columns, 7 * rows.measured, rows.simulated, WHITE, rows.time, rows.run))
        found.add("free", terms("x", "x*u"))
        return found

    assert scaled(1.0).target_scale == pytest.approx(7 * some_rows().scale)
    np.testing.assert_allclose(scaled(1e-3).values, scaled(1.0).values)
    np.testing.assert_allclose(scaled(1e-3).target, scaled(1.0).target)


# Errors of sensors


def error(kind, sd=0.1, channel="x"):
    return ChannelSuspect(kind, channel, sd)


def test_an_error_of_a_sensor_has_its_prior_in_units_of_the_rate():
    found = empty(some_rows())
    column = found.rows.columns["x"] ** 2
    found.add_sensor_errors([(error(GAIN), 3.0 * column)])
    (one,) = found.columns
    size = 3 * np.sqrt(np.mean(column**2))
    assert one.scale == pytest.approx(size) and one.sd == pytest.approx(0.1 * size / found.target_scale)
    np.testing.assert_allclose(found.values[:, 0], 3 * column / size)
    found.add_sensor_errors([(error(OFFSET), np.zeros(N)), (error(OFFSET, channel="u"), np.full(N, np.nan))])
    assert len(found.columns) == 1


def test_of_two_errors_that_look_alike_one_stays_and_may_be_as_large_as_the_larger():
    found = empty(some_rows())
    u = found.rows.columns["u"]
    found.add_sensor_errors([(error(GAIN, 0.1, "u"), u), (error(OFFSET, 0.5, "x"), 2 * u)])
    (one,) = found.columns
    assert one.suspect.key == error(GAIN, channel="u").key
    assert found.twins == {error(OFFSET, channel="x").key: one.suspect.key}
    # 0.5 of twice the column is as much as 1.0 of it.
    assert one.sd * found.target_scale / one.scale == pytest.approx(1.0) and one.suspect.sd == pytest.approx(1.0)


def test_an_error_that_a_correction_stands_for_is_none_and_one_that_was_found_stays():
    rows = some_rows()
    for known, count in (((), 1), ((error(GAIN, channel="u").key,), 2)):
        found = empty(rows)
        found.add("correction", [(Term("u"), {"nominal": 2.0})])
        found.add_sensor_errors([(error(GAIN, channel="u"), 2 * rows.columns["u"])], known)
        assert len(found.columns) == found.values.shape[1] == count
    found = empty(rows)
    found.add("correction", [(Term("u"), {"nominal": 2.0})])
    found.add_sensor_errors([(error(GAIN, channel="u"), 2 * rows.columns["u"])])
    assert found.twins == {error(GAIN, channel="u").key: "recalibration of u"}
    assert found.changes == pytest.approx({error(GAIN, channel="u").key: 0.2})


def test_an_error_that_is_a_sum_of_corrections_is_a_number_of_its_own_and_one_of_free_terms_is_none():
    rows = some_rows()
    x, u = rows.columns["x"], rows.columns["u"]
    found = empty(rows)
    found.add("correction", [(Term("x"), {"nominal": -1.0}), (Term("u"), {"nominal": 1.0})])
    found.add_sensor_errors([(error(GAIN), u - x)])
    assert len(found.of_kind("suspect")) == 1
    free = empty(rows)
    free.add("free", terms("x", "u"))
    free.add_sensor_errors([(error(GAIN), u - x)])
    assert free.of_kind("suspect") == []


def test_what_errors_showed_is_added_to_the_target_in_its_scale():
    plain, shown = empty(some_rows()), empty(some_rows())
    shown.shown = np.linspace(0, 1, N)
    np.testing.assert_allclose(shown.target - plain.target, np.linspace(0, 1, N))


# Columns that are left out


def test_an_effect_that_the_simulation_has_is_left_out_as_a_recalibration():
    found = regressors_made(np.square, [effect("r + r", "linear").bind({"r": "x"})])
    assert found.of_kind("effect") == []
    assert "recalibration" in found.left_out["linear"]


def test_an_effect_in_the_span_of_several_own_terms_is_left_out():
    found = regressors_made(np.square, [effect("a - 3*b", "mix").bind({"a": "x", "b": "u"})])
    assert "recalibration" in found.left_out["mix"]


@pytest.mark.parametrize(("share", "count"), [(5 * COLLINEAR, 1), (0.2 * COLLINEAR, 0)])
def test_an_effect_of_its_own_has_more_than_a_trace_outside_the_span(share, count):
    # Of the cube's square 4/175 is outside the span of r, whose square is 1/3, on states spread evenly over [−1, 1].
    formula = f"r + {np.sqrt(share / (4 / 175 * 3)):.3g}*r**3"
    x, u = np.linspace(-1, 1, 999), np.linspace(-1, 1, 999) ** 2
    data = Trajectories.from_arrays(np.arange(999.0), states={"x": x}, inputs={"u": u}, derivatives={"x": np.cos(x)})
    model = Program(simulation={"x": "-x"}, discrepancy=OrthogonalGP(features=3))
    found = regressors_of(model, data, "x", [effect(formula, "near").bind({"r": "x"})])
    assert len(found.of_kind("effect")) == count


def test_an_effect_of_which_another_binding_serves_is_not_left_out():
    both = effect("r**2", "two")
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, 40), rng.uniform(-1, 1, 40)
    data = Trajectories.from_arrays(
        np.arange(40.0), states={"x": x}, inputs={"u": u}, derivatives={"x": x**2 + rng.standard_normal(40)}
    )
    model = Program(simulation={"x": "u**2"}, discrepancy=OrthogonalGP(features=3))
    found = regressors_of(model, data, "x", [both.bind({"r": "u"}), both.bind({"r": "x"})])
    assert [found.columns[i].term.name for i in found.of_kind("effect")] == ["x**2"]
    assert found.left_out == {}


def test_a_correction_that_repeats_a_free_term_is_none():
    found = regressors_made(np.square, [], dictionary={"x": ["x"]})
    assert [found.columns[i].term.name for i in found.of_kind("free")] == ["x"]
    assert [found.columns[i].term.name for i in found.of_kind("correction")] == ["u"]


def test_effects_may_be_collinear_with_each_other():
    found = regressors_made(
        np.square, [effect("r**3", "one").bind({"r": "x"}), effect("2*r**3", "other").bind({"r": "x"})]
    )
    assert len(found.of_kind("effect")) == 2 and found.left_out == {}


@pytest.mark.parametrize(
    ("formula", "why"), [("max(r - 5, 0)", "zero on all the data"), ("log(r)", "not finite on all the data")]
)
def test_an_effect_without_a_value_on_the_data_is_left_out_with_the_reason(formula, why):
    found = regressors_made(np.square, [effect(formula, "odd").bind({"r": "x"})])
    assert found.left_out == {"odd": why} and found.of_kind("effect") == []


@pytest.mark.parametrize(
    ("formula", "why"), [("max(x - 5, 0)", "zero on all the data"), ("log(x)", "not finite on all the data")]
)
def test_a_free_term_without_a_value_on_the_data_is_refused(formula, why):
    with pytest.raises(InputError, match=f"{why}: remove it"):
        empty(some_rows()).add("free", terms(formula))


def test_a_correction_without_a_value_on_the_data_is_passed_over():
    found = regressors_made(np.square, [], simulation={"x": "-x + u + max(x - 5, 0)"})
    assert {found.columns[i].term.name for i in found.of_kind("correction")} == {"x", "u"}
    assert found.left_out == {}


def test_an_effect_is_not_left_out_while_a_value_of_its_inner_parameter_serves():
    inner = (InnerParameter("c", "edge", of="r", low=0.5, high=2.0, unit_of="r"),)
    found = regressors_made(np.square, [effect("max(r - c, 0)", "edge", inner).bind({"r": "x"})])
    # Eight values up to twice the largest |x|; those beyond it are zero everywhere.
    assert 0 < len(found.of_kind("effect")) < 8 and found.left_out == {}


@pytest.mark.parametrize("also_bound_to_x", [False, True])
def test_an_inner_parameter_that_is_a_share_of_nothing_leaves_its_binding_out(also_bound_to_x):
    inner = (InnerParameter("c", "edge", of="r", low=0.1, high=0.9, unit_of="r"),)
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, 50)
    data = Trajectories.from_arrays(
        0.1 * np.arange(50.0), states={"x": x}, inputs={"u": np.zeros(50)},
        derivatives={"x": rng.standard_normal(50)}, constant="keep",
    )  # fmt: skip
    edge = effect("max(r - c, 0)", "edge", inner)
    bound = [edge.bind({"r": name}) for name in (("u", "x") if also_bound_to_x else ("u",))]
    model = Program(simulation={"x": "-x"}, discrepancy=OrthogonalGP(variables=("x",), features=3))
    found = regressors_of(model, data, "x", bound)
    assert found.left_out == ({} if also_bound_to_x else {"edge": "zero on all the data"})
    assert bool(found.of_kind("effect")) == also_bound_to_x


def test_an_effect_that_serves_is_not_left_out_for_a_later_value_that_does_not():
    inner = (InnerParameter("c", "edge", of="r", low=0.1, high=2.0, unit_of="r"),)
    bound = effect("max(r - c, 0)", "edge", inner).bind({"r": "x"})
    found = empty(some_rows())
    found.add("effect", [offered(bound, c=0.1)])
    found.add("effect", [offered(bound, c=1.5)])
    assert found.left_out == {} and len(found.columns) == 1


# Columns and their priors


def test_columns_are_free_terms_then_corrections_then_effects():
    found = regressors_made(np.square, [effect("r**2").bind({"r": "x"})], dictionary={"x": ["x**3"]})
    assert [column.kind for column in found.columns] == ["free", "correction", "correction", "effect"]


def test_corrections_are_the_terms_of_the_simulation_with_their_coefficients():
    found = regressors_made(np.square, [], simulation={"x": "3*u - 0.5*x"})
    nominal = {found.columns[i].term.name: found.columns[i].nominal for i in found.of_kind("correction")}
    assert nominal == {"u": 3.0, "x": -0.5}


def test_a_simulation_that_is_code_has_no_corrections():
    found = regressors_made(np.square, [], simulation=lambda t, x, u: [u[0] - x[0]])
    assert found.of_kind("correction") == []


def test_the_prior_of_a_correction_is_a_share_of_its_coefficient():
    found = regressors_made(np.square, [], simulation={"x": "3*u - 0.5*x"})
    for i in found.of_kind("correction"):
        column = found.columns[i]
        in_units = column.sd * found.target_scale / column.scale
        assert in_units == pytest.approx(CORRECTION_SCALE * abs(column.nominal))


def test_each_value_of_an_inner_parameter_is_a_column_with_its_prior_weight():
    inner = (InnerParameter("c", "edge", of="r", low=0.1, high=0.5, unit_of="r"),)
    found = regressors_made(np.square, [effect("max(r - c, 0)", "edge", inner).bind({"r": "x"})])
    effects = [found.columns[i] for i in found.of_kind("effect")]
    assert len(effects) == 8
    np.testing.assert_allclose(np.exp([column.log_weight for column in effects]), 1 / 8)


def test_f_has_the_features_that_the_user_names_and_finer_ones_otherwise():
    assert regressors_made(np.square, []).basis.per_variable == (3, 3)
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 30)
    data = Trajectories.from_arrays(np.arange(30.0), states={"x": x}, derivatives={"x": x**2})
    assert regressors_of(Program(), data, "x", []).basis.per_variable == (LAW_FEATURES[1],)


def test_columns_are_evaluated_anywhere_in_the_scale_of_the_data():
    found = empty(some_rows())
    found.add("free", terms("x", "u"))
    elsewhere = {"x": np.array([2.0, 3.0]), "u": np.array([5.0, 7.0])}
    scale = np.sqrt(np.mean(found.rows.columns["u"] ** 2))
    np.testing.assert_allclose(found.evaluate([1], elsewhere)[:, 0], np.array([5.0, 7.0]) / scale)
    assert found.evaluate([], elsewhere).shape == (2, 0)


def test_values_of_a_nonlinear_parameter_may_be_given():
    inner = (InnerParameter("c", "edge", of="r", low=0.1, high=0.5, unit_of="r"),)
    bound = effect("max(r - c, 0)", "edge", inner).bind({"r": "x"})
    data = Trajectories.from_arrays(np.arange(9.0), states={"x": np.linspace(-1, 1, 9)}, derivatives={"x": np.ones(9)})
    values = Values(np.array([[0.21], [0.33]]), np.log([0.7, 0.3]))
    found = regressors_of(Program(discrepancy=OrthogonalGP(features=3)), data, "x", [bound], {bound.label: values})
    own = [found.columns[i] for i in found.of_kind("effect")]
    assert [column.inner["c"] for column in own] == [0.21, 0.33] and found.group(bound.label) == [0, 1]
    np.testing.assert_allclose([column.log_weight for column in own], np.log([0.7, 0.3]))
