"""Row noise of differentiators: banded for finite filters, diagonal in Fourier space for periodic records."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag, cholesky_banded, get_lapack_funcs, toeplitz

from .errors import InputError
from .row_noise import WHITE_SHARE, WHITE_SHARES, RowNoise, check_white_share
from .state_space_noise import StateSpaceNoise
from .weighted_noise import WeightedNoise
from .white_noise import WhiteNoise

KINDS = ("white", "banded", "spectral", "state space", "weighted")
"""Row noises that files of data and fits can hold, as `RowNoise.to_dict` calls them."""


def noise_from_dict(record: Mapping[str, Any]) -> RowNoise:
    """Rebuild a noise from `RowNoise.to_dict`.

    Args:
        record: mapping with the key "kind" (one of `KINDS`) and the fields of that kind.

    Returns:
        The noise.

    Raises:
        InputError: if the kind is unknown.
    """
    fields = {key: value for key, value in record.items() if key != "kind"}
    if record["kind"] == "white":
        return WhiteNoise(tuple(fields["run_lengths"]))
    if record["kind"] == "banded":
        return BandedNoise(
            autocorrelation=np.asarray(fields["autocorrelation"], dtype=float),
            run_lengths=tuple(fields["run_lengths"]),
            run_variances=np.asarray(fields["run_variances"], dtype=float),
            scale=float(fields["scale"]),
            white_share=float(fields["white_share"]),
        )
    if record["kind"] == "spectral":
        return SpectralNoise(
            order=int(fields["order"]),
            run_lengths=tuple(fields["run_lengths"]),
            steps=tuple(fields["steps"]),
            kept=tuple(fields["kept"]),
            white_share=float(fields["white_share"]),
        )
    if record["kind"] == "state space":
        return StateSpaceNoise(
            times=tuple(np.asarray(t, dtype=float) for t in fields["times"]),
            process=fields["process"],
            time_scale=float(fields["time_scale"]),
            white=float(fields["white"]),
            scale=float(fields["scale"]),
        )
    if record["kind"] == "weighted":
        return WeightedNoise(
            inner=noise_from_dict(fields["inner"]),
            sd=np.asarray(fields["sd"], dtype=float),
            scale=float(fields["scale"]),
        )
    known = ", ".join(f'"{kind}"' for kind in KINDS)
    raise InputError(f'Row noise of kind "{record["kind"]}" is unknown; the kinds are {known}.')


def fir_noise(
    taps: Float[np.ndarray, " n_tap"],
    order: int,
    run_lengths: Sequence[int],
    steps: Sequence[float],
    white_share: float = WHITE_SHARE,
) -> "BandedNoise":
    """Noise of rows computed by a finite impulse response filter, edges dropped.

    With G the filter's rows, G Gᵀ is banded Toeplitz with entries Σ_i c_i c_{i+k}.

    Args:
        taps: taps for unit sample spacing; a run with step h uses taps / h^order.
        order: order of the derivative.
        run_lengths: filtered rows of each run.
        steps: sample spacing of each run.
        white_share: δ.

    Returns:
        The noise of the stacked rows.
    """
    autocovariance = np.correlate(taps, taps, mode="full")[len(taps) - 1 :]
    lengths = np.asarray(run_lengths, dtype=float)
    variances = autocovariance[0] / np.asarray(steps, dtype=float) ** (2 * order)
    mean = float(np.sum(lengths * variances) / np.sum(lengths))
    return BandedNoise(
        autocorrelation=autocovariance / autocovariance[0],
        run_lengths=tuple(int(n) for n in run_lengths),
        run_variances=variances / mean,
        scale=math.sqrt(mean),
        white_share=white_share,
    )


@dataclass(frozen=True, eq=False)
class BandedNoise(RowNoise):
    """Rows of a finite impulse response filter: R is banded Toeplitz in each run, W = L⁻¹ with R = L Lᵀ.

    Every operation costs O(n · bandwidth²) at most.

    Attributes:
        autocorrelation: correlation of rows 0, 1, 2, … apart, before the white share; zero beyond.
        run_lengths: rows of each run.
        run_variances: diagonal of R in each run (differs only if the sample spacing does); row mean 1.
        scale: see `RowNoise`.
        white_share: δ.
    """

    autocorrelation: Float[np.ndarray, " n_lag"]
    run_lengths: tuple[int, ...]
    run_variances: Float[np.ndarray, " n_run"]
    scale: float
    white_share: float = WHITE_SHARE

    def __post_init__(self) -> None:
        check_white_share(self.white_share)

    @property
    def n_white(self) -> int:
        """Number of whitened rows, one for each row."""
        return self.n_obs

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R| = Σ 2 log diag L."""
        total = 0.0
        for n, variance in zip(self.run_lengths, self.run_variances, strict=True):
            total += 2.0 * float(np.sum(np.log(self._factors[n][0]))) + n * math.log(variance)
        return total

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """L⁻¹ rows."""
        return self._solve(rows, trans="N")

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """L⁻ᵀ rows."""
        return self._solve(rows, trans="T")

    def precision_diagonal(self) -> Float[np.ndarray, " n_obs"]:
        """Diagonal of R⁻¹."""
        return self.precision_band(1)[:, 0]

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Diagonals of R⁻¹ by the displacement structure of an inverse Toeplitz matrix.

        With x the first column of T⁻¹: (T⁻¹)_{i+1,j+1} = (T⁻¹)_{i,j} + (x_{i+1} x_{j+1} − x_{n−1−i} x_{n−1−j}) / x_0
        (Gohberg & Semencul 1972).
        """
        band, start = np.zeros((self.n_obs, width)), 0
        for n, variance in zip(self.run_lengths, self.run_variances, strict=True):
            unit = np.zeros((n, 1))
            unit[0] = 1.0
            x = _triangular_solve(self._factors[n], _triangular_solve(self._factors[n], unit, "N"), "T")[:, 0]
            for k in range(min(width, n)):
                steps = (x[1 : n - k] * x[1 + k :] - x[:k:-1] * x[::-1][k : n - 1]) / x[0]
                band[start : start + n - k, k] = np.cumsum(np.concatenate([x[k : k + 1], steps])) / variance
            start += n
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """R as a dense matrix."""
        blocks = [
            variance * toeplitz(_pad(self._column, n))
            for n, variance in zip(self.run_lengths, self.run_variances, strict=True)
        ]
        return np.asarray(block_diag(*blocks))

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "BandedNoise":
        """Noise of contiguous rows of each run; see `RowNoise.restrict`."""
        lengths = np.array([stop - start for start, stop in bounds])
        stay = lengths > 0
        variances = self.run_variances[stay]
        mean = float(np.sum(lengths[stay] * variances) / np.sum(lengths[stay]))
        return BandedNoise(
            autocorrelation=self.autocorrelation,
            run_lengths=tuple(int(n) for n in lengths[stay]),
            run_variances=variances / mean,
            scale=self.scale * math.sqrt(mean),
            white_share=self.white_share,
        )

    def thin(self, every: int) -> "BandedNoise":
        """Noise of every so many rows of each run, from its first on."""
        return BandedNoise(
            autocorrelation=self.autocorrelation[::every],
            run_lengths=tuple(-(-n // every) for n in self.run_lengths),
            run_variances=self.run_variances,
            scale=self.scale,
            white_share=self.white_share,
        )

    def alternatives(self) -> tuple[RowNoise, ...]:
        """The same filter's noise with other white shares."""
        return tuple(replace(self, white_share=share) for share in WHITE_SHARES if share != self.white_share)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists that `noise_from_dict` reads back."""
        return {
            "kind": "banded",
            "autocorrelation": self.autocorrelation.tolist(),
            "run_lengths": list(self.run_lengths),
            "run_variances": self.run_variances.tolist(),
            "scale": self.scale,
            "white_share": self.white_share,
        }

    @property
    def _column(self) -> Float[np.ndarray, " n_lag"]:
        column = (1.0 - self.white_share) * self.autocorrelation
        column[0] += self.white_share
        return column

    @cached_property
    def _factors(self) -> dict[int, np.ndarray]:
        """Lower banded Cholesky factor of the unit-variance block, for each length of run."""
        return {n: _toeplitz_cholesky(self._column, n) for n in set(self.run_lengths)}

    def _solve(self, rows: np.ndarray, trans: str) -> np.ndarray:
        out, start = [], 0
        for n, variance in zip(self.run_lengths, self.run_variances, strict=True):
            block = rows[start : start + n]
            out.append(_triangular_solve(self._factors[n], block, trans) / math.sqrt(variance))
            start += n
        return np.concatenate(out)


@dataclass(frozen=True, eq=False)
class SpectralNoise(RowNoise):
    """Rows of a Fourier derivative of order m of periodic records: R is diagonal in the Fourier basis.

    Each kept frequency ω has one cosine and one sine coefficient with variance proportional to ω^{2m}. The
    mean and the frequencies outside the band carry no rows, so W has fewer rows than the data and a constant
    term leaves no trace in the whitened equation.

    Attributes:
        order: m.
        run_lengths: rows of each run.
        steps: sample spacing of each run, in units of time.
        kept: number of kept frequencies 1, …, kept of each run (multiples of 1 / (n · step)).
        white_share: δ, spread evenly over the kept coefficients of each run.
    """

    order: int
    run_lengths: tuple[int, ...]
    steps: tuple[float, ...]
    kept: tuple[int, ...]
    white_share: float = WHITE_SHARE

    def __post_init__(self) -> None:
        check_white_share(self.white_share)

    @cached_property
    def scale(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Standard deviation of the rows for unit white noise on the samples."""
        return math.sqrt(sum(2.0 * float(np.sum(power)) for power in self._powers) / self.n_obs)

    @property
    def n_white(self) -> int:
        """Number of whitened rows, two for each kept frequency."""
        return 2 * sum(self.kept)

    @property
    def white_lengths(self) -> tuple[int, ...]:
        """Two for each kept frequency of a run."""
        return tuple(2 * kept for kept in self.kept)

    def sequences(
        self, white: Float[np.ndarray, "n_draw n_white"]
    ) -> tuple[Float[np.ndarray, "n_draw n_value"], tuple[int, ...], bool]:
        """Power at each frequency, less its mean: neighbours in time have no rows of their own.

        Cosines come before sines, run by run; the power of one frequency is exponential with mean 1.
        """
        powers, start = [], 0
        for k in self.kept:
            powers.append(0.5 * (white[:, start : start + k] ** 2 + white[:, start + k : start + 2 * k] ** 2) - 1.0)
            start += 2 * k
        return np.concatenate(powers, axis=1), self.kept, True

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Log of the product of the nonzero eigenvalues of R."""
        return sum(2.0 * float(np.sum(np.log(values))) for values in self._eigenvalues)

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Orthonormal Fourier coefficients divided by their SD; cosines, then sines, run by run."""
        out, start = [], 0
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            spectrum = np.fft.rfft(rows[start : start + n], axis=0)[1 : kept + 1]
            spectrum = spectrum * (math.sqrt(2.0 / n) / np.sqrt(values))[:, None]
            out += [spectrum.real, -spectrum.imag]
            start += n
        return np.concatenate(out)

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """The band-limited signal whose weighted Fourier coefficients are given."""
        out, start = [], 0
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            cosines, sines = rows[start : start + kept], rows[start + kept : start + 2 * kept]
            spectrum = np.zeros((n // 2 + 1, rows.shape[1]), dtype=complex)
            spectrum[1 : kept + 1] = (cosines - 1j * sines) * (math.sqrt(n / 2.0) / np.sqrt(values))[:, None]
            out.append(np.fft.irfft(spectrum, n=n, axis=0))
            start += 2 * kept
        return np.concatenate(out)

    def precision_diagonal(self) -> Float[np.ndarray, " n_obs"]:
        """Diagonal of Wᵀ W, the same for all rows of a run."""
        return self.precision_band(1)[:, 0]

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Diagonals of Wᵀ W, constant within a run: (2/n) Σ_j cos(2π j k / n) / λ_j."""
        band, start = np.zeros((self.n_obs, width)), 0
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            for k in range(min(width, n)):
                waves = np.cos(2.0 * np.pi * k / n * np.arange(1, kept + 1))
                band[start : start + n - k, k] = 2.0 / n * float(np.sum(waves / values))
            start += n
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """R as a dense matrix, singular."""
        blocks = []
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            lag = 2.0 * np.pi * np.outer(np.arange(n), np.arange(1, kept + 1)) / n
            # r_k = (2/n) Σ_j λ_j cos(2π j k / n)
            blocks.append(toeplitz(2.0 / n * (np.cos(lag) @ values)))
        return np.asarray(block_diag(*blocks))

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "SpectralNoise":
        """Noise of whole runs; a part of a periodic record has no such form.

        Raises:
            InputError: if a run would be cut.
        """
        stay = [i for i, (start, stop) in enumerate(bounds) if stop > start]
        for i in stay:
            if bounds[i] != (0, self.run_lengths[i]):
                raise InputError(
                    "Rows differentiated with method='spectral' belong to whole periodic records and cannot "
                    "be split by time; split the measured data first and differentiate the parts, or split "
                    "with by='trajectory'."
                )
        return SpectralNoise(
            order=self.order,
            run_lengths=tuple(self.run_lengths[i] for i in stay),
            steps=tuple(self.steps[i] for i in stay),
            kept=tuple(self.kept[i] for i in stay),
            white_share=self.white_share,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists that `noise_from_dict` reads back."""
        return {
            "kind": "spectral",
            "order": self.order,
            "run_lengths": list(self.run_lengths),
            "steps": list(self.steps),
            "kept": list(self.kept),
            "white_share": self.white_share,
        }

    @cached_property
    def _powers(self) -> tuple[np.ndarray, ...]:
        """ω^{2m} of the kept frequencies of each run."""
        return tuple(
            (2.0 * np.pi * np.arange(1, kept + 1) / (n * step)) ** (2 * self.order)
            for n, step, kept in zip(self.run_lengths, self.steps, self.kept, strict=True)
        )

    @cached_property
    def _eigenvalues(self) -> tuple[np.ndarray, ...]:
        """Eigenvalues of R at the kept frequencies: ((1 − δ) ω^{2m} + δ mean ω^{2m}) / scale², run by run."""
        share, scale = self.white_share, self.scale
        return tuple(((1.0 - share) * power + share * np.mean(power)) / scale**2 for power in self._powers)


def _pad(column: np.ndarray, n: int) -> np.ndarray:
    return np.concatenate([column, np.zeros(max(0, n - len(column)))])[:n]


def _toeplitz_cholesky(column: np.ndarray, n: int) -> np.ndarray:
    """Banded Cholesky factor, lower form: row k holds the k-th subdiagonal."""
    band = column[: min(len(column), n)]
    return cholesky_banded(np.repeat(band[:, None], n, axis=1), lower=True)


def _triangular_solve(factor: np.ndarray, rows: np.ndarray, trans: str) -> np.ndarray:
    (tbtrs,) = get_lapack_funcs(("tbtrs",), (factor,))
    solution, info = tbtrs(factor, rows, uplo="L", trans=trans, diag="N")
    if info != 0:
        raise np.linalg.LinAlgError(f"banded triangular solve failed (LAPACK info {info})")
    return solution
