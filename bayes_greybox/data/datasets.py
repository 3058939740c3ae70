"""Measured benchmark data sets, read from a folder of the user and checked by hash; nothing is downloaded."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError

from .reading.sources import INSTALL_TABLES
from .trajectories import Trajectories

FOLDER_VARIABLE = "BAYES_GREYBOX_DATA"  # environment variable that names the folder of the data sets
SILVERBOX_RATE = 1e7 / 2**14  # sampling rate of the Silverbox record, Hz
TANK_CLIP = 10.0  # level at which the sensor of the cascaded tanks saturates, V


@dataclass(frozen=True)
class BallDrops:
    """Falling balls.

    Attributes:
        data: runs named "<ball>, drop <number>" with the states y (height, m) and v (velocity, m/s, derived
            from the heights by the authors); time in s.
        balls: table indexed by ball with mass (kg), diameter (m) and the number of drops.
    """

    data: Trajectories
    balls: pd.DataFrame


def load_dataset(name: str, **options: Any) -> Any:
    """Load a measured data set by its name in `dataset_table()`.

    Args:
        name: one of the names in `dataset_table()`.
        **options: options of `load_silverbox`, `load_cascaded_tanks` or `load_falling_balls`, whichever is loaded.

    Raises:
        InputError: if the name or an option is unknown, or a file is missing or not the original.
    """
    if name not in _SETS:
        raise InputError(f'There is no data set "{name}"; there are {", ".join(_SETS)}.')
    known = list(signature(_SETS[name].load).parameters)
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise InputError(f'Data set "{name}" has no option "{option}"; {has}.')
    return _SETS[name].load(**options)


def dataset_table() -> pd.DataFrame:
    """List the data sets: files, folder, verification, hidden effect, source, terms.

    Returns:
        Table indexed by name. `found` is the folder that holds all files, or ""; `verified` is True if
        their hashes are those of the originals.
    """
    rows = []
    for name, entry in _SETS.items():
        files = entry.files
        folder = next((f for f in search_folders() if all((f / file).is_file() for file in files)), None)
        verified = folder is not None and all(_sha256(folder / f) == h for f, h in files.items())
        place = str(folder) if folder is not None else ""
        rows.append((name, ", ".join(files), place, verified, entry.hidden_effect, entry.source, entry.terms))
    columns = ["name", "files", "found", "verified", "hidden effect", "source", "terms"]
    return pd.DataFrame(rows, columns=columns).set_index("name")


def search_folders() -> list[Path]:
    """Return the folders that may hold the data sets, in the order in which they are searched."""
    from platformdirs import user_cache_path

    named = os.environ.get(FOLDER_VARIABLE)
    return [*([Path(named)] if named else []), user_cache_path("bayes_greybox", appauthor=False, opinion=False)]


def load_silverbox(remove_offset: bool = False) -> dict[str, Trajectories]:
    """Load Silverbox: an electronic Duffing oscillator (Wigren & Schoukens 2013, ECC).

    Input u (V1) and output y (V2) in volts, time in seconds at 610.35 Hz. V1 carries an offset of about 6.2
    mV that is no part of the excitation; raw values stay unless asked, and a model of raw values needs a
    constant term.

    Args:
        remove_offset: subtract the mean of V1 over the whole record.

    Returns:
        The official parts: "multisine_train" and "multisine_test" (first 75 % and last 25 % of samples
        40650–127400), "arrow" (samples 100–40575) and "arrow_no_extrapolation" (its first 32000 samples).
    """
    import scipy.io

    content = scipy.io.loadmat(_locate("silverbox", "silverbox/SNLS80mV.mat"))
    u, y = (np.asarray(content[key], dtype=float).reshape(-1) for key in ("V1", "V2"))
    if remove_offset:
        u = u - np.mean(u)
    cut = 40650 + round(0.75 * (127400 - 40650))
    parts = {"multisine_train": (40650, cut), "multisine_test": (cut, 127400)}
    parts |= {"arrow": (100, 40575), "arrow_no_extrapolation": (100, 32100)}
    return {
        name: _volts(name, np.arange(start, stop) / SILVERBOX_RATE, y[start:stop], u[start:stop])
        for name, (start, stop) in parts.items()
    }


def _volts(name: str, time: np.ndarray, y: np.ndarray, u: np.ndarray, **options: Any) -> Trajectories:
    units = {"y": "V", "u": "V", "t": "s"}
    return Trajectories.from_arrays(time, states={"y": y}, inputs={"u": u}, units=units, run_names=[name], **options)


def load_cascaded_tanks(clipped: str = "keep") -> dict[str, Trajectories]:
    """Load the cascaded tanks: a pump fills an upper tank that empties into a lower one (Schoukens et al. 2016).

    Pump voltage u and lower level y in volts, every 4 s. The level sensor saturates at 10 V: samples there
    show only that the level was at least that high.

    Args:
        clipped: "keep" leaves saturated samples in, for free runs scored as the benchmark scores them; "drop"
            leaves out their rows and counts them in `dropped`, which makes sampling uneven, so that the runs
            cannot be differentiated across the gap.

    Returns:
        "train" (estimation record) and "test" (validation record), 1024 samples each before dropping.
    """
    if clipped not in ("keep", "drop"):
        raise InputError(f'clipped must be "keep" or "drop", not {clipped!r}.')
    table = pd.read_csv(_locate("cascaded_tanks", "cascaded_tanks/dataBenchmark.csv"))
    out = {}
    for name, suffix in (("train", "Est"), ("test", "Val")):
        level, pump = (table[f"{column}{suffix}"].to_numpy(dtype=float) for column in "yu")
        if clipped == "drop":
            level = np.where(level >= TANK_CLIP, np.nan, level)
        missing = "drop" if clipped == "drop" else "error"
        out[name] = _volts(name, 4.0 * np.arange(len(level)), level, pump, missing=missing)
    return out


IMPACT = 3  # number of frames at the end of a drop that `by_ball` leaves out: the ball hits the ground there


def load_falling_balls(by_ball: bool = False) -> BallDrops:
    """Load the falling balls: eleven balls dropped from a bridge, filmed at 15 Hz (de Silva et al. 2020).

    Reading the workbook needs openpyxl, which comes with the extra `tables`.

    Args:
        by_ball: If true, return the data for one model of all drops: the heights alone, without the last `IMPACT`
            frames of each drop, and for each ball an input that is one in its drops and zero in all others
            ("tennis_ball").

    Returns:
        The drops and the table of balls; mass and diameter of the volleyball are not known (NaN).
    """
    path = _locate("falling_balls", "falling_balls/Ball_drops_data.xlsx")
    try:
        # No drop has 200 frames, but some sheets are formatted down to the last possible row.
        sheets = pd.read_excel(path, sheet_name=None, nrows=1000)
    except ImportError as error:
        raise InputError(f'Reading "{path}" needs openpyxl; {INSTALL_TABLES}.') from error
    runs, drops = {}, {}
    for ball, sheet in sheets.items():
        each = list(sheet.dropna(subset=["Drop #"]).groupby("Drop #", sort=False))
        runs |= {f"{ball}, drop {int(float(str(drop)))}": rows for drop, rows in each}
        drops[str(ball)] = len(each)

    def columns(name: str) -> list[np.ndarray]:
        return [rows[name].to_numpy(dtype=float)[: -IMPACT if by_ball else None] for rows in runs.values()]

    times, states, inputs, units = columns("Time (s)"), {"y": columns("Height (m)")}, {}, {"y": "m", "t": "s"}
    if by_ball:
        for ball in drops:
            dropped = [float(name.partition(",")[0] == ball) for name in runs]
            one_hot = [np.full(len(time), each) for time, each in zip(times, dropped, strict=True)]
            inputs[ball.lower().replace(" ", "_")] = one_hot
    else:
        states, units = states | {"v": columns("Velocity (m/s)")}, {"y": "m", "v": "m/s", "t": "s"}
    constant = "keep" if by_ball else "error"
    data = Trajectories.from_arrays(
        times, states=states, inputs=inputs, units=units, run_names=list(runs), constant=constant
    )
    return BallDrops(data, _ball_table(drops))


def load_hudson_bay() -> Trajectories:
    """Load the Hudson Bay record: hare and lynx pelts in thousands, by years, 1900–1920 (Odum 1953), as one run."""
    table = np.loadtxt(_locate("hudson_bay", "hudson_bay/hudson_bay_data.dat"), encoding="ascii")
    return Trajectories.from_arrays(table[:, 0], states={"hare": table[:, 1], "lynx": table[:, 2]}, units={"t": "year"})


class _DataSet(NamedTuple):
    load: Callable[..., Any]
    hidden_effect: str
    source: str
    terms: str
    files: dict[str, str]


_SETS = {
    "silverbox": _DataSet(
        load_silverbox, "cubic stiffness", "Wigren & Schoukens, European Control Conference 2013", "no licence stated",
        {"silverbox/SNLS80mV.mat": "5c7413a52255af0cb4e2f93fb6903beb92b08965ba1e6ad0a6ffedfed8477ed4"},
    ),
    "cascaded_tanks": _DataSet(
        load_cascaded_tanks, "square-root outflow, overflow", "Schoukens et al. 2016, DOI 10.4121/12960104",
        "CC BY-SA 4.0",
        {"cascaded_tanks/dataBenchmark.csv": "ef2388ed822f3aef4aa80d6b0f2b466dd80b361786b3eafc7a2957c31ea323a7"},
    ),
    "falling_balls": _DataSet(
        load_falling_balls, "quadratic drag", "de Silva et al. 2020, Frontiers in Artificial Intelligence", "MIT",
        {
            "falling_balls/Ball_drops_data.xlsx": "942b2d68abfff3828ca323de491435d4ec27c3a22e62cee0cbdf52c2e8d1c0ed",
            "falling_balls/balls.txt": "7cc282a6559ef636ce30cad53aae5bf825ce6200a94dd54f668af9797c584585",
        },
    ),
    "hudson_bay": _DataSet(
        load_hudson_bay, "predation (bilinear interaction)", "Odum 1953, Fundamentals of Ecology",
        "as tabulated in many texts",
        {"hudson_bay/hudson_bay_data.dat": "7653cdd9cf35c34620c87b0d93cc2858b5214180a93eea0f7b2096e1b471b6bb"},
    ),
}  # fmt: skip

# Names in the list of masses and sizes that are not the sheet's name in lower case.
_BALL_KEYS = {
    "Whiffle Ball 1": "wiffleball1", "Whiffle Ball 2": "wiffleball2", "Yellow Whiffle Ball": "yellowWiffle",
    "Orange Whiffle Ball": "orangeWiffle",
}  # fmt: skip
_OUNCE = 0.028349523125  # kg


def _ball_table(drops: dict[str, int]) -> pd.DataFrame:
    lines = _locate("falling_balls", "falling_balls/balls.txt").read_text(encoding="ascii").splitlines()
    listed = {parts[0]: parts[1:] for parts in (line.split() for line in lines) if len(parts) == 3}
    rows = []
    for ball, n_drop in drops.items():
        key = _BALL_KEYS.get(ball, ball.lower().replace(" ", ""))
        ounces, circumference = (float("nan") if text == "??" else float(text) for text in listed[key])
        rows.append((ball, ounces * _OUNCE, circumference / 100.0 / np.pi, n_drop))
    return pd.DataFrame(rows, columns=["ball", "mass", "diameter", "drops"]).set_index("ball")


def _locate(name: str, file: str) -> Path:
    """Return the path of a verified file."""
    entry, folders = _SETS[name], search_folders()
    path = next((folder / file for folder in folders if (folder / file).is_file()), None)
    if path is None:
        places = " and ".join(f'"{folder}"' for folder in folders)
        raise InputError(
            f'The file "{file}" of data set "{name}" was not found in {places}; get it from its source '
            f"({entry.source}) and name its folder in the environment variable {FOLDER_VARIABLE}."
        )
    if _sha256(path) != entry.files[file]:
        raise InputError(
            f'"{path}" is not the original file of data set "{name}" (its SHA-256 differs); get it from its '
            f"source ({entry.source})."
        )
    return path


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
