"""Keyframes of a patched file: more joints have longer positions."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from bayescal.exporting.digits import numbers
from bayescal.exporting.mjcf.into.scene_file import SceneFile, compiled
from bayescal.exporting.mjcf.law import Law
from bayescal.exporting.mjcf.readings import Joints, posture


def with_keyframes(
    scene: SceneFile, before: Any, gone: Collection[str], law: Law, joints: Joints, renamed: Mapping[str, str]
) -> None:
    """Rewrite positions and speeds of the keyframes for the joints of the patched file.

    Parameters
    ----------
    scene : SceneFile
        The patched file; its tree is changed.
    before : MjModel
        Of the file as it was.
    gone : collection of str
        Joints of that file that are taken out of it.
    law, joints
        Of the arm: added joints stand as its readings demand.
    renamed : mapping
        Names of added joints in the file, where they differ.
    """
    keys = [key for keyframe in scene.root.findall("keyframe") for key in keyframe.iter("key")]
    if not keys:
        return
    kept = [(key.attrib.pop("qpos", None), key.attrib.pop("qvel", None)) for key in keys]
    after = compiled(scene.xml.text, scene.path.parent, scene.path.name)
    old = [j for j in range(before.njnt) if before.joint(j).name not in gone]
    own = {before.joint(j).name for j in old}
    same = not gone and [before.joint(j).name for j in range(before.njnt)] == [
        after.joint(j).name for j in range(after.njnt)
    ]
    for k, (key, (qpos, qvel)) in enumerate(zip(keys, kept, strict=True)):
        if qpos is not None:
            values = before.key_qpos[k]
            angles = np.array([values[before.joint(name).qposadr[0]] for name in joints.names])
            stood = posture(law, joints, np.linalg.solve(law.nominal, joints.signs * angles))
            stood = {renamed.get(name, name): value for name, value in stood.items()}
            key.set("qpos", qpos if same else numbers(_moved(before, after, old, own, values, "qpos", stood)))
        if qvel is not None:
            key.set(
                "qvel",
                qvel if same else numbers(_moved(before, after, old, own, before.key_qvel[k], "dof", {})),
            )


def _moved(
    before: Any, after: Any, old: list[int], names: Collection[str], values: np.ndarray, what: str,
    stood: Mapping[str, float],
) -> np.ndarray:  # fmt: skip
    """Values of the joints of the patched file: those of the file's own joints, and of the added ones."""
    sizes = {"qpos": (7, 4, 1, 1), "dof": (6, 3, 1, 1)}[what]
    start = {"qpos": "jnt_qposadr", "dof": "jnt_dofadr"}[what]
    out = after.qpos0.copy() if what == "qpos" else np.zeros(after.nv)
    own = iter(old)
    for j in range(after.njnt):
        name, size = after.joint(j).name, sizes[int(after.jnt_type[j])]
        at = int(getattr(after, start)[j])
        if name and name not in names:
            if name in stood:
                out[at] = stood[name]
            continue
        was = int(getattr(before, start)[next(own)])
        out[at : at + size] = values[was : was + size]
    return out
