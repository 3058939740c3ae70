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

NOISE_KINDS = ("white", "banded", "spectral", "state space", "weighted", "starts", "forced", "overlapping")
"""Row noises that files of data and fits can hold, as `RowNoise.to_dict` calls them."""


def noise_from_dict(record: Mapping[str, Any]) -> RowNoise:
    """Rebuild a noise from `RowNoise.to_dict`.

    Args:
        record: mapping with the key "kind" (one of `NOISE_KINDS`) and the fields of that kind.

    Returns:
        The noise.

    Raises:
        InputError: if the kind is unknown.
    """
    fields = {key: value for key, value in record.items() if key != "kind"}
    if record["kind"] == "white":
        return WhiteNoise(tuple(fields["run_lengths"]))
    if record["kind"] == "banded":
        return BandedNoise(
            autocorrelation=np.asarray(fields["autocorrelation"], dtype=float),
            run_lengths=tuple(fields["run_lengths"]),
            run_variances=np.asarray(fields["run_variances"], dtype=float),
            scale=float(fields["scale"]),
            white_share=float(fields["white_share"]),
        )
    if record["kind"] == "spectral":
        return SpectralNoise(
            order=int(fields["order"]),
            run_lengths=tuple(fields["run_lengths"]),
            steps=tuple(fields["steps"]),
            kept=tuple(fields["kept"]),
            white_share=float(fields["white_share"]),
        )
    if record["kind"] == "state space":
        return StateSpaceNoise(
            times=tuple(np.asarray(t, dtype=float) for t in fields["times"]),
            process=fields["process"],
            time_scale=float(fields["time_scale"]),
            white=float(fields["white"]),
            scale=float(fields["scale"]),
        )
    if record["kind"] == "weighted":
        return WeightedNoise(
            inner=noise_from_dict(fields["inner"]),
            sd=np.asarray(fields["sd"], dtype=float),
            scale=float(fields["scale"]),
        )
    if record["kind"] == "starts":
        inner, starts = noise_from_dict(fields["inner"]), np.asarray(fields["starts"], dtype=float)
        return StartsNoise(inner, starts, scale=float(fields["scale"]))
    if record["kind"] == "forced":
        about = dict(fields["motion"])
        outputs, fresh = tuple(int(k) for k in about.pop("outputs")), np.asarray(about.pop("fresh"), bool)
        motion = Motion(fresh=fresh, outputs=outputs, **{k: np.asarray(v, float) for k, v in about.items()})
        sensor, starts = noise_from_dict(fields["sensor"]), np.asarray(fields["starts"], float)
        return ForcedNoise(sensor, motion, starts, float(fields["intensity"]), float(fields["scale"]))
    if record["kind"] == "overlapping":
        bands = tuple(np.asarray(band, dtype=float) for band in fields["bands"])
        return OverlappingNoise(bands, float(fields["scale"]))
    known = ", ".join(f'"{kind}"' for kind in NOISE_KINDS)
    raise InputError(f'Row noise of kind "{record["kind"]}" is unknown; the kinds are {known}.')
