"""What a study says of the measurement: channels that are late, scaled, offset or bent, and noise that is not white."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.samples.clipping import clipped_in_words, seen_samples
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.discovery.evidence.ties import sorted_by_probability
from bayes_greybox.discovery.suspects.bends import POWERS
from bayes_greybox.discovery.suspects.channels import DELAY, DELAY_STEPS, GAIN, LAG, STATES, ChannelSuspect
from bayes_greybox.discovery.weighing.aligned import Aligned
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING
from bayes_greybox.physics.units import target_unit

from .coefficients import Coefficients
from .doubt import contradicted
from .finding import Finding
from .weighed import Mirror

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

_REACH = 1.6448536269514722


def instrument_table(
    aligned: Aligned, finding: Finding, coefficients: Coefficients, data: Trajectories
) -> pd.DataFrame:
    """Suspects by probability.

    A delay is positive where its channel is late, and given in time units and in samples; a gain is relative. A lag of
    the sensor stands beside that of an input which does the same.

    Args:
        aligned: Delays that were undone, and noise on samples.
        finding: The answer.
        coefficients: Draws of the sizes of suspects that are in the answer.
        data: Measurements, for units.
    """
    statistics = finding.world.evaluations.statistics
    rows: list[dict[str, Any]] = []
    weighed, right = finding.weighed, aligned.data.samples or aligned.data
    places = {statistics.columns[i].suspect.key: k for k, i in enumerate(coefficients.suspects)}  # type: ignore[union-attr]
    for key, p in weighed.by_suspect.items():
        index = next(
            i
            for i in statistics.of_kind("suspect")
            if statistics.columns[i].suspect.key == key  # type: ignore[union-attr]
        )
        column = statistics.columns[index]
        suspect = column.suspect
        assert suspect is not None
        p = (
            aligned.probability.get(suspect.channel, p)
            if suspect.channel in aligned.delays and suspect.kind == DELAY
            else p
        )
        if p < LISTED:
            continue
        in_model = key in places
        scale = statistics.target_scale / column.scale
        if in_model:
            draws = coefficients.suspect_draws[:, places[key]] * scale
            mean, sd = float(np.mean(draws)), float(np.std(draws))
        else:
            other = next((w, e) for w, e, _, _ in weighed.items if index_of(w, key) in e.suspects)
            mean, sd = _moments(*other, key)
        if suspect.kind == DELAY:
            mean += aligned.delays.get(suspect.channel, 0.0)
        rows.append(_row(statistics.equation, suspect, p, mean, sd, in_model, data, right))
    for name, p in weighed.by_noise.items():
        if name == PROCESS or p < LISTED:
            continue
        about = next(w.model.about[name] for w in weighed.worlds if name in w.model.names)
        inside = name in finding.world.model.names
        rows.append(_noise_row(statistics.equation, name, p, about, inside, data))
    for name, late in aligned.late.items():
        suspect = ChannelSuspect(DELAY, name, DELAY_STEPS * late.step, late.step)
        p = contradicted(late.p, finding.world.evaluations.odds.suspect)
        rows.append(_row(statistics.equation, suspect, p, late.by, late.sd, True, data, right))
    effects = [statistics.columns[i].called for i in finding.base]
    for binding, p in weighed.by_mirror.items():
        mirror = weighed.mirrors[binding]
        times = np.array([mirror.time])
        if binding in effects:
            # The lag of the answer is as long.
            drawn = coefficients.inner[:, effects.index(binding)]
            times = np.array([time for i in drawn for time in statistics.columns[int(i)].inner.values()])
        rows.append(_lag_row(statistics.equation, mirror, p, times, data))
    for name, noise in aligned.sample_noise.items():
        unit = data.unit(name) or ""
        rows.append(
            _blank(
                statistics.equation,
                NOISY,
                name,
                1.0,
                IN_MODEL,
                f"samples of {name} have noise of {noise.sd:.2g} {unit_text(unit)}".rstrip(),
            )
            | {"mean": noise.sd, "unit": unit}
        )
    for name, rows_at_end in aligned.clipped.items():
        text = clipped_in_words(name, rows_at_end)
        rows.append(_blank(statistics.equation, CLIPPED, name, 1.0, IN_MODEL, text))
    for name, rows_misread in aligned.misread.items():
        text = f"{name} is misread at {int(np.sum(rows_misread))} samples, which are left out"
        rows.append(_blank(statistics.equation, MISREAD, name, 1.0, IN_MODEL, text))
    found = pd.DataFrame(rows, columns=list(COLUMNS))
    return sorted_by_probability(found, ignore_index=True)


def index_of(world: Any, key: str) -> int:
    """Column of a suspect in a world; -1 where it has none."""
    columns = world.evaluations.statistics.columns
    return next((i for i, c in enumerate(columns) if c.suspect is not None and c.suspect.key == key), -1)


def _moments(world: Any, e: Any, key: str) -> tuple[float, float]:
    statistics = world.evaluations.statistics
    index = index_of(world, key)
    mean, covariance = world.coefficients(e)
    k = world.evaluations.indices(e.columns).index(index)
    scale = statistics.target_scale / statistics.columns[index].scale
    return float(mean[k]) * scale, float(np.sqrt(max(covariance[k, k], 0.0))) * scale


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
    low, high = mean - _REACH * sd, mean + _REACH * sd
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
    elif suspect.kind in POWERS:
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
    power, values = POWERS[suspect.kind], samples.column(suspect.channel)[seen_samples(samples)]
    low, high = float(np.min(values)), float(np.max(values))
    x = high if high - suspect.center >= ALIKE * (suspect.center - low) else low
    off = mean * (x - suspect.center) ** power
    sizes = (f"{value:.3g} {unit}".rstrip() for value in (abs(off), x))
    return {
        "unit": unit_text("1" + f"/({unit})" * (power - 1)) if unit else "",
        "text": f"{suspect.channel} reads {next(sizes)} too {'large' if off >= 0 else 'small'} at {next(sizes)}: "
        "its sensor bends",
    }


def _lag_row(equation: str, mirror: Mirror, p: float, times: np.ndarray, data: Trajectories) -> dict[str, Any]:
    """A lag of the sensor that no column stands for: the answer's model has the effect that does the same."""
    mean, sd = float(np.mean(times)), float(np.std(times)) if len(times) > 1 else np.nan
    low, high = mean - _REACH * sd, mean + _REACH * sd
    unit, step = data.unit("t") or "", mirror.step
    row = _blank(equation, LAG, mirror.channel, p, "", "")
    return row | {
        "mean": mean, "sd": sd, "lower": low, "upper": high, "unit": unit, "samples": mean / step,
        "lower_samples": low / step, "upper_samples": high / step,
        "text": f"{mirror.channel} lags by {mean:.3g} {unit}".rstrip()
        + f" ({mean / step:.2g} samples), and {mirror.instead} does not",
    }  # fmt: skip


def _article(kind: str) -> str:
    return f"an {kind}" if kind[0] in "aeiou" else f"a {kind}"


def _noise_row(
    equation: str, name: str, p: float, about: Mapping[str, Any], inside: bool, data: Trajectories
) -> dict[str, Any]:
    channel, time = data.target_label(equation), data.unit("t") or ""
    if equation not in data.derivatives:
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
