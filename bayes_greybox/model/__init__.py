"""The probabilistic program: kernels, features, priors, the collapsed likelihood, GreyBox."""
