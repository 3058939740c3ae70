"""What was found out about a fit, in its saved file."""
