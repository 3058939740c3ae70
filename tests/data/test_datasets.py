import importlib.util
import os
import sys

import numpy as np
import pytest

from bayes_greybox.data.datasets import FOLDER_VARIABLE, IMPACT, dataset_table, load_dataset, search_folders
from bayes_greybox.running.errors import InputError

measured = pytest.mark.skipif(
    not os.environ.get(FOLDER_VARIABLE),
    reason=f"{FOLDER_VARIABLE} does not name a folder with the measured data sets",
)
NAMES = ["silverbox", "cascaded_tanks", "falling_balls", "hudson_bay"]


@pytest.fixture
def empty_folders(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "cache"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return tmp_path


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_file_says_where_it_was_sought_and_where_it_comes_from(name, empty_folders):
    with pytest.raises(InputError) as caught:
        load_dataset(name)
    sentence = str(caught.value)
    table = dataset_table()
    assert table.loc[name, "source"] in sentence and FOLDER_VARIABLE in sentence
    for folder in search_folders():
        assert f'"{folder}"' in sentence
    assert table.loc[name, "found"] == "" and not table.loc[name, "verified"]


def test_altered_bytes_are_refused(empty_folders):
    path = empty_folders / "hudson_bay" / "hudson_bay_data.dat"
    path.parent.mkdir()
    path.write_text("1900 30 4\n1901 47 6\n")
    with pytest.raises(InputError, match=r'hudson_bay_data.dat" is not the original file .* SHA-256 differs'):
        load_dataset("hudson_bay")
    assert dataset_table().loc["hudson_bay", "found"] == str(empty_folders)
    assert not dataset_table().loc["hudson_bay", "verified"]


def test_the_cache_is_searched_after_the_named_folder(empty_folders, monkeypatch):
    assert search_folders()[0] == empty_folders
    assert search_folders()[1].name == "bayes_greybox"
    monkeypatch.delenv(FOLDER_VARIABLE)
    assert len(search_folders()) == 1


def test_unknown_names_and_options():
    with pytest.raises(InputError, match=r'no data set "silverbx"; there are silverbox'):
        load_dataset("silverbx")
    with pytest.raises(InputError, match=r'has no option "offset"; its options are remove_offset'):
        load_dataset("silverbox", offset=True)
    with pytest.raises(InputError, match=r'has no option "x"; it has none'):
        load_dataset("hudson_bay", x=1)


@measured
def test_every_set_is_found_and_verified():
    table = dataset_table()
    assert list(table.index) == NAMES and table["verified"].all()


@measured
def test_silverbox_official_parts():
    raw, centred = load_dataset("silverbox"), load_dataset("silverbox", remove_offset=True)
    assert {k: v.n_obs for k, v in raw.items()} == {
        "multisine_train": 65062,
        "multisine_test": 21688,
        "arrow": 40475,
        "arrow_no_extrapolation": 32000,
    }
    train, test = raw["multisine_train"], raw["multisine_test"]
    step = 2**14 / 1e7
    assert test.time[0] - train.time[-1] == pytest.approx(step, rel=1e-6)
    assert (train.units["u"], train.units["y"], train.units["t"]) == ("V", "V", "s")
    offset = raw["arrow"].inputs["u"] - centred["arrow"].inputs["u"]
    assert np.ptp(offset) < 1e-12 and offset[0] == pytest.approx(6.2e-3, abs=1e-3)


@measured
def test_clipped_tank_samples_stay_or_go_with_a_count():
    kept, dropped = load_dataset("cascaded_tanks"), load_dataset("cascaded_tanks", clipped="drop")
    for part in ("train", "test"):
        n_clipped = int(np.sum(kept[part].states["y"] >= 10.0))
        assert kept[part].n_obs == 1024 and n_clipped > 0
        assert dropped[part].dropped == n_clipped and dropped[part].states["y"].max() < 10.0
    with pytest.raises(InputError, match='clipped must be "keep" or "drop"'):
        load_dataset("cascaded_tanks", clipped="interpolate")


@measured
@pytest.mark.skipif(importlib.util.find_spec("openpyxl") is None, reason="openpyxl (extra tables) is missing")
def test_falling_balls_have_one_run_for_each_drop():
    drops = load_dataset("falling_balls")
    assert drops.data.n_run == 22 and len(drops.balls) == 11 and drops.balls["drops"].sum() == 22
    golf = drops.data.take("Golf Ball, drop 1")
    # A golf ball falls almost freely: the velocity loses about 9.8 m/s each second at first.
    slope = np.polyfit(golf.time[:20], golf.states["v"][:20], 1)[0]
    assert -11.0 < slope < -8.0
    assert drops.balls.loc["Golf Ball", "mass"] == pytest.approx(0.0459, abs=1e-3)
    assert np.isnan(drops.balls.loc["Volleyball", "mass"])


@measured
@pytest.mark.skipif(importlib.util.find_spec("openpyxl") is None, reason="openpyxl (extra tables) is missing")
def test_falling_balls_for_one_model_of_all_drops():
    drops, every = load_dataset("falling_balls", by_ball=True), load_dataset("falling_balls")
    data = drops.data
    assert data.n_run == 22 and data.state_names == ("y",) and len(data.input_names) == 11
    assert [n + IMPACT for n in data.run_lengths] == list(every.data.run_lengths)
    own = np.column_stack(list(data.inputs.values()))
    assert np.all(own.sum(axis=1) == 1) and set(np.unique(own)) == {0.0, 1.0}
    first = data.take(data.run_names.index("Tennis Ball, drop 1"))
    assert np.all(first.inputs["tennis_ball"] == 1)


@measured
def test_falling_balls_without_openpyxl_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(InputError, match=r'openpyxl; install it with pip install "\.\[tables\]"'):
        load_dataset("falling_balls")


@measured
def test_hudson_bay_years():
    data = load_dataset("hudson_bay")
    np.testing.assert_array_equal(data.time, np.arange(1900, 1921))
    assert data.state_names == ("hare", "lynx") and data.unit("t") == "year"
    assert data.states["hare"].max() == 77.4
