"""What the measurement does: late, filtered, bent or wrong sensors, and noise that is not white and normal."""
