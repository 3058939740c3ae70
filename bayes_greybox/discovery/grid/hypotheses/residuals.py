"""Residuals of hypotheses, split into the discrepancy of a noise point and white noise."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bayes_greybox.discovery.grid.evidence.gram import Basis, discrepancy_basis
from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.noise.points import LATENT_FORCE, LAW, MEMORY, NoisePoint
from bayes_greybox.discovery.grid.table import RegressorTable


@dataclass(frozen=True)
class Residuals:
    """Split of residuals under noise points.

    Attributes:
        table: Target and regressors.
        forces: Rows under each shape of the noise.
        points: Noise points.
    """

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
