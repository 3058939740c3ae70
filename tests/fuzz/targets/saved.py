"""Search for damage to a saved fit that crashes its reader; an input is what is done to the file, see CONTRIBUTING."""

from pathlib import Path

from searching import search  # isort: skip
import probes
from damaging import damage, small

_whole: list[Path] = []


def _target(given: bytes, folder: Path) -> None:
    if not _whole:
        _whole.append(small(folder / "whole.nc"))
    damage(_whole[0], folder / "run.nc", given[0] if given else 0, int.from_bytes(given[1:9], "big"))
    probes.saved(folder / "run.nc")


search(_target)
