"""Named parameters: intervals of those that are learned, and names of those that are off."""
