"""Checks of a fit: the noise model, and the influence of the prior beside the data."""
