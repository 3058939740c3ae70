"""The records: place of publication, simulation to begin with, and right answer.

The files are not part of the project. Each reader says where its file was published, and reads it from a folder, by a
name of its own: coastdown.csv, gause_f22.csv, and so on.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import loadmat

from bayes_greybox.data.trajectories import Trajectories

FROM_ARRAYS = Trajectories.from_arrays


@dataclass(frozen=True)
class Record:
    """One record as its owner would study it.

    Attributes:
        data: The samples.
        simulation: Right-hand sides to begin with.
        equation: Studied state or output.
        catalogue: Domain of effects.
        roles: Columns of roles that names cannot tell.
        right: Right answer by a textbook, the source, or least squares.
        sampled: True if the data are samples of states, without measured rates or outputs.
    """

    data: Trajectories
    simulation: dict[str, str]
    equation: str
    catalogue: str
    right: str
    roles: dict[str, str] = field(default_factory=dict)
    sampled: bool = True


def _coastdown(folder: Path) -> Record:
    """Abaiquni/Finding-Rolling-Resistance-and-Aerodynamic-Drag-Coefficients@83b5854, Data/rolling1.csv; s, km/h."""
    table = pd.read_csv(folder / "coastdown.csv", header=None).apply(pd.to_numeric, errors="coerce").dropna()
    table = table[table[0].diff().fillna(1) > 0]
    data = FROM_ARRAYS(table[0].to_numpy(), states={"v": table[1].to_numpy()})
    return Record(data, {"v": "-1.438e-4*v**2"}, "v", "vehicle", "constant rolling resistance")


def _two_species(folder: Path) -> Record:
    """bblais/gauseR@6a02a6e: Gause's Paramecium caudatum, alone and with P. aurelia."""
    time, own, other = [], [], []
    for _, run in pd.read_csv(folder / "gause_f22.csv").groupby("Treatment"):
        run = run.sort_values("Day")

        def volume(name: str, run: pd.DataFrame = run) -> np.ndarray:
            first = np.where(run.Species1 == name, run.Volume_Species1, np.nan)
            return np.where(run.Species2 == name, run.Volume_Species2, first).astype(float)

        caudatum, aurelia = volume("Paramecium caudatum"), volume("Paramecium aurelia")
        lives = np.isfinite(caudatum) & (caudatum > 0)
        if np.sum(lives) > 3:
            time.append(run.Day.to_numpy(float)[lives])
            own.append(caudatum[lives])
            other.append(np.nan_to_num(aurelia[lives]))
    data = FROM_ARRAYS(time, states={"Pc": own}, inputs={"Pa": other})
    right = "logistic crowding, and competition"
    return Record(data, {"Pc": "0.8*Pc"}, "Pc", "population", right, {"other": "Pa"})


def _heater(folder: Path) -> Record:
    """jckantor/TCLab@196c74e, notebooks/step_test_data.csv: a heater's step of 50 %."""
    table = pd.read_csv(folder / "tclab_step.csv")
    data = FROM_ARRAYS(table.Time.to_numpy(), states={"T1": table.T1.to_numpy()})
    right = "a second thermal mass, or the sensor's lag"
    return Record(data, {"T1": "(0.84*50 - (T1 - 22.3))/160"}, "T1", "thermal", right)


def _ball_and_beam(folder: Path) -> Record:
    """Rafa7046/Non_Linear_Identification@e5c9b00: rad and m at 0.1 s, in closed loop."""
    table = pd.read_csv(folder / "ball_and_beam.csv")
    data = FROM_ARRAYS(0.1 * np.arange(len(table)), states={"y": table.y.to_numpy()}, inputs={"u": table.u.to_numpy()})
    return Record(data, {"y": "v", "v": "7.0*u"}, "v", "mechanical", "u has 4.8, not 7, beside an unmeasured push")


def _cooling(folder: Path) -> Record:
    """vincentarelbundock/Rdatasets@1dcc2bf: a cup of water."""
    table = pd.read_csv(folder / "cooling_water.csv")
    data = FROM_ARRAYS(table.time.to_numpy(float), states={"temp": table.temp.to_numpy()})
    return Record(data, {"temp": "-0.0115*(temp - 24)"}, "temp", "thermal", "a law of temp beyond Newton's")


def _indomethacin(folder: Path) -> Record:
    """vincentarelbundock/Rdatasets@1dcc2bf: R's Indometh, six subjects."""
    runs = [run for _, run in pd.read_csv(folder / "indometh.csv").groupby("Subject")]
    data = FROM_ARRAYS([r.time.to_numpy() for r in runs], states={"conc": [r.conc.to_numpy() for r in runs]})
    return Record(data, {"conc": "-0.35*conc"}, "conc", "compartment", "a second compartment")


def _theophylline(folder: Path) -> Record:
    """vincentarelbundock/Rdatasets@1dcc2bf: R's Theoph, twelve subjects."""
    runs = [run.sort_values("Time") for _, run in pd.read_csv(folder / "theoph.csv").groupby("Subject")]
    data = FROM_ARRAYS([r.Time.to_numpy() for r in runs], states={"conc": [r.conc.to_numpy() for r in runs]})
    simulation = {"gut": "-1.5*gut", "conc": "1.5*gut - 0.086*conc"}
    return Record(data, simulation, "conc", "compartment", "nothing is missing")


