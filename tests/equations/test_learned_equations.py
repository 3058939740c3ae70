"""Equations that are taken out say what the package's own right-hand side says."""

import json
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from fabricated import fabricate, oscillator
from tiny_equation import DEAD_ZONE, forced, forced_model, forced_study, tiny_data, tiny_model, tiny_near

import bayes_greybox as bg
from bayes_greybox.discovery.answer.amendment import Amendment, Remainder
from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.learned import extended_system
from bayes_greybox.equations.of_posterior import fitted_system
from bayes_greybox.equations.rates import learned_rates
from bayes_greybox.inference.whole_rate import whole_rate
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.report.equations.record import equations_record
from bayes_greybox.report.equations.text import as_simulation, equations_text
from bayes_greybox.running.errors import InputError

CLOSE = {"rtol": 1e-8, "atol": 1e-8}
SHAPE = (2, 6)


def data_of(n=60, seed=0):
    """Rows of y, v and a force, with both rates."""
    rng, plain = np.random.default_rng(seed), oscillator(n, seed)
    y, v = plain.states["y"], plain.states["v"]
    F = rng.uniform(-1, 1, n)
    return bg.Trajectories.from_arrays(
        plain.time,
        states={"y": y, "v": v},
        inputs={"F": F},
        derivatives={"y": v + 0.01 * rng.standard_normal(n), "v": plain.derivatives["v"] + F},
        units={"t": "s", "y": "m", "v": "m/s", "F": "N"},
    )


def made(model, data=None, *, chains=2, draws=6, **scaled):
    """A fit with draws that nobody sampled; f small unless its weights are given."""
    data = data_of() if data is None else data
    basis = next(iter(model.assemble(data).values())).frame.basis
    if basis is not None and "weight" not in scaled:
        scaled["weight"] = 1e-4 * np.random.default_rng(5).standard_normal((chains, draws, basis.size))
    p = fabricate(model, data, chains=chains, draws=draws, **scaled)
    return bg.Fit(p.model, p.data, p.sampling, p.idata)


