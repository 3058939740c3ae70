"""Noise of a fit that is not white: found on residuals, as users ask for it.

In all functions `residual` is the measured less the explained rate, in scaled units, `current` the noise as it is, and
`prior` that of σ.
"""
