"""What a study says once everything is weighed: finding, checks, amended model, instrument, gap."""
