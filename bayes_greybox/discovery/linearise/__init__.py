"""Rows and regressors near what was found, taken anew until it stays."""
