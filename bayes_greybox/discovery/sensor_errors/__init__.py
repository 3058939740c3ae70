"""Errors of sensors and inputs: their columns, how they are undone in data, and noise on the samples."""
