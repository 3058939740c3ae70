"""The catalogue of effects: what it holds, how effects are bound to columns, and users' own files."""

import dataclasses

import jax
import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effect_tables import keys_of
from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter
from bayes_greybox.physics.catalogue.loading import DOMAINS, load_catalogue
from bayes_greybox.physics.catalogue.pairs import pairs_in_data
from bayes_greybox.physics.catalogue.roles import ROLES, Columns, bind_catalogue, unbound
from bayes_greybox.physics.catalogue.roles import roles_of as roles_of_columns
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.formula.grammar import read
from bayes_greybox.physics.hidden_states import HiddenState, along
from bayes_greybox.physics.terms import Dictionary, Term
from bayes_greybox.physics.units import coefficient_unit, derivative_unit
from bayes_greybox.running.errors import InputError

SLUGS = {
    "mechanical": """linear-stiffness quadratic-stiffness cubic-stiffness quintic-stiffness signed-quadratic-stiffness
        pendulum-restoring dead-zone bilinear-stiffness viscous-damping coulomb-friction stribeck-friction
        quadratic-drag cubic-damping van-der-pol-damping velocity-squared position-velocity-coupling constant-force
        input-gain cubic-input smooth-friction exponential-stribeck-friction direction-dependent-friction backlash
        bouc-wen dahl-friction maxwell-damper actuator-lag absorber""",
    "fluid": "linear-outflow torricelli-outflow overflow",
    "population": "logistic-crowding bilinear-interaction holling-ii allee constant-harvest",
    "electrical": "diode saturating-inductor",
    "thermal": "heat-loss linear-cooling constant-heat natural-convection radiation second-mass",
    "battery": "relaxation two-relaxations charge-transfer one-sided-resistance constant-voltage",
    "compartment": "linear-elimination saturable-elimination second-order-elimination absorption second-compartment",
    "vehicle": """rolling-resistance driveline-loss aerodynamic-drag grade steady-push input-saturation
        drive-dead-zone drive-lag""",
}
OSCILLATOR = {"y": "ydot", "ydot": "F - y - 0.1*ydot"}
CHAIN = {"x1": "v1", "v1": "x2 - 2*x1", "x2": "v2", "v2": "x1 - x2"}
ALL = load_catalogue(list(DOMAINS))
BY_SLUG = {effect.slug: effect for effect in ALL}


def roles_of(simulation, states, inputs, equation, given=None, units=None, pairs=None, outputs=()):
    return roles_of_columns(simulation, Columns(states, inputs, outputs, units or {}), equation, given, pairs)


def texts(catalogue, roles, units=None):
    """Formulas of all bound effects, by slug where there is one way only."""
    return {(b.slug, b.text()) for b in bind_catalogue(load_catalogue(catalogue), roles, units)}


def middle(effect, scale=1.0):
    """A value of the nonlinear parameter in the middle of its prior."""
    single = [dataclasses.replace(inner, values=1) for inner in effect.inner]
    return {inner.name: float(inner.nodes(inner.low * scale, inner.high * scale)[0]) for inner in single}


def write(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


# ---------------------------------------------------------------- values of nonlinear parameters

WITH_INNER = [effect for effect in ALL if effect.inner]


def at_values(effect, rng, names=None):
    """The effect at random values of its nonlinear parameters, and the same written out and read."""
    bound = effect.bind(names or {role: f"{role}_1" for role in effect.roles})
    term = bound.term({inner.name: float(rng.uniform(0.2, 1.5)) for inner in effect.inner})
    states = tuple(HiddenState(s.name, s.rate, s.unit_of, start=s.start) for s in term.states)
    return term, Term(term.expression, states=states)


@pytest.mark.parametrize("effect", WITH_INNER, ids=lambda effect: effect.slug)
def test_an_effect_at_values_is_what_it_is_written_out(effect):
    rng = np.random.default_rng(len(effect.slug))
    for _ in range(3):
        term, written = at_values(effect, rng)
        names = {*written.symbols, *(name for s in written.states for name in s.symbols)}
        columns = {name: rng.standard_normal(40) for name in names}
        np.testing.assert_allclose(term.evaluate(columns), written.evaluate(columns), rtol=1e-12, atol=1e-14)
        traced = jax.jit(term.evaluate)(columns)
        np.testing.assert_allclose(traced, written.evaluate(columns), rtol=1e-12, atol=1e-14)
        assert term.text == written.text and term.symbols == written.symbols
        if not term.states:
            continue
        known = {name: x for name, x in columns.items() if name not in {s.name for s in term.states}}
        paths = (along([each.states], 0.05 * np.arange(40), known, np.arange(40) == 0)[0] for each in (term, written))
        for own, other in zip(*(path.items() for path in paths), strict=True):
            np.testing.assert_allclose(own[1], other[1], rtol=1e-12, atol=1e-14)


def test_a_column_may_be_called_as_an_inner_parameter_is():
    term, written = at_values(BY_SLUG["dead-zone"], np.random.default_rng(0), {"position": "gap"})
    columns = {"gap": np.linspace(-2.0, 2.0, 30)}
    np.testing.assert_allclose(term.evaluate(columns), written.evaluate(columns), rtol=1e-12)
    assert term.symbols == ("gap",)


def test_a_formula_is_read_once_for_all_values():
    bound = BY_SLUG["lugre-friction"].bind({role: role for role in BY_SLUG["lugre-friction"].roles})
    values, columns = {inner.name: 0.3 for inner in bound.effect.inner}, {"velocity": np.ones(3)}
    bound.term(values)
    before = read.cache_info().misses
    for k in range(1, 20):
        term = bound.term({name: value + k / 64 for name, value in values.items()})
        term.evaluate({**columns, term.states[0].name: np.ones(3)})
        along([term.states], np.arange(3.0), columns, np.arange(3) == 0)
    assert read.cache_info().misses == before
    assert "0.596875" in term.text and read.cache_info().misses > before


# ---------------------------------------------------------------- the packaged catalogue


@pytest.mark.parametrize("domain", DOMAINS)
def test_every_promised_effect_is_there(domain):
    effects = load_catalogue(domain)
    assert set(SLUGS[domain].split()) <= {effect.slug for effect in effects}
    assert {effect.domain for effect in effects} == {domain}


def test_all_has_every_effect_once():
    assert len({effect.slug for effect in ALL}) == len(ALL)
    assert {e.slug for d in DOMAINS for e in load_catalogue(d)} == {effect.slug for effect in ALL}
    # Rolling resistance is Coulomb friction by another name.
    named = {effect.slug for effect in load_catalogue("all")}
    assert named == {e.slug for d in DOMAINS if d != "vehicle" for e in load_catalogue(d)}
    assert load_catalogue(["mechanical", "mechanical"]) == load_catalogue("mechanical")
    assert load_catalogue(ALL) == ALL and load_catalogue(ALL[0]) == ALL[:1]


def test_an_effect_of_several_domains_has_the_look_alikes_of_all():
    for order in (["fluid", "mechanical"], ["mechanical", "fluid"]):
        gain = {effect.slug: effect for effect in load_catalogue(order)}["input-gain"]
        looks_like = {
            "squared-input",
            "cubic-input",
            "backlash",
            "actuator-lag",
            "input-saturation",
            "stroke-dependent-drive",
        }
        assert set(gain.confusions) == looks_like and gain.domain == order[0]


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.slug)
def test_entries_are_complete_and_their_formulas_work(effect):
    assert effect.name and effect.meaning.endswith(".")
    assert set(effect.roles) <= set(ROLES)
    MathTextParser("path").parse(f"${effect.latex}$")
    for inner in effect.inner:
        assert inner.unit_of == (inner.of if inner.scale in ("size", "threshold") else "") and inner.meaning
    bound = effect.bind({role: f"the_{role}" for role in ROLES})
    rng = np.random.default_rng(0)
    columns = {f"the_{role}": np.append(rng.uniform(-2.0, 2.0, 50), 0.0) for role in ROLES}
    if effect.domain in ("fluid", "population"):
        columns = {name: np.abs(column) for name, column in columns.items()}
    # Each value of one nonlinear parameter beside the middle ones of the others.
    values = {i.name: i.nodes(2.0 * i.low, 2.0 * i.high) for i in effect.inner}
    middle = {name: float(np.median(each)) for name, each in values.items()}
    for inner in [middle | {name: float(value)} for name, each in values.items() for value in each] or [{}]:
        term = bound.term(inner)
        assert all(state.meaning and state.unit_of in columns for state in term.states)
        rates = [parse_expression(state.rate, (*columns, *(s.name for s in term.states))) for state in term.states]
        columns |= {state.name: rng.uniform(-2.0, 2.0, 51) for state in term.states}
        assert all(np.all(np.isfinite(np.asarray(evaluate(rate, columns)))) for rate in rates)
        values = np.asarray(term.evaluate(columns))
        assert values.shape == (51,) and np.all(np.isfinite(values)) and np.any(values != 0)
        slopes = jax.vmap(jax.grad(term.evaluate))(columns)
        assert all(np.all(np.isfinite(slopes[name])) for name in term.symbols)


