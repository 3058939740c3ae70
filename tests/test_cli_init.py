"""The first configuration that is written for a table: what it guesses, and that it runs."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from shell import refuse

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.config import load_config

N = 600
T = np.arange(N) * 0.02
FORCE = np.sin(0.7 * T) + 0.3 * np.sign(np.sin(2.1 * T))


def oscillator():
    def rate(t, x):
        return [x[1], np.interp(t, T, FORCE) - 4 * x[0] - 0.3 * x[1]]

    y, v = solve_ivp(rate, (0, T[-1]), [1, 0], t_eval=T, rtol=1e-8).y
    return y, v, FORCE - 4 * y - 0.3 * v


def noisy(values, size, seed):
    return values + size * np.random.default_rng(seed).standard_normal(len(values))


def measured_rates():
    y, v, a = oscillator()
    columns = {"Time (s)": T, "Pos [m]": y, "Vel [m/s]": v, "acc": noisy(a, 0.02, 0), "Load cell": FORCE, "gain": 2.0}
    return pd.DataFrame({**columns, "note": "x"})


def position_alone():
    return pd.DataFrame({"t": T, "y": noisy(oscillator()[0], 1e-3, 0), "F": FORCE})


def two_levels():
    stamps = T + np.random.default_rng(0).uniform(-0.004, 0.004, N)
    levels = {"level 1": noisy(np.exp(-stamps / 5), 1e-3, 1), "level 2": noisy(np.exp(-stamps / 3), 1e-3, 2)}
    return pd.DataFrame({"t": stamps, **levels, "trial": np.repeat(["a", "b"], N // 2)})


TABLES = {
    "measured rates": (measured_rates, {}),
    "position alone": (position_alone, {"sep": ";", "decimal": ","}),
    "two levels": (two_levels, {}),
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(name, folder, **changes):
    make, options = TABLES[name]
    table = make().assign(**changes)
    table.to_csv(folder / "run.csv", index=False, **options)
    assert cli.main(["init", "run.csv"]) == 0
    return load_config(folder / "run.toml")


@pytest.mark.parametrize("name", TABLES)
def test_what_is_written_is_a_configuration_that_builds_data_and_model(name, here, capsys):
    settings = written(name, here)
    assert "check what was guessed" in capsys.readouterr().out
    train, test = settings.read_data()
    model = settings.build_model()
    completed = model.on(train)
    completed.dictionaries(train)
    assert test.n_obs and set(model.equations) <= {*completed.states(train), *train.output_names}
    assert settings.build_studied_model() is not None
    # Comments say what is to be filled in.
    assert "unit of" in settings.text and 'such as "' in settings.text


def test_rates_and_inputs_are_known_by_their_behaviour(here):
    settings = written("measured rates", here)
    train, _ = settings.read_data()
    assert train.state_names == ("Pos", "Vel") and train.input_names == ("Load_cell",)
    assert train.derivative_names == ("Vel",) and settings.simulation == {"Pos": "Vel"}
    assert train.units == {"t": "s", "Pos": "m", "Vel": "m/s"}
    assert "# gain has no role: it never changes." in settings.text and "# note has no role" in settings.text


def test_a_position_has_a_rate_that_is_learned(here):
    settings = written("position alone", here)
    train, _ = settings.read_data()
    assert settings.data.decimal == "," and settings.simulation == {"y": "y_rate"}
    assert train.filter is not None and train.derivative_names == ("y", "y_rate")


def test_runs_and_uneven_stamps_are_seen(here):
    settings = written("two levels", here)
    train, _ = settings.read_data()
    # Uneven stamps are not filtered: their rows are samples.
    assert train.run_names == ("a", "b") and train.filter is None
    assert list(settings.build_model().dictionary) == ["level_1", "level_2"]


def test_runs_without_a_name_and_empty_cells_are_told(here):
    y = noisy(oscillator()[0], 1e-3, 0)
    y[7] = np.nan
    settings = written("position alone", here, t=np.tile(T[: N // 2], 2), y=y)
    assert (settings.data.restart, settings.data.missing) == ("run", "drop")
    assert "rows with empty cells are left out, 1 here" in settings.text


def test_what_cannot_be_written_is_refused(here, capsys):
    position_alone().to_csv(here / "run.csv", index=False)
    (here / "run.toml").write_text("# mine\n")
    assert "is there already; choose another name with --output" in refuse(capsys, "init", "run.csv")
    assert (here / "run.toml").read_text() == "# mine\n"
    assert "cannot be written" in refuse(capsys, "init", "run.csv", "-o", "no/folder/run.toml")
    pd.DataFrame({"t": T, "gain": 1.0}).to_csv(here / "flat.csv", index=False)
    assert "nothing to model" in refuse(capsys, "init", "flat.csv")
    assert "There is no file" in refuse(capsys, "init", "absent.csv")


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_what_is_written_runs(name, here):
    written(name, here)
    words = ["--draws", "200", "--tune", "300", "--no-progress", "--quiet"]
    assert cli.main(["fit", "run.toml", "--output", "out", *words]) in (0, 3)
    fit = bg.load(here / "out" / "run.nc")
    table = fit.inclusion()
    if name != "two levels":
        # The truth is F - 4 y - 0.3 v.
        mean = table["mean"].to_numpy()
        np.testing.assert_allclose(np.sort(mean)[[0, 1, -1]], [-4.0, -0.3, 1.0], atol=0.1)


def test_a_german_file_is_no_file_of_words(here):
    table = position_alone().assign(y=lambda table: 1500.0 * table["y"], F=np.repeat([0.5, 1.5], N // 2))
    text = table.to_csv(index=False, sep=";", decimal=",", float_format="%.3f")
    lines = text.splitlines()
    cells = [line.split(";") for line in lines[1:]]
    for row in cells:
        whole, part = row[1].split(",")
        row[1] = f"{int(whole):,d}".replace(",", ".") + f",{part}" if abs(int(whole)) >= 1000 else row[1]
    (here / "run.csv").write_text("\n".join([lines[0], *map(";".join, cells)]))
    assert cli.main(["init", "run.csv"]) == 0
    settings = load_config(here / "run.toml")
    assert (settings.data.decimal, settings.data.thousands, settings.data.run) == (",", ".", None)
    assert settings.data.inputs == ["F"]
    read = bg.read(here / "run.csv", time="t", states=["y"], inputs=["F"], decimal=",", thousands=".")
    np.testing.assert_allclose(read.states["y"], table["y"], atol=5e-4)


def test_dates_that_cannot_be_told_are_asked_for(here, capsys):
    days = pd.date_range("2024-03-04", periods=8)
    pd.DataFrame({"day": days.strftime("%d/%m/%Y"), "y": np.arange(8.0) ** 2}).to_csv(here / "run.csv", index=False)
    assert "pass dayfirst=True or dayfirst=False" in refuse(capsys, "init", "run.csv")
    assert cli.main(["init", "run.csv", "--dayfirst"]) == 0
    settings = load_config(here / "run.toml")
    assert (settings.data.time, settings.data.dayfirst) == ("day", True)
