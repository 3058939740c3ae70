"""Is the noise model right, and who decides, data or prior: checks of what a fit claims."""
