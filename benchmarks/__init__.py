"""Data with a known answer, and what the package makes of them; run from a checkout: `python -m benchmarks NAME`."""
