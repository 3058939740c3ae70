"""Host systems, what is hidden in them, and what is exact about their paths; all in plain NumPy and SciPy."""
