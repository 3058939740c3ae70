"""Designs: the rows of one equation as the likelihood sees them, by compressed features or a dense covariance."""

from .dense import DenseDesign
from .features import FeatureDesign
from .protocol import Compress, EquationDraws, Root, WeightedRows

Design = FeatureDesign | DenseDesign
"""A design of either kind. Both have the same methods: remove f, draw f, evaluate f elsewhere, leave rows out."""

__all__ = ["Compress", "DenseDesign", "Design", "EquationDraws", "FeatureDesign", "Root", "WeightedRows"]
