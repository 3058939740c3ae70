"""Explanations weighed along the path of a system: rows near a model, and turns towards the one that stays."""
