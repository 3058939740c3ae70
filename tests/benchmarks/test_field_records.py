"""Records of batteries, houses, drugs and vehicles: their data, what counts as right, and the run over them."""

import json
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.discovery.answer.instrument import CLIPPING, MISREAD, NOISY
from bayes_greybox.discovery.decision.decide import VERDICTS
from bayes_greybox.discovery.sensor_errors.channels import ERRORS
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, VARYING
from bayes_greybox.physics.catalogue.loading import catalogue
from bayes_greybox.running.errors import InputError
from benchmarks.field_records import run
from benchmarks.field_records.cells import relaxation
from benchmarks.field_records.record import FieldRecord, Measured
from benchmarks.field_records.records import RECORDS
from benchmarks.field_records.signals import held, levels, path, rounded, wandering
from benchmarks.judged import judged, show
from benchmarks.runner import Asked, perform

# Clipping and misreadings are removed before hypotheses are weighed.
KNOWN_ERRORS = {*ERRORS, CLIPPING, MISREAD}


def weighed(**effects: float) -> pd.DataFrame:
    return pd.DataFrame([(slug.replace("_", "-"), p) for slug, p in effects.items()], columns=["slug", "probability"])


def suspected(*suspects: tuple[str, str, float]) -> pd.DataFrame:
    return pd.DataFrame(suspects, columns=["suspect", "channel", "probability"])


def answered(verdict: str, effects: pd.DataFrame, instrument: pd.DataFrame) -> SimpleNamespace:
    return SimpleNamespace(verdict=verdict, effects=effects, instrument=instrument)


def runs(column) -> list[np.ndarray]:
    return list(column) if isinstance(column, list) else [column]


def test_there_are_49_records_of_four_fields_and_no_two_share_their_draws():
    counts = Counter(record.kind for record in RECORDS.values())
    assert counts == {"battery": 13, "thermal": 12, "compartment": 12, "vehicle": 12} and len(RECORDS) == 49
    assert len({record.seed for record in RECORDS.values()}) == 49
    assert len({record.truth for record in RECORDS.values()}) == 49


@pytest.mark.parametrize("record", RECORDS.values(), ids=lambda record: record.name)
def test_right_answers_are_answers_that_a_study_can_give(record):
    slugs = set(catalogue(record.kind)["slug"])
    assert record.right <= slugs and record.harmless <= slugs and not set(record.right) & set(record.harmless)
    assert record.verdicts and record.verdicts <= set(VERDICTS)
    assert {error.partition(" of ")[0] for error in record.errors} <= KNOWN_ERRORS
    # An answer that names something needs a name that is right, or tied with what is.
    assert not record.verdicts & {"named", "partly named"} or record.right
    if record.truth.startswith("Nothing"):
        assert not record.right and "named" not in record.verdicts


@pytest.mark.parametrize("record", RECORDS.values(), ids=lambda record: record.name)
def test_data_are_finite_and_of_the_simulation(record):
    made = record.measured()
    measured = {**made.states, **made.outputs}
    assert measured and set(made.simulation) == {*measured, *made.starts}
    assert set(made.units) == {"t", *measured, *made.inputs}
    for name, column in {**measured, **made.inputs}.items():
        for t, x in zip(runs(made.time), runs(column), strict=True):
            assert np.isfinite(x).all() and len(x) == len(t) and np.all(np.diff(t) > 0), name
    assert {error.partition(" of ")[2] for error in record.errors} <= {*measured, *made.inputs}


def test_a_record_is_the_same_at_every_call():
    for name in ("noisy_current", "repeated_infusions"):
        made, again = RECORDS[name].measured(), RECORDS[name].measured()
        for column, same in ((made.inputs, again.inputs), (made.states or made.outputs, again.states or again.outputs)):
            for key, x in column.items():
                np.testing.assert_array_equal(x, same[key])


def test_makers_give_what_the_truth_says():
    late, quiet = (RECORDS[name].measured() for name in ("late_voltage", "quiet_cell"))
    i, v = np.asarray(late.inputs["i"]), np.asarray(late.outputs["V"])
    jumps = np.flatnonzero(np.abs(np.diff(i[:-1])) > 0.5)
    # The voltage answers a jump of the current one sample after it.
    assert np.mean(np.abs(np.diff(v)[jumps + 1])) > 10 * np.mean(np.abs(np.diff(v)[jumps]))
    assert set(np.diff(np.asarray(quiet.time))) == {2.0}
    coarse = np.asarray(RECORDS["coarse_thermostat"].measured().states["T"])
    np.testing.assert_allclose(coarse * 2, np.round(coarse * 2))
    zeros = np.asarray(RECORDS["below_the_limit"].measured().states["c"])
    assert np.sum(zeros == 0) > 3 and zeros[zeros > 0].min() >= 0.3
    hills, drag = (RECORDS[name].measured() for name in ("unmeasured_hills", "drag_under_cruise_control"))
    assert "slope" not in hills.inputs and "slope" in drag.inputs
    assert "cd" in hills.simulation["v"] and "cd" not in drag.simulation["v"]


