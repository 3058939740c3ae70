"""Simulation-based calibration of the posterior of data drawn from the model."""
