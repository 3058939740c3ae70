"""A small saved fit, made without sampling, and what can befall its file."""

import json
import random
import shutil
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import xarray as xr
from fabricated import fabricate, oscillator
from inputs import changed

import bayes_greybox as bg
from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import SEALS

OTHERS = [
    None, 3, 2.5, "", "{", "[]", "null", "5", "x", '{"format": 4}', '{"format": "x"}', '{"format": 99}',
    np.array([1, 2]), b"\xff\xfe",
]  # fmt: skip
"""What an attribute may be instead."""


def small(path: Path) -> Path:
    """Save a fit of made-up draws; without seals, as files of earlier versions are, so that reading goes on."""
    model = bg.GreyBox({"v": ["v", "y**3"]}, simulation={"y": "v"}, discrepancy=bg.OrthogonalGP(features=3))
    weight = np.random.default_rng(0).normal(size=(1, 2, 9))
    made = fabricate(model, oscillator(12), chains=1, draws=2, weight=weight)
    made.idata["log_prior"] = xr.DataTree(made.idata["posterior"].dataset[["v_sigma"]])
    netcdf.save(made, path)
    with h5py.File(path, "r+") as file:
        del file.attrs[SEALS]
    return path


def bits(raw: bytes, rng: random.Random) -> bytes:
    """Some bits turned over, half of the times near the beginning, where the structure is."""
    copy, end = bytearray(raw), rng.choice((len(raw), 4000))
    for _ in range(rng.choice((1, 2, 8))):
        copy[rng.randrange(end)] ^= 1 << rng.randrange(8)
    return bytes(copy)


def blank(raw: bytes, rng: random.Random) -> bytes:
    """A stretch of zeros, as a disk leaves it."""
    start, length = rng.randrange(len(raw)), rng.choice((4, 64, 512))
    return raw[:start] + bytes(length) + raw[start + length :]


def short(raw: bytes, rng: random.Random) -> bytes:
    """The end missing, as a copy that was stopped leaves it."""
    return raw[: rng.randrange(len(raw))]


BYTES = (bits, blank, short)


def attribute(file: h5py.File, rng: random.Random) -> None:
    """An attribute missing or of another kind."""
    place, name = rng.choice([(at, name) for at in everything(file) for name in at.attrs])
    other = rng.choice(OTHERS)
    del place.attrs[name]
    if other is not None:
        place.attrs[name] = other


def record(file: h5py.File, rng: random.Random) -> None:
    """Something else in the record of model, settings and data."""
    content = json.loads(file.attrs[netcdf.RECORD_ATTRIBUTE])
    bad = rng.choice([None, -1, 0, 1e400, "x", "", [], {}, [[1]], {"a": None}, True, 10**30, "open('pwned', 'w')"])
    # A part may have come to stand within itself, which no file can hold.
    with suppress(ValueError):
        file.attrs[netcdf.RECORD_ATTRIBUTE] = json.dumps(changed(content, rng.randrange(2**32), bad))


def lost(file: h5py.File, rng: random.Random) -> None:
    """A group or an array missing, or under another name."""
    place = rng.choice(everything(file)[1:])
    if rng.random() < 0.5:
        del file[place.name]
    else:
        file.move(place.name, f"{place.name}_zz")


def array(file: h5py.File, rng: random.Random) -> None:
    """An array with other numbers, of another shape or of no numbers at all."""
    name = rng.choice([at.name for at in everything(file) if isinstance(at, h5py.Dataset)])
    shape = file[name].shape
    others = [
        np.full(shape, np.nan), np.full(shape, np.inf), np.zeros(shape), np.zeros(shape, int), np.zeros(shape, complex),
        np.full(shape, b"a"), np.zeros((*shape, 2)), np.zeros(shape[:-1]), np.zeros((0,) * max(1, len(shape))),
    ]  # fmt: skip
    del file[name]
    file[name] = rng.choice(others)


PARTS = (attribute, record, lost, array)


def everything(file: h5py.File) -> list[h5py.Group | h5py.Dataset]:
    """The file, its groups and its arrays."""
    found: list = [file]
    file.visititems(lambda _, at: found.append(at))
    return found


def damage(whole: Path, copy: Path, how: int, seed: int) -> None:
    """Make a damaged copy.

    Args:
        whole: The file.
        copy: Where the copy goes.
        how: Which of `BYTES` and `PARTS`.
        seed: What exactly.
    """
    rng, kinds = random.Random(seed), (*BYTES, *PARTS)
    kind = kinds[how % len(kinds)]
    if kind in BYTES:
        copy.write_bytes(kind(whole.read_bytes(), rng))
        return
    shutil.copy(whole, copy)
    with h5py.File(copy, "r+") as file:
        kind(file, rng)
