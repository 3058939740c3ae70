"""Rates from samples: differentiators, what their filters do to terms and noise."""
