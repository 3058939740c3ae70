"""Hypotheses with their posterior probability, coefficients, residuals and agreement."""
