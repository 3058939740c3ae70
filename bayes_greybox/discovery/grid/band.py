"""The part of what is left in the frequency band of a force: only that can be mistaken for the force.

With p and q the spectra of the force and of what is left, each of sum one, averaged over the blocks of a record (Welch
1967, IEEE Trans. Audio Electroacoust. 15:70), its share is

    Σ_ω p q/Σ_ω p²,  at most 1.

It is 1 if both have the same spectrum. If what is left is white and the force has some frequencies evenly, it is the
share of the frequencies that the force has.
"""

import numpy as np
from jaxtyping import Float
from scipy.signal.windows import hann

from .agreement import blocks


def in_band(
    left: Float[np.ndarray, "n_sample n_left"], forces: Float[np.ndarray, "n_sample n_force"]
) -> Float[np.ndarray, "n_left n_force"]:
    """Return the share of the square of what is left that has the spectrum of a force.

    Args:
        left: What is left, at samples in order of time.
        forces: Forces at the same samples; a column of zeros has a share of 1.
    """
    p, q = _spectra(forces), _spectra(left)
    square = np.sum(p**2, axis=0)
    return np.clip(np.where(square > 0, (q.T @ p) / np.where(square > 0, square, 1.0), 1.0), 0.0, 1.0)


def _spectra(table: np.ndarray) -> Float[np.ndarray, "n_frequency k"]:
    """Return spectra over their sums, of blocks under a Hann window: their ends do not leap."""
    n_block = int(blocks(len(table)).max(initial=0)) + 1
    length = len(table) // n_block
    cut = table[: n_block * length].reshape(n_block, length, -1) * hann(length, sym=False)[:, None]
    power = np.sum(np.abs(np.fft.rfft(cut, axis=1)) ** 2, axis=0)
    # All frequencies but zero and half the rate of the samples stand for their negative, too.
    power[1 : (length + 1) // 2] *= 2
    total = np.sum(power, axis=0)
    return power / np.where(total > 0, total, 1.0)
