"""Several machines studied at once: which effects they share, and how far their coefficients differ."""
