"""The table of suspects about the measurement."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tiny_equation import forced, forced_study, soft, studied_motion

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.instrument import (
    CLIPPING,
    IN_MODEL,
    INSTRUMENT_COLUMNS,
    LISTED,
    NOISY,
    _bend,
    _noise_row,
)
from bayes_greybox.discovery.sensor_errors.channels import GAIN_SD, ChannelSuspect
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, VARYING


def table(study, data=None):
    return study.instrument(forced() if data is None else data)


def test_a_measurement_without_errors_has_no_suspect_that_matters():
    found = table(forced_study(True))
    assert tuple(found.columns) == INSTRUMENT_COLUMNS
    assert not (found["status"] == IN_MODEL).any() and (found["probability"] < 0.2).all()


@pytest.mark.parametrize(("channel", "are"), [("d(v)/dt", "is"), ("states", "are"), ("F", "is")])
@pytest.mark.parametrize("missing", [False, True])
def test_a_delay_is_told_in_time_and_in_samples(channel, are, missing):
    row = table(forced_study(missing, channel)).iloc[0]
    assert (row["suspect"], row["channel"], row["status"], row["unit"]) == ("delay", channel, IN_MODEL, "s")
    assert row["mean"] == pytest.approx(0.1 * row["samples"])
    # The interval at 90 % is 1.645 standard deviations wide on either side; four of them.
    wide = 4 / 1.645 * (row["upper_samples"] - row["lower_samples"]) / 2
    assert row["lower_samples"] < row["samples"] < row["upper_samples"] and abs(row["samples"] - 0.5) < wide
    assert f"{are} {row['mean']:.3g} s late ({row['samples']:.2g} samples)" in row["text"]
    assert row["text"].startswith("all states" if channel == "states" else channel)


def test_what_is_early_is_told_as_early():
    row = table(forced_study(False, "d(v)/dt", -1.0)).iloc[0]
    assert row["mean"] < 0 and "0.1 s early (1 samples)" in row["text"]


def test_a_delay_is_as_probable_as_the_hypotheses_that_have_it():
    study = forced_study(False, "states")
    row = table(study).iloc[0]
    assert row["probability"] == pytest.approx(study.probabilities.by_sensor["delay of states"].probability)


@pytest.mark.parametrize(
    ("channel", "factor", "said"),
    [("F", 1.04, "F reads 4.*\u00a0% too large"), ("F", 0.96, "F reads [34].*\u00a0% too small")],
)
def test_a_gain_is_told_in_per_cent(channel, factor, said):
    data = forced(n=100)
    data = replace(data, inputs={"F": factor * data.inputs["F"]})
    study = studied_motion(data, effects=())
    found = table(study, data).set_index(["suspect", "channel"])
    # The simulation's own coefficient of F may as well be off: no other suspect says the same.
    assert study.verdict.code in ("instrument", "recalibrate")
    if ("gain", channel) in found.index:
        assert pd.Series([found.loc[("gain", channel), "text"]]).str.contains(said).all()
    else:
        assert study.regressors.twins[f"gain of {channel}"] == f"recalibration of {channel}"
        # The coefficient that the reading needs, which is 1 over the factor, changes by as much as the gain does.
        assert study.regressors.changes[f"gain of {channel}"] == pytest.approx(GAIN_SD / factor, rel=0.01)


def test_an_offset_has_the_unit_of_its_channel():
    data = forced(n=100)
    data = replace(data, derivatives={"v": data.derivatives["v"] + 0.06})
    row = table(studied_motion(data, effects=()), data).set_index(["suspect", "channel"]).loc[("offset", "d(v)/dt")]
    assert row["unit"] == "m/s²" and row["probability"] > 0.5
    assert row["mean"] == pytest.approx(0.06, abs=0.015)
    assert row["text"] == f"d(v)/dt has an offset of {row['mean']:.3g} m/s²"


def test_suspects_come_by_probability_and_those_that_are_next_to_impossible_not_at_all():
    found = table(studied_motion(forced(n=20)))
    assert found["probability"].is_monotonic_decreasing and (found["probability"] >= LISTED).all()


def test_noisy_and_clipped_samples_are_told():
    data = forced(soft, n=300, jump=(0.0, 0.03))
    top = np.quantile(data.derivatives["v"], 0.93)
    data = replace(data, derivatives={"v": np.minimum(data.derivatives["v"], top)})
    found = table(studied_motion(data), data).set_index(["suspect", "channel"])
    noisy, clipped = found.loc[(NOISY, "v")], found.loc[(CLIPPING, "d(v)/dt")]
    assert noisy["unit"] == "m/s" and noisy["text"].startswith("samples of v have noise of 0.0")
    count = int(np.sum(data.derivatives["v"] == top))
    assert clipped["text"] == f"d(v)/dt is clipped at {count} samples, which are left out"


@pytest.mark.parametrize(
    ("name", "about", "said"),
    [
        (
            CORRELATED,
            {"correlation": 0.9, "time_scale": 1.2},
            "correlated over 1.2 s (0.90 from one sample to the next)",
        ),
        (VARYING, {"variable": "y", "exponent": 1.0}, "grows with |y|"),
        (VARYING, {"variable": "y", "exponent": -0.5}, "shrinks with |y|"),
        (HEAVY, {"degrees": 2.0, "scale": 0.1}, "has outliers (Student t, 2 degrees of freedom)"),
    ],
)
@pytest.mark.parametrize("inside", [False, True])
def test_noise_is_told_in_words(name, about, said, inside):
    row = _noise_row("v", name, 0.9, about, inside, forced(n=20))
    assert said in row["text"] and row["channel"] == "d(v)/dt"
    assert (row["status"] == IN_MODEL) == inside


def test_of_rows_of_samples_the_noise_is_of_the_sensors():
    data = forced(n=20)
    samples = replace(data, states={"y": data.states["y"]}, derivatives={})
    # So it is where the rates of the path through them stand beside them.
    for given in (samples, replace(data, samples=samples)):
        row = _noise_row("v", CORRELATED, 0.9, {"correlation": 0.5, "time_scale": 0.2}, True, given)
        assert row["channel"] == "y" and row["text"].startswith("the noise of y is correlated over 0.2")


@pytest.mark.parametrize(
    ("x", "kind", "mean", "said"),
    [
        ([-1.0, 0.2, 1.0], "cubic error", -0.05, "y reads 0.05 m too small at 1 m: its sensor bends"),
        ([-10.0, -3.0, 0.1], "quadratic error", 0.01, "y reads 1 m too large at -10 m: its sensor bends"),
    ],
)
def test_a_bend_is_told_where_it_is_most(x, kind, mean, said):
    samples = Trajectories.from_arrays(np.arange(3.0), states={"y": np.array(x)})
    row = _bend(ChannelSuspect(kind, "y", 1.0), mean, samples, "m")
    assert row["text"] == said and row["unit"] == ("1/m²" if kind == "cubic error" else "1/m")
