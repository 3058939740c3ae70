"""Sets of effects and suspects, searched and weighed under every noise that the residuals speak for."""
