"""Noise of rows: what every kind of it answers, and white, banded, spectral, correlated and weighted noise."""