@pytest.mark.parametrize("domain", DOMAINS)
def test_confusions_are_mutual_and_in_the_domain(domain):
    effects = {effect.slug: effect for effect in load_catalogue(domain)}
    for effect in effects.values():
        assert len(set(effect.confusions)) == len(effect.confusions)
        for slug in effect.confusions:
            assert effect.slug in effects[slug].confusions, (effect.slug, slug)


@pytest.mark.parametrize("domain", DOMAINS)
def test_effects_of_a_domain_are_different_terms(domain):
    bound = [effect.bind({role: role for role in ROLES}) for effect in load_catalogue(domain)]
    terms = [b.term(middle(b.effect)) for b in bound]
    Dictionary.of(terms, (*ROLES, *(state.name for term in terms for state in term.states)))


@pytest.mark.parametrize(
    ("slug", "inner", "columns", "values"),
    [
        ("dead-zone", {"gap": 0.5}, {"position": [-2.0, -0.4, 0.0, 0.5, 0.7]}, [-1.5, 0.0, 0.0, 0.0, 0.2]),
        ("bilinear-stiffness", {}, {"position": [-1.0, 0.0, 2.0]}, [0.0, 0.0, 2.0]),
        ("coulomb-friction", {}, {"velocity": [-0.1, 0.0, 3.0]}, [-1.0, 0.0, 1.0]),
        ("stribeck-friction", {"stribeck_speed": 0.2}, {"velocity": [-0.2, 1e-9, 4.0]}, [-np.exp(-1.0), 1.0, 0.0]),
        (
            "exponential-stribeck-friction",
            {"stribeck_speed": 0.5},
            {"velocity": [-1.0, 1e-12, 40.0]},
            [-np.exp(-2.0), 1.0, 0.0],
        ),
        ("smooth-friction", {"creep_speed": 0.1}, {"velocity": [-9.0, 0.0, 0.1]}, [-1.0, 0.0, np.tanh(1.0)]),
        ("direction-dependent-friction", {}, {"velocity": [-2.0, 0.0, 3.0]}, [2.0, 0.0, 3.0]),
        ("backlash", {"play": 0.5}, {"input": [-2.0, -0.4, 0.0, 0.7]}, [-0.5, -0.4, 0.0, 0.5]),
        ("quadratic-drag", {}, {"velocity": [-2.0, 3.0]}, [-4.0, 9.0]),
        ("torricelli-outflow", {}, {"level": [-1.0, 0.0, 4.0]}, [0.0, 0.0, 2.0]),
        ("overflow", {"brim": 3.0}, {"level": [2.0, 4.0]}, [0.0, 1.0]),
        ("weir-overflow", {"crest": 3.0}, {"level": [2.0, 7.0]}, [0.0, 8.0]),
        ("connecting-pipe", {}, {"level": [4.0, 1.0], "upstream": [0.0, 5.0]}, [-2.0, 2.0]),
        ("holling-ii", {"half_saturation": 2.0}, {"population": [2.0, 1e9], "other": [3.0, 3.0]}, [1.5, 3.0]),
        ("holling-ii-gain", {"half_saturation": 2.0}, {"population": [3.0], "other": [2.0]}, [1.5]),
        ("holling-iii", {"half_saturation": 2.0}, {"population": [2.0], "other": [3.0]}, [1.5]),
        ("allee", {"scarcity": 1.0}, {"population": [0.0, 1.0, 1e9]}, [0.0, 0.5, 1.0]),
        ("diode", {"slope_voltage": 0.1}, {"voltage": [-9.0, 0.0, 0.1]}, [-1.0, 0.0, np.e - 1.0]),
        ("saturating-inductor", {"knee": 1.0}, {"flux": [-3.0, 0.9]}, [-2.0, 0.0]),
    ],
)  # fmt: skip
def test_effects_have_the_physics_that_their_names_promise(slug, inner, columns, values):
    term = BY_SLUG[slug].bind({role: role for role in columns}).term(inner)
    columns = {name: np.array(column) for name, column in columns.items()}
    np.testing.assert_allclose(term.evaluate(columns), values, atol=1e-8)


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.slug)
def test_entries_say_what_the_other_sign_means(effect):
    assert effect.sign in (-1, 0, 1) and bool(effect.reverse) == bool(effect.sign)
    assert not effect.reverse.endswith(".")


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.slug)
def test_forces_that_resist_or_restore_have_the_sign_that_they_state(effect):
    """Along a motion, sign × expression takes power from it; of a pull to rest, sign × expression points back."""
    if effect.domain != "mechanical" or not effect.sign or "input" in effect.roles or effect.hidden:
        return
    rng = np.random.default_rng(0)
    columns = {role: rng.uniform(-1.5, 1.5, 200) for role in effect.roles}
    term = effect.bind({role: role for role in effect.roles}).term(middle(effect, 1.5))
    role = "velocity" if "velocity" in effect.roles else "position"
    against = columns[role] - columns.get(f"other_{role}", 0.0)
    force = effect.sign * np.asarray(term.evaluate(columns))
    assert np.all(force * against <= 0) and np.any(force * against < 0)