def test_signals_are_those_of_their_equations():
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 3.0, 7)
    u = held(t, np.arange(7.0))
    assert [u(-1.0), u(0.0), u(0.49), u(0.5), u(9.0)] == [0.0, 0.0, 0.0, 1.0, 6.0]
    x = path(lambda time, x: [-2 * x[0] + (time >= 1.25)], [1.0], t, [1.25])[:, 0]
    forced = np.where(t > 1.25, 0.5 * (1 - np.exp(-2 * (t - 1.25))), 0.0)
    np.testing.assert_allclose(x, np.exp(-2 * t) + forced, atol=1e-7)
    # 40,000 samples of a correlation of 10 hold 2,000 independent ones: 1.6 % of an SD, at four standard errors.
    assert np.std(wandering(rng, 40_000, 1.0, 10.0, 2.0)) == pytest.approx(2.0, rel=0.065)
    kept = levels(rng, 500, [0.0, 1.0], 5, 9)
    assert len(kept) == 500 and np.diff(np.flatnonzero(np.diff(kept))).min() >= 5
    assert rounded(0.26, 0.1) == pytest.approx(0.3)
    step, time = np.where(np.arange(50) < 10, 0.0, 2.0), np.arange(50) * 3.0
    drop = relaxation(0.5, 20.0)(time, step, time)
    np.testing.assert_allclose(drop, -1.0 * (1 - np.exp(-np.clip(time - 30.0, 0, None) / 20.0)), atol=1e-12)


def test_names_and_errors_are_judged():
    record = FieldRecord(
        "x", "thermal", 0, "", lambda rng: Measured([], {}, {}, {}, {}), {"one of"}, {"heat-loss"}, {"radiation"},
        {"delay of T"},
    )  # fmt: skip
    effects = weighed(heat_loss=0.99, radiation=0.95, second_mass=0.91, constant_heat=0.6, input_gain=0.4)
    instrument = suspected(
        ("delay", "T", 0.99), ("offset", "T", 0.95), ("delay", "heater", 0.92), ("gain", "T", 0.89),
        (CORRELATED, "T", 1.0), (VARYING, "T", 1.0), (HEAVY, "T", 1.0), (NOISY, "T", 1.0),
    )  # fmt: skip
    assert judged(record, answered("one of", effects, instrument)) == {
        "verdict": "one of",
        "acceptable": True,
        "names above 0.5": "heat-loss:0.990 radiation:0.950 second-mass:0.910 constant-heat:0.600",
        "wrong above 0.5": "second-mass constant-heat",
        "wrong above 0.9": "second-mass",
        "wrong errors above 0.9": "offset of T, delay of heater",
    }
    silent = judged(record, answered("no gap", weighed(), suspected()))
    assert not silent.pop("acceptable") and set(silent.values()) == {"no gap", ""}


def test_a_study_is_given_what_the_owner_says(monkeypatch):
    calls = []

    def find(model, train, **settings):
        calls.append((model, train, settings))
        return answered("recalibrate", weighed(input_gain=0.6), suspected())

    monkeypatch.setattr("bayes_greybox.missing_effects.find_missing_effects", find)
    assert run.judged("quiet_cell")["acceptable"] is False
    row = run.judged("different_people")
    (cell, train, settings), (drug, people, of_people) = calls
    assert cell.rows.interpolation == "zoh" and settings["catalogue"] == "battery" and not settings["settle"]
    assert len(train.time) == 490 and len(settings["test"].time) == 210 and "free_runs" not in settings
    assert drug.rows.interpolation != "zoh" and of_people["test"] is None and len(people.time) == 5 * 14
    assert row["acceptable"] is True and row["wrong above 0.5"] == "input-gain" and row["wrong above 0.9"] == ""


def test_the_run_counts_fields_and_a_refusal_is_not_acceptable(tmp_path, monkeypatch):
    def study_of(record):
        if record.kind == "vehicle":
            raise InputError("No path.")
        return answered("no gap", weighed(second_mass=0.95), suspected(("gain", "T", 0.95)))

    monkeypatch.setattr(run, "study_of", study_of)
    asked = Asked(tmp_path, only=["quiet_house", "heavy_car"], progress=False)
    tables = perform(run.FIELD_RECORDS, run.cases(asked), asked)
    assert tables["counts"].to_dict("index") == {
        "thermal": {"records": 1, "acceptable": 1, "wrong above 0.9": 1, "wrong errors above 0.9": 1},
        "vehicle": {"records": 1, "acceptable": 0, "wrong above 0.9": 0, "wrong errors above 0.9": 0},
        "all": {"records": 2, "acceptable": 1, "wrong above 0.9": 1, "wrong errors above 0.9": 1},
    }
    assert tables["records"].loc["heavy_car", "verdict"] == "refused: No path."
    assert json.loads((tmp_path / "summary.json").read_text())["cases"] == 2
    assert list(show(tables)["Verdicts"].index) == ["thermal", "vehicle", "all"]
    with pytest.raises(InputError, match="There is no record 'mouse'"):
        run.cases(Asked(tmp_path, only=["mouse"]))
