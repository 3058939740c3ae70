"""Experiments: input signals, candidates for the next experiment, and simulated systems with known truth."""
