"""Noise models of the rows: correlated sensor noise, a latent force, and the grid of their hyperparameters."""
