"""The linear algebra of the model: integrating out, compressing, factorising and summing."""
