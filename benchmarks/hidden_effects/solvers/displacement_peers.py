"""The way of a user with a displacement today: a smoothing spline, and PySINDy's weak form on its values.

The spline is the smoothest that generalised cross-validation allows; position and speed are its. Columns are those of
`peers`, evaluated there; they, the simulation and the speed's rate enter as integrals over windows with a test function
that is zero at their ends (Reinbold et al. 2020, Phys. Rev. E 101:010203), so that no acceleration is needed.
"""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_smoothing_spline

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.trajectories import combine

from .displacement import displacement
from .peers import candidate_terms, numpy_seed, regressed, require

WINDOWS = 200
"""Windows of a run."""


def ask(data: CaseData, noise: float, seed: int = 0) -> dict[str, Any]:
    """Return the answers of PySINDy's weak form by method; see `peers.Rivals`.

    Raises:
        InputError: PySINDy is not installed.
    """
    smooth = smoothed(data, noise)
    near = replace(data, train=smooth)
    book = candidate_terms(near)
    known = combine(data.given_rates[data.equation], near.measured())
    parts = [(own, smooth.time[own]) for own in (smooth.run == r for r in range(smooth.n_run))]
    columns = np.vstack([weak(book.columns[own], t, seed)[0] for own, t in parts])
    sides = [weak(np.column_stack([known, smooth.states[data.equation]])[own], t, seed) for own, t in parts]
    gap = np.concatenate([rates[:, 1] - values[:, 0] for values, rates in sides])
    size = np.sqrt(np.mean(columns**2, axis=0))
    # What integrates to nothing in every window cannot be seen in them.
    columns = columns / np.where(size > 0, size, 1.0)
    methods = {"stlsq": False, "ensemble": True}
    return {name: regressed(columns, book.slugs, gap, ensemble, seed) for name, ensemble in methods.items()}


def smoothed(data: CaseData, noise: float) -> Trajectories:
    """Return position and speed of smoothing splines through the samples."""
    samples, place = displacement(data, noise)[0], data.host.roles["position"]
    times, states = [], {name: [] for name in data.host.states}
    for own in (samples.run == r for r in range(samples.n_run)):
        t = samples.time[own]
        spline = make_smoothing_spline(t, samples.states[place][own])
        times.append(t)
        for name in data.host.states:
            states[name].append(spline(t) if name == place else spline.derivative()(t))
    inputs = {name: [values[samples.run == r] for r in range(samples.n_run)] for name, values in samples.inputs.items()}
    return Trajectories.from_arrays(times, states=states, inputs=inputs, constant="keep")


def weak(
    columns: Float[np.ndarray, "n k"], t: Float[np.ndarray, " n"], seed: int
) -> tuple[Float[np.ndarray, "n_window k"], Float[np.ndarray, "n_window k"]]:
    """Integrate columns at times t of a run, and their rates, over PySINDy's windows with their test functions.

    The windows are those of the seed, in order of time.
    """
    pysindy = require()
    with warnings.catch_warnings(), numpy_seed(seed):
        warnings.simplefilter("ignore")
        same = pysindy.CustomLibrary(library_functions=[lambda x: x], function_names=[lambda x: x])
        library = pysindy.WeakPDELibrary(function_library=same, spatiotemporal_grid=t, K=WINDOWS)
        # Columns of ones and of times tell where a window is: blocks that are left out have neighbours.
        table = pysindy.AxesArray(np.column_stack([np.ones(len(t)), t, columns]), {"ax_time": 0, "ax_coord": 1})
        library.fit([table])
        values, rates = np.asarray(library.transform([table])[0]), np.asarray(library.convert_u_dot_integral(table))
    order = np.argsort(values[:, 1] / values[:, 0])
    return values[order, 2:], rates[order, 2:]