@pytest.mark.parametrize("effect", [e for e in ALL if e.hidden and e.sign], ids=lambda effect: effect.slug)
def test_memories_that_resist_take_power_from_a_motion_to_and_fro(effect):
    t = np.linspace(0.0, 60.0, 6001)
    path = {"position": np.sin(t), **dict.fromkeys(("velocity", "temperature", "current", "concentration"), np.cos(t))}
    term = effect.bind({role: role for role in effect.roles}).term(middle(effect, 1.0))
    (hidden,) = along([term.states], t, path, np.arange(len(t)) == 0)
    force = effect.sign * np.asarray(term.evaluate({**path, **hidden}))
    late = t > 40.0
    assert np.mean((force * path["velocity"])[late]) < 0


@pytest.mark.parametrize(
    ("slug", "unit"), [("bouc-wen", "1/s²"), ("maxwell-damper", "1/s²"), ("actuator-lag", "1/kg"), ("absorber", "1/s²")]
)
def test_coefficients_of_memories_have_the_units_of_their_hidden_states(slug, unit):
    units = {"position": "m", "velocity": "m/s", "state": "m/s", "input": "N", "t": "s"}
    term = BY_SLUG[slug].bind({role: role for role in units}).term(middle(BY_SLUG[slug]))
    assert coefficient_unit("m/s^2", term, term.units(units)) == unit


def test_signs_of_flows_populations_and_circuits():
    """A sign for the rate of this tank, population or circuit; none where either is as ordinary."""
    signs = {slug: effect.sign for slug, effect in BY_SLUG.items()}
    losses = """linear-outflow torricelli-outflow overflow weir-overflow logistic-crowding cubic-crowding holling-ii
        holling-iii allee ohmic-loss cubic-resistor diode diode-pair brush-drop saturating-inductor cubic-storage
        backlash linear-cooling relaxation two-relaxations charge-transfer linear-elimination saturable-elimination
        second-order-elimination rolling-resistance driveline-loss aerodynamic-drag grade drive-dead-zone"""
    gains = """linear-inflow torricelli-inflow overflow-inflow connecting-pipe holling-ii-gain holling-iii-gain
        inductance-drop heat-loss natural-convection radiation second-mass second-compartment"""
    either = """quadratic-stiffness bilinear-stiffness velocity-squared position-velocity-coupling constant-force
        direction-dependent-friction input-gain squared-input cubic-input constant-inflow linear-growth migration
        bilinear-interaction constant-harvest driven-growth constant-source actuator-lag constant-heat
        one-sided-resistance constant-voltage constant-production absorption steady-push drive-lag"""
    for sign, slugs in ((-1, losses), (1, gains), (0, either)):
        assert {slug: signs[slug] for slug in slugs.split()} == dict.fromkeys(slugs.split(), sign)
    assert sum(sign == 0 for sign in signs.values()) == len(either.split())


def test_an_input_with_play_is_the_input_less_what_backlash_takes():
    """The dead zone of the drive is reached by adding to the simulation's input what the play costs."""
    play = BY_SLUG["backlash"].bind({"input": "F"}).term({"play": 0.4})
    zone = BY_SLUG["dead-zone"].bind({"position": "F"}).term({"gap": 0.4})
    F = {"F": np.linspace(-2.0, 2.0, 41)}
    felt = F["F"] + BY_SLUG["backlash"].sign * np.asarray(play.evaluate(F))
    np.testing.assert_allclose(felt, zone.evaluate(F), atol=1e-12)


def test_inner_parameters_are_shares_of_a_size_or_of_a_time():
    time = np.linspace(0.0, 100.0, 10_001)
    run, x = np.zeros(len(time), int), 3.0 * np.sin(2 * np.pi * time / 5.0)
    for scale, size in (("size", 3.0), ("period", 5.0), ("frequency", 2 * np.pi / 5.0)):
        inner = InnerParameter("own", "its meaning", "position", 0.1, 1.0, scale=scale)
        assert inner.size(x, time, run) == pytest.approx(size, rel=1e-3)
        # At rest nothing is a share of anything; and without times no time is known.
        assert inner.size(0 * x, time, run) == 0.0
        assert inner.size(x, None, None) == (pytest.approx(3.0) if scale == "size" else 0.0)
    record = InnerParameter("own", "its meaning", "position", 0.1, 1.0, scale="record")
    assert record.size(x, time, run) == 100.0 and record.size(x, None, None) == 0.0
    # The longest of two runs.
    assert record.size(x, time, np.repeat([0, 1], [4000, len(time) - 4000])) == pytest.approx(60.0)
    # Between two runs nothing moves.
    again = InnerParameter("own", "its meaning", "position", 0.1, 1.0, scale="period")
    padded = np.concatenate([x, np.full(5000, x[-1])]), np.append(time, np.full(5000, time[-1]))
    assert inner.size(*padded, np.zeros(len(padded[0]), int)) == pytest.approx(inner.size(x, time, run), rel=1e-9)
    one = again.size(x - np.mean(x), time, run)
    both = again.size(np.concatenate([x, x]), np.concatenate([time, time]), np.repeat([0, 1], len(time)))
    assert both == pytest.approx(one, rel=1e-6)


