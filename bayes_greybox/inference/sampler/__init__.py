"""Compiled parts of a fit: NUTS, Gibbs moves on patterns, exact conditional draws, draws from the prior."""
