"""Whose results a folder holds, and copies of configuration files that can be run where they lie."""

import json
import tomllib
from pathlib import Path

import pytest

from bayes_greybox.config import load_config
from bayes_greybox.report.folders.holding import author_text, command_of, copy_of, free_folder, require_own
from bayes_greybox.running.errors import InputError

TEXT = """#:schema ./bayes-greybox.schema.json
# What a spring does, measured by ü.

[data]
path = ["run 1.csv", "more/*.csv"]  # two of them
time = "t"
states = ["y", "ydot"]
[data.test]
path = "late.csv"

[study]
catalogue = ["mechanical", "own.toml"]

[output]
folder = "there"
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "spring.toml").write_text(TEXT, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def held(folder: Path, **record) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "summary.json").write_text(json.dumps(record))
    return folder


@pytest.mark.parametrize(
    ("record", "command"),
    [
        ({"command": "discover"}, "discover"), ({"coefficients": []}, "fit"), ({"effects": [], "gap": []}, "discover"),
        ({"comparison": []}, "compare"), ({"something": 1}, None), ({"command": "own"}, None),
    ],
)  # fmt: skip
def test_the_record_tells_whose_results_they_are(tmp_path, record, command):
    assert command_of(held(tmp_path, **record)) == command


def test_of_a_run_that_was_stopped_the_files_tell(tmp_path):
    assert command_of(tmp_path / "absent") is None and command_of(tmp_path) is None
    (tmp_path / "run.nc").touch()
    # A fit that was saved by hand; no command writes over it but fit.
    assert command_of(tmp_path) is None
    (tmp_path / "config.toml").touch()
    assert command_of(tmp_path) == "fit"
    (tmp_path / "summary.json").write_text("{ half")
    assert command_of(tmp_path) == "fit"


def test_another_command_goes_beside_and_its_own_comes_back(tmp_path):
    folder = held(tmp_path / "case", command="fit")
    assert free_folder(folder, "fit") == folder and free_folder(tmp_path / "new", "fit") == tmp_path / "new"
    other = tmp_path / "case-discover"
    assert free_folder(folder, "discover") == other
    held(other, command="discover")
    assert free_folder(folder, "discover") == other
    held(other, command="compare")
    with pytest.raises(InputError, match='case-discover" holds results of compare.*--output'):
        free_folder(folder, "discover")


def test_the_folder_that_one_stands_in_has_a_neighbour_too(tmp_path, monkeypatch):
    monkeypatch.chdir(held(tmp_path / "case", command="fit"))
    assert free_folder(Path("."), "discover") == tmp_path / "case-discover"


def test_what_was_asked_for_is_refused_where_another_command_would_be_overwritten(tmp_path):
    require_own(tmp_path, "fit")
    require_own(held(tmp_path / "case", command="fit"), "fit")
    with pytest.raises(InputError, match="holds results of fit, which those of compare would overwrite"):
        require_own(tmp_path / "case", "compare")


@pytest.mark.parametrize("text", [TEXT, TEXT.replace("\n", "\r\n"), TEXT.split("\n", 1)[1]])
def test_a_copy_has_the_author_s_text_whole_and_says_where_its_paths_start(tmp_path, text):
    copy = copy_of(text, tmp_path / "configs" / "spring.toml", tmp_path / "runs" / "spring")
    assert tomllib.loads(copy) == {"copied_from": "../../configs/spring.toml", **tomllib.loads(text)}
    assert author_text(copy) == text and copy.startswith("#:schema") is text.startswith("#:schema")
    assert ("\r\n" in copy) is ("\r\n" in text) and copy.count("\n") == text.count("\n") + 3


def test_a_copy_is_found_from_wherever_it_is_run(here, tmp_path_factory, monkeypatch):
    given = load_config("configs/spring.toml")
    folder = here / "runs" / "spring"
    folder.mkdir(parents=True)
    given.copy_to(folder)
    for place, path in (
        (here, "runs/spring/config.toml"),
        (folder, "config.toml"),
        (here.parent, folder / "config.toml"),
    ):
        monkeypatch.chdir(place)
        copy = load_config(path)
        assert copy.text == TEXT and copy.file == "spring.toml"
        assert copy.origin == here / "configs" / "spring.toml"
        assert copy.study_arguments()["catalogue"] == ["mechanical", str(here / "configs" / "own.toml")]
    # A copy of the copy is one of the original.
    far = tmp_path_factory.mktemp("far")
    copy.copy_to(far)
    assert load_config(far / "config.toml").origin == here / "configs" / "spring.toml"
    assert load_config(far / "config.toml").text == TEXT


def test_the_results_of_a_copy_go_where_it_lies_and_of_one_that_was_taken_elsewhere_to_runs(here, monkeypatch):
    given = load_config("configs/spring.toml")
    assert given.folder == Path("there")
    held(here / "there", command="fit")
    given.copy_to(here / "there")
    monkeypatch.chdir(here / "there")
    assert load_config("config.toml").folder.resolve() == here / "there"
    (here / "new").mkdir()
    given.copy_to(here / "new")
    assert load_config(here / "new" / "config.toml").folder == Path("runs/spring")


def test_the_path_is_whole_where_nothing_is_shared(tmp_path):
    copy = copy_of("[data]\n", Path("/elsewhere/case.toml"), Path("/results"))
    assert tomllib.loads(copy)["copied_from"] == "/elsewhere/case.toml"
