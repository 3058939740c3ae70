"""The part of the discrepancy in the frequency band of a force: only that part can be mistaken for the force.

With p and q the spectra of the force and of the discrepancy, each of sum one, averaged over the blocks of a record
(Welch 1967, IEEE Trans. Audio Electroacoust. 15:70), its share is

    Σ_ω p q/Σ_ω p²,  at most 1.

It is 1 if both have the same spectrum. If the discrepancy is white and the force has some frequencies evenly, it is the
share of the frequencies that the force has.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.signal.windows import hann

from .agreement import blocks


class Band:
    """Spectra of forces and of the discrepancies beside hypotheses, over the blocks of a record.

    Args:
        forces: Forces at samples in order of time [n_sample, n_force].
        left: Discrepancy beside each hypothesis there [n_sample, n_hypothesis].
    """

    def __init__(
        self, forces: Float[np.ndarray, "n_sample n_force"], left: Float[np.ndarray, "n_sample n_left"]
    ) -> None:
        self._n_block = int(blocks(len(forces)).max(initial=0)) + 1
        self._length = len(forces) // self._n_block
        self._forces = self._transformed(forces)
        self._left = self._shares(self._transformed(left))

    def share(
        self, hypothesis: int, members: Sequence[int], mixed: Float[np.ndarray, "k k"]
    ) -> Float[np.ndarray, " k"]:
        """Return the share of a discrepancy's square that has the spectrum of each of some sums of forces.

        Args:
            hypothesis: Number of the hypothesis beside which the discrepancy is.
            members: Forces.
            mixed: Coefficients of the sums, one in each row. A sum that is zero has a share of 1.
        """
        p = self._shares(self._forces[..., list(members)] @ mixed.T)
        q, square = self._left[:, hypothesis], np.sum(p**2, axis=0)
        return np.clip(np.where(square > 0, (q @ p) / np.where(square > 0, square, 1.0), 1.0), 0.0, 1.0)

    def _transformed(self, table: np.ndarray) -> np.ndarray:
        """Return Fourier transforms of the blocks under a Hann window, which has no leaps at the ends."""
        cut = table[: self._n_block * self._length].reshape(self._n_block, self._length, -1)
        return np.fft.rfft(cut * hann(self._length, sym=False)[:, None], axis=1)

    def _shares(self, transformed: np.ndarray) -> Float[np.ndarray, "n_frequency k"]:
        """Return spectra over their sums."""
        power = np.sum(np.abs(transformed) ** 2, axis=0)
        # All frequencies but zero and half the rate of the samples stand for their negative, too.
        power[1 : (self._length + 1) // 2] *= 2
        total = np.sum(power, axis=0)
        return power / np.where(total > 0, total, 1.0)
