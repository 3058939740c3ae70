"""Host systems, effects hidden in them, and their exact paths; all in plain NumPy and SciPy."""
