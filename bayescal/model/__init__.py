"""The model: a session as geometry (`Scene`), its effects as whitened parameters (`Model`)."""

from bayescal.model.block import ARM as ARM
from bayescal.model.block import Block as Block
from bayescal.model.block import Turned as Turned
from bayescal.model.equilibrium import arm_at_rest as arm_at_rest
from bayescal.model.equilibrium import equilibrium as equilibrium
from bayescal.model.equilibrium import standing as standing
from bayescal.model.model import ORIENTATION as ORIENTATION
from bayescal.model.model import Model as Model
from bayescal.model.model import build as build
from bayescal.model.model import with_parameters as with_parameters
from bayescal.model.options import USUAL as USUAL
from bayescal.model.options import FitOptions as FitOptions
from bayescal.model.options import check_asked as check_asked
from bayescal.model.scene import Scene as Scene
