"""A simulation that is an FMU: its description, its instances, and its right-hand side."""
