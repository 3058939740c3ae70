"""What the likelihood knows of the rows of one equation: as compressed features, or by a dense covariance matrix."""

from bayes_greybox.model.design.dense import DenseDesign
from bayes_greybox.model.design.features import FeatureDesign
from bayes_greybox.model.design.protocol import Compress, Design, EquationDraws, Root, WeightedRows

__all__ = ["Compress", "DenseDesign", "Design", "EquationDraws", "FeatureDesign", "Root", "WeightedRows"]
