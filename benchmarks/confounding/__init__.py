"""Confounding of θ and f: what orthogonality costs and gives, over repeated data with a known answer."""
