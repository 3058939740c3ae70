"""The known part of the model: the user's simulation as a right-hand side."""
