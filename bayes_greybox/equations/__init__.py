"""Learned equations: terms with coefficients, right-hand sides as formulas and as functions."""
