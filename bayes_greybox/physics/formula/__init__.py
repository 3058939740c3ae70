"""Formulas: their grammar, their values, and how they are printed, rounded and differentiated."""
