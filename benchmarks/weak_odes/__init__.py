"""Terms and coefficients of differential equations from noisy samples of all states, nothing of them known."""