def points(n=7, seed=3):
    """Times, states and inputs, some of them beyond the data."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 9, n), rng.uniform(-1.3, 1.3, (n, 2)), rng.uniform(-1.3, 1.3, (n, 1))


def own_rates(fit, t, x, u, pick=None, with_f=True):
    """The right-hand side that free runs integrate, at draws, or at the mean of those in `pick`."""
    simulation, learned = fit.model.simulator(fit.data), fit.learned()
    rate = whole_rate(simulation, learned, fit.data.columns)
    parameters = {}
    for name, each in learned.items():
        draws = each.of(fit.draws(each.block))
        weight = np.asarray(draws.weight) * with_f
        parts = (draws.theta, weight) if pick is None else (draws.theta[pick].mean(0)[None], weight[pick].mean(0)[None])
        parameters[name] = tuple(map(jnp.asarray, parts))
    at = jax.vmap(jax.vmap(rate, (0, 0, 0, None)), (None, None, None, 0))
    return np.asarray(at(*map(jnp.asarray, (t, x, u)), parameters))


def by_sympy(expressions, fit_or_names, x, u):
    names = [sympy.Symbol(name, real=True) for name in fit_or_names]
    columns = [*x.T, *u.T]
    values = [sympy.lambdify(names, e)(*columns) for e in expressions.values()]
    return np.stack([np.broadcast_to(v, len(x)) for v in values], axis=-1)


def by_json(text, x, u, given=None):
    """What the record says, read with the formula parser alone."""
    record = json.loads(text)
    assert record["format"] == 1
    columns = dict(zip((*record["states"], *record["inputs"]), (*x.T, *u.T), strict=True))
    found = []
    for k, each in enumerate(record["equations"]):
        rate = np.array(evaluate(parse_expression(each["simulation"]), columns))
        rate += given[:, k] if each["function"] else 0.0
        for term in each["terms"]:
            rate += term["mean"] * np.asarray(evaluate(parse_expression(term["expression"]), columns))
        found.append(rate)
    return np.stack(found, axis=-1)


ONE = {"simulation": {"y": "v", "v": "F - 0.3*v"}, "dictionary": {"v": ["y", "y**3", "v**3"]}}
TWO = {
    "simulation": {"v": "F"}, "dictionary": {"y": ["v", "y**2"], "v": ["y", "v"]}, "discrepancy": None,
    "prior": bg.Normal(),
}  # fmt: skip
WITH_FUNCTIONS = {
    "simulation": {"y": "v", "v": "F*exp(-0.5*y**2)"},
    "dictionary": {"v": ["sin(2*y)", "F*v/(1 + y**2)", "tanh(3*v)", "y - 0.2"]},
    "prior": bg.Laplace(),
}


@pytest.mark.parametrize("given", [ONE, TWO, WITH_FUNCTIONS], ids=["one", "two", "functions"])
def test_all_ways_out_say_what_the_packages_own_right_hand_side_says(given):
    fit = made(bg.GreyBox(**{"discrepancy": bg.OrthogonalGP(features=3), **given}))
    t, x, u = points()
    every = own_rates(fit, t, x, u)
    plain = own_rates(fit, t, x, u, with_f=False)
    mean = own_rates(fit, t, x, u, slice(None), with_f=False)[0]
    # Random draws are far from zero, so no term is left out.
    assert all(not each.left_out for each in fitted_system(fit).learned.values())
    for backend in ("numpy", "jax"):
        rates = fit.to_callable(backend)
        assert rates.equations == rates.states == ("y", "v") and rates.inputs == ("F",)
        np.testing.assert_allclose(rates(t, x, u), mean, **CLOSE)
        np.testing.assert_allclose(fit.to_callable(backend, draws=12)(t, x, u), plain, **CLOSE)
        np.testing.assert_allclose(fit.to_callable(backend, draws=12, discrepancy=True)(t, x, u), every, **CLOSE)
    if fit.model.discrepancy is not None:
        with_f = own_rates(fit, t, x, u, slice(None))[0]
        np.testing.assert_allclose(fit.to_callable(discrepancy=True)(t, x, u), with_f, **CLOSE)
        assert np.max(np.abs(with_f - mean)) > 1e-6
    np.testing.assert_allclose(by_sympy(fit.to_sympy(), ("y", "v", "F"), x, u), mean, **CLOSE)
    np.testing.assert_allclose(by_json(fit.to_json(), x, u), mean, **CLOSE)


def test_columns_may_be_called_anything_beside_numbers_in_formulas():
    renamed = {"y": "number_0", "F": "number_1", "v": "v"}
    plain = data_of()
    data = bg.Trajectories.from_arrays(
        plain.time,
        states={renamed[name]: values for name, values in plain.states.items()},
        inputs={renamed["F"]: plain.inputs["F"]},
        derivatives={"v": plain.derivatives["v"]},
    )
    model = bg.GreyBox(
        simulation={"number_0": "v"}, dictionary={"v": ["sin(2.5*number_0)", "exp(0.3*number_1)*v"]}, discrepancy=None
    )
    fit, (t, x, u) = made(model, data), points()
    np.testing.assert_allclose(own_rates(fit, t, x, u), fit.to_callable(draws=12)(t, x, u), **CLOSE)


def test_the_function_takes_points_of_any_shape_and_single_draws_and_jax_follows_it():
    fit = made(bg.GreyBox(**ONE, discrepancy=bg.OrthogonalGP(features=3)))
    t, x, u = points(6)
    rates, drawn = fit.to_callable(), fit.to_callable(draws=5, discrepancy=True)
    flat = rates(t, x, u)
    assert rates(0.0, x[0], u[0]).shape == (2,) and drawn(0.0, x[0], u[0]).shape == (5, 2)
    np.testing.assert_allclose(rates(t.reshape(2, 3), x.reshape(2, 3, 2), u.reshape(2, 3, 1)), flat.reshape(2, 3, 2))
    assert drawn(t, x, u[0]).shape == (5, 6, 2)
    np.testing.assert_allclose(drawn.draw(4)(t, x, u), drawn(t, x, u)[4], **CLOSE)
    assert rates.units == {"y": "m/s", "v": "m/s²"}
    in_jax = fit.to_callable("jax")
    jacobian = jax.jit(jax.jacfwd(lambda x: in_jax(0.0, x, jnp.asarray(u[0]))))(jnp.asarray(x[0]))
    h = 1e-6
    sides = [(rates(0.0, x[0] + e, u[0]) - rates(0.0, x[0] - e, u[0])) / (2 * h) for e in h * np.eye(2)]
    np.testing.assert_allclose(jacobian, np.stack(sides, axis=-1), atol=1e-7)


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda fit: fit.to_callable("torch"), "use 'numpy' or 'jax'"),
        (lambda fit: fit.to_callable(draws=13), "between 1 and 12"),
        (lambda fit: fit.to_callable(draws=0), "between 1 and 12"),
        (lambda fit: fit.to_callable().draw(0), "ask for draws"),
        (lambda fit: fit.to_callable()(0.0, [0.1], [0.2]), r"must have 2 values \(y, v\), not 1"),
        (lambda fit: fit.to_callable()(0.0, [0.1, 0.2]), "the inputs must have 1 values"),
    ],
)
def test_what_cannot_be_is_refused(ask, sentence):
    with pytest.raises(InputError, match=sentence):
        ask(made(bg.GreyBox(**ONE, discrepancy=None)))


PATTERNS = np.array([[1, 1, 0]] * 7 + [[0, 1, 0]] * 4 + [[1, 1, 1]]).reshape(*SHAPE, 3)


def patterned(**changes):
    theta = np.where(PATTERNS, np.random.default_rng(1).normal([0.5, -2.0, 1.0], 0.01, PATTERNS.shape), 0.0)
    given = {"theta": theta, "gamma": PATTERNS, "inclusion": np.where(PATTERNS, 0.9, 0.1)} | changes
    return made(bg.GreyBox(**ONE, discrepancy=bg.OrthogonalGP(features=3)), **given)


def test_the_likeliest_pattern_is_the_equation_and_its_draws_alone_say_its_coefficients():
    fit = patterned()
    t, x, u = points()
    equation = fitted_system(fit).learned["v"]
    assert [each.name for each in equation.terms] == ["y", "y**3"]
    assert [each.name for each in equation.left_out] == ["v**3"] and equation.pattern == 7 / 12
    theta = fit.values("v")["theta"][:7]
    assert [each.value.mean for each in equation.terms] == pytest.approx(theta.mean(axis=0)[:2].tolist())
    assert equation.terms[1].value.sd == pytest.approx(theta[:, 1].std(ddof=1))
    mean = own_rates(fit, t, x, u, slice(0, 7), with_f=False)[0]
    np.testing.assert_allclose(fit.to_callable()(t, x, u), mean, **CLOSE)
    np.testing.assert_allclose(by_sympy(fit.to_sympy(), ("y", "v", "F"), x, u), mean, **CLOSE)
    np.testing.assert_allclose(by_json(fit.to_json(), x, u), mean, **CLOSE)
    record = json.loads(fit.to_json())["equations"][1]
    assert record["left_out"][0]["expression"] == "v**3" and record["pattern_probability"] == 7 / 12
    assert record["terms"][0]["inclusion"] == pytest.approx((11 * 0.9 + 0.1 - 0.8 * 3) / 12)
    # Draws are whole: each has all terms of its own.
    np.testing.assert_allclose(fit.to_callable(draws=12)(t, x, u), own_rates(fit, t, x, u, with_f=False), **CLOSE)
    pickle.loads(pickle.dumps(fit.memory))


def test_text_and_latex_have_the_terms_their_numbers_and_units_and_the_rule_once():
    fit = patterned()
    text, latex = repr(fit), fit.to_latex()
    (y, cubic) = fitted_system(fit).learned["v"].terms
    line = next(each for each in text.splitlines() if each.startswith("d(v)/dt"))
    assert line.startswith("d(v)/dt = F − 0.3·v + ") and "v³" not in line
    assert f"{cubic.value.mean:.3f}".lstrip("-")[:4] in line and "[1/(m²·s²)] y³" in line and " [1/s²] y −" in line
    assert text.count("likeliest pattern") == 1 and text.count("1.23(4) is 1.23 ± 0.04") == 1
    assert latex.startswith(r"\begin{aligned}") and r"\frac{\mathrm{d} y}{\mathrm{d} t} &= v \\" in latex
    assert r"\frac{\mathrm{d} v}{\mathrm{d} t} &= F - 0.3 v + " in latex and latex.endswith("y^{3}\n\\end{aligned}")
    assert r"[\mathrm{1/(m^{2}\cdot s^{2})}]" in latex
    assert as_simulation(fitted_system(fit)).startswith('y = "v"\nv = "F - 0.3*v + ')


def test_f_stands_where_the_data_tell_it_from_zero_and_only_there():
    size = made(bg.GreyBox(**ONE, discrepancy=bg.OrthogonalGP(features=3))).draws("v").weight.shape[1]
    scatter = np.random.default_rng(2).standard_normal((*SHAPE, size))
    sure, unsure, small = 1.0 + 0.1 * scatter, 0.3 * scatter, 1e-4 * (1.0 + 0.1 * scatter)
    for weight, left in ((sure, True), (unsure, False), (small, False)):
        fit = patterned(weight=weight)
        assert fitted_system(fit).learned["v"].discrepancy.left is left
        assert repr(fit).splitlines()[-2].endswith("+ f") is left
        assert ("f{\\left(y,v,F \\right)}" in fit.to_latex()) is left
        used = {str(f.func): f.args for f in fit.to_sympy()["v"].atoms(sympy.core.function.AppliedUndef)}
        names = {name: tuple(map(str, args)) for name, args in used.items()}
        assert names == ({"f_v": ("y", "v", "F")} if left else {})
        assert json.loads(fit.to_json())["equations"][1]["discrepancy"] == {"left": left, "variables": ["y", "v", "F"]}


@pytest.mark.parametrize("beside_others", [0.0, 1.0])
def test_f_is_told_from_zero_beside_the_terms_that_are_shown(beside_others):
    """What f is beside other terms, it is not beside those of the likeliest pattern."""
    size = made(bg.GreyBox(**ONE, discrepancy=bg.OrthogonalGP(features=3))).draws("v").weight.shape[1]
    shape, shown = (2, 40), np.arange(80).reshape(2, 40, 1) % 2 == 0
    gamma = np.where(shown, [1, 1, 0], np.where(np.arange(80).reshape(2, 40, 1) % 4 == 1, [0, 1, 0], [0, 1, 1]))
    scatter = 0.02 * np.random.default_rng(2).standard_normal((*shape, size))
    beside = np.where(np.arange(80).reshape(2, 40, 1) % 4 == 1, 1.0, -1.0 + 2 * beside_others)
    weight = np.where(shown, 1.0 - beside_others, beside * (10.0 - 9.0 * beside_others)) + scatter
    given = {"theta": gamma * 1.0, "gamma": gamma, "inclusion": gamma * 1.0, "weight": weight}
    fit = made(bg.GreyBox(**ONE, discrepancy=bg.OrthogonalGP(features=3)), draws=40, **given)
    equation = fitted_system(fit).learned["v"]
    assert [each.name for each in equation.terms] == ["y", "y**3"] and equation.pattern == 0.5
    assert equation.discrepancy.left is (beside_others == 0.0)


def test_a_prior_without_inclusion_leaves_out_what_hardly_moves_the_rate():
    theta = np.random.default_rng(1).normal([0.5, -2.0, 0.001], [0.01, 0.01, 0.002], (*SHAPE, 3))
    fit = made(bg.GreyBox(**ONE, prior=bg.Laplace(), discrepancy=None), theta=theta)
    equation = fitted_system(fit).learned["v"]
    assert [each.name for each in equation.terms] == ["y", "y**3"] and equation.pattern is None
    assert equation.terms[0].value.mean == pytest.approx(fit.values("v")["theta"][:, 0].mean())
    assert (
        "likely to move the rate by over 1\u00a0% (RMS) of what the simulation leaves" in repr(fit)
        and json.loads(fit.to_json())["equations"][1]["terms"][0]["inclusion"] is None
    )


def test_a_simulation_that_is_code_is_called_and_said_to_be_code():
    def code(t, x, u):
        return jnp.stack([x[1], u[0] - 0.3 * x[1] + 0.1 * jnp.sin(t)])

    fit = made(bg.GreyBox(simulation=code, dictionary=ONE["dictionary"], prior=bg.Normal(), discrepancy=None))
    t, x, u = points()
    mean = own_rates(fit, t, x, u, slice(None))[0]
    for backend in ("numpy", "jax"):
        np.testing.assert_allclose(fit.to_callable(backend)(t, x, u), mean, **CLOSE)
    assert "d(v)/dt = g(x, u) " in repr(fit) and r"g{\left(x,u \right)}" in fit.to_latex()
    expression = fit.to_sympy()["v"]
    (g,) = expression.atoms(sympy.core.function.AppliedUndef)
    assert str(g) == "g_v(t, y, v, F)"
    simulated = np.stack([x[:, 1], u[:, 0] - 0.3 * x[:, 1] + 0.1 * np.sin(t)], axis=-1)
    known = by_sympy({"v": expression.subs(g, 0)}, ("y", "v", "F"), x, u)[:, 0] + simulated[:, 1]
    np.testing.assert_allclose(known, mean[:, 1], **CLOSE)
    np.testing.assert_allclose(by_json(fit.to_json(), x, u, simulated), mean, **CLOSE)
    assert "cannot be written down" in json.loads(fit.to_json())["simulation"]
    assert as_simulation(fitted_system(fit)) == ""


def test_fixed_coefficients_are_part_of_the_equation():
    fit = made(
        bg.GreyBox(
            **ONE, coefficients={"v": {"y**3": bg.priors.Coefficient(fixed=-1.0)}}, prior=bg.Normal(), discrepancy=None
        )
    )
    t, x, u = points()
    mean = own_rates(fit, t, x, u, slice(None))[0]
    np.testing.assert_allclose(by_sympy(fit.to_sympy(), ("y", "v", "F"), x, u), mean, **CLOSE)
    np.testing.assert_allclose(fit.to_callable()(t, x, u), mean, **CLOSE)
    # Exact, and marked as what it is.
    assert "− 1(given) [1/(m²·s²)] y³" in repr(fit)


def test_an_output_has_an_equation_without_a_rate():
    rng = np.random.default_rng(0)
    p, q = rng.uniform(0.1, 1, 40), rng.uniform(-1, 1, 40)
    data = bg.Trajectories.from_arrays(
        np.arange(40.0),
        states={},
        inputs={"p": p, "q": q},
        outputs={"R": p + 2 * q**2 + 0.01 * rng.standard_normal(40)},
    )
    model = bg.GreyBox(simulation={"R": "p"}, dictionary={"R": ["q", "q**2"]}, prior=bg.Normal(), discrepancy=None)
    fit = made(model, data)
    theta = fit.values("R")["theta"].mean(axis=0)
    u = np.stack([p, q], axis=-1)
    for backend in ("numpy", "jax"):
        found = fit.to_callable(backend)(0.0, np.zeros((40, 0)), u)
        np.testing.assert_allclose(found[:, 0], p + theta[0] * q + theta[1] * q**2, **CLOSE)
    assert "\nR = p " in repr(fit) and fit.to_latex().splitlines()[1].startswith("R &= p")


# Studies


def test_an_amended_study_says_what_its_free_runs_integrate():
    study, data = forced_study(True), forced(lambda y, v: -0.3 * y**3)
    system = extended_system(forced_model(), data, {"v": study.amendment}, {("v", "cube"): 0.97})
    t, x, u = points()
    columns = {"y": x[:, 0], "v": x[:, 1], "F": u[:, 0]}
    (term,) = system.learned["v"].terms
    assert (term.name, term.term.text, term.probability) == ("cube", "y**3", 0.97)
    row = study.effects(data).iloc[0]
    assert term.value.mean == pytest.approx(row["mean"], rel=1e-3) and term.unit == "1/m²/s²"
    simulated = np.stack([x[:, 1], u[:, 0] - 2 * x[:, 0] - 0.15 * x[:, 1]], axis=-1)
    n = len(system.learned["v"].drawn.coefficients)
    for backend in ("numpy", "jax"):
        found = learned_rates(system, backend, n)(t, x, u)
        np.testing.assert_allclose(found[..., 1], simulated[:, 1] + study.amendment.rates(columns, n)[1], **CLOSE)
    mean = simulated + np.stack([0 * t, term.value.mean * x[:, 0] ** 3], axis=-1)
    np.testing.assert_allclose(learned_rates(system)(t, x, u), mean, **CLOSE)
    np.testing.assert_allclose(by_sympy(system.to_sympy(), ("y", "v", "F"), x, u), mean, **CLOSE)
    np.testing.assert_allclose(by_json(json.dumps(equations_record(system)), x, u), mean, **CLOSE)
    assert "− 0.3" in equations_text(system) and not equations_text(system).splitlines()[0].endswith("+ f")


@pytest.fixture(scope="module")
def zone():
    """A dead zone found with three values of its gap, a correction in most draws, and an f beside them."""
    near = tiny_near([DEAD_ZONE], lambda x: np.sign(x) * np.maximum(abs(x) - 0.4, 0) + 0.3 * np.cos(3 * x))
    statistics, rng = near.regressors, np.random.default_rng(4)
    own, gaps = statistics.of_kind("correction"), statistics.of_kind("effect")[2:5]
    inner = rng.choice(gaps, 10)
    draws = np.column_stack([0.2 * (np.arange(10) < 7), rng.normal(1.0, 0.05, 10)])
    coefficients = Coefficients((*own, gaps[1]), draws, inner[:, None], np.full(10, 0.1))
    rest = Remainder.of(near, near.weighed.before, coefficients)
    return Amendment(statistics, np.zeros(0), coefficients, 0.1, rest)


def test_an_inner_parameter_has_its_mean_in_the_equation_and_its_own_value_in_every_draw(zone):
    system = extended_system(tiny_model(), tiny_data(), {"x": zone}, {})
    statistics, equation = zone.statistics, system.learned["x"]
    x = np.random.default_rng(0).uniform(-1.2, 1.2, (9, 1))
    (gap,) = equation.inner
    columns = [statistics.columns[i] for i in zone.after.inner[:7, 0]]
    assert gap.value.mean == pytest.approx(np.mean([c.inner["gap"] for c in columns]))
    assert equation.pattern == 0.7 and [each.name for each in equation.terms] == ["x", "dead-zone"]
    values = [d * statistics.target_scale / c.scale for d, c in zip(zone.after.draws[:7, 1], columns, strict=True)]
    assert equation.terms[1].value.mean == pytest.approx(np.mean(values))
    r = x[:, 0]
    bent = np.sign(r) * np.maximum(abs(r) - gap.value.mean, 0)
    mean = (-r + equation.terms[0].value.mean * r + np.mean(values) * bent)[:, None]
    for backend in ("numpy", "jax"):
        np.testing.assert_allclose(learned_rates(system, backend)(0.0, x), mean, **CLOSE)
        found = learned_rates(system, backend, 10, discrepancy=True)(0.0, x)[..., 0]
        np.testing.assert_allclose(found, -r + zone.rates({"x": r}, 10)[1], **CLOSE)
    left = {f: 0 for f in system.to_sympy()["x"].atoms(sympy.core.function.AppliedUndef)}
    assert [str(f) for f in left] == ["f_x(x)"]
    plain = {"x": system.to_sympy()["x"].subs(left)}
    np.testing.assert_allclose(by_sympy(plain, ("x",), x, np.zeros((9, 0))), mean, **CLOSE)
    record = equations_record(system)
    np.testing.assert_allclose(by_json(json.dumps(record), x, np.zeros((9, 0))), mean, **CLOSE)
    assert record["equations"][0]["inner_parameters"][0]["mean"] == gap.value.mean
    text = equations_text(system)
    assert text.splitlines()[0].endswith("+ f") and "\n  gap = 0." in text and "(dead-zone)" in text
