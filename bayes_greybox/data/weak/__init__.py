"""Test functions of the weak form, and the smoothing of samples at which their integrals are evaluated."""
