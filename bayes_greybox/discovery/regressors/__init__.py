"""What a hypothesis may hold: free terms, corrections, effects, sensor errors, and forces that remember."""
