"""Log evidence of inclusion sets on the noise grid, their prior, and the search among them."""
