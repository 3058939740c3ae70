"""Kinds of rows: measurements as a linear equation in the coefficients."""
