"""Rules of a whole study: which equations, whose verdict, what is in the extended model, what is refused."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, tiny_data, tiny_model, tiny_regressors

import bayes_greybox.discovery.study as module
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.discovery.answer.equation_study import EquationStudy
from bayes_greybox.discovery.answer.free_runs import FreePath
from bayes_greybox.discovery.answer.where import GapMap, GapTrace
from bayes_greybox.discovery.decision.criteria import FEWEST_ROWS, Criteria
from bayes_greybox.discovery.decision.decide import VERDICTS, Place, Verdict
from bayes_greybox.discovery.decision.probabilities import Share
from bayes_greybox.discovery.decision.reasons import Reason
from bayes_greybox.discovery.decision.vetoes import MISFIT, worse_in_words
from bayes_greybox.discovery.decision.vetoes import verdict_of as with_reasons
from bayes_greybox.discovery.equation import Question, study_equation
from bayes_greybox.discovery.extended import extended_program
from bayes_greybox.discovery.grid.points import LATENT_FORCE, NO_DISCREPANCY, SENSOR_NOISE, NoisePoint
from bayes_greybox.discovery.linearise.near import Point, Shape
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.study import StudySettings, investigate
from bayes_greybox.discovery.subject import check_data, studied_equations
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.noise.noise_model import HEAVY, VARYING
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError


def two_states(n=24, rates=("x", "z"), states=("x", "z"), lengths=None, seed=0, units=None):
    """Noise in every column, in runs of these lengths."""
    rng = np.random.default_rng(seed)
    lengths = lengths or [n]
    columns = {name: [rng.uniform(-1, 1, k) for k in lengths] for name in ("x", "z", "dx", "dz")}
    return Trajectories.from_arrays(
        [np.arange(float(k)) for k in lengths],
        states={name: columns[name] for name in states},
        derivatives={name: columns[f"d{name}"] for name in rates},
        units=units,
    )


BOTH = Program(simulation={"x": "-x + z", "z": "-z*x"})


# Which equations


@pytest.mark.parametrize(
    ("hidden", "verdict"),
    [(np.zeros_like, "no gap"), (lambda x: -0.3 * x, "recalibrate"), (lambda x: 0.8 * x**2, "unknown")],
)
def test_without_a_catalogue_all_but_effects_is_weighed(hidden, verdict):
    settings = StudySettings(catalogue=[], settle=False, free_runs=False)
    found = investigate(tiny_model(), tiny_data(hidden), settings=settings, progress=False)
    assert found.verdict == verdict and not len(found.effects) and found.settings["catalogue"] == "none"
    assert set(found.hypotheses.droplevel(0).index) <= {"no gap", "recalibrate", "instrument", "unknown"}
    # The probability of a rest is that of the unknown, where nothing has a name.
    (rest,) = found.settings["rest beside the answer"].values()
    assert rest == pytest.approx(found.hypotheses.loc[("x", "unknown"), "probability"])


def test_the_equations_of_the_dictionary_are_studied_and_no_others():
    assert studied_equations(Program({"z": ["x"]}, simulation=BOTH.simulation), two_states()) == ("z",)


def test_without_a_dictionary_every_equation_with_a_measured_rate_is_studied():
    assert studied_equations(BOTH, two_states()) == ("x", "z")
    assert studied_equations(BOTH, two_states(rates=("z",))) == ("z",)


def test_an_equation_that_only_names_another_state_is_not_studied():
    assert studied_equations(Program(simulation={"x": "z", "z": "-x"}), two_states()) == ("z",)


def test_an_equation_that_the_simulation_meets_exactly_is_not_studied():
    plain = two_states()
    x, z = plain.states["x"], plain.states["z"]
    rates = {"x": -x + z, "z": plain.derivatives["z"]}
    data = Trajectories.from_arrays(plain.time, states=dict(plain.states), derivatives=rates)
    assert studied_equations(BOTH, data) == ("z",)


def test_data_that_the_simulation_meets_exactly_leave_nothing_to_study():
    plain = two_states()
    x, z = plain.states["x"], plain.states["z"]
    data = Trajectories.from_arrays(plain.time, states=dict(plain.states), derivatives={"x": -x + z, "z": -z * x})
    with pytest.raises(InputError, match="equals every measured derivative exactly"):
        studied_equations(BOTH, data)


def test_data_whose_only_rate_is_kinematic_are_refused_with_the_remedy():
    with pytest.raises(InputError, match=r"no equation to study.*data\.differentiate"):
        studied_equations(Program(simulation={"x": "z"}), two_states(rates=("x",)))


# Whose verdict


def finding(code, n_place=0, against=()):
    """A verdict with so many effects, and what speaks against it."""
    reasons = tuple(Reason("check", text) for text in against)
    places = (Place("cube(r=x)", "cube", Share(0.9, 0.9), ()),) * n_place
    return Verdict(code, places, None, (), 0.0, 0.0, reasons=reasons, probabilities=None)


def verdict_of(*given):
    """The verdict of a study, and the texts of the reasons against it."""
    verdict, reasons = with_reasons(*given)
    return verdict, tuple(reason.text for reason in reasons)


def blank(kind, equation):
    """An instance of a dataclass with nothing in it but the name of its equation."""
    made = object.__new__(kind)
    # A default that is a function would be a method of what has no attribute of its own.
    made.__dict__.update(equation=equation, corrected=lambda data: data)
    return made


class Told(EquationStudy):
    """What was found out about one equation, in as few words as tables need."""

    def __init__(self, name, verdict):
        known = SimpleNamespace(
            left_out={"odd": f"odd in {name}"}, columns=[], twins={}, of_kind=lambda kind: [],
            rows=SimpleNamespace(columns={}), equation=name,
        )  # fmt: skip
        points = (NoisePoint(NO_DISCREPANCY),)
        parts = {"amendment": Amendment, "map": GapMap, "trace": GapTrace}
        self.__dict__ |= {"name": name, **{part: blank(kind, name) for part, kind in parts.items()}}
        self.amendment.__dict__["parameters"] = {}
        self.__dict__ |= {
            "verdict": replace(finding(verdict, 0, (f"{name} is odd",)), hypothesis=SimpleNamespace(point=0)),
            "where": self.frame(),
            "near": SimpleNamespace(
                regressors=known, weighed=SimpleNamespace(grid=SimpleNamespace(points=points)),
                rows=SimpleNamespace(point=Point()),
            ),
            "coefficients": SimpleNamespace(indices=()),
            "source": SimpleNamespace(n_sensor=1, with_inputs=lambda program: program),
        }  # fmt: skip

    counted = 24

    def frame(self, *_):
        return pd.DataFrame({"equation": [self.name]})

    effects = hypotheses = memory = quantities = instrument = check_table = corrections = ladder = frame

    def ties(self, data):
        return [{"equation": self.name}]


@pytest.fixture
def told(monkeypatch):
    """A study whose equations have the verdicts that are given, and the calls that it made."""
    calls = SimpleNamespace(studied=[], gaps=[])

    def study(*verdicts, **settings):
        given = dict(zip(("x", "z"), verdicts, strict=True))

        def study_equation(question, say):
            calls.studied.append(question)
            return Told(question.name, given[question.name])

        def gap_rows(model, amendments, data, part, *rest):
            calls.gaps.append(part)
            index = pd.MultiIndex.from_tuples([(part, "derivative NMSE", "x")], names=["data", "metric", "variable"])
            return pd.DataFrame({"part": [part]}, index=index), {"x": blank(FreePath, part)}

        monkeypatch.setattr(module, "explained", lambda found: ())
        monkeypatch.setattr(module, "study_equation", study_equation)
        monkeypatch.setattr(module, "gap_rows", gap_rows)
        test = settings.pop("test", None)
        return investigate(BOTH, two_states(), test, StudySettings(catalogue="population", **settings), progress=False)

    study.calls = calls
    return study


@pytest.mark.parametrize("later", range(1, len(VERDICTS)))
@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_equations_the_graver_verdict_speaks_for_the_study(told, later, swapped):
    pair = (VERDICTS[later], VERDICTS[later - 1])
    assert told(*(pair[::-1] if swapped else pair)).verdict == VERDICTS[later]


def test_what_speaks_against_any_equations_verdict_is_told(told):
    assert told("named", "no gap").against == ("in d(x)/dt: x is odd", "in d(z)/dt: z is odd")


def gap(*rows):
    """Free runs before and after: (data, metric, variable, before, after), whose interval is narrow."""
    index = pd.MultiIndex.from_tuples([row[:3] for row in rows], names=["data", "metric", "variable"])
    values = [(before, after, 0.99 * after, 1.01 * after) for *_, before, after in rows]
    return pd.DataFrame(values, columns=["before", "after", "lower", "upper"], index=index)


WORSE = gap(("test", "free-run NRMSE", "x", 0.1, 0.3), ("test", "derivative NMSE", "x", 0.5, 0.1))
BETTER = gap(("test", "free-run NRMSE", "x", 0.3, 0.1))


def test_held_out_samples_that_are_left_have_a_veto_and_are_told_of_any_answer():
    rows = ("train", MISFIT, "x", 30.0, 1.0), ("test", MISFIT, "x", 30.0, 4.5)
    said = "held-out samples are left 4.5 times as far off as their noise allows"
    assert verdict_of({"x": finding("named", 1)}, gap(*rows)) == ("partly named", (said,))
    assert verdict_of({"x": finding("named", 1)}, gap(rows[0])) == ("named", ())
    assert verdict_of({"x": finding("no gap", 0)}, gap(*rows)) == ("no gap", (said,))


@pytest.mark.parametrize(
    ("verdict", "expected"), [("named", "partly named"), ("one of", "one of"), ("partly named", "partly named")]
)
def test_a_free_run_that_gets_worse_has_a_veto(verdict, expected):
    assert verdict_of({"x": finding(verdict, 1)}, WORSE) == (expected, ("the free run of x gets worse",))
    assert verdict_of({"x": finding(verdict, 1)}, BETTER) == (verdict, ())


def test_what_the_checks_say_comes_before_the_free_run():
    _, against = verdict_of({"x": finding("named", 1, ("residuals hang together",))}, WORSE)
    assert against == ("residuals hang together", "the free run of x gets worse")


@pytest.mark.parametrize("verdict", ["no gap", "instrument", "unknown"])
def test_where_no_effect_is_claimed_the_free_run_vetoes_nothing(verdict):
    assert verdict_of({"x": finding(verdict)}, WORSE) == (verdict, ())


def test_a_recalibration_that_makes_free_runs_worse_is_told():
    assert verdict_of({"x": finding("recalibrate")}, WORSE) == ("recalibrate", ("the free run of x gets worse",))


def test_held_out_free_runs_have_the_say_where_there_are_any():
    mixed = pd.concat([gap(("train", "free-run NRMSE", "x", 0.1, 0.3)), BETTER])
    assert verdict_of({"x": finding("named", 1)}, mixed)[0] == "named"
    assert verdict_of({"x": finding("named", 1)}, mixed.loc[["train"]])[0] == "partly named"


def test_a_run_that_fails_sooner_vetoes_too():
    sooner = gap(("test", "time to failure", "all", 9.0, 3.0))
    assert verdict_of({"x": finding("named", 1)}, sooner) == ("partly named", ("the free run fails sooner",))
    assert worse_in_words(("test", "time to failure", "all")) == "the free run fails sooner"


def test_tables_maps_and_ties_are_those_of_all_equations(told):
    found = told("named", "no gap")
    tables = (
        found.effects, found.hypotheses, found.instrument, found.checks, found.corrections, found.where, found.rounds
    )  # fmt: skip
    for table in tables:
        assert table["equation"].tolist() == ["x", "z"]
    for part in (found.maps, found.traces, found.amendments):
        assert {name: made.equation for name, made in part.items()} == {"x": "x", "z": "z"}
    assert [tie["equation"] for tie in found.ties] == ["x", "z"]


def test_what_was_left_out_is_told_by_equation(told):
    left_out = told("named", "no gap").left_out
    assert left_out[("x", "odd")] == "odd in x" and left_out[("z", "odd")] == "odd in z"


def test_the_gap_is_measured_on_test_data_where_there_are_any(told):
    assert told("named", "no gap").gap["part"].tolist() == ["train"]
    assert told("named", "no gap", test=two_states(seed=1)).gap["part"].tolist() == ["train", "test"]


def test_free_runs_shown_are_those_of_the_test_data_where_there_are_any(told):
    assert told("named", "no gap").paths["x"].equation == "train"
    assert told("named", "no gap", test=two_states(seed=1)).paths["x"].equation == "test"


def test_settings_reach_each_equation_with_odds_of_the_system(told):
    odds = Odds(effects=0.2)
    told("named", "no gap", odds=odds, effects_at_most=2, seed=7)
    for name, asked in zip(("x", "z"), told.calls.studied, strict=True):
        assert (asked.name, asked.odds, asked.most, asked.seed) == (name, odds.of_each(2), 2, 7)


def test_odds_and_thresholds_are_stated_in_the_result(told):
    settings = told("named", "no gap", odds=Odds(effects=0.2)).settings
    assert settings["prior odds"]["effects"] == 0.2
    assert {0.9, 0.5, 0.05, 0.01} <= set(settings["thresholds"].values())
    assert set(asdict(Criteria())) <= set(settings["thresholds"])


def test_nothing_is_sampled(told):
    assert told("named", "no gap").fit is None


# The extended model


def found_of(known, base, kind=NO_DISCREPANCY, shape=None, n_sensor=1):
    """A study of regressors with these effects added, at a noise point."""
    told = Told("x", "named" if base else "no gap")
    near = SimpleNamespace(
        regressors=known,
        weighed=SimpleNamespace(
            grid=SimpleNamespace(points=(NoisePoint(kind, 1.0, 1.0, shape=int(shape is not None)),))
        ),
        rows=SimpleNamespace(point=Point(shapes=() if shape is None else (shape,))),
    )
    own = (*known.of_kind("free"), *known.of_kind("correction"))
    places = finding("named", len(base)).places
    told.__dict__ |= {
        "near": near,
        "verdict": replace(told.verdict, places=places),
        "coefficients": SimpleNamespace(indices=(*own, *base)),
        "amendment": SimpleNamespace(hidden=(), rows=None),
        "source": SimpleNamespace(n_sensor=n_sensor),
    }
    return told


def amended(known, base, model=BOTH, **noise):
    return extended_program(model, {"x": found_of(known, base, **noise)}, tiny_data())


def test_the_extended_model_has_free_terms_corrections_and_effects():
    known = tiny_regressors([CUBE, SQUARE], dictionary={"x": ["sin(3*x)"]})
    _, square = known.of_kind("effect")
    terms = amended(known, (square,), replace(BOTH, dictionary={"x": ["sin(3*x)"]})).dictionary["x"]
    assert [term.name for term in terms] == ["sin(3*x)", "x", "x**2"]


def test_effects_that_were_not_added_are_not_in_the_extended_model():
    known = tiny_regressors([CUBE, SQUARE])
    assert [term.name for term in amended(known, ()).dictionary["x"]] == ["x"]


def test_an_effect_is_added_at_the_value_of_its_inner_parameter():
    known = tiny_regressors([DEAD_ZONE])
    index = known.of_kind("effect")[2]
    assert amended(known, (index,)).dictionary["x"][-1] == known.columns[index].term


def test_where_nothing_is_free_an_offset_is_asked_for():
    known = tiny_regressors(simulation=lambda t, x, u: [-x[0]])
    assert amended(known, ()).dictionary["x"] == [Term("1")]


def test_the_extended_model_is_otherwise_the_model_that_was_given():
    known = tiny_regressors()
    model = Program(simulation=BOTH.simulation, noise_floor=3e-4)
    found = amended(known, (), model)
    assert found.simulation == model.simulation and found.noise_floor == 3e-4 and model.dictionary == {}


def test_a_force_that_a_study_leaves_is_in_the_posterior_on_samples_and_never_on_rates():
    known, samples = tiny_regressors(), replace(BOTH, rows=TrajectoryRows())
    assert amended(known, (), samples, kind=LATENT_FORCE).noise == Noise(force="fit")
    assert amended(known, (), samples, kind=SENSOR_NOISE).noise == Noise(correlation="fit")
    # On rates f takes a force in time.
    assert amended(known, (), BOTH, kind=LATENT_FORCE).noise == BOTH.noise
    # Of several sensors noise of a kind of its own is not found.
    assert amended(known, (), samples, kind=SENSOR_NOISE, n_sensor=2).noise == BOTH.noise


def test_the_shape_of_the_noise_is_found_again_in_the_posterior():
    known = tiny_regressors()
    shape = Shape(f"{VARYING} + {HEAVY}", np.ones(60), -3.0, {VARYING: {}, HEAVY: {}})
    assert amended(known, (), shape=shape).noise == Noise(depends_on="fit", tails="fit")


# What is refused


def check(train, test=None, free_runs=True, equations=("x", "z"), model=BOTH):
    check_data(model, equations, train, test, free_runs)


def test_data_that_can_be_used_are_not_refused():
    check(two_states(lengths=[2, 25]), two_states(seed=1))


def test_test_data_without_a_column_of_the_training_data_are_refused():
    with pytest.raises(InputError, match="test data have no 'z'.*add it"):
        check(two_states(), two_states(rates=("x",), states=("x",)))


def test_test_data_may_have_columns_that_the_training_data_have_not():
    model = Program(simulation={"x": "-x"})
    check(two_states(rates=("x",), states=("x",)), two_states(), equations=("x",), model=model)


def test_test_data_need_no_rates():
    check(two_states(), two_states(rates=()))


@pytest.mark.parametrize("part", ["training", "test"])
def test_a_run_of_one_row_is_refused_by_name_since_it_cannot_run_freely(part):
    short, long = two_states(lengths=[25, 1]), two_states(seed=1)
    with pytest.raises(InputError, match=f"Run '1' of the {part} data has one row.*free_runs=False"):
        check(*((short, long) if part == "training" else (long, short)))


def test_a_run_of_one_row_will_do_without_free_runs():
    check(two_states(lengths=[25, 1]), free_runs=False)


def test_a_run_of_one_row_will_do_where_no_free_run_is_possible():
    check(two_states(lengths=[25, 1]), equations=("x",), model=Program(simulation={"x": "-x"}))


def test_too_few_rows_are_refused_and_few_are_told_to_go_unchecked(told):
    check(two_states(n=FEWEST_ROWS))
    with pytest.raises(InputError, match="training data have 7 rows.*give at least 8"):
        check(two_states(n=FEWEST_ROWS - 1))
    first, second = told("named", "no gap").warnings
    assert "24 rows are too few to check residuals of d(x)/dt: below 40" in first and "of d(z)/dt: below" in second


def test_few_are_the_rows_that_count_and_not_all_that_are_given(told, monkeypatch):
    # A sensor at its end takes rows away, and several sensors have more than there are samples.
    for counted, expected in ((23, "The 23 of 24 rows that count are too few to check residuals"), (40, None)):
        monkeypatch.setattr(Told, "counted", counted)
        said = told("named", "no gap").warnings
        assert len(said) == (2 if expected else 0) and all(text.startswith(expected) for text in said)


def test_rows_at_the_end_of_the_rates_sensor_do_not_count():
    rng = np.random.default_rng(0)
    t = 0.2 * np.arange(60.0)
    rate = np.minimum(np.cos(t) + 0.01 * rng.standard_normal(60), 0.7)
    data = Trajectories.from_arrays(t, states={"x": np.sin(t)}, derivatives={"x": rate})
    model = Program(simulation={"x": "1 - x"})
    found = study_equation(Question(model, data, "x", (), Odds(), 1, 0, Criteria()), lambda _: None)
    assert found.counted == np.sum(rate < 0.7) < 60 and found.source.clipped


def test_test_data_in_another_unit_are_refused():
    metres = two_states(units={"x": "m", "t": "s", "z": "m/s"})
    with pytest.raises(InputError, match="test data have x in mm, the training data in m: convert them"):
        check(metres, two_states(units={"x": "mm", "t": "s"}))
    check(metres, two_states(units={"z": "m*s^-1"}))


def test_a_simulation_that_no_integrator_can_follow_is_refused_before_the_search():
    def plain(t, x, u):
        rates = np.zeros(2)
        rates[0], rates[1] = -x[0] + x[1], -x[0] * x[1]
        return rates

    model = Program(simulation=plain)
    with pytest.raises(InputError, match=r"jax\.numpy, without in-place assignment.*free_runs=False"):
        check(two_states(), model=model)
    check(two_states(), model=model, free_runs=False)
    check(two_states(), model=Program(simulation=lambda t, x, u: [-x[0] + x[1], -x[0] * x[1]]))


@pytest.mark.parametrize(
    "given, sentence",
    [
        ({"effects_at_most": 0}, "effects_at_most=0 must be a whole number, at least 1"),
        ({"effects_at_most": 1.5}, "effects_at_most=1.5 must be a whole number"),
        ({"negligible": 1.0}, "negligible=1.0 must be a share of the modelled rate, from 0 to below 1"),
        ({"odds": {"no_gap": 0.5}}, r"odds is dict: give bg.Odds\(...\)"),
        ({"interpolation": "spline"}, "Unknown interpolation 'spline'; use 'linear', 'zoh' or 'cubic'"),
        ({"interpolation": ["zoh", "spline"]}, "Unknown interpolation 'spline'"),
    ],
)
def test_settings_that_no_data_can_have_are_refused_before_the_search(given, sentence, monkeypatch):
    monkeypatch.setattr(module, "study_equation", lambda *_: pytest.fail("a search"))
    with pytest.raises(InputError, match=sentence):
        investigate(BOTH, two_states(), settings=StudySettings(**given))


def test_noise_that_cannot_be_had_on_the_data_is_refused_before_the_search():
    with pytest.raises(InputError, match="depends_on='w'.* is neither a state nor an input"):
        check(two_states(), model=Program(simulation=BOTH.simulation, noise=Noise(depends_on="w")))
    check(two_states(), model=Program(simulation=BOTH.simulation, noise=Noise(depends_on="x")))


def test_noise_that_was_asked_for_is_said_to_concern_the_posterior_only(told, monkeypatch):
    monkeypatch.setattr("test_study_rules.BOTH", Program(simulation=BOTH.simulation, noise=Noise(tails=4.0)))
    *_, warning = told("named", "no gap", settle=False).warnings
    assert "applies only to the posterior of the extended model, and nothing was sampled" in warning


# Odds


PROBABILITIES = (
    "no_gap",
    "recalibrate",
    "unknown",
    "effects",
    "another",
    "correction",
    "remainder",
    "suspect",
    "noise",
)


@pytest.mark.parametrize("field", PROBABILITIES)
@pytest.mark.parametrize("value", [0.0, 1.0, -0.1, float("nan")])
def test_odds_are_probabilities_that_exclude_nothing(field, value):
    with pytest.raises(InputError, match=f"{field} = .* must be a probability above 0 and below 1"):
        Odds(**{field: value})


@pytest.mark.parametrize(("effects", "fine"), [(0.4, True), (0.3, True), (0.41, False)])
def test_explanations_are_parts_of_one(effects, fine):
    if fine:
        assert Odds(effects=effects).effects == effects
    else:
        with pytest.raises(InputError, match="they are parts of 1"):
            Odds(effects=effects)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_several_equations_have_no_gap_as_often_as_the_system(n):
    system = Odds()
    each = system.of_each(n)
    assert each.no_gap**n == pytest.approx(system.no_gap)
    parts = np.array([[o.recalibrate, o.unknown, o.effects] for o in (system, each)])
    assert parts[1] / parts[1].sum() == pytest.approx(parts[0] / parts[0].sum())
    assert each.no_gap + parts[1].sum() == pytest.approx(1.0)
    assert (each.another, each.correction, each.remainder) == (system.another, system.correction, system.remainder)
