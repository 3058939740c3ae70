"""Raw measurements in: trajectories, table readers, differentiators, benchmark data sets."""
