"""Studies of many assets under one description, or of one configuration, on one machine or on many."""