def _battery(folder: Path) -> Record:
    """soorajsunil/Battery-ECM@b00a688: pulses of current."""
    held = loadmat(folder / "battery_pulses.mat")
    time, current, voltage = (held[name].ravel().astype(float) for name in ("tpulse", "ipulse", "vpulse"))
    later = time > np.append(-np.inf, np.maximum.accumulate(time)[:-1])
    data = FROM_ARRAYS(time[later], states={}, inputs={"I": current[later]}, outputs={"V": voltage[later]})
    simulation, right = {"V": "3.83 + 0.0215*I"}, "one or two relaxations of I"
    return Record(data, simulation, "V", "battery", right, {"current": "I"}, sampled=False)


def _tank(folder: Path) -> Record:
    """A tank that drains, 26 levels."""
    table = pd.read_csv(folder / "tank_drain.csv")
    data = FROM_ARRAYS(table.iloc[:, 0].to_numpy(float), states={"Height": table.iloc[:, 1].to_numpy()})
    return Record(data, {"Height": "-0.0085*Height"}, "Height", "fluid", "Torricelli's square root, or a tie with it")


def _phone(folder: Path) -> Record:
    """fsaliby/Air_Resistance@2d8e516: what a falling phone's accelerometer reads; its speed is the integral."""
    table = pd.read_csv(folder / "phone_fall.txt", sep=r"\s+", header=None)
    time, reading = table[0].to_numpy(float), table[4].to_numpy(float)
    # The longest stretch in which it reads little: there the phone falls.
    ends = np.flatnonzero(np.diff(np.concatenate([[0], (reading < 6.0).astype(int), [0]])))
    first, last = max(ends.reshape(-1, 2), key=lambda pair: pair[1] - pair[0])
    time, rate = time[first:last], 9.81 - reading[first:last]
    speed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    data = FROM_ARRAYS(time, states={"v": speed}, derivatives={"v": rate})
    right = "quadratic drag; the accelerometer is late"
    return Record(data, {"v": "9.81"}, "v", "mechanical", right, sampled=False)


def _pendulum(number: int) -> Callable[[Path], Record]:
    """y-fysiks/PHY180-Pendulum-datafit: an angle from video at 100 Hz."""

    def read(folder: Path) -> Record:
        table = pd.read_csv(folder / f"pendulum_{number}.csv", skipinitialspace=True)
        time, angle = table.time.to_numpy(), table.angle.to_numpy()
        later = time > np.append(-np.inf, np.maximum.accumulate(time)[:-1])
        time, angle = time[later], angle[later]
        # Its frequency at small swings: a period by the first and the last crossing of the last quarter.
        since, late = time[3 * len(time) // 4 :], angle[3 * len(angle) // 4 :]
        swing = late - np.mean(late)
        before = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
        slope = (swing[before + 1] - swing[before]) / (since[before + 1] - since[before])
        crossings = since[before] - swing[before] / slope
        # Near zero noise crosses more than once.
        crossings = crossings[np.append(True, np.diff(crossings) > 0.5)]
        period = (crossings[-1] - crossings[0]) / (len(crossings) - 1)
        frequency = 2 * np.pi / period / (1 - 2 * np.mean(swing**2) / 16)
        simulation = {"theta": "w", "w": f"-{frequency**2:.4f}*sin(theta) - 0.02*w"}
        data = FROM_ARRAYS(time, states={"theta": angle})
        return Record(data, simulation, "w", "mechanical", "Coulomb friction and quadratic drag")

    return read


def _damper(folder: Path) -> Record:
    """labcontrol-data/mr-damper: mm, mm/s and N of a magnetorheological damper at 0.01 s, its motion imposed."""
    x, v, force = loadmat(folder / "mr_damper_a1.mat")["x_F"].T
    a, b, c = np.linalg.lstsq(np.column_stack([np.ones(len(x)), x, v]), force, rcond=None)[0]
    data = FROM_ARRAYS(0.01 * np.arange(len(x)), states={"x": x, "v": v}, outputs={"F": force})
    simulation, roles = {"F": f"{a:.6g} + {b:.6g}*x + {c:.6g}*v"}, {"position": "x", "velocity": "v"}
    return Record(data, simulation, "F", "mechanical", "smooth dry friction", roles, sampled=False)


READ: dict[str, Callable[[Path], Record]] = {
    "coast-down": _coastdown,
    "two species": _two_species,
    "heater": _heater,
    "ball and beam": _ball_and_beam,
    "cooling water": _cooling,
    "indomethacin": _indomethacin,
    "theophylline": _theophylline,
    "battery": _battery,
    "draining tank": _tank,
    "falling phone": _phone,
    "pendulum 31": _pendulum(31),
    "pendulum 32": _pendulum(32),
    "damper": _damper,
}
"""Reader of each record."""
