"""Files without the sum of their bytes: another process reads them first."""

import os

import h5py
import pytest

from bayes_greybox.inference.kept import unsummed
from bayes_greybox.running.errors import InputError


@pytest.fixture
def file(tmp_path):
    with h5py.File(tmp_path / "run.nc", "w") as made:
        made.attrs["said"] = "so"
        made.create_group("inner").create_dataset("x", data=[1.0, 2.0])
    return tmp_path / "run.nc"


def test_a_file_that_can_be_read_passes(file):
    unsummed.require_readable(file)


def test_a_reader_that_does_not_come_back_is_refused_in_one_sentence(file, monkeypatch):
    monkeypatch.setattr(unsummed, "READER", "import time; time.sleep(60)")
    with pytest.raises(InputError, match="did not finish reading it in 1 s"):
        unsummed.require_readable(file, patience=1.0)


def test_a_reader_that_dies_is_refused(file, monkeypatch):
    monkeypatch.setattr(unsummed, "READER", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(InputError, match="HDF5 cannot read it"):
        unsummed.require_readable(file)


def test_what_lies_in_the_working_folder_is_not_run(file, monkeypatch):
    (file.parent / "h5py.py").write_text("raise SystemExit(open('ran', 'w').write('yes'))")
    monkeypatch.chdir(file.parent)
    unsummed.require_readable(file)
    assert not os.path.exists("ran")
