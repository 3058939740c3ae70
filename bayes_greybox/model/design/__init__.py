"""Designs: the rows of one equation as the likelihood sees them, by compressed features or a dense covariance."""

from .dense import DenseDesign
from .features import FeatureDesign
from .protocol import Compress, Design, EquationDraws, Root, WeightedRows

__all__ = ["Compress", "DenseDesign", "Design", "EquationDraws", "FeatureDesign", "Root", "WeightedRows"]
