"""A finished study made of plausible arrays: a forced oscillator whose cubic spring was not in the simulation."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.criticism.bands import Band
from bayes_greybox.criticism.convergence import Verdict
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.gap import FreePath
from bayes_greybox.discovery.where import GapMap, GapTrace
from bayes_greybox.greybox import GreyBox
from bayes_greybox.missing_effects import Study

TERM, ADDED = "y**3", "added"
SENTENCE = (
    "The simulation misses a cubic spring (probability 0.97): adding −0.80·y³ to d(ydot)/dt closes 99 % of the gap on "
    "data that were not used to find it."
)


def oscillator(n: int = 400, seed: int = 0) -> Trajectories:
    """Two forced runs of y'' = F − y − 0.1 y' − 0.8 y³, by Euler's method; a row every 20 steps."""
    rng = np.random.default_rng(seed)
    times, columns = [], {"y": [], "ydot": [], "a": [], "F": []}
    step = 0.01
    for run in range(2):
        y, v, path = 0.2, 0.0, []
        for s in step * np.arange(20 * (n // 2)):
            force = 0.6 * np.cos((0.9 + 0.25 * run) * s + seed) + 0.3 * np.sin(0.31 * s)
            a = force - y - 0.1 * v - 0.8 * y**3
            path.append((y, v, a, force))
            y, v = y + step * v, v + step * a
        rows = np.array(path)[::20]
        rows[:, 2] += 0.05 * rng.standard_normal(len(rows))
        times.append(20 * step * np.arange(len(rows)))
        for name, column in zip(columns, rows.T, strict=True):
            columns[name].append(column)
    return Trajectories.from_arrays(
        times,
        states={"y": columns["y"], "ydot": columns["ydot"]},
        derivatives={"ydot": columns["a"]},
        inputs={"F": columns["F"]},
        units={"t": "s", "y": "m", "ydot": "m/s", "F": "m/s**2"},
        run_names=["slow sweep", "fast sweep"],
    )


def fake_study(**changes: Any) -> Study:
    """The study; keyword arguments replace its fields."""
    train, test = oscillator(), oscillator(seed=1)
    base = GreyBox({"ydot": ["y"]}, simulation={"y": "ydot", "ydot": "F - y - 0.1*ydot"})
    fields: dict[str, Any] = {
        "base": base,
        "model": GreyBox({"ydot": ["y", TERM]}, simulation=base.simulation),
        "fit": fake_fit(),
        "train": train,
        "test": test,
        "verdict": "named",
        "sentence": SENTENCE,
        "effects": effects(),
        "hypotheses": hypotheses(),
        "corrections": corrections(),
        "where": where(),
        "gap": gap_table(),
        "rounds": rounds(),
        "ties": [
            {
                "equation": "ydot",
                "slugs": ("cubic-stiffness", "pendulum-restoring"),
                "advice": "Drive the system to |y| > 1.1 m: a cubic spring and a sine differ by 4 noise SD there.",
            }
        ],
        "maps": {"ydot": gap_map(train)},
        "traces": {"ydot": gap_trace(train)},
        "paths": free_paths(test),
        "left_out": {("ydot", "input-gain"): "the model has this term already: a change of it is a recalibration"},
        "settings": {
            "seed": 0,
            "catalogue": "mechanical",
            "prior odds": {"no gap": 0.5, "recalibrate": 0.2},
            "thresholds": {"gap": "one noise SD", "tie": 0.05},
            "seconds": {"gap": 1.3, "screen": 2.4, "settle": 9.87},
            "versions": {"python": "3.11.9", "bayes-greybox": "0.1.0", "jax": "0.10"},
        },
    }
    study = object.__new__(Study)
    # Not by its constructor, which would insist on a real fit.
    study.__dict__.update({**fields, **changes})
    return study


def fake_fit(ok: bool = True, seed: int = 0) -> Any:
    """What the page reads of a fit: its verdict and the draws of θ."""
    import xarray as xr

    rng = np.random.default_rng(seed)
    theta = np.stack([rng.normal(0.0, 0.002, (4, 500)), rng.normal(-0.80, 0.013, (4, 500))], axis=2)
    posterior = xr.Dataset({"ydot_theta": (("chain", "draw", "ydot_term"), theta)}, coords={"ydot_term": ["y", TERM]})
    reasons = () if ok else ("R̂ of ydot_sigma is 1.04; sample longer (draws=2000).", "12 divergences; raise tune.")
    summary = pd.DataFrame(
        {"mean": [0.0, -0.8], "sd": [0.002, 0.013], "r_hat": [1.001, 1.002], "ess_bulk": [1900.0, 2100.0]},
        index=pd.MultiIndex.from_tuples([("ydot", "y"), ("ydot", TERM)], names=["equation", "quantity"]),
    )
    return SimpleNamespace(
        verdict=Verdict(ok, reasons),
        idata=xr.DataTree.from_dict({"posterior": posterior}),
        save=lambda path: Path(path).write_bytes(b"netCDF"),
        summary=lambda level=0.9: summary,
    )


def effects() -> pd.DataFrame:
    rows = [
        ("cubic-stiffness", "cubic spring", TERM, 0.97, -0.80, 0.013, "1/m²/s²", ("pendulum-restoring",), {}, ADDED),
        ("pendulum-restoring", "pendulum restoring force", "sin(2.1*y)", 0.02, -0.31, 0.02, "m/s²", (), {}, ""),
        ("signed-quadratic-stiffness", "signed quadratic spring", "y*abs(y)", 0.006, -0.7, 0.02, "1/m/s²", (), {}, ""),
        ("dead-zone", "dead zone", "max(abs(y) - 0.21, 0)*sign(y)", 0.003, 1.2, 0.2, "1/s²", (), {"gap": 0.21}, ""),
        ("coulomb-friction", "Coulomb friction", "sign(ydot)", 0.001, 0.01, 0.01, "m/s²", (), {}, ""),
    ]
    columns = ["slug", "name", "expression", "probability", "mean", "sd", "unit", "tied_with", "inner", "status"]
    table = pd.DataFrame(rows, columns=columns)
    table.insert(0, "equation", "ydot")
    table.insert(7, "lower", table["mean"] - 1.645 * table["sd"])
    table.insert(8, "upper", table["mean"] + 1.645 * table["sd"])
    return table


def hypotheses(equation: str = "ydot") -> pd.DataFrame:
    rows = {
        "cubic-stiffness": (0.97, 812.4, 0.004),
        "pendulum-restoring": (0.02, 808.5, 0.021),
        "signed-quadratic-stiffness": (0.006, 807.3, 0.09),
        "dead-zone": (0.003, 806.6, 0.12),
        "coulomb-friction": (1e-9, 770.1, 0.93),
        "unknown": (1e-3, 805.0, 1.0),
        "recalibrate": (1e-6, 750.3, 0.71),
        "no gap": (1e-30, 640.0, 0.0),
    }
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["probability", "log_evidence", "share_left"])
    table.index = pd.MultiIndex.from_product([[equation], table.index], names=["equation", "hypothesis"])
    return table


def corrections() -> pd.DataFrame:
    rows = {("ydot", "y"): (-1.0, 0.03), ("ydot", "ydot"): (-0.1, 0.61)}
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["nominal", "probability"])
    table["mean"], table["sd"] = [0.0, -0.008], [0.002, 0.004]
    table["lower"], table["upper"] = [-0.003, -0.014], [0.003, -0.001]
    table["unit"] = ["1/s²", "1/s"]
    table.index = pd.MultiIndex.from_tuples(table.index, names=["equation", "term"])
    return table


def where() -> pd.DataFrame:
    rows = [
        ("ydot", "region", "|y| > 0.71 m", 0.998, 0.83, 0.19),
        ("ydot", "region", "y < −0.52 m and ydot > 0.3 m/s", 0.91, 0.11, 0.06),
        ("ydot", "window", "slow sweep, 12.4 s to 17.9 s", 0.97, 0.35, 0.09),
    ]
    return pd.DataFrame(rows, columns=["equation", "kind", "description", "probability", "gap_share", "sample_share"])


def gap_table(data: tuple[str, ...] = ("train", "test")) -> pd.DataFrame:
    numbers = {
        ("derivative NMSE", "ydot"): (0.412, 0.0034, 0.0029, 0.0041),
        ("free-run NRMSE", "y"): (0.93, 0.021, 0.016, 0.03),
        ("free-run NRMSE", "ydot"): (1.21, 0.034, 0.027, 0.045),
        ("unexplained share", "ydot"): (0.409, 0.0016, 0.0004, 0.0039),
        ("time to failure", "all"): (17.3, np.inf, np.nan, np.nan),
    }
    rows = {(part, *key): value for part in data for key, value in numbers.items()}
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["before", "after", "lower", "upper"])
    table["closed"] = 1 - table["after"] / table["before"]
    table.loc[[key[1] == "time to failure" for key in table.index], "closed"] = np.nan
    table.index = pd.MultiIndex.from_tuples(table.index, names=["data", "metric", "variable"])
    return table


def rounds() -> pd.DataFrame:
    rows = {
        ("ydot", 1): ("cubic-stiffness", "cubic-stiffness", 0.97, "pendulum-restoring", 0.02, 0.004),
        ("ydot", 2): ("enough", "", 0.94, "viscous-damping", 0.03, 0.003),
    }
    columns = ["verdict", "added", "probability", "runner_up", "runner_up_probability", "share_left"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    table.index = pd.MultiIndex.from_tuples(table.index, names=["equation", "round"])
    return table


def gap_map(data: Trajectories, n_var: int = 2, n: int = 41, equation: str = "ydot") -> GapMap:
    variables = ("y", "ydot")[:n_var]
    samples = data.matrix(variables)
    axes = [np.linspace(column.min(), column.max(), n) for column in samples.T]
    mesh = np.meshgrid(*axes, indexing="ij")
    before = -0.8 * mesh[0] ** 3 + 0.02 * np.sin(5 * mesh[-1])
    after = 0.015 * np.sin(4 * mesh[0]) * np.cos(3 * mesh[-1])
    return GapMap(
        equation=equation,
        variables=variables,
        axes=tuple(axes),
        before=before,
        after=after,
        probability=1 / (1 + np.exp(-(np.abs(before) - 0.05) / 0.01)),
        after_probability=1 / (1 + np.exp(-(np.abs(after) - 0.05) / 0.01)),
        samples=samples,
        threshold=0.05,
        unit="m/s²",
        units=("m", "m/s")[:n_var],
    )


def gap_trace(data: Trajectories, equation: str = "ydot") -> GapTrace:
    rng = np.random.default_rng(0)
    before = -0.8 * data.states["y"] ** 3
    after = 0.01 * np.sin(data.time) + 0.002 * rng.standard_normal(data.n_obs)
    spread = np.full(data.n_obs, 0.012)
    return GapTrace(
        equation=equation,
        time=data.time,
        run=data.run,
        before=before,
        before_sd=spread,
        after=after,
        after_sd=0.5 * spread,
        probability=1 / (1 + np.exp(-(np.abs(before) - 0.05) / 0.01)),
        threshold=0.05,
        unit="m/s²",
    )


def free_paths(data: Trajectories) -> dict[str, FreePath]:
    paths = {}
    for name, measured in data.states.items():
        drift = 1.0 + 0.03 * data.time
        before = measured * drift + 0.3 * np.sin(1.3 * data.time)
        before = np.where(data.time > 31.0, np.nan, before) if name == "y" else before
        paths[name] = FreePath(
            time=data.time,
            run=data.run,
            measured=measured,
            before=_band(before, 0.02),
            after=_band(measured + 0.01 * np.sin(data.time), 0.015 + 0.0005 * data.time),
        )
    return paths


def _band(mean: np.ndarray, sd: Any) -> Band:
    sd = np.broadcast_to(sd, mean.shape).copy()
    return Band(mean, sd, mean - 1.645 * sd, mean + 1.645 * sd)
