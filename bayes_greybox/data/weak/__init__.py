"""Test functions, and the smoothing of samples that their integrals are evaluated at."""
