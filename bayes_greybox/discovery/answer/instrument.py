"""Table of the measurement's errors: channels that are late, scaled, offset or bent, and noise that is not white."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.samples.clipping import clipped_in_words, seen_samples
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.decision.decide import Verdict
from bayes_greybox.discovery.grid.noise.points import SENSOR_NOISE
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.linearise.source import Source
from bayes_greybox.discovery.regressors.regressors import SENSOR
from bayes_greybox.discovery.sensor_errors.bends import BEND_POWERS
from bayes_greybox.discovery.sensor_errors.channels import DELAY, DELAY_STEPS, GAIN, STATES, ChannelSuspect
from bayes_greybox.discovery.ties import sorted_by_probability
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, VARYING
from bayes_greybox.physics.units import target_unit

from .coefficients import Coefficients
from .interval import REACH

NOISY = "noisy state"
"""A state whose samples carry white noise of their own."""

CLIPPED = "clipping"

MISREAD = "misreadings"

IN_MODEL = "in the model"
"""Status of what the answer takes for true."""

LISTED = 0.01
"""Suspects below this probability are not listed."""

COLUMNS = (
    "equation", "suspect", "channel", "probability", "mean", "sd", "lower", "upper", "unit", "samples",
    "lower_samples", "upper_samples", "status", "text",
)  # fmt: skip

ALIKE = 0.8
"""Ends of a range that are as far from the middle of a bend but for this share are alike."""


def instrument_table(
    source: Source, near: Near, verdict: Verdict, coefficients: Coefficients, data: Trajectories
) -> pd.DataFrame:
    """Return what is suspected of the measurement, by probability.

    A delay is positive where its channel is late, and given in time units and in samples; a gain is relative.

    Args:
        source: Rows that were out, and noise on samples.
        near: Hypotheses.
        verdict: The answer.
        coefficients: Draws of the sizes of sensor errors that are in the answer.
        data: Measurements, for units.
    """
    rows: list[dict[str, Any]] = []
    regressors, right = near.regressors, near.rows.data.samples or near.rows.data
    equation = regressors.equation
    index = {regressors.columns[i].called: i for i in regressors.of_kind(SENSOR)}
    places = {regressors.columns[i].called: k for k, i in enumerate(coefficients.suspects)}
    for key, share in verdict.probabilities.by_sensor.items():
        if share.probability < LISTED:
            continue
        column = regressors.columns[index[key]]
        suspect, unit = column.suspect, regressors.target_scale / column.scale
        assert suspect is not None
        if key in places:
            draws = coefficients.suspect_draws[:, places[key]] * unit
            mean, sd = float(np.mean(draws)), float(np.std(draws))
        else:
            h = next(h for h in near.weighed.hypotheses if index[key] in h.members)
            k = h.members.index(index[key])
            mean, sd = float(h.mean[k]) * unit, float(h.sd[k]) * abs(unit)
        rows.append(_row(equation, suspect, share.probability, mean, sd, key in places, data, right))
    rows += _noise_rows(near, verdict, data)
    for name, late in source.late.items():
        suspect = ChannelSuspect(DELAY, name, DELAY_STEPS * late.step, late.step)
        rows.append(_row(equation, suspect, 1.0 - late.p, late.by, late.sd, True, data, right))
    for name, noise in source.sample_noise.items():
        unit = data.unit(name) or ""
        text = f"samples of {name} have noise of {noise.sd:.2g} {unit_text(unit)}".rstrip()
        rows.append(_blank(equation, NOISY, name, 1.0, IN_MODEL, text) | {"mean": noise.sd, "unit": unit})
    for name, at_end in source.clipped.items():
        rows.append(_blank(equation, CLIPPED, name, 1.0, IN_MODEL, clipped_in_words(name, at_end)))
    for name, out in source.misread.items():
        text = f"{name} is misread at {int(np.sum(out))} samples, which are left out"
        rows.append(_blank(equation, MISREAD, name, 1.0, IN_MODEL, text))
    found = pd.DataFrame(rows, columns=list(COLUMNS))
    return sorted_by_probability(found, ignore_index=True)


def _noise_rows(near: Near, verdict: Verdict, data: Trajectories) -> list[dict[str, Any]]:
    """Return what is suspected of the noise."""
    p, rows = verdict.probabilities, []
    likeliest = near.weighed.grid.points[verdict.hypothesis.point]
    together = p.by_discrepancy[SENSOR_NOISE]
    if together >= LISTED:
        every = zip(verdict.hypothesis.points, near.weighed.grid.points, strict=True)
        points = [(float(share), point) for share, point in every if point.kind == SENSOR_NOISE]
        _, best = max(points, key=lambda item: item[0])
        rho = float(np.exp(-near.rows.force.step / best.scale)) * best.ratio**2 / (1 + best.ratio**2)
        size: dict[str, Any] = {"correlation": rho, "time_scale": best.scale}
        inside = likeliest.kind == SENSOR_NOISE
        rows.append(_noise_row(near.regressors.equation, CORRELATED, together, size, inside, data))
    shares: dict[str, float] = {}
    about: dict[str, Mapping[str, Any]] = {}
    for number, shape in enumerate(near.rows.point.shapes, start=1):
        for name in shape.about:
            shares[name] = shares.get(name, 0.0) + p.by_shape.get(number, 0.0)
            about[name] = shape.about[name]
    inside = set(near.rows.point.shapes[likeliest.shape - 1].about) if likeliest.shape else set()
    for name, share in shares.items():
        if share >= LISTED:
            rows.append(_noise_row(near.regressors.equation, name, share, about[name], name in inside, data))
    return rows


def _blank(equation: str, kind: str, channel: str, p: float, status: str, text: str) -> dict[str, Any]:
    empty = dict.fromkeys(COLUMNS, np.nan)
    return {
        **empty, "equation": equation, "suspect": kind, "channel": channel, "probability": min(p, 1.0), "unit": "",
        "status": status, "text": text,
    }  # fmt: skip


def _row(
    equation: str, suspect: ChannelSuspect, p: float, mean: float, sd: float, in_model: bool, data: Trajectories,
    samples: Trajectories,
) -> dict[str, Any]:  # fmt: skip
    low, high = mean - REACH * sd, mean + REACH * sd
    time = data.unit("t") or ""
    channel = "all states" if suspect.channel == STATES else suspect.channel
    row = _blank(equation, suspect.kind, suspect.channel, p, IN_MODEL if in_model else "", "")
    row |= {"mean": mean, "sd": sd, "lower": low, "upper": high}
    if suspect.kind == DELAY:
        way = "late" if mean >= 0 else "early"
        row |= {
            "unit": time, "samples": mean / suspect.step, "lower_samples": low / suspect.step,
            "upper_samples": high / suspect.step,
            "text": f"{channel} {'are' if suspect.channel == STATES else 'is'} {abs(mean):.3g} {time}".rstrip()
            + f" {way} ({abs(mean / suspect.step):.2g} samples)",
        }  # fmt: skip
    elif suspect.kind == GAIN:
        row |= {"text": f"{channel} reads {100 * abs(mean):.3g}\u00a0% too {'large' if mean >= 0 else 'small'}"}
    elif suspect.kind in BEND_POWERS:
        row |= _bend(suspect, mean, samples, unit_text(data.unit(suspect.channel)))
    else:
        rate = suspect.channel not in data.columns
        unit = target_unit(equation, data) if rate else data.unit(suspect.channel)
        row |= {
            "unit": unit or "",
            "text": f"{channel} has {_article(suspect.kind)} of {mean:.3g} {unit_text(unit)}".rstrip(),
        }
    return row


def _bend(suspect: ChannelSuspect, mean: float, samples: Trajectories, unit: str) -> dict[str, str]:
    """Unit of a bend's coefficient, and how far off the sensor is where that is most; of like ends the upper one."""
    power, values = BEND_POWERS[suspect.kind], samples.column(suspect.channel)[seen_samples(samples)]
    low, high = float(np.min(values)), float(np.max(values))
    x = high if high - suspect.center >= ALIKE * (suspect.center - low) else low
    off = mean * (x - suspect.center) ** power
    sizes = (f"{value:.3g} {unit}".rstrip() for value in (abs(off), x))
    return {
        "unit": unit_text("1" + f"/({unit})" * (power - 1)) if unit else "",
        "text": f"{suspect.channel} reads {next(sizes)} too {'large' if off >= 0 else 'small'} at {next(sizes)}: "
        "its sensor bends",
    }


def _article(kind: str) -> str:
    return f"an {kind}" if kind[0] in "aeiou" else f"a {kind}"


def _noise_row(
    equation: str, name: str, p: float, about: Mapping[str, Any], inside: bool, data: Trajectories
) -> dict[str, Any]:
    channel, time = data.target_label(equation), data.unit("t") or ""
    if equation not in data.derivatives or data.samples is not None:
        # Rows are the samples of the sensors, and no rates.
        channel = " and ".join((data.samples or data).state_names)
    row = _blank(equation, name, channel, p, IN_MODEL if inside else "", "")
    if name == CORRELATED:
        row |= {
            "mean": about["correlation"],
            "text": f"the noise of {channel} is correlated over {about['time_scale']:.2g} {time}".rstrip()
            + f" ({about['correlation']:.2f} from one sample to the next)",
        }
    elif name == VARYING:
        verb = "grows" if about["exponent"] > 0 else "shrinks"
        row |= {"mean": about["exponent"], "text": f"the noise of {channel} {verb} with |{about['variable']}|"}
    elif name == HEAVY:
        row |= {
            "mean": about["degrees"],
            "text": f"the noise of {channel} has outliers (Student t, {about['degrees']:g} degrees of freedom)",
        }
    return row
