"""`GreyBox(noise=bg.Noise(...))`: noise of the rows that is correlated, depends on the state, or has heavy tails.

The parameters of R are found at their mode on the residuals of a ridge fit of the equation, before the sampler runs,
and held in the fit (empirical Bayes). The ridge fit has the terms of the dictionary and few features of the
discrepancy, and is repeated under the noise that it found:

    β | R = argmin (y − Xβ)ᵀR⁻¹(y − Xβ)/σ² + βᵀD⁻¹β,   R = mode of p(y − Xβ | R),   alternately.

Correlated noise looks like what β explains, and residuals have lost that part: a correlation is held at the mode of
p(y | R), β integrated out (restricted likelihood; Patterson & Thompson 1971, Biometrika 58:545).

Samples of a path may have, beside the sensor's noise, an unknown force that moves the path (see `suspicions.force`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.model.estimate.evidence import Spectrum, coefficients, marginal
from bayes_greybox.model.frame import box_of, held_features, scaled_position
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.model.rows.equation_rows import EquationRows, Jumps
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.errors import InputError

from .in_time import Stamps, in_time
from .noise_model import CORRELATED, HEAVY, PROCESS, VARYING, NoiseModel, Suspicion
from .suspicions import LEAST_ROWS, below_floor, force, heavy, varying

FIT = "fit"
"""Value of an option whose parameter is found from the data."""

NOISE_OPTIONS = ("correlation", "depends_on", "tails", "force")

RIDGE_FEATURES = {1: 20, 2: 8, 3: 4}
"""Features of f per variable, by the number of variables; f of more variables is left out of the ridge fit."""


@dataclass(frozen=True)
class Noise:
    """Noise ε ~ N(0, σ² R) of the rows of each equation, beyond white noise of one size.

    Attributes:
        scale: Prior scale of σ over the RMS of the target: σ² = floor² + s², s ~ HalfNormal(scale).
        correlation: "fit" or the correlation time τ in units of time, for noise with correlation
            `(1 − w) exp(−|t − t'|/τ)` between rows of a run; the white share w is always found. None: none. "fit"
            leaves the noise as it is where the data speak against a correlation.
        depends_on: "fit" or a column x, for noise with standard deviation ∝ (δ² + (x/RMS)²)^(a/2); δ and a are always
            found, and under "fit" x is one of the states, inputs and the simulated rate. None: none.
        tails: "fit" or degrees of freedom, for Student's t; each row is weighted by its likeliest scale. None: normal.
        force: "fit", for an unknown force, white in time, that moves the path of sampled rows (process noise), if the
            data speak for one: coefficients are then as uncertain as it makes them. None: the path is the model's.
        found: Parameters that were found, by equation; filled in by a fit.
    """

    scale: float = 1.0
    correlation: str | float | None = None
    depends_on: str | None = None
    tails: str | float | None = None
    force: str | None = None
    found: Mapping[str, Mapping[str, Any]] | None = None

    def __post_init__(self) -> None:
        if not (is_number(self.scale) and 0 < self.scale < math.inf):
            raise InputError(f"Noise(scale={self.scale!r}) must be a positive number.")
        for name in ("correlation", "tails"):
            value = getattr(self, name)
            if not (value is None or value == FIT or (is_number(value) and 0 < value < math.inf)):
                raise InputError(f"Noise({name}={value!r}) must be None, 'fit' or a positive number.")
        if self.force not in (None, FIT):
            raise InputError(f"Noise(force={self.force!r}) must be None or 'fit'.")
        if self.force is not None and self.correlation is not None:
            raise InputError(
                "Noise(correlation=..., force=...): noise of a sensor that hangs together and an unknown force are "
                "not told apart on the same samples; leave one of them out."
            )
        if not (self.depends_on is None or (isinstance(self.depends_on, str) and self.depends_on)):
            raise InputError(f"Noise(depends_on={self.depends_on!r}) must be None, 'fit' or the name of a column.")

    @property
    def white(self) -> bool:
        """True if R is that of the rows as they come."""
        return all(getattr(self, name) is None for name in NOISE_OPTIONS)


def find_noise(
    noise: Noise, rows: EquationRows, dictionary: Dictionary, discrepancy: OrthogonalGP | None, floor: float
) -> NoiseModel:
    """Find R at the mode on the residuals of a ridge fit; `floor` is the least σ over the RMS of the target."""
    model = plain = NoiseModel(rows.noise)
    if noise.white:
        return plain
    check_asked(noise, rows)
    quantities = _quantities(noise, rows)
    prior = NoisePrior(floor, noise.scale)
    X, y = _dictionary_columns(rows, dictionary), rows.target / rows.scale
    psi, choices = _features(rows, discrepancy)
    both = np.column_stack([X, psi])

    def ridge(R: RowNoise) -> tuple[float, np.ndarray]:
        """Return log p(y | R), and β with the prior of f that has the highest evidence."""
        white = R.whiten(np.column_stack([both, y]))
        F, z = white[:, :-1], white[:, -1]
        gram, product, square = F.T @ F, F.T @ z, float(np.sum(z**2))
        best, mean = -math.inf, np.zeros(both.shape[1])
        for spread in choices:
            # Coefficients of the dictionary have hardly a prior at all.
            sd = np.concatenate([np.full(X.shape[1], 10.0), spread])
            spectrum = Spectrum.of(gram, product, square, len(white), sd)
            posterior = marginal(spectrum, prior)
            if float(posterior.log_evidence) > best:
                best, mean = float(posterior.log_evidence), coefficients(spectrum, posterior)[0]
        return best - 0.5 * R.log_det, mean

    def found_under(R: RowNoise, evidence: Callable[[RowNoise], float] | None = None) -> NoiseModel:
        residual = y - both @ ridge(R)[1]
        return _held_at_mode(noise, residual, plain, rows, quantities, prior, evidence)

    # Residuals and noise in turn.
    for _ in range(4):
        before, model = model, found_under(model.noise)
        if _settled(before, model):
            break
    return model if CORRELATED not in model.names else found_under(model.noise, lambda R: ridge(R)[0])


def varies_with(rows: EquationRows) -> dict[str, Float[np.ndarray, " n_row"]]:
    """Return quantities that the noise may grow with: states, inputs and, for rates or outputs, the simulated one."""
    rate = {f"simulated {rows.label}": rows.simulated} if rows.gain == 1.0 else {}
    return {**rows.at_rows(), **rate}


def check_asked(noise: Noise, rows: EquationRows) -> None:
    """Refuse noise that cannot be found on these rows, before there is any work to lose."""
    if noise.white:
        return
    if rows.noise.derived:
        raise InputError(
            f"The noise of the rows of {rows.equation!r} follows from that of the samples, and no other is sought: "
            "leave GreyBox(noise=...) a number, or use GreyBox(rows=bg.TrajectoryRows())."
        )
    _quantities(noise, rows)
    if rows.n_row < LEAST_ROWS:
        raise InputError(
            f"The noise of {rows.equation!r} cannot be found on {rows.n_row} rows: give at least {LEAST_ROWS}, or "
            "leave GreyBox(noise=...) a number."
        )
    if noise.force is not None and not len(rows.noise.intensities):
        rates = "rates: give GreyBox(rows=bg.TrajectoryRows()), or leave it out"
        kind = "an output: leave it out" if rows.output else rates
        raise InputError(
            f"Noise(force='fit') needs rows of samples, whose path a force can move; those of {rows.equation!r} are "
            f"{kind}."
        )
    several = rows.operator is not None and rows.n_row > len(set(rows.operator.sample.tolist()))
    if several and rows.noise.square and not replace(noise, force=None).white:
        raise InputError(
            f"Noise of several sensors at once cannot be found for {rows.equation!r} yet: leave GreyBox(noise=...) a "
            "number, or give the samples of one sensor."
        )
    if not rows.noise.square or (noise.correlation is not None and not rows.noise.error.independent):
        what = "rows" if rows.output else "rates"
        how = "smoothed as rates are" if rows.output else "computed by differentiation"
        raise InputError(
            f"The {what} of {rows.equation!r} were {how}, which gives their noise a known "
            "correlation: leave Noise(correlation=...) out, and for the rest differentiate by 'savgol'."
        )


def _held_at_mode(
    noise: Noise, residual: Float[np.ndarray, " n_row"], plain: NoiseModel, rows: EquationRows,
    quantities: Mapping[str, Float[np.ndarray, " n_row"]], prior: NoisePrior,
    evidence: Callable[[RowNoise], float] | None,
) -> NoiseModel:  # fmt: skip
    """Find every option in turn: size along the path, correlation of the residual, tails of the innovations, a force.

    A fitted option is kept only if it explains the residuals better.
    """
    model, whole = plain, residual
    residual = plain.noise.without_starts(residual[:, None])[:, 0]
    if below_floor(residual, plain, prior):
        # There is nothing that could be found; what is given is given.
        noise = replace(noise, **{name: None for name in NOISE_OPTIONS if getattr(noise, name) == FIT})
    if noise.depends_on is not None:
        model = _taken(model, varying(residual, model, quantities, prior), noise.depends_on)
    if noise.correlation is not None:
        tau = None if noise.correlation == FIT else float(noise.correlation)
        suspicion = in_time(residual, model, Stamps(rows.time, rows.run), prior, CORRELATED, tau, evidence)
        model = _taken(model, suspicion, noise.correlation)
    if noise.tails is not None:
        asked = {} if noise.tails == FIT else {"degrees": (float(noise.tails),)}
        model = _taken(model, heavy(residual, model, prior, **asked), noise.tails)
    if noise.force is not None:
        # Weights of the sensors' rows stay theirs.
        model = _taken(model, force(whole, model, prior), noise.force)
    return model


def _taken(model: NoiseModel, suspicion: Suspicion | None, asked: Any) -> NoiseModel:
    if suspicion is None or not np.isfinite(suspicion.log_bayes_factor):
        return model
    return suspicion.model if asked != FIT or suspicion.log_bayes_factor > 0 else model


def _settled(before: NoiseModel, after: NoiseModel) -> bool:
    if before.names != after.names:
        return False
    pairs = [(before.about[name][key], b) for name in after.names for key, b in after.about[name].items()]
    # Every parameter to 2 %.
    return all(abs(a - b) <= 0.02 * max(abs(a), abs(b)) for a, b in pairs if isinstance(b, float))


def _dictionary_columns(rows: EquationRows, dictionary: Dictionary) -> Float[np.ndarray, "n_row n_term"]:
    places = dictionary.jumping
    jumping = Dictionary(tuple(dictionary.terms[i] for i in places))
    values = rows.table(
        lambda at: np.asarray(dictionary.evaluate(at), float),
        jumps=Jumps(places, lambda at: np.asarray(jumping.evaluate(at), float)),
    )(np.arange(rows.n_row))
    scale = np.sqrt(np.mean(values**2, axis=0))
    # What cannot be evaluated, or is zero, is refused with its name where the equation is assembled.
    usable = np.isfinite(scale) & (scale > 0)
    return values[:, usable] / scale[usable]


def _features(
    rows: EquationRows, discrepancy: OrthogonalGP | None
) -> tuple[Float[np.ndarray, "n_row n_basis"], list[Float[np.ndarray, " n_basis"]]]:
    """Return ψ at the rows, and the prior standard deviations of its weights to try; the first is no f at all."""
    none = np.zeros((rows.n_row, 0)), [np.zeros(0)]
    if discrepancy is None:
        return none
    variables = tuple(discrepancy.variables or rows.columns)
    if len(variables) not in RIDGE_FEATURES or any(name not in rows.columns for name in variables):
        return none
    centre, half_width = box_of(rows.columns, variables)
    if not np.all(half_width > 0):
        return none
    basis = HilbertBasis(discrepancy.boundary, (RIDGE_FEATURES[len(variables)],) * len(variables))
    features = rows.table(
        lambda at: np.asarray(held_features(basis, scaled_position(at, variables, centre, half_width)))
    )
    psi = features(np.arange(rows.n_row))
    kernel = KERNELS[discrepancy.kernel]
    spreads = [
        np.exp(0.5 * np.asarray(log_spectral_density(kernel, basis.frequency, a, jnp.full(len(variables), length))))
        for a in (0.03, 0.1, 0.3, 1.0)
        for length in (0.4, 0.8, 1.6)
    ]
    return psi, [np.zeros(basis.size), *spreads]


def _quantities(noise: Noise, rows: EquationRows) -> dict[str, Float[np.ndarray, " n_row"]]:
    """Return quantities that the noise may depend on, by name."""
    if noise.depends_on is None:
        return {}
    if noise.depends_on == FIT:
        return varies_with(rows)
    if noise.depends_on not in rows.columns:
        raise InputError(
            f"Noise(depends_on={noise.depends_on!r}) is neither a state nor an input; known: {', '.join(rows.columns)}."
        )
    return {noise.depends_on: rows.at_rows()[noise.depends_on]}


def noise_record(model: NoiseModel) -> dict[str, Any]:
    """Return the parameters that were found, as plain values for the columns of `Fit.noise`."""
    columns = {
        CORRELATED: {"correlation_time": "time_scale", "white_share": "white"},
        VARYING: {"depends_on": "variable", "exponent": "exponent", "level": "level"},
        PROCESS: {"force": "intensity", "force_share": "share"},
        HEAVY: {"degrees": "degrees"},
    }
    record = {
        column: model.about[name][key]
        for name, each in columns.items()
        for column, key in each.items()
        if name in model.about
    }
    if "force" in record:
        record["force"] = math.sqrt(record["force"])
    return record


def is_number(value: Any) -> bool:
    """Return whether a setting is a real number, NumPy's among them; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)
