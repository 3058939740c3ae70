"""Table of the measurement's errors: channels that are late, scaled, offset or bent, and noise that is not white."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.samples.clipping import clipped_in_words, seen_samples
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.decision.decide import Verdict
from bayes_greybox.discovery.grid.points import SENSOR_NOISE
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.linearise.source import Source
from bayes_greybox.discovery.regressors.regressors import SENSOR
from bayes_greybox.discovery.sensor_errors.bends import BEND_POWERS
from bayes_greybox.discovery.sensor_errors.channels import DELAY, DEPARTURE, GAIN, NOISE, STATES, ChannelSuspect
from bayes_greybox.discovery.sensor_errors.kinematics import pair_of
from bayes_greybox.discovery.ties import sorted_by_probability
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, VARYING
from bayes_greybox.physics.units import target_unit

from .coefficients import Coefficients
from .interval import INTERVAL_REACH

NOISY, CLIPPING, MISREAD = "noisy state", "clipping", "misreadings"
"""Errors that are removed before hypotheses are weighed: noise on samples of a state, ends of a range, slips."""

IN_MODEL = "in the model"
"""Status of errors that belong to the answer."""

LARGE_GAIN = 0.5
"""Error of a gain that no sensor has: it is said as a factor."""

LISTED = 0.01
"""Probability below which an error is not listed."""

Row = dict[str, Any]
"""Row of the table by column."""

INSTRUMENT_COLUMNS = (
    "equation", "suspect", "channel", "probability", "mean", "sd", "lower", "upper", "unit", "samples",
    "lower_samples", "upper_samples", "status", "text",
)  # fmt: skip


def instrument_table(
    source: Source, near: Near, verdict: Verdict, coefficients: Coefficients, data: Trajectories
) -> pd.DataFrame:
    """Return the suspected errors of the measurement, by probability; a delay is positive if its channel is late."""
    rows = [*_sensor_rows(near, verdict, coefficients, data), *_noise_rows(near, verdict, data)]
    for suspect, known in source.known.items():
        error = _error(suspect, known.size, known.sd, near, data)
        rows.append(_row(suspect.kind, suspect.channel, 1.0 - known.p, True) | error)
    for name, noise in source.sample_noise.items():
        unit = data.unit(name) or ""
        rows.append(_row(NOISY, name, 1.0, True, _noisy(name, noise.sd, unit)) | {"mean": noise.sd, "unit": unit})
    rows += [_row(CLIPPING, name, 1.0, True, clipped_in_words(name, at)) for name, at in source.clipped.items()]
    misread = {name: f"{name} is misread at {int(np.sum(out))} samples" for name, out in source.misread.items()}
    rows += [_row(MISREAD, name, 1.0, True, f"{text}, which are left out") for name, text in misread.items()]
    equation = {"equation": near.regressors.equation}
    return sorted_by_probability(pd.DataFrame([row | equation for row in rows], columns=list(INSTRUMENT_COLUMNS)), True)


def _noisy(name: str, sd: float, unit: str) -> str:
    return f"samples of {name} have noise of {abs(sd):.2g} {unit_text(unit)}".rstrip()


def _row(kind: str, channel: str, probability: float, in_model: bool, text: str = "") -> dict[str, Any]:
    about = {"suspect": kind, "channel": channel, "probability": min(probability, 1.0), "unit": ""}
    return dict.fromkeys(INSTRUMENT_COLUMNS, np.nan) | about | {"status": IN_MODEL if in_model else "", "text": text}


def _sensor_rows(near: Near, verdict: Verdict, coefficients: Coefficients, data: Trajectories) -> Iterator[Row]:
    columns = near.regressors.columns
    index = {columns[i].called: i for i in near.regressors.of_kind(SENSOR)}
    places = {columns[i].called: k for k, i in enumerate(coefficients.suspects)}
    for key, share in verdict.probabilities.by_sensor.items():
        if share.probability < LISTED:
            continue
        suspect, unit = columns[index[key]].suspect, near.regressors.target_scale / columns[index[key]].scale
        assert suspect is not None
        if key in places:
            draws = coefficients.suspect_draws[:, places[key]] * unit
            mean, sd = float(np.mean(draws)), float(np.std(draws))
        else:
            h = next(h for h in near.weighed.hypotheses if index[key] in h.members)
            k = h.members.index(index[key])
            mean, sd = float(h.mean[k]) * unit, float(h.sd[k]) * abs(unit)
        row = _row(suspect.kind, suspect.channel, share.probability, key in places)
        yield row | _error(suspect, mean, sd, near, data)


def _error(suspect: ChannelSuspect, mean: float, sd: float, near: Near, data: Trajectories) -> dict[str, Any]:
    low, high = mean - INTERVAL_REACH * sd, mean + INTERVAL_REACH * sd
    row: dict[str, Any] = {"mean": mean, "sd": sd, "lower": low, "upper": high}
    channel, are = ("all states", "are") if suspect.channel == STATES else (suspect.channel, "is")
    if suspect.kind == DELAY:
        steps, time = mean / suspect.step, data.unit("t") or ""
        size = f"{abs(mean):.3g} {time}".rstrip()
        text = f"{channel} {are} {size} {'late' if mean >= 0 else 'early'} ({abs(steps):.2g} samples)"
        in_samples = {"lower_samples": low / suspect.step, "upper_samples": high / suspect.step}
        return row | {"unit": time, "samples": steps, **in_samples, "text": text}
    if suspect.kind == GAIN and abs(mean) > LARGE_GAIN:
        check = "check its units" if mean > -1 else "check its sign"
        return row | {"text": f"{channel} reads {1 + mean:.4g} times what it should ({check})"}
    if suspect.kind == GAIN:
        return row | {"text": f"{channel} reads {100 * abs(mean):.3g}\u00a0% too {'large' if mean >= 0 else 'small'}"}
    if suspect.kind in BEND_POWERS:
        samples = near.rows.data.samples or near.rows.data
        return row | _bend(suspect, mean, samples, unit_text(data.unit(suspect.channel)))
    if suspect.kind == NOISE:
        unit = data.unit(suspect.channel) or ""
        return row | {"unit": unit, "text": _noisy(suspect.channel, mean, unit)}
    if suspect.kind == DEPARTURE:
        unit = data.unit(suspect.channel)
        state, rate = pair_of(near.rows.model.simulator(data), suspect.channel, data.state_names)
        other = f"the integral of {rate}" if suspect.channel == state else f"the slope of {state}"
        size = f"{abs(mean):.2g} {unit_text(unit)}".rstrip()
        return row | {"unit": unit or "", "text": f"{channel} departs from {other} by {size} (RMS)"}
    is_rate = suspect.channel not in data.columns
    unit = target_unit(near.regressors.equation, data) if is_rate else data.unit(suspect.channel)
    article = "an" if suspect.kind[0] in "aeiou" else "a"
    text = f"{channel} has {article} {suspect.kind} of {mean:.3g} {unit_text(unit)}".rstrip()
    return row | {"unit": unit or "", "text": text}


def _bend(suspect: ChannelSuspect, mean: float, samples: Trajectories, unit: str) -> dict[str, str]:
    """Return unit and text of a bend: the error at the end of the range where it is largest, the upper of like ends."""
    power, values = BEND_POWERS[suspect.kind], samples.column(suspect.channel)[seen_samples(samples)]
    low, high = float(np.min(values)), float(np.max(values))
    x = high if high - suspect.center >= 0.8 * (suspect.center - low) else low
    off = mean * (x - suspect.center) ** power
    size, place = (f"{value:.3g} {unit}".rstrip() for value in (abs(off), x))
    return {
        "unit": unit_text("1" + f"/({unit})" * (power - 1)) if unit else "",
        "text": f"{suspect.channel} reads {size} too {'large' if off >= 0 else 'small'} at {place}: its sensor bends",
    }


def _noise_rows(near: Near, verdict: Verdict, data: Trajectories) -> Iterator[Row]:
    p, points, equation = verdict.probabilities, near.weighed.grid.points, near.regressors.equation
    likeliest = points[verdict.hypothesis.point]
    correlated = p.by_discrepancy[SENSOR_NOISE]
    if correlated >= LISTED:
        of_kind = [k for k, point in enumerate(points) if point.kind == SENSOR_NOISE]
        best = points[max(of_kind, key=lambda k: float(verdict.hypothesis.points[k]))]
        rho = float(np.exp(-near.rows.force.step / best.scale)) * best.ratio**2 / (1 + best.ratio**2)
        about = {"correlation": rho, "time_scale": best.scale}
        yield _noise_row(equation, CORRELATED, correlated, about, likeliest.kind == SENSOR_NOISE, data)
    shapes, shares = near.rows.point.shapes, {}
    for number, shape in enumerate(shapes, start=1):
        for name, about in shape.about.items():
            shares[name] = shares.get(name, (0.0,))[0] + p.by_shape.get(number, 0.0), about
    inside = set(shapes[likeliest.shape - 1].about) if likeliest.shape else set()
    for name, (share, about) in shares.items():
        if share >= LISTED:
            yield _noise_row(equation, name, share, about, name in inside, data)


def _noise_row(equation: str, name: str, p: float, about: Row, inside: bool, data: Trajectories) -> Row:
    channel, time = data.target_label(equation), data.unit("t") or ""
    if equation not in data.derivatives or data.samples is not None:
        # Rows are the samples of the sensors, and no rates.
        channel = " and ".join((data.samples or data).state_names)
    row, noise = _row(name, channel, p, inside), f"the noise of {channel}"
    if name == CORRELATED:
        over, rho = f"{about['time_scale']:.2g} {time}".rstrip(), about["correlation"]
        text = f"{noise} is correlated over {over} ({rho:.2f} from one sample to the next)"
        return row | {"mean": rho, "text": text}
    if name == VARYING:
        verb = "grows" if about["exponent"] > 0 else "shrinks"
        return row | {"mean": about["exponent"], "text": f"{noise} {verb} with |{about['variable']}|"}
    if name == HEAVY:
        degrees = about["degrees"]
        return row | {"mean": degrees, "text": f"{noise} has outliers (Student t, {degrees:g} degrees of freedom)"}
    return row
