import os

import pytest

from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.running.errors import InputError


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_staged_files_appear_together_at_the_end(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with staged(tmp_path) as place:
        (place / "a.txt").write_text("new")
        (place / "sub").mkdir()
        (place / "sub" / "b.txt").write_text("b")
        assert place.parent == tmp_path
        assert (tmp_path / "a.txt").read_text() == "old"
        assert not (tmp_path / "sub").exists()
    assert (tmp_path / "a.txt").read_text() == "new"
    assert names(tmp_path) == ["a.txt", "sub", os.path.join("sub", "b.txt")]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_what_was_there_and_nothing_else(tmp_path, error):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(error), staged(tmp_path) as place:
        (place / "a.txt").write_text("half of the n")
        raise error
    assert names(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_a_full_disk_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(InputError, match="No space left on device.*make room, or choose another"), staged(tmp_path):
        raise OSError(28, "No space left on device")
    assert names(tmp_path) == []


def test_folder_is_made_and_kept_once_it_holds_a_file(tmp_path):
    with output_folder(tmp_path / "a" / "b") as folder:
        assert names(folder) == [".lock"]
        (folder / "x").write_text("x")
    assert (tmp_path / "a" / "b" / "x").exists()


def test_folders_made_for_work_that_failed_go_again(tmp_path):
    (tmp_path / "kept").mkdir()
    with pytest.raises(InputError, match="bad data"), output_folder(tmp_path / "kept" / "a" / "b"):
        raise InputError("bad data")
    assert names(tmp_path) == ["kept"]


def test_a_folder_with_results_survives_a_failure(tmp_path):
    with pytest.raises(InputError, match="bad data"), output_folder(tmp_path / "a" / "b") as folder:
        (folder / "x").write_text("x")
        raise InputError("bad data")
    assert (tmp_path / "a" / "b" / "x").exists()


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match=r'Cannot write to the folder ".*run" \(Not a directory\); choose'):
        with output_folder(tmp_path / "file" / "run"):
            raise AssertionError("the work started")
    with pytest.raises(InputError, match="Cannot write to the folder"), output_folder(tmp_path / "file"):
        raise AssertionError("the work started")
