"""Parameters of ordinary differential equations from noisy samples, on problems with published results."""
