"""Rows that a sensor did not measure as it should: at its end, where it slipped, or at another time."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from bayes_greybox.data.samples.clipping import clipped
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import Rate, measured_at, shifted, slope_along, within
from bayes_greybox.discovery.sensor_errors.late import Late
from bayes_greybox.discovery.sensor_errors.samples import misread


def at_end(data: Trajectories, equation: str) -> dict[str, Bool[np.ndarray, " n_obs"]]:
    """Rows at which the sensor of the rate was at its end, by what it is called in tables."""
    # A state may rest, and an input may be held; a rate that stays to the last bit where it is largest is clipped.
    if not _separable(data):
        return {}
    values = data.rate(equation)
    # An output may rest too, as a force does in a dead zone: only where it is noisy it does not stay by itself.
    if data.is_output(equation) and not sample_noise(data.time, values[:, None], data.run_lengths)[0] > 0:
        return {}
    return clipped({data.target_label(equation): values}, data.run)


def mended(data: Trajectories, equation: str, rate: Rate) -> tuple[Trajectories, dict[str, Bool[np.ndarray, " n_obs"]]]:
    """The data without slips of sensors, and where these were."""
    if not _separable(data) or equation not in data.derivatives:
        return data, {}
    found, columns, ones = {}, {}, np.ones(data.n_obs)
    for name in (*data.state_names, *data.input_names):
        slope = slope_along(data, rate, name, ones)
        out, better = misread(data.column(name), data.run, data.rate(equation), slope)
        if np.any(out):
            found[name], columns[name] = out, better
    states = {name: columns.get(name, x) for name, x in data.states.items()}
    inputs = {name: columns.get(name, x) for name, x in data.inputs.items()}
    return (replace(data, states=states, inputs=inputs) if found else data), found


def usable(
    data: Trajectories, equation: str, delays: Mapping[str, float], out: Sequence[np.ndarray]
) -> Bool[np.ndarray, " n_obs"]:
    """Rows that are not out, and whose states and inputs were measured where delays take them."""
    used = np.ones(data.n_obs, bool)
    if _separable(data):
        used = within(data, equation, delays)
    for rows in out:
        used = used & ~rows
    return used


def earlier(data: Trajectories, late: Mapping[str, Late]) -> Trajectories:
    """Data with late states as they were."""
    return shifted(data, {name: found.by for name, found in late.items()}) if late else data


def beyond(data: Trajectories, late: Mapping[str, Late]) -> list[Bool[np.ndarray, " n_obs"]]:
    """Rows at ends of runs that a late state was not measured at."""
    if not late or not _separable(data):
        return []
    return [~measured_at(data, {found.by for found in late.values()})]


def _separable(data: Trajectories) -> bool:
    """Whether a row can be left out: rows of a filter hang together."""
    return all(noise.local for noise in data.noise.values())
