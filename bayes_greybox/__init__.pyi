from .criticism.compare import compare as compare
from .data.datasets import dataset_table as dataset_table
from .data.datasets import load_dataset as load_dataset
from .data.errors import InputError as InputError
from .data.tables import read_table as read_table
from .data.trajectories import Trajectories as Trajectories
from .discovery.odds import Odds as Odds
from .discovery.study import Study as Study
from .discovery.study import find_missing_effects as find_missing_effects
from .greybox import Fit as Fit
from .greybox import GreyBox as GreyBox
from .greybox import load as load
from .model.discrepancy import OrthogonalGP as OrthogonalGP
from .model.priors import CustomPrior as CustomPrior
from .model.priors import Laplace as Laplace
from .model.priors import Normal as Normal
from .model.priors import RegularisedHorseshoe as RegularisedHorseshoe
from .model.priors import SpikeAndSlab as SpikeAndSlab
from .physics import systems as systems
from .physics.terms import Dictionary as Dictionary
from .physics.terms import Term as Term
from .physics.terms import polynomial as polynomial
from .report import figures as figures
from .report import plots as plots
from .report import study_figures as study_figures

__version__: str
