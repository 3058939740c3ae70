"""Studies of many assets under one description, or of one: what a configuration asks for, on many machines."""
