"""Evidence p(y | hypothesis) of sets of effects and suspects, on the sufficient statistics of one equation."""
