"""The Gaussian process of the discrepancy: kernels, features, orthogonality, hyperparameters."""
