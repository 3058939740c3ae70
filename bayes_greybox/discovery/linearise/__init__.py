"""Rows and regressors near the likeliest hypothesis, linearised again until it stays."""
