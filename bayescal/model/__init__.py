"""The model: a session as geometry (`Scene`), its effects as whitened parameters (`Model`)."""

from __future__ import annotations

from bayescal.model.block import ARM, Block, Turned
from bayescal.model.equilibrium import equilibrium, standing
from bayescal.model.model import ORIENTATION, Model, build, with_parameters
from bayescal.model.options import USUAL, FitOptions, check_asked
from bayescal.model.scene import Scene

__all__ = [
    "ARM",
    "ORIENTATION",
    "USUAL",
    "Block",
    "FitOptions",
    "Model",
    "Scene",
    "Turned",
    "build",
    "check_asked",
    "equilibrium",
    "standing",
    "with_parameters",
]
