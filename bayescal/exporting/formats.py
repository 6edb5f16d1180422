"""All formats that an arm can be exported to. A further one is a file and an entry here."""

from __future__ import annotations

from bayescal.errors import BayescalError
from bayescal.exporting.dh_table import DH_CSV
from bayescal.exporting.joint_zeros import JOINT_ZEROS
from bayescal.exporting.mjcf.format import MJCF
from bayescal.exporting.robot import ROBOT_YAML
from bayescal.exporting.sdf import SDF
from bayescal.exporting.ur_yaml import UR_YAML
from bayescal.exporting.urdf import URDF
from bayescal.exporting.written import Format

FORMATS: dict[str, Format] = {f.name: f for f in (ROBOT_YAML, URDF, SDF, MJCF, UR_YAML, DH_CSV, JOINT_ZEROS)}
CERTIFICATE = "dcc"
"""A Digital Calibration Certificate: a format of the command, which is no file of an arm."""


def format_of(name: str) -> Format:
    """A format by its name.

    Raises
    ------
    BayescalError
        If there is no such format.
    """
    if name not in FORMATS:
        known = ", ".join((*FORMATS, CERTIFICATE))
        raise BayescalError(f"there is no format `{name}`", "--to", f"formats: {known}")
    return FORMATS[name]
