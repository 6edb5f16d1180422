"""Keyframes of a patched file: more joints have longer positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.exporting.digits import numbers
from bayescal.exporting.mjcf.into.scene_file import compiled
from bayescal.exporting.mjcf.law import Law
from bayescal.exporting.mjcf.readings import Joints, posture


def with_keyframes(root: ET.Element, before: Any, path: Path, law: Law, joints: Joints) -> None:
    """Rewrite positions and speeds of the keyframes for the joints of the patched file.

    Parameters
    ----------
    root : ET.Element
        The patched file; changed.
    before : MjModel
        Of the file as it was.
    path : Path
        Of the user's file.
    law, joints
        Of the arm: added joints stand as its readings demand.
    """
    keys = [key for keyframe in root.findall("keyframe") for key in keyframe.iter("key")]
    if not keys:
        return
    kept = [(key.attrib.pop("qpos", None), key.attrib.pop("qvel", None)) for key in keys]
    after = compiled(root, path.parent, path.name)
    old = {before.joint(j).name: j for j in range(before.njnt)}
    for k, (key, (qpos, qvel)) in enumerate(zip(keys, kept, strict=True)):
        if qpos is not None:
            values = before.key_qpos[k]
            angles = np.array([values[before.joint(name).qposadr[0]] for name in joints.names])
            stood = posture(law, joints, np.linalg.solve(law.nominal, joints.signs * angles))
            key.set("qpos", numbers(_moved(before, after, old, values, "qpos", stood)))
        if qvel is not None:
            key.set("qvel", numbers(_moved(before, after, old, before.key_qvel[k], "dof", {})))


def _moved(
    before: Any, after: Any, old: dict[str, int], values: np.ndarray, what: str, stood: Any
) -> np.ndarray:
    """Values of the joints of the patched file: those of the file's own joints, and of the added ones."""
    sizes = {"qpos": (7, 4, 1, 1), "dof": (6, 3, 1, 1)}[what]
    start = {"qpos": "jnt_qposadr", "dof": "jnt_dofadr"}[what]
    out = after.qpos0.copy() if what == "qpos" else np.zeros(after.nv)
    own = iter(range(before.njnt))
    for j in range(after.njnt):
        name, size = after.joint(j).name, sizes[int(after.jnt_type[j])]
        at = int(getattr(after, start)[j])
        if name and name not in old:
            if name in stood:
                out[at] = stood[name]
            continue
        was = int(getattr(before, start)[next(own)])
        out[at : at + size] = values[was : was + size]
    return out
