"""Regressors that a hypothesis may hold: free terms, corrections, effects, sensor errors, and forces with memory."""
