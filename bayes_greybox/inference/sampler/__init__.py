"""What is compiled for a fit: NUTS, Gibbs moves on patterns, exact conditional draws, draws from the prior."""
