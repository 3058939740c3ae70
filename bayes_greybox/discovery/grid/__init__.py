"""One grid of noise models, the evidence of every set of regressors on it, and how well the data agree with it."""
