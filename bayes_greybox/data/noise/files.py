"""Row noise from files."""

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError

from .banded import BandedNoise, OverlappingNoise
from .protocol import RowNoise
from .spectral import SpectralNoise
from .starts_noise import ForcedNoise, Motion, StartsNoise
from .state_space import StateSpaceNoise
from .weighted import WeightedNoise, WhiteNoise

# Row noises that files of data and fits can hold, by the name that `RowNoise.to_dict` gives them.
NOISE_KINDS: dict[str, Any] = {
    noise.kind: noise
    for noise in (
        WhiteNoise, BandedNoise, SpectralNoise, StateSpaceNoise, WeightedNoise, StartsNoise, ForcedNoise,
        OverlappingNoise,
    )
}  # fmt: skip


def noise_from_dict(record: Mapping[str, Any]) -> RowNoise:
    """Rebuild a noise from `RowNoise.to_dict`, and refuse an unknown kind."""
    if record["kind"] not in NOISE_KINDS:
        kinds = ", ".join(f'"{kind}"' for kind in NOISE_KINDS)
        raise InputError(f'Row noise of kind "{record["kind"]}" is unknown; the kinds are {kinds}.')
    return _filled(NOISE_KINDS[record["kind"]], record)


def _filled(kind: Callable[..., Any], record: Mapping[str, Any]) -> Any:
    """Return a noise with those of its fields that a record has; a value that is no such field is refused here."""
    fields = {name: each.annotation for name, each in signature(kind).parameters.items() if name in record}
    return kind(**{name: _field(name, declared, record[name]) for name, declared in fields.items()})


def _field(name: str, declared: Any, value: Any) -> Any:
    if isinstance(value, Mapping):
        return noise_from_dict(value) if "kind" in value else _filled(Motion, value)
    if declared in (float, int):
        return declared(value)
    if value is None or isinstance(value, str | int | float):
        return value
    if name in ("run_lengths", "steps", "kept", "outputs"):
        return tuple(value)
    if name in ("times", "bands"):
        return tuple(np.asarray(each, dtype=float) for each in value)
    return np.asarray(value, dtype=bool if name == "fresh" else float)