def test_direction_dependent_friction_is_no_other_two_effects_together():
    """It must differ from dry friction whose level depends on the direction, and from a lift."""
    v = np.linspace(-1.0, 1.5, 400)
    columns = {"velocity": v}
    own = BY_SLUG["direction-dependent-friction"].bind({"velocity": "velocity"}).term().evaluate(columns)
    others = [np.ones_like(v), np.sign(v), v, v**2, v * np.abs(v)]
    rest = own - np.column_stack(others) @ np.linalg.lstsq(np.column_stack(others), own, rcond=None)[0]
    assert np.sqrt(np.mean(rest**2)) > 0.02 * np.sqrt(np.mean(own**2))


def test_smooth_friction_lies_between_dry_and_viscous():
    bound = BY_SLUG["smooth-friction"].bind({"velocity": "v"})
    v = {"v": np.array([-2.0, -0.5, 0.5, 2.0])}
    np.testing.assert_allclose(bound.term({"creep_speed": 1e-3}).evaluate(v), np.sign(v["v"]))
    np.testing.assert_allclose(1e3 * bound.term({"creep_speed": 1e3}).evaluate(v), v["v"], rtol=1e-5)


def test_allee_effect_makes_a_small_population_shrink():
    """n' = n - 2 n/(A + n) falls below n = 2 - A and grows above it."""
    rate = parse_expression("n") - 2 * parse_expression(
        BY_SLUG["allee"].bind({"population": "n"}).text({"scarcity": 0.5})
    )
    assert np.sign(evaluate(rate, {"n": np.array([0.1, 1.4, 1.6])})).tolist() == [-1.0, -1.0, 1.0]


def test_inner_parameters_keep_to_their_stated_ranges():
    shares = {(slug, i.name): (i.low, i.high) for slug, e in BY_SLUG.items() for i in e.inner}
    assert shares["dead-zone", "gap"] == (0.1, 0.8)
    assert shares["stribeck-friction", "stribeck_speed"] == (0.05, 0.6)
    assert shares["overflow", "brim"] == (0.5, 0.95)


def test_nodes_are_the_middles_of_equal_parts_of_a_log_uniform_prior():
    gap = BY_SLUG["dead-zone"].inner[0]
    values = gap.nodes(0.3, 2.4)
    assert len(values) == 8
    np.testing.assert_allclose(np.diff(np.log(values)), np.log(8.0) / 8)
    np.testing.assert_allclose([values[0], values[-1]], [0.3 * 8 ** (1 / 16), 2.4 * 8 ** (-1 / 16)])
    # The prior mean of the value is scale (high - low) / log(high / low).
    fine = dataclasses.replace(gap, values=2000).nodes(0.3, 2.4)
    np.testing.assert_allclose(np.mean(fine), 3.0 * 0.7 / np.log(8.0), rtol=1e-6)
    for *ends, count in ((0.0, 1.0, 8), (1.0, np.inf, 8), (np.nan, 1.0, 8), (1.0, 1.0, 8), (1.0, 2.0, 0)):
        with pytest.raises(InputError):
            dataclasses.replace(gap, values=count).nodes(*ends)


def test_a_threshold_has_the_column_on_both_sides_of_it():
    """Below the lowest level an edge never shows: the smooth law that is left would pass for a weir."""
    brim = BY_SLUG["overflow"].inner[0]
    least, most = brim.ends(np.array([0.1, 2.0]), None, None)
    assert (least, most) == pytest.approx((1.0, 1.9))
    assert brim.ends(np.array([-2.0, -1.4]), None, None) == pytest.approx((1.4, 1.9))
    assert brim.ends(np.array([1.95, 2.0]), None, None) == (0.0, 0.0)
    # What is no threshold may lie anywhere.
    scarcity = BY_SLUG["allee"].inner[0]
    low, high = scarcity.low, scarcity.high
    assert scarcity.ends(np.array([1.9, 2.0]), None, None) == pytest.approx((2 * low, 2 * high))


# ---------------------------------------------------------------- binding


def test_term_has_the_full_value_and_a_readable_name():
    bound = BY_SLUG["dead-zone"].bind({"position": "y", "velocity": "ydot"})
    assert bound.names == {"position": "y"} and (bound.slug, bound.name) == ("dead-zone", "Dead zone")
    assert bound.text() == "sign(y)*max(abs(y)-gap,0)"
    term = bound.term({"gap": 1 / 3})
    assert term.name == "sign(y)*max(abs(y)-0.3333,0)" and repr(1 / 3) in str(term.expression)
    assert float(term.evaluate({"y": np.array(1.0)})) == 1.0 - 1 / 3
    assert bound.term({"gap": np.float64(1e-7)}).name == "sign(y)*max(abs(y)-1e-07,0)"
    assert BY_SLUG["constant-force"].bind({}).term().name == "1"
    for inner in ({}, {"gap": -1.0}, {"gap": np.nan}, {"gap": 1.0, "brim": 1.0}):
        with pytest.raises(InputError, match="gap"):
            bound.term(inner)
    with pytest.raises(InputError, match="no values"):
        BY_SLUG["cubic-stiffness"].bind({"position": "y"}).term({"gap": 1.0})


def test_columns_may_be_called_as_roles_and_inner_parameters_are():
    names = {"position": "velocity", "velocity": "position"}
    assert BY_SLUG["van-der-pol-damping"].bind(names).text() == "velocity**2*position"
    bound = BY_SLUG["dead-zone"].bind({"position": "gap"})
    assert bound.term({"gap": 0.5}).symbols == ("gap",)
    assert float(bound.term({"gap": 0.5}).evaluate({"gap": np.array(2.0)})) == 1.5


