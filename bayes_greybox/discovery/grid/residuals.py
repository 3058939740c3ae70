"""Residuals of hypotheses: discrepancy and white noise, the discrepancy in the band of a force, and bagged records."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import hann

from .latent_force import LatentForce
from .log_evidence import Basis, discrepancy_basis
from .points import LATENT_FORCE, LAW, MEMORY, NoisePoint
from .table import RegressorTable

FEWEST_BAGGED_BLOCKS, MOST_BAGGED_BLOCKS = 6, 30
"""Least and largest number of contiguous blocks of a record."""

BLOCK_ROWS = 25
"""Least number of rows of a block, but where there would be fewer blocks than the least."""

BAGGED_RECORDS = 200
"""Number of bagged records: an average of 0.9 over them is known to ±√(0.9 · 0.1/200) = 0.02 at worst."""


def blocks(n: int) -> Int[np.ndarray, " n"]:
    """Return the number of the contiguous block that each of n rows belongs to."""
    count = int(np.clip(n // BLOCK_ROWS, min(FEWEST_BAGGED_BLOCKS, n), MOST_BAGGED_BLOCKS))
    return np.arange(n) * count // n


def bagged(
    logs: Float[np.ndarray, "n_hypothesis n_block"], probability: Float[np.ndarray, " n_hypothesis"], seed: int
) -> Float[np.ndarray, " n_hypothesis"]:
    """Return probabilities averaged over bagged records, to first order (Huggins & Miller 2023).

    Evidence of models that are all a little wrong is overconfident: its differences grow like √n at random. Each log
    weight changes by Σ_b (c_b − 1) ℓ_b, c the multinomial counts of the blocks and ℓ their log likelihood at the mode.
    """
    n = logs.shape[1]
    counts = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=BAGGED_RECORDS)
    log_weights = np.log(np.maximum(probability, 1e-300)) + (counts - 1.0) @ logs.T
    return np.mean(np.exp(log_weights - np.logaddexp.reduce(log_weights, axis=1, keepdims=True)), axis=0)


class Band:
    """Spectra of forces and of the discrepancies beside hypotheses, over the blocks of a record.

    Only the part of a discrepancy in the frequency band of a force can be mistaken for the force. With p and q the
    spectra of the force and of the discrepancy, each of sum one, averaged over the blocks (Welch 1967, IEEE Trans.
    Audio Electroacoust. 15:70), its share is Σ_ω p q/Σ_ω p², at most 1: 1 if both have the same spectrum; if the
    discrepancy is white and the force has some frequencies evenly, the share of the frequencies that the force has.
    """

    def __init__(self, forces: Float[np.ndarray, "n_sample k"], left: Float[np.ndarray, "n_sample n_left"]) -> None:
        self._n_block = int(blocks(len(forces)).max(initial=0)) + 1
        self._length = len(forces) // self._n_block
        self._forces = self._transformed(forces)
        self._left = self._shares(self._transformed(left))

    def share(self, number: int, members: Sequence[int], mixed: Float[np.ndarray, "k k"]) -> Float[np.ndarray, " k"]:
        """Return the share of a hypothesis's discrepancy with the spectrum of sums of its forces, rows of `mixed`."""
        p = self._shares(self._forces[..., list(members)] @ mixed.T)
        q, square = self._left[:, number], np.sum(p**2, axis=0)
        return np.clip(np.where(square > 0, (q @ p) / np.where(square > 0, square, 1.0), 1.0), 0.0, 1.0)

    def _transformed(self, table: np.ndarray) -> np.ndarray:
        """Return Fourier transforms of the blocks under a Hann window, which has no leaps at the ends."""
        cut = table[: self._n_block * self._length].reshape(self._n_block, self._length, -1)
        return np.fft.rfft(cut * hann(self._length, sym=False)[:, None], axis=1)

    def _shares(self, transformed: np.ndarray) -> Float[np.ndarray, "n_frequency k"]:
        power = np.sum(np.abs(transformed) ** 2, axis=0)
        # All frequencies but zero and half the rate of the samples stand for their negative, too.
        power[1 : (self._length + 1) // 2] *= 2
        total = np.sum(power, axis=0)
        return power / np.where(total > 0, total, 1.0)


@dataclass(frozen=True)
class Residuals:
    """Split of residuals under noise points."""

    table: RegressorTable
    forces: Sequence[LatentForce]
    points: Sequence[NoisePoint]
    _bases: dict[tuple, Basis] = field(default_factory=dict, repr=False)

    def white(self, number: int, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals without the smoothed discrepancy of a law, whitened, and log variances of the rows."""
        point = self.points[number]
        white, logs = self.forces[point.shape].whiten_at(point, residuals)
        if point.kind in (LAW, MEMORY):
            basis = self._basis(point)
            white = white - basis.features @ basis.posterior(white, point.ratio)
        return white, logs

    def smoothed(self, number: int, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the posterior mean of the discrepancy, as a force, and its variance over v."""
        point = self.points[number]
        force = self.forces[point.shape]
        if point.kind == LATENT_FORCE:
            return force.smooth(residuals, point.scale, point.ratio)
        basis = self._basis(point)
        mean = basis.acting @ basis.posterior(force.whiten_plain(residuals), point.ratio)
        return mean, basis.acting**2 @ basis.shrunk(point.ratio)

    def block_logs(self, best: np.ndarray, residuals: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the log likelihood of each block at each hypothesis's mode [n_hypothesis, n_block]."""
        member = (self.table.block == np.arange(self.table.block.max() + 1)[:, None]).astype(float)
        logs = np.empty((residuals.shape[1], len(member)))
        for number in np.unique(best):
            places = np.flatnonzero(best == number)
            white, log_variance = self.white(int(number), residuals[:, places])
            logs[places] = (member @ (-0.5 * (white**2 / v[places] + np.log(v[places]) + log_variance))).T
        return logs

    def discrepancies(self, logs: np.ndarray, residuals: np.ndarray) -> np.ndarray:
        """Return the smoothed discrepancy beside each hypothesis, at its likeliest point that has one."""
        unnamed = np.array([point.unnamed for point in self.points])
        best = np.argmax(np.where(unnamed, logs, -np.inf), axis=1)
        smoothed = np.zeros((len(self.table.acting), len(best)))
        # There is none where each one would be larger than the gap.
        for number in np.unique(best[unnamed[best]]):
            places = np.flatnonzero(best == number)
            smoothed[:, places] = self.smoothed(int(number), residuals[:, places])[0]
        return smoothed

    def _basis(self, point: NoisePoint) -> Basis:
        key = point.shape, point.kind, point.scale, point.memory
        if key not in self._bases:
            self._bases[key] = discrepancy_basis(self.table, point, self.forces[point.shape])
        return self._bases[key]
