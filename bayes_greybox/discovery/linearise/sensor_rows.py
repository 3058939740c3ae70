"""Rows that a sensor did not measure as it should: at its end, where it slipped, or at another time."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from bayes_greybox.data.samples.clipping import clipped
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import (
    Rate,
    measured_at,
    shifted,
    slope_along,
    with_columns,
    within,
)
from bayes_greybox.discovery.sensor_errors.late import Late
from bayes_greybox.discovery.sensor_errors.samples import misread


def at_end(data: Trajectories, equation: str) -> dict[str, Bool[np.ndarray, " n_obs"]]:
    """Return true at rows where the sensor of the rate was at its end, by its name in tables."""
    # A state may rest, and an input may be held; a rate that stays to the last bit where it is largest is clipped.
    if not _separable(data):
        return {}
    values = data.rate(equation)
    # An output may rest too, as a force does in a dead zone; a noisy one does not.
    if data.is_output(equation) and not sample_noise(data.time, values[:, None], data.run_lengths)[0] > 0:
        return {}
    return clipped({data.target_label(equation): values}, data.run)


def mended(data: Trajectories, equation: str, rate: Rate) -> tuple[Trajectories, dict[str, Bool[np.ndarray, " n_obs"]]]:
    """Return the data without slips of sensors, and true where these were, by channel."""
    if not _separable(data) or equation not in data.derivatives:
        return data, {}
    slips, columns, ones = {}, {}, np.ones(data.n_obs)
    for name, values in data.columns.items():
        slope = slope_along(data, rate, name, ones)
        out, better = misread(values, data.run, data.rate(equation), slope)
        if np.any(out):
            slips[name], columns[name] = out, better
    return (with_columns(data, columns) if slips else data), slips


def usable(
    data: Trajectories, equation: str, delays: Mapping[str, float], out: Sequence[np.ndarray]
) -> Bool[np.ndarray, " n_obs"]:
    """Return true for rows that are not out, and whose states and inputs were measured where delays take them."""
    used = within(data, equation, delays) if _separable(data) else np.ones(data.n_obs, bool)
    for rows in out:
        used = used & ~rows
    return used


def earlier(data: Trajectories, late: Mapping[str, Late]) -> Trajectories:
    """Return the data with late states at their own times."""
    return shifted(data, {name: each.by for name, each in late.items()}) if late else data


def beyond(data: Trajectories, late: Mapping[str, Late]) -> list[Bool[np.ndarray, " n_obs"]]:
    """Return rows at ends of runs that a late state was not measured at."""
    return [~measured_at(data, {each.by for each in late.values()})] if late and _separable(data) else []


def _separable(data: Trajectories) -> bool:
    """Return true if a row can be left out: the rows of a filter hang together."""
    return all(noise.local for noise in data.noise.values())