def test_bind_refuses_what_cannot_be_bound():
    effect = BY_SLUG["van-der-pol-damping"]
    for names, words in (({"position": "y"}, "'velocity'"), ({"position": "y", "velocity": "y"}, "of its own")):
        with pytest.raises(InputError, match=words):
            effect.bind(names)
    with pytest.raises(InputError, match="column name"):
        effect.bind({"position": "y", "velocity": "v dot"})


def test_effects_are_values():
    bound = BY_SLUG["dead-zone"].bind({"position": "y"})
    assert bound == BY_SLUG["dead-zone"].bind({"position": "y"}) and len({bound, bound}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        bound.effect.slug = "other"


def test_one_degree_of_freedom():
    roles = roles_of(OSCILLATOR, ("y", "ydot"), ("F",), "ydot")
    assert (roles["position"], roles["velocity"], roles["input"]) == (("y",), ("ydot",), ("F",))
    assert roles["other_position"] == roles["other_velocity"] == ()
    found = texts("mechanical", roles)
    assert {("cubic-stiffness", "y**3"), ("coulomb-friction", "sign(ydot)"), ("input-gain", "F")} <= found
    assert len(found) == 34 and not any(slug.startswith("coupling") for slug, _ in found)
    assert not any(
        slug.endswith("-input") or slug.startswith("input-") for slug, _ in texts("mechanical", {**roles, "input": ()})
    )


def test_a_position_is_read_from_its_equation_however_it_is_written():
    for rate in ("ydot", " 1*ydot ", "(ydot)"):
        assert roles_of({"y": rate}, ("y", "ydot"), (), "ydot")["position"] == ("y",)
    for simulation in (None, {}, {"y": "2*ydot"}, {"y": "ydot + y"}, lambda t, x, u: x):
        assert roles_of(simulation, ("y", "ydot"), (), "ydot")["position"] == ()
    # In the equation of the position itself, its rate is the velocity.
    roles = roles_of(OSCILLATOR, ("y", "ydot"), (), "y")
    assert (roles["position"], roles["velocity"], roles["other_position"]) == (("y",), ("ydot",), ())


def test_two_degrees_of_freedom():
    states = ("x1", "v1", "x2", "v2")
    roles = roles_of(CHAIN, states, (), "v2")
    assert (roles["position"], roles["velocity"]) == (("x2",), ("v2",))
    assert (roles["other_position"], roles["other_velocity"]) == (("x1",), ("v1",))
    found = texts("mechanical", roles)
    assert {
        ("cubic-coupling-stiffness", "(x2-x1)**3"),
        ("coupling-damping", "v2-v1"),
        ("cubic-stiffness", "x2**3"),
    } <= found
    # Three bodies: the one in the middle may be coupled with either.
    middle = roles_of({**CHAIN, "x3": "v3", "v3": "-x3"}, (*states, "x3", "v3"), (), "v2")
    coupled = {text for slug, text in texts("mechanical", middle) if slug == "coupling-stiffness"}
    assert coupled == {"x2-x1", "x2-x3"}


def test_integrals_of_the_own_position_are_no_other_body():
    simulation = {"w": "x", "x": "v", "v": "a", "a": "-v"}
    roles = roles_of(simulation, ("w", "x", "v", "a"), (), "a")
    assert (roles["position"], roles["other_position"], roles["other_velocity"]) == (("v",), (), ())
    # A ring of rates must not be walked for ever.
    assert roles_of({"p": "q", "q": "p"}, ("p", "q"), (), "p")["position"] == ("p",)


def test_a_speed_is_no_concentration():
    for unit, there in (("mg/l", True), ("mol/l", True), ("1/ml", True), ("", True), ("m/s", False), ("K", False)):
        roles = roles_of({}, ("c",), (), "c", units={"c": unit})
        assert roles["concentration"] == (("c",) if there else ()), unit


def test_a_slope_of_the_road_is_no_input_of_the_drive():
    roles = roles_of({}, ("v",), ("F", "slope"), "v", {"grade": "slope"})
    assert roles["grade"] == ("slope",) and roles["input"] == ("F",)
    assert {("grade", "sin(slope)"), ("input-gain", "F")} <= texts("vehicle", roles)


def test_tanks():
    roles = roles_of({"h1": "0.05*u"}, ("h1", "h2"), ("u",), "h2")
    found = texts("fluid", roles)
    assert ("torricelli-outflow", "sqrt(max(h2,0))") in found and ("torricelli-inflow", "sqrt(max(h1,0))") in found
    assert ("overflow", "max(h2-brim,0)") in found and ("overflow-inflow", "max(h1-brim,0)") in found
    alone = texts("fluid", roles_of(None, ("h",), ("u",), "h"))
    assert {slug for slug, _ in alone} == {
        *("linear-outflow", "torricelli-outflow", "overflow", "weir-overflow", "constant-inflow"),
        *("input-gain", "squared-input", "cubic-input"),
    }


def test_populations():
    roles = roles_of({"hare": "0.5*hare"}, ("hare", "lynx", "fox"), (), "hare")
    found = texts("population", roles)
    assert {text for slug, text in found if slug == "bilinear-interaction"} == {"hare*lynx", "hare*fox"}
    assert ("holling-ii-gain", "hare*fox/(half_saturation+fox)") in found
    assert ("logistic-crowding", "hare**2") in found and "driven-growth" not in {slug for slug, _ in found}


def test_circuits():
    coil = roles_of({"phi": "v"}, ("phi", "v"), ("i_s",), "v")
    assert coil["flux"] == coil["stored"] == ("phi",)
    assert ("saturating-inductor", "sign(phi)*max(abs(phi)-knee,0)") in texts("electrical", coil)
    single = roles_of(None, ("z",), ("u",), "z")
    assert single["flux"] == single["voltage"] == single["current"] == ("z",) and single["stored"] == ()
    # Units tell a voltage from a current.
    by_unit = roles_of(None, ("z",), ("u",), "z", units={"z": "mA", "u": "V"})
    assert by_unit["current"] == ("z",) and by_unit["voltage"] == by_unit["flux"] == ()
    found = {slug for slug, _ in texts("electrical", by_unit)}
    assert "brush-drop" in found and "diode" not in found


def test_temperatures():
    units = {"T": "degC", "outside": "degC", "heater": "kW"}
    house = roles_of({"T": "heater - T"}, ("T",), ("outside", "heater"), "T", units=units)
    found = texts("thermal", house, units)
    # A power is no temperature, and the fourth power of one in °C is no radiation.
    assert {text for slug, text in found if slug == "heat-loss"} == {"outside-T"}
    assert "radiation" not in {slug for slug, _ in found} and ("second-mass", "z_second_mass_T-T") in found
    kelvin = {**units, "T": "K", "outside": "K"}
    furnace = roles_of({"T": "heater - T"}, ("T",), ("outside", "heater"), "T", units=kelvin)
    assert ("radiation", "outside**4-T**4") in texts("thermal", furnace, kelvin)
    # In the equation of a speed there are none.
    speed = texts("thermal", roles_of(None, ("v",), ("F",), "v", units={"v": "m/s", "F": "N"}), {"v": "m/s"})
    assert not {slug for slug, _ in speed} & {"heat-loss", "linear-cooling", "natural-convection", "second-mass"}


def of_output(simulation=None, states=("x", "v"), inputs=("u",), **given):
    return roles_of(simulation, states, inputs, "R", outputs=("R",), **given)


def test_a_temperature_is_no_speed_no_level_and_no_population():
    known = {"T": "degC", "heater": "W", "outside": "K", "t": "s"}
    roles = roles_of({"T": "heater - T"}, ("T",), ("heater", "outside"), "T", units=known)
    thermal = {"temperature", "surroundings", "absolute_surroundings"}
    assert {role for role, columns in roles.items() if columns} == {"state", "input"} | thermal
    assert roles["state"] == ("T",) and roles["input"] == ("heater", "outside")
    # Whoever says so may have it.
    assert roles_of(None, ("T",), (), "T", {"velocity": "T"}, known)["velocity"] == ("T",)
    assert roles_of(None, ("T",), (), "T", units={"T": "m/s"})["velocity"] == ("T",)


def test_an_output_has_columns_by_their_units():
    roles = of_output(inputs=("w", "u"), units={"x": "mm", "v": "m/s", "w": "deg/s", "u": "V", "R": "N"})
    assert (roles["position"], roles["velocity"], roles["voltage"]) == (("x",), ("v", "w"), ("u",))
    # One column in two roles would be one effect under two names; and no state's equation is learned.
    assert roles["input"] == roles["state"] == roles["level"] == ()
    found = dict(texts("mechanical", roles))
    assert found["quadratic-drag"] in ("v*abs(v)", "w*abs(w)") and "cubic-input" not in found
    # A share is no angle, and a frequency no speed.
    assert of_output(units={"x": "1", "v": "Hz"})["position"] == ()


def test_an_output_has_columns_by_the_simulation_or_by_what_is_said():
    assert of_output()["position"] == of_output()["velocity"] == ()
    paired = of_output({"x": "v", "R": "3*x"})
    assert (paired["position"], paired["velocity"], paired["input"]) == (("x",), ("v",), ("u",))
    assert of_output({"x": "v"}, units={"x": "C", "v": "A"})["position"] == ()
    given = of_output(given={"level": "u", "position": "x"})
    assert (given["level"], given["position"], given["input"]) == (("u",), ("x",), ())
    assert of_output(given={"level": "u", "input": "u"})["input"] == ("u",)
    with pytest.raises(InputError, match="unknown column 'R'"):
        of_output(given={"level": "R"})


def test_of_an_output_no_sign_is_usual():
    drag = next(effect for effect in load_catalogue("mechanical") if effect.slug == "quadratic-drag")
    free = drag.either_way()
    assert drag.sign == -1 and (free.sign, free.reverse, free.expression) == (0, "", drag.expression)


def test_given_roles_win():
    roles = roles_of(
        OSCILLATOR, ("y", "ydot", "T"), ("F", "G"), "ydot", given={"input": "G", "heat": ["T"], "velocity": ()}
    )
    assert (roles["input"], roles["heat"], roles["velocity"], roles["position"]) == (("G",), ("T",), (), ("y",))
    for given, words in (({"input": "H"}, "unknown column 'H'"), ({"my role": "F"}, "'my role'")):
        with pytest.raises(InputError, match=words):
            roles_of(OSCILLATOR, ("y", "ydot"), ("F",), "ydot", given=given)
    with pytest.raises(InputError, match="did you mean 'ydot'"):
        roles_of(OSCILLATOR, ("y", "ydot"), ("F",), "ydott")


def test_every_way_to_bind_is_kept_once():
    effect = Effect("mix", "Mix", "own", "position*velocity")
    roles = {"position": ("a", "b", "c"), "velocity": ("a", "b")}
    # b*a is a*b again.
    assert [bound.text() for bound in bind_catalogue([effect], roles)] == ["a*b", "c*a", "c*b"]


def test_units_leave_out_effects_that_cannot_be_and_say_why():
    mechanical = load_catalogue("mechanical")
    roles = roles_of(OSCILLATOR, ("y", "ydot"), (), "ydot")
    metres = {"t": "s", "y": "m", "ydot": "m/s"}
    bound = bind_catalogue(mechanical, roles, metres)
    reasons = unbound(mechanical, roles, metres)
    assert {b.slug for b in bound}.isdisjoint(reasons) and len(bound) + len(reasons) == len(mechanical)
    assert "inside sin" in reasons["pendulum-restoring"] and "'input'" in reasons["input-gain"]
    assert "pendulum-restoring" not in unbound(mechanical, roles, {"t": "s", "y": "rad", "ydot": "rad/s"})
    assert "pendulum-restoring" not in unbound(mechanical, roles)
    assert "columns of their own" in unbound(mechanical, {**roles, "velocity": ("y",)})["position-velocity-coupling"]


@pytest.mark.parametrize(
    ("slug", "equation", "unit"),
    [
        ("cubic-stiffness", "ydot", "1/m²/s²"),
        ("dead-zone", "ydot", "1/s²"),
        ("coulomb-friction", "ydot", "m/s²"),
        ("smooth-friction", "ydot", "m/s²"),
        ("direction-dependent-friction", "ydot", "1/s"),
        ("backlash", "ydot", "1/kg"),
        ("stribeck-friction", "ydot", "m/s²"),
        ("overflow", "h", "1/s"),
        ("torricelli-outflow", "h", "cm⁰⋅⁵/s"),
        ("holling-ii", "n", "1/d"),
        ("holling-iii", "n", "1/d"),
        ("allee", "n", "kg/d"),
        ("diode", "v", "V/s"),
        ("saturating-inductor", "p", "1/s"),
    ],
)
def test_coefficients_get_the_unit_that_the_physics_has(slug, equation, unit):
    names = {
        "position": "y", "velocity": "ydot", "level": "h", "population": "n", "other": "m", "voltage": "v", "flux": "p",
        "input": "F",
    }  # fmt: skip
    units = {"t": "s", "y": "m", "ydot": "m/s", "h": "cm", "n": "kg", "m": "kg", "v": "V", "p": "Wb", "F": "N"}
    units["t"] = "d" if equation == "n" else "s"
    term = BY_SLUG[slug].bind(names).term(middle(BY_SLUG[slug], 2.0))
    found = coefficient_unit(derivative_unit(equation, units), term, units)
    assert found == unit


# ---------------------------------------------------------------- users' own files

OWN = """
[[effect]]
slug = "radiation"
name = "Radiation"
expression = "temperature**4 - ambient**4"
meaning = "Heat leaves with the fourth power of the temperature."

[[effect]]
slug = "late-drag"
name = "Late drag"
expression = "max(velocity-onset,0)"
meaning = "Drag sets in beyond a speed."
latex = '\\max(v-v_0, 0)'
confusions = ["quadratic-drag", "radiation"]
sign = -1
reverse = "pushes along beyond the speed"

[effect.inner.onset]
meaning = "speed at which it sets in"
of = "velocity"
low = 0.2
high = 1
"""


def test_a_users_own_file(tmp_path):
    path = write(tmp_path, OWN)
    radiation, drag = load_catalogue(path)
    assert (radiation.domain, radiation.roles, radiation.latex) == (
        *("mine", ("ambient", "temperature")),
        r"- \mathrm{ambient}^{4} + \mathrm{temperature}^{4}",
    )
    assert drag.inner == (InnerParameter("onset", "speed at which it sets in", "velocity", 0.2, 1.0, "velocity"),)
    assert (radiation.sign, radiation.reverse) == (0, "")
    assert (drag.sign, drag.reverse) == (-1, "pushes along beyond the speed")
    both = load_catalogue(["mechanical", str(path)])
    assert both[-2:] == (radiation, drag) and both[:-2] == load_catalogue("mechanical")
    roles = roles_of(None, ("T", "v"), ("T_0",), "T", given={"temperature": "T", "ambient": "T_0"})
    assert bind_catalogue([radiation], roles)[0].term().name == "T**4-T_0**4"
    named = load_catalogue(write(tmp_path, 'domain = "thermal"\n' + OWN))
    assert {effect.domain for effect in named} == {"thermal"}


def test_a_role_that_nobody_knows_is_refused_when_it_is_bound(tmp_path):
    roles = roles_of(OSCILLATOR, ("y", "ydot"), ("F",), "ydot")
    path = write(tmp_path, OWN.replace("max(velocity-", "max(velocty-").replace('of = "velocity"', 'of = "velocty"'))
    with pytest.raises(InputError, match="unknown role 'velocty'; did you mean 'velocity'"):
        bind_catalogue(load_catalogue(path)[1:], roles)
    with pytest.raises(InputError, match=r"unknown role 'ambient'.*roles=\{'ambient': 'column'\}"):
        bind_catalogue(load_catalogue(path), roles)
    assert "'ambient'" in unbound(load_catalogue(path)[:1], {"ambient": (), "temperature": ("T",)})["radiation"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('slug = "late', 'slog = "late', "effect number 2: unknown key 'slog'; did you mean 'slug'"),
        ("[[effect]]", "[[effects]]", "unknown key 'effects'; did you mean 'effect'"),
        ("low = 0.2", "lo = 0.2", "'late-drag': nonlinear parameter 'onset': unknown key 'lo'; did you mean 'low'"),
        ('name = "Radiation"\n', "", "'radiation': needs the key 'name'"),
        ("low = 0.2\n", "", "'onset': needs the key 'low'"),
        ("low = 0.2", 'low = "0.2"', "low = '0.2' cannot be used; it must be a number"),
        ("low = 0.2", "low = true", "must be a number"),
        ("low = 0.2", "low = 1.0", "low = 1 and high = 1"),
        ("low = 0.2", "low = 0.0", "low = 0 and"),
        ("high = 1", "high = inf", "high = inf"),
        ('name = "Radiation"', "name = 3", "name = 3 cannot be used; it must be text in quotes"),
        ('name = "Radiation"', 'name = " "', "name is empty"),
        ('"radiation"]', "4]", "must be a list of slugs"),
        ("sign = -1", "sign = 2", "effect 'late-drag': .*sign = 2; it is -1 or 1, or 0"),
        ("sign = -1", "sign = -1.0", "sign = -1.0 cannot be used; it must be a whole number"),
        ("sign = -1", "sign = true", "sign = True cannot be used; it must be a whole number"),
        ("sign = -1", 'sign = "-1"', "must be a whole number"),
        ("sign = -1", "sign = 0", "effect 'late-drag': .*not which sign is the usual one"),
        ("sign = -1\n", "", "not which sign is the usual one"),
        ('reverse = "pushes along beyond the speed"', 'reverse = ""', "reverse is empty"),
        ('"radiation"]', '"radation"]', "unknown 'radation'.*did you mean 'radiation'"),
        ("temperature**4", "temperature^4", r"effect 'radiation': .*'\*\*'"),
        ("temperature**4", "import(4)", "effect 'radiation': "),
        ("temperature**4 - ambient**4", "0*ambient", "zero everywhere"),
        ('slug = "radiation"', 'slug = "late-drag"', "slug 'late-drag' occurs 2 times"),
        ('slug = "radiation"', 'slug = "Hot Body"', "'Hot Body' must be small letters"),
        ('slug = "radiation"', 'slug = "unknown"', "The slug 'unknown' is reserved for a study's answer"),
        ("velocity-onset", "velocity", "'onset' does not occur"),
        ('of = "velocity"', 'of = "speed"', "refers to 'speed', which is not a role.*its roles: velocity"),
        ('of = "velocity"', 'of = "velocity"\nunit_of = "m"', "refers to 'm'"),
        ("inner.onset", "inner.sin", "'sin' is taken"),
        ("[effect.inner.onset]", "[effect.inner]", "start it with a line such as"),
        (
            "[effect.inner.onset]",
            '[effect.inner.pace]\nmeaning = "x"\nof = "velocity"\nlow = 0.1\nhigh = 1\n[effect.inner.onset]',
            r"'pace' does not occur",
        ),
        (
            "[effect.inner.onset]",
            '[effect.hidden.z]\nrat = "velocity"\n[effect.inner.onset]',
            "hidden state 'z': unknown key 'rat'",
        ),
        (
            "[effect.inner.onset]",
            "[effect.hidden]\nz = 3\n[effect.inner.onset]",
            "start it with a line such as .effect.hidden.z.",
        ),
        (
            "[effect.inner.onset]",
            '[effect.hidden.z]\nmeaning = "x"\nrate = "velocity"\nunit_of = "velocity"\n[effect.inner.onset]',
            "hidden state 'z' occurs neither in",
        ),
        ("low = 0.2", 'scale = "perod"\nlow = 0.2', "did you mean 'period'"),
        (OWN, "", "no effects"),
        (OWN, "effect = []", "no effects"),
        (OWN, "effect = [3]", "an effect is a table"),
        (OWN, 'effect = "x"', "must be a list"),
        ('slug = "radiation"', "slug = radiation", "not valid TOML"),
    ],
)
def test_mistakes_in_a_users_file_are_named(tmp_path, old, new, words):
    assert old in OWN
    path = write(tmp_path, OWN.replace(old, new))
    with pytest.raises(InputError, match=words) as raised:
        load_catalogue(path)
    assert "mine.toml" in str(raised.value) or "confusions" in str(raised.value)


