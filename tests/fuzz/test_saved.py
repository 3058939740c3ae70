"""No damaged copy of a saved fit crashes its reader: it loads, or is refused in a sentence that names the file."""

import h5py
import probes
import pytest
from damaging import BYTES, PARTS, damage, small
from hypothesis import given, settings
from hypothesis import strategies as st

import bayes_greybox as bg
from bayes_greybox.criticism.kept.file import load_checked
from bayes_greybox.inference.kept import netcdf

SETTINGS = settings(derandomize=True, deadline=None, max_examples=30, database=None)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    # Whoever reads first, what is asked of the reader is the same; `test_unsummed` asks the other process.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(netcdf, "require_readable", lambda path: None)
        yield small(tmp_path_factory.mktemp("saved") / "whole.nc")


@SETTINGS
@given(how=st.integers(0, len(BYTES) + len(PARTS) - 1), seed=st.integers(0, 2**32))
def test_damaged_files_are_read_or_refused(whole, how, seed):
    damage(whole, whole.with_name("run.nc"), how, seed)
    probes.saved(whole.with_name("run.nc"))


def test_a_text_that_was_changed_is_refused(whole, tmp_path):
    path = tmp_path / "run.nc"
    netcdf.save(load_checked(whole), path)
    # Whole, it is read.
    assert load_checked(path).model.equations == ("v",)
    with h5py.File(path, "r+") as file:
        text = file.attrs[netcdf.RECORD_ATTRIBUTE]
        assert '"noise_floor": 0.0001' in text
        # One bit of one digit: nothing but the seal could tell.
        file.attrs[netcdf.RECORD_ATTRIBUTE] = text.replace('"noise_floor": 0.0001', '"noise_floor": 0.0003')
    with pytest.raises(bg.InputError, match=r"run\.nc' is damaged.* 'bayes_greybox' is not what was written; take"):
        bg.load(path)


def test_a_changed_byte_is_found_before_the_file_is_opened(whole, tmp_path):
    path = tmp_path / "run.nc"
    netcdf.save(load_checked(whole), path)
    raw = path.read_bytes()
    for at in range(0, len(raw) - 40, len(raw) // 40):
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 1]) + raw[at + 1 :])
        with pytest.raises(bg.InputError, match=r"run\.nc' is damaged.*bytes are not those that were written"):
            bg.load(path)
    path.write_bytes(raw)
    with h5py.File(path, "r+") as file:
        file.attrs["note"] = "mine"
    # What another program changed is no damage.
    assert bg.load(path).idata.attrs["note"] == "mine"
