"""Studies of outputs with memory: the voltage of a cell, whose state of charge nobody measures."""

from dataclasses import replace

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.report.words.asked import asked

STEP, N, TIME, RESISTANCE = 1.0, 500, 12.0, 0.03


def cell(resistance):
    """A cell with 0.05 Ω and one relaxation; its current is held from sample to sample."""
    rng, current, slow = np.random.default_rng(3), np.zeros(N), np.zeros(N)
    for k in range(0, N, 40):
        current[k : k + int(rng.integers(8, 36))] = rng.uniform(-2, 3)
    for k in range(1, N):
        left = np.exp(-STEP / TIME)
        slow[k] = left * slow[k - 1] + (1 - left) * current[k - 1]
    charge = 0.8 - np.append(0.0, np.cumsum(current[:-1])) * STEP / 9000
    volts = 3.2 + 0.9 * charge - 0.05 * current - resistance * slow + 1e-3 * rng.standard_normal(N)
    units = {"t": "s", "i": "A", "V": "V"}
    return bg.Trajectories.from_arrays(STEP * np.arange(N), inputs={"i": current}, outputs={"V": volts}, units=units)


def studied(data, **options):
    model = bg.GreyBox(
        simulation={"soc": "-i/9000", "V": "3.2 + 0.9*soc - R0*i"}, parameters={"R0": 0.05}, starts={"soc": 0.8}
    )
    train, test = data.split(0.7)
    given = {"catalogue": "battery", "settle": False, "free_runs": False, "progress": False, **options}
    return bg.find_missing_effects(model, train, test=test, **given)


few = [replace(each, confusions=()) for each in load_catalogue("battery") if each.slug == "relaxation"]


@pytest.fixture(scope="module")
def relaxing():
    return studied(cell(RESISTANCE), free_runs=True)


def test_a_relaxation_is_named_with_its_time_and_resistance(relaxing):
    assert relaxing.verdict == "named", relaxing.sentence
    row = relaxing.effects.set_index("slug").loc["relaxation"]
    assert row["status"] == "added" and row["lower"] < -RESISTANCE < row["upper"] and row["unit"] == "V/A"
    # Lines between samples of a current that is held would make it half a sample slower.
    assert relaxing.base.rows.interpolation == "zoh" and any("held" in text for text in relaxing.warnings)
    (inner,) = studied_system(relaxing).learned["V"].inner
    assert abs(inner.value.mean - TIME) < 4 * inner.value.sd < STEP / 2 and inner.unit == "s"


def test_held_out_rows_go_on_from_the_training_rows(relaxing):
    assert relaxing.gap.loc[("test", "unexplained share", "V"), "closed"] > 0.99
    assert relaxing.model.starts == {"soc": 0.8, "z_relaxation_i": 0.0}
    assert {"soc", "V", "z_relaxation_i"} == {*relaxing.model.simulation}
    # No sensor reads what is computed.
    assert "soc" not in {*relaxing.instrument["channel"]}


def test_what_remembers_goes_on_where_rows_are_left_out():
    data = cell(RESISTANCE)
    volts = np.minimum(data.rate("V"), np.quantile(data.rate("V"), 0.85))
    clipped = bg.Trajectories.from_arrays(
        data.time, inputs=dict(data.inputs), outputs={"V": volts}, units=dict(data.units)
    )
    study = studied(clipped, catalogue=few)
    row = study.effects.set_index("slug").loc["relaxation"]
    assert study.verdict == "named" and abs(row["mean"] + RESISTANCE) < 4 * row["sd"] < 0.004, study.sentence
    (inner,) = studied_system(study).learned["V"].inner
    assert abs(inner.value.mean - TIME) < 4 * inner.value.sd < 1.0


