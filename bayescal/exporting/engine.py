"""Simulators, which are extras of the package."""

from __future__ import annotations

from types import ModuleType

from bayescal.errors import BayescalError


def mujoco() -> ModuleType:
    """The module of MuJoCo. Its warnings are not written to a file of the working folder.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    try:
        import mujoco as module
    except ImportError:
        remedy = "pip install 'bayescal[mujoco]'"
        raise BayescalError("MuJoCo is not installed", "simulator", remedy) from None
    module.set_mju_user_warning(lambda _: None)
    return module


def pinocchio() -> ModuleType:
    """The module of Pinocchio.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    try:
        import pinocchio as module
    except ImportError:
        remedy = "pip install 'bayescal[mujoco]' or 'bayescal[world]'"
        raise BayescalError("neither MuJoCo nor Pinocchio is installed", "simulator", remedy) from None
    return module
