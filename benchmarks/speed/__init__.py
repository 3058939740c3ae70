"""Speed of drawing posteriors, beside others that draw the same, and beside the machine's own routines."""
