"""A simulation that is an FMU: what users give, how it is run, and the right-hand side that it is."""
