"""What the likelihood knows of the rows of one equation: as compressed features, or by a dense covariance matrix."""

from .dense import DenseDesign
from .features import FeatureDesign
from .protocol import Compress, Design, EquationDraws, Root, WeightedRows

__all__ = ["Compress", "DenseDesign", "Design", "EquationDraws", "FeatureDesign", "Root", "WeightedRows"]