def test_a_file_has_the_fields_of_the_classes_as_keys():
    keys = keys_of(Effect, "domain")
    assert set(keys.types) | {"domain"} == {field.name for field in dataclasses.fields(Effect) if field.init}
    assert keys.needed == ("slug", "name", "expression", "meaning")
    assert (keys.types["confusions"], keys.types["inner"], keys.types["latex"]) == (list, dict, str)
    assert keys.types["sign"] is int
    keys = keys_of(InnerParameter, "name")
    assert keys.types == {
        "meaning": str, "of": str, "low": float, "high": float, "unit_of": str, "scale": str, "values": int,
    }  # fmt: skip
    assert keys.needed == ("meaning", "of", "low", "high")
    assert keys_of(HiddenState, "name", "rest").types == {"rate": str, "unit_of": str, "meaning": str, "start": str}
    # Where nothing else is said, the parameter has the unit of what it is a share of.
    assert InnerParameter("onset", "speed", "velocity", 0.1, 1.0).unit_of == "velocity"


def test_wrong_catalogues_are_refused(tmp_path):
    path = write(tmp_path, OWN.replace('slug = "radiation"', 'slug = "overflow"'))
    for spec, words in (
        ("mechnical", "did you mean 'mechanical'"),
        ("mine.toml", "no catalogue file"),
        (tmp_path / "none.toml", "no catalogue file"),
        (tmp_path, "cannot be read"),
        ([], "empty"),
        (["fluid", path], "Two different effects have the slug 'overflow'.*fluid and mine"),
    ):
        with pytest.raises(InputError, match=words):
            load_catalogue(spec)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        load_catalogue(binary)


