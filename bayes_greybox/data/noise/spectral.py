"""Row noise of periodic records: diagonal in Fourier space, frequencies beyond the band left out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag, toeplitz

from bayes_greybox.running.errors import InputError

from .protocol import WHITE_SHARE, RowNoise, Sequences, check_white_share


@dataclass(frozen=True, eq=False)
class SpectralNoise(RowNoise):
    """Rows of a Fourier derivative of order m of periodic records: R is diagonal in the Fourier basis.

    Each kept frequency ω has one cosine and one sine coefficient with variance proportional to ω^{2m}. The mean and the
    frequencies outside the band carry no rows: W has fewer rows than the data, and a constant term leaves no trace.
    """

    kind: ClassVar[str] = "spectral"
    order: int  # m
    run_lengths: tuple[int, ...]
    steps: tuple[float, ...]  # sample spacing of each run, in units of time
    kept: tuple[int, ...]  # number of kept frequencies 1, …, kept of each run (multiples of 1 / (n · step))
    white_share: float = WHITE_SHARE  # δ, spread evenly over the kept coefficients of each run

    def __post_init__(self) -> None:
        check_white_share(self.white_share)

    @cached_property
    def scale(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Standard deviation of the rows for unit white noise on the samples."""
        return math.sqrt(sum(2.0 * float(np.sum(power)) for power in self._powers) / self.n_obs)

    @property
    def white_lengths(self) -> tuple[int, ...]:
        """Number of whitened rows of each run, two for each kept frequency."""
        return tuple(2 * kept for kept in self.kept)

    def sequences(self, white: Float[np.ndarray, "n_draw n_white"]) -> Sequences:
        """Return the power at each frequency, less its mean: neighbours in time have no rows of their own.

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
        """Return orthonormal Fourier coefficients divided by their SD; cosines, then sines, run by run."""
        out, start = [], 0
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            spectrum = np.fft.rfft(rows[start : start + n], axis=0)[1 : kept + 1]
            spectrum = spectrum * (math.sqrt(2.0 / n) / np.sqrt(values))[:, None]
            out += [spectrum.real, -spectrum.imag]
            start += n
        return np.concatenate(out)

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return the band-limited signal that has these weighted Fourier coefficients."""
        out, start = [], 0
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            cosines, sines = rows[start : start + kept], rows[start + kept : start + 2 * kept]
            spectrum = np.zeros((n // 2 + 1, rows.shape[1]), dtype=complex)
            spectrum[1 : kept + 1] = (cosines - 1j * sines) * (math.sqrt(n / 2.0) / np.sqrt(values))[:, None]
            out.append(np.fft.irfft(spectrum, n=n, axis=0))
            start += 2 * kept
        return np.concatenate(out)

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return diagonals of Wᵀ W, constant within a run: (2/n) Σ_j cos(2π j k / n) / λ_j."""
        band, start = np.zeros((self.n_obs, width)), 0
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            for k in range(min(width, n)):
                waves = np.cos(2.0 * np.pi * k / n * np.arange(1, kept + 1))
                band[start : start + n - k, k] = 2.0 / n * float(np.sum(waves / values))
            start += n
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix, which is singular."""
        blocks = []
        for n, kept, values in zip(self.run_lengths, self.kept, self._eigenvalues, strict=True):
            lag = 2.0 * np.pi * np.outer(np.arange(n), np.arange(1, kept + 1)) / n
            # r_k = (2/n) Σ_j λ_j cos(2π j k / n)
            blocks.append(toeplitz(2.0 / n * (np.cos(lag) @ values)))
        return np.asarray(block_diag(*blocks))

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "SpectralNoise":
        """Return the noise of whole runs, and refuse to cut one: a part of a periodic record has no such form."""
        stay = [i for i, (start, stop) in enumerate(bounds) if stop > start]
        if any(bounds[i] != (0, self.run_lengths[i]) for i in stay):
            raise InputError(
                "Rows differentiated with method='spectral' belong to whole periodic records and cannot be split by "
                "time; split the measured data first and differentiate the parts, or split with by='trajectory'."
            )
        lengths, steps, kept = (tuple(each[i] for i in stay) for each in (self.run_lengths, self.steps, self.kept))
        return replace(self, run_lengths=lengths, steps=steps, kept=kept)

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
