"""Noise of a fit that is not white: what residuals say of it, and what users ask for."""
