"""Files that are whole or not there, and folders that one process at a time writes to."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.locking import LOCK, locked
from bayes_greybox.running.whole_files import PART_PREFIX, remove_parts, whole_file, write_text

ROOT = Path(__file__).parents[2]
HOLD = """
import pathlib, sys
from bayes_greybox.running.locking import locked
with locked(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def held_by_another(folder: Path) -> subprocess.Popen:
    """Another process that holds the folder until its input ends."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], env=environment, **pipes)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_a_file_gets_its_name_once_it_is_whole(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with whole_file(file) as part:
        assert part.parent == tmp_path and part.name.startswith(PART_PREFIX)
        part.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new" and os.listdir(tmp_path) == ["a.txt"]
    # As any other file that a user writes, not private as temporary ones are.
    (tmp_path / "b.txt").touch()
    assert file.stat().st_mode == (tmp_path / "b.txt").stat().st_mode


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, OSError(28, "No space left on device")])
def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path, error):
    write_text(tmp_path / "a.txt", "old\r\n")
    with pytest.raises(type(error) if isinstance(error, Exception) else error), whole_file(tmp_path / "a.txt") as part:
        part.write_text("half of the n")
        raise error
    assert (tmp_path / "a.txt").read_bytes() == b"old\r\n" and os.listdir(tmp_path) == ["a.txt"]


def test_what_killed_processes_left_is_removed(tmp_path):
    (tmp_path / f"{PART_PREFIX}1").write_text("half")
    (tmp_path / f"{PART_PREFIX}2" / "sub").mkdir(parents=True)
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / f"{PART_PREFIX}3").write_text("half")
    (tmp_path / "figures" / "a.png").write_text("whole")
    remove_parts(tmp_path)
    assert [path.name for path in sorted(tmp_path.rglob("*"))] == ["figures", "a.png"]


def test_a_folder_that_another_process_writes_to_is_refused_with_its_number(tmp_path):
    process = held_by_another(tmp_path)
    try:
        with pytest.raises(InputError, match=rf'{tmp_path.name}" is being written to by another.*\({process.pid} on '):
            with locked(tmp_path):
                raise AssertionError("both had it")
    finally:
        process.kill()
        process.communicate()
    # The dead process left its file, which holds nothing.
    assert (tmp_path / LOCK).is_file()
    with locked(tmp_path), pytest.raises(InputError, match=f"{os.getpid()} on"), locked(tmp_path):
        raise AssertionError("the same process had it twice")
    assert os.listdir(tmp_path) == []


def test_a_file_system_without_locks_holds_nobody_up(tmp_path, monkeypatch, caplog):
    fcntl = pytest.importorskip("fcntl")

    def flock(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    with locked(tmp_path):
        assert "no locks" in caplog.text
