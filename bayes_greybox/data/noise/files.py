"""Row noise from files."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError

from .banded import BandedNoise
from .forced_noise import ForcedNoise, Motion
from .overlapping import OverlappingNoise
from .protocol import RowNoise
from .spectral import SpectralNoise
from .starts_noise import StartsNoise
from .state_space import StateSpaceNoise
from .weighted import WeightedNoise
from .white import WhiteNoise

NOISE_KINDS: dict[str, Any] = {
    noise.kind: noise
    for noise in (
        WhiteNoise, BandedNoise, SpectralNoise, StateSpaceNoise, WeightedNoise, StartsNoise, ForcedNoise,
        OverlappingNoise,
    )
}  # fmt: skip
"""Row noises that files of data and fits can hold, by the name that `RowNoise.to_dict` gives them."""


def noise_from_dict(record: Mapping[str, Any]) -> RowNoise:
    """Rebuild a noise from `RowNoise.to_dict`.

    Raises:
        InputError: if the kind is unknown.
    """
    if record["kind"] not in NOISE_KINDS:
        kinds = ", ".join(f'"{kind}"' for kind in NOISE_KINDS)
        raise InputError(f'Row noise of kind "{record["kind"]}" is unknown; the kinds are {kinds}.')
    return NOISE_KINDS[record["kind"]](**{name: _field(name, each) for name, each in record.items() if name != "kind"})


def _field(name: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        motion = "kind" not in value
        return Motion(**{key: _field(key, each) for key, each in value.items()}) if motion else noise_from_dict(value)
    if isinstance(value, str | int | float):
        return value
    if name in ("run_lengths", "steps", "kept", "outputs"):
        return tuple(value)
    if name in ("times", "bands"):
        return tuple(np.asarray(each, dtype=float) for each in value)
    return np.asarray(value, dtype=bool if name == "fresh" else float)
