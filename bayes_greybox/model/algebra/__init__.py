"""The linear algebra of the model: what is integrated out, compressed, factorised and summed over."""
