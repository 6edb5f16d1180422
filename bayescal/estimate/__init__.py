"""The estimate: Levenberg-Marquardt on the factor graph, outliers, noise, covariance."""

from bayescal.estimate.estimate import Estimate as Estimate
from bayescal.estimate.estimate import calibrated as calibrated
from bayescal.estimate.estimate import check_enough as check_enough
from bayescal.estimate.estimate import estimate as estimate
from bayescal.estimate.estimate import fitted_level as fitted_level
from bayescal.estimate.estimate import settled as settled
from bayescal.estimate.estimate import unfitted as unfitted
from bayescal.estimate.solver import STATED_WORTH as STATED_WORTH
from bayescal.estimate.solver import Weights as Weights
from bayescal.estimate.solver import linearise as linearise
from bayescal.estimate.solver import root as root
from bayescal.estimate.solver import solve as solve
from bayescal.estimate.solver import unit_weights as unit_weights
