"""What to measure next: candidates, what each explanation predicts of them, and the information they are worth."""