def test_effects_made_in_python_are_checked():
    onset = InnerParameter("onset", "speed", "velocity", 0.1, 1.0, "velocity")
    names = ("onset", "pace", "third", "fourth", "fifth")
    several = tuple(dataclasses.replace(onset, name=name) for name in names)
    assert Effect("a", "A", "own", "velocity*onset*pace", several[:2]).roles == ("velocity",)
    with pytest.raises(InputError, match="5 nonlinear parameters"):
        Effect("a", "A", "own", f"velocity*{'*'.join(names)}", several)
    plain = dataclasses.replace(onset, unit_of="")
    assert Effect("a", "A", "own", "velocity**onset", (plain,)).roles == ("velocity",)


def swing(noise=0.0, n_run=2):
    """Runs of y = sin t in noisy samples, whose rate ydot was measured, beside an unrelated z."""
    rng = np.random.default_rng(0)
    t = [0.1 * np.arange(60) + 0.3 * run for run in range(n_run)]
    return Trajectories.from_arrays(
        t,
        states={
            "z": [rng.standard_normal(60) for _ in t],
            "y": [np.sin(each) + noise * rng.standard_normal(60) for each in t],
            "ydot": [np.cos(each) for each in t],
        },
        derivatives={"ydot": [-np.sin(each) for each in t]},
    )


@pytest.mark.parametrize(
    ("rate_of_y", "noise", "found"),
    [("velocity", 0.1, {"y": "ydot"}), ("none", 0.0, {"y": "ydot"}), ("none", 0.1, {})],
)
def test_a_position_of_a_simulation_that_is_code_is_found_in_its_values_or_the_samples(rate_of_y, noise, found):
    def simulation(t, x, u):
        return [-x[0], x[2] if rate_of_y == "velocity" else 0 * x[2], -x[1]]

    data = swing(noise)
    pairs = pairs_in_data(Program(simulation=simulation).simulator(data), data)
    assert pairs == found
    roles = roles_of(simulation, data.state_names, (), "ydot", pairs=pairs)
    assert roles["position"] == (("y",) if found else ()) and roles["velocity"] == ("ydot",)


def test_a_position_is_found_in_its_measured_rate():
    data = swing(0.1)
    data = dataclasses.replace(data, derivatives={**data.derivatives, "y": data.states["ydot"].copy()})
    assert pairs_in_data(Program(simulation=lambda t, x, u: 0 * x).simulator(data), data) == {"y": "ydot"}
