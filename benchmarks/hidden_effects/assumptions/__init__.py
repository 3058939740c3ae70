"""Cases whose data break an assumption of the study: channels, noise, memory, or a disturbance for a moment."""
