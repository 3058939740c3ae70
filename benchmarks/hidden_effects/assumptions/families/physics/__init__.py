"""What the system does that no entry of the catalogue says, or that is hard to see of it."""
