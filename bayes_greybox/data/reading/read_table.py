"""Read measured tables under the name that came before `read`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from bayes_greybox.data.trajectories import Trajectories

from .door import read


def read_table(
    path: str | Path,
    *,
    time: str | None = None,
    states: Sequence[str] | Mapping[str, str] = (),
    inputs: Sequence[str] | Mapping[str, str] = (),
    derivatives: Mapping[str, str] | None = None,
    outputs: Sequence[str] | Mapping[str, str] = (),
    trajectory: str | None = None,
    dt: float | None = None,
    units: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error",
    constant: Literal["error", "keep"] = "error",
) -> Trajectories:
    """Read one file of measurements: `read(path, run=trajectory, ...)`, which has more to say of the file.

    Args:
        path: As `source` of `read`.
        time: As in `read`.
        states: As in `read`.
        inputs: As in `read`.
        derivatives: As in `read`.
        outputs: As in `read`.
        trajectory: Column whose value tells the runs apart, `run` of `read`.
        dt: As in `read`.
        units: As in `read`.
        missing: As in `Trajectories.from_arrays`.
        constant: As in `Trajectories.from_arrays`.

    Returns:
        The data.

    Raises:
        InputError: If the file or a column cannot be used; the message names it.
    """
    return read(
        path,
        time=time,
        states=states,
        inputs=inputs,
        derivatives=derivatives,
        outputs=outputs,
        run=trajectory,
        dt=dt,
        units=units,
        missing=missing,
        constant=constant,
    )
