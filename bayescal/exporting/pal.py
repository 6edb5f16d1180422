"""A calibrated arm as PAL Robotics' ``master_calibration.yaml``, for TIAGo, TALOS and others.

`robot_state_publisher` adds its entries to the origins of the URDF at start: ``geometric_calibration`` has
``arm_1_dx``, ``dy``, ``dz`` (m), ``droll``, ``dpitch`` and ``dyaw`` (rad), differences of `xyz` and `rpy` of
the joint ``arm_1_joint`` (source: figaroh-plus, which writes the same file). So the file is the difference of
the robot's URDF and its calibrated copy.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import yaml

from bayescal.errors import BayescalError
from bayescal.exporting.geometry import constant
from bayescal.exporting.urdf import write as write_urdf
from bayescal.exporting.written import Format, Options, Written, path_of
from bayescal.fitted.arm import FittedArm
from bayescal.robots.markup import LARGEST, parse_markup
from bayescal.storage.reading import decoded

KEYS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw")
ATTRIBUTE = "geometric_calibration"
LEAST = 1e-12
"""m and rad: smaller differences are rounding."""


def _origins(content: bytes, file: str) -> dict[str, np.ndarray]:
    """`xyz` and `rpy` (6,) of the joints of a URDF, as they are written."""
    out = {}
    for joint in parse_markup(content, file).findall("joint"):
        origin = joint.find("origin")
        stated = {} if origin is None else origin.attrib
        texts = (stated.get("xyz", "0 0 0"), stated.get("rpy", "0 0 0"))
        out[joint.get("name", "")] = np.array([float(x) for text in texts for x in text.split()])
    return out


def _write(arm: FittedArm, options: Options) -> Written:
    if not options.into:
        what = "the entries are differences from the URDF of the robot"
        raise BayescalError(what, "--to pal", "give it: `--into robot.urdf#link`")
    path = path_of(options.into)[0]
    patched = write_urdf(arm, options)
    text = patched.content if isinstance(patched.content, bytes) else patched.content.encode()
    before, after = _origins(decoded(path, LARGEST)[1], path.name), _origins(text, path.name)
    entries: dict[str, float] = {}
    for name, origin in after.items():
        change = origin - before[name]
        change[3:] = (change[3:] + np.pi) % (2.0 * np.pi) - np.pi
        bare = name.removesuffix("_joint")
        differences = zip(KEYS, change.tolist(), strict=True)
        new = {f"{bare}_{k}": x for k, x in differences if abs(x) > LEAST}
        if twice := entries.keys() & new.keys():
            what = f"two joints have the entry {min(twice)}"
            raise BayescalError(what, path.name, "names differ by `_joint` alone: rename one of the joints")
        entries |= new
    content = {"robot_state_publisher": {ATTRIBUTE: entries}}
    named = [replace(i, element=_joint_of(i.element), attribute=ATTRIBUTE) for i in patched.items]
    added = f"the entries are added to the origins of {path.name}: an earlier calibration must not be in it"
    notes = [*(n for n in patched.notes if "mesh" not in n), added]
    text_ = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    return Written(text_, named, notes=notes, details=patched.details)


def _joint_of(element: str) -> str:
    """The name of a joint in an XPath."""
    found = re.search(r"@name=(['\"])(.*)\1", element)
    return found[2] if found else element


PAL = Format(
    ".yaml",
    _write,
    lambda arm, k: constant(arm.model.parameters[k]),
    "master_calibration.yaml has constant geometry only",
    into=True,
)
"""Differences of joint origins from those of the robot's URDF, which is given as the file of the user."""
