"""Hidden states with a start, on rows of rates and outputs: along measured columns, from where runs start."""

from dataclasses import replace

import numpy as np
import pytest
from fabricated import estimated, fabricate

import bayes_greybox as bg
from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.physics.hidden_states import HiddenState, along

T = 0.5 * np.arange(80)
PULSES = np.repeat([0.0, 1.0, -0.5, 0.0], 20)


def cell(noise=0.0, current=PULSES, **options):
    """V = 3 + 2 q − 0.1 i, q' = −i/50 with i held, and q = 1 where the run starts."""
    charge = 1.0 - np.append(0.0, np.cumsum(current[:-1])) * 0.5 / 50
    volts = 3.0 + 2.0 * charge - 0.1 * current + noise * np.random.default_rng(1).standard_normal(len(current))
    return bg.Trajectories.from_arrays(T, inputs={"i": current}, outputs={"V": volts}, **options), charge


def model(dictionary=None, rows=None, **options):
    given = {"simulation": {"q": "-i/50", "V": "2*q"}, "starts": {"q": 1.0}, "discrepancy": None, **options}
    return bg.GreyBox(dictionary or {}, rows=rows or bg.DerivativeRows(interpolation="zoh"), **given)


def test_held_columns_drive_hidden_states_exactly():
    state = HiddenState("z", "(u - z)/3", "u")
    fresh = np.arange(80) % 40 == 0
    exact = np.zeros(80)
    for k in range(1, 80):
        left = np.exp(-0.5 / 3)
        exact[k] = 0.0 if fresh[k] else left * exact[k - 1] + (1 - left) * PULSES[k - 1]
    (held,) = along([[state]], T, {"u": PULSES}, fresh, held=("u",))
    np.testing.assert_allclose(held["z"], exact, atol=1e-7)
    (lines,) = along([[state]], T, {"u": PULSES}, fresh)
    assert np.max(np.abs(lines["z"] - exact)) > 0.01


def test_states_are_integrated_from_their_starts():
    data, charge = cell()
    complete = model().started(data)
    assert complete.state_names == complete.computed == ("q",)
    np.testing.assert_allclose(complete.states["q"], charge, atol=1e-12)
    # A line between two samples of a current that is held is another one.
    lines = model(rows=bg.DerivativeRows()).started(data)
    assert np.max(np.abs(lines.states["q"] - charge)) > 1e-3
    # What the data have is not computed, and what was computed is computed anew.
    assert model().started(complete) is complete
    again = model(starts={"q": 0.5}).rows.complete_all(complete, (), model(starts={"q": 0.5}).simulator(complete))
    np.testing.assert_allclose(again.states["q"], charge - 0.5, atol=1e-12)


def test_each_run_starts_anew_and_a_column_may_say_where():
    (one, charge), begin = cell(), np.full(80, 0.7)
    runs = bg.Trajectories.from_arrays(
        [T, T], inputs={"i": [PULSES, PULSES], "begin": [begin, 0 * begin + 0.2]}, outputs={"V": [one.rate("V")] * 2}
    )
    found = model(starts={"q": "begin"}).started(runs).states["q"]
    np.testing.assert_allclose(found, np.concatenate([charge - 0.3, charge - 0.8]), atol=1e-12)


def test_what_was_split_off_goes_on():
    data, charge = cell()
    train, test = data.split(0.6)
    np.testing.assert_allclose(model().started(test).states["q"], charge[48:], atol=1e-12)
    first, second = test.split(0.5)
    np.testing.assert_allclose(model().started(second).states["q"], charge[64:], atol=1e-12)
    np.testing.assert_allclose(model().started(second.keep(slice(2, None))).states["q"], charge[66:], atol=1e-12)
    renamed = replace(second, before=replace(test, inputs={}))
    with pytest.raises(bg.InputError, match="earlier rows of these runs lack"):
        model().started(renamed)


def test_coefficients_beside_a_hidden_state_are_learned_saved_and_predicted(tmp_path):
    data, _ = cell(noise=1e-3)
    train, test = data.split(0.5)
    fit = estimated(model({"V": ["1", "i"]}), train, draws=100)
    table = fit.summary().loc["V"]
    for name, truth in (("1", 3.0), ("i", -0.1)):
        assert abs(table.loc[name, "mean"] - truth) < 4 * table.loc[name, "sd"] < 0.01
    fit.save(tmp_path / "fit.nc")
    loaded = bg.load(tmp_path / "fit.nc")
    assert loaded.model.starts == {"q": 1.0}
    for each in (fit, loaded):
        assert each.predict(test).nmse()["V"] < 1e-3
    assert "d(q)/dt" in str(fit)
    # Files know what was computed, and the rows before those that were cut off.
    assert loaded.data.computed == ("q",)
    made = fabricate(fit.model, fit.model.started(test.split(0.25)[1]))
    later = bg.Fit(made.model, made.data, made.sampling, made.idata)
    later.save(tmp_path / "later.nc")
    again = bg.load(tmp_path / "later.nc").data
    assert again.before.n_obs == 10 and again.before.before.n_obs == 40 and again.before.before.before is None
    np.testing.assert_array_equal(again.states["q"], later.data.states["q"])
    np.testing.assert_allclose(model().started(again).states["q"], again.states["q"], atol=1e-12)
    fit.export(tmp_path / "cell.py")
    assert "q: hidden, with a known start, 1 where the data start" in (tmp_path / "cell.py").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": {"q": "first"}}, "depend on 'first', which is no state and no input of the data; there are i"),
        ({"simulation": lambda t, x, u: -u / 50}, "need formulas"),
        ({"simulation": {"V": "2*q"}}, "has a start and no formula"),
        ({"simulation": {"q": "q**2", "V": "2*q"}, "starts": {"q": 5.0}}, "does not stay finite"),
        ({"dictionary": {"q": ["i"]}}, "follows from its start: nothing in its equation can be learned"),
        (
            {"simulation": {"q": "-i/c", "V": "2*q"}, "parameters": {"c": bg.Parameter(50.0, sd=1.0)}},
            "a hidden state with a start depends on it, which follows nothing that is learned",
        ),
        ({"rows": bg.TrajectoryRows()}, "is for rows of rates and outputs"),
    ],
)
def test_starts_that_cannot_be_followed_are_refused(options, message):
    data, _ = cell(noise=1e-3)
    given = {"dictionary": {"V": ["1"]}, **options}
    with pytest.raises(bg.InputError, match=message):
        model(**given).fit(data, draws=10, tune=10, chains=1, progress=False)


def test_a_stream_of_rows_has_no_hidden_states():
    stream = RowStream.from_chunks(lambda part: cell()[0].take(0), 1)
    with pytest.raises(bg.InputError, match="'q' is followed through whole runs"):
        model({"V": ["1"]}).fit(stream, draws=10, tune=10, chains=1, progress=False)


@pytest.mark.parametrize("starts", [{"q": None}, {"q": ""}, {"q": (0.9, 0.05)}, {"q": np.inf}])
def test_starts_are_numbers_or_columns(starts):
    with pytest.raises(bg.InputError, match="starts="):
        model(starts=starts)


def test_what_is_measured_has_no_start():
    data, charge = cell()
    measured = bg.Trajectories.from_arrays(
        T, states={"q": charge}, inputs=dict(data.inputs), outputs={"V": data.rate("V")}
    )
    with pytest.raises(bg.InputError, match="'q' has a start, as a hidden state has, and is measured"):
        model().states(measured)
