"""Maps without a derivative: forces over position and speed, flows over pressure, under white and correlated noise."""