def test_two_outputs_have_memories_of_their_own():
    one = cell(RESISTANCE)
    current = one.inputs["i"]
    other, left = np.zeros(N), np.exp(-STEP / (4 * TIME))
    for k in range(1, N):
        other[k] = left * other[k - 1] + (1 - left) * current[k - 1]
    noise = 1e-3 * np.random.default_rng(9).standard_normal(N)
    data = bg.Trajectories.from_arrays(
        one.time,
        inputs={"i": current},
        outputs={"V": one.rate("V"), "W": noise - 0.04 * other - 0.01 * current},
        units=dict(one.units),
    )
    model = bg.GreyBox(
        simulation={"soc": "-i/9000", "V": "3.2 + 0.9*soc - 0.05*i", "W": "-0.01*i"}, starts={"soc": 0.8},
        rows=bg.DerivativeRows(interpolation="zoh"),
    )  # fmt: skip
    study = bg.find_missing_effects(model, data, catalogue=few, settle=False, free_runs=False, progress=False)
    times = {name: studied_system(study).learned[name].inner[0].value.mean for name in ("V", "W")}
    assert abs(times["V"] - TIME) < 1.0 and abs(times["W"] - 4 * TIME) < 4.0
    assert {"z_relaxation_i_V", "z_relaxation_i_W"} < {*study.model.simulation}


def test_without_units_it_is_said_which_role_to_give():
    data = cell(RESISTANCE)
    plain = bg.Trajectories.from_arrays(data.time, inputs=dict(data.inputs), outputs={"V": data.rate("V")})
    text = "4 effects were not weighed: no column plays the role 'current'; give roles={'current': "
    assert any(text in each.text for each in asked(studied(plain)))
    given = studied(plain, roles={"current": "i"}, catalogue=few)
    assert given.verdict == "named", given.sentence


def test_a_cell_that_lacks_nothing_has_no_gap():
    study = studied(cell(0.0))
    assert study.verdict == "no gap", study.sentence
    assert not study.left_out.keys() & {("V", "relaxation"), ("V", "two-relaxations")}


def test_a_simulation_that_gives_nothing_has_no_errors_that_are_shares_of_it():
    data = cell(RESISTANCE)
    model = bg.GreyBox({"V": ["1", "i"]}, simulation={"V": "0*i"})
    found = bg.find_missing_effects(model, data, catalogue=few, settle=False, free_runs=False, progress=False)
    assert found.instrument.empty and found.verdict in ("unknown", "partly named")


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.02, 0.06])
def test_noise_of_an_ammeter_is_no_hysteresis(noise):
    """V follows the true current: what the noise of the current does looks like a loop that is smaller than a pulse."""
    rng, t = np.random.default_rng(0), 2.0 * np.arange(500)
    current = np.repeat(rng.choice([-1.5, 0.0, 0.8, 1.6, 2.5, 4.0], 25), 20)
    soc = 0.9 - np.concatenate([[0], np.cumsum(2.0 * current[:-1])]) / 9000
    voltage = 3.2 + 0.9 * soc - 0.05 * current + 0.0007 * rng.standard_normal(500)
    measured = current + noise * rng.standard_normal(500)
    data = bg.Trajectories.from_arrays(t, inputs={"i": measured}, outputs={"V": voltage}, units={"i": "A", "V": "V"})
    model = bg.GreyBox(
        simulation={"soc": "-i/(3600*Q)", "V": "3.2 + 0.9*soc - R0*i"}, parameters={"Q": 2.5, "R0": 0.05},
        starts={"soc": 0.9}, rows=bg.DerivativeRows(interpolation="zoh"),
    )  # fmt: skip
    study = bg.find_missing_effects(model, data, catalogue="battery", settle=False, progress=False)
    assert study.verdict in ("instrument", "no gap") and (study.effects["probability"] < 0.5).all()
    assert study.memory["probability"].loc["V", "something that remembers"] < 0.5
    noisy = study.instrument.query("suspect == 'noise'")
    # Where it is too small to tell, nothing is said of it.
    assert not len(noisy) or noisy["mean"].item() == pytest.approx(noise, rel=0.2)
