"""Evidence p(y | hypothesis) of competing sets of terms on the sufficient statistics of one equation."""
