"""A patched file, compiled: the arm is the calibrated one, and the rest is as it was."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayescal.arm.transforms import rigid, rotation
from bayescal.errors import BayescalError
from bayescal.exporting.engine import mujoco
from bayescal.exporting.mjcf.into.found_arm import FoundArm
from bayescal.exporting.mjcf.mechanism import Mechanism
from bayescal.exporting.same_arm import Match

CLOSE = 1e-9
"""m: difference of the written file's kinematics from the arm's at which it is not handed out."""


def check(
    found: FoundArm,
    where: Match,
    machine: Mechanism,
    before: Any,
    after: Any,
    names: Mapping[str, str],
    file: str,
) -> None:
    """Compare the compiled file with the arm's kinematics, and its other bodies with the file as it was.

    Raises
    ------
    BayescalError
        If they differ: nothing is written.
    """
    mj = mujoco()
    data, rng = mj.MjData(after), np.random.default_rng(0)
    off = 0.0
    for turns in (np.zeros(len(found.ids)), *rng.uniform(-np.pi, np.pi, (3, len(found.ids)))):
        data.qpos[:] = after.qpos0
        angles = iter(turns.tolist())
        pose = np.eye(4)
        for body in machine.bodies:
            turn = next(angles) if body.name.startswith("link") else 0.0
            pose = pose @ body.pose @ rigid(rotation(2, turn))
        for name, sign, turn in zip(found.file.names, where.signs, turns, strict=True):
            data.joint(name).qpos[0] = sign * turn
        mj.mj_kinematics(after, data)
        own = data.body(names.get("flange", "flange"))
        theirs = where.root @ rigid(own.xmat.reshape(3, 3), own.xpos)
        off = max(off, float(np.max(np.abs(theirs - pose @ machine.flange))))
    arm = {before.body(b).name for b in found.ids}
    others = [before.body(b).name for b in range(1, before.nbody) if before.body(b).name not in arm | {""}]
    same = after.ngeom == before.ngeom and all(
        np.allclose(getattr(before.body(name), key), getattr(after.body(name), key), rtol=1e-9, atol=1e-12)
        for name in others
        for key in ("mass", "inertia", "pos", "ipos")
    )
    if not (off < CLOSE and same):
        what = (
            f"moves by {off:.1e} m (or rad) from the calibrated geometry" if same else "changes other bodies"
        )
        raise BayescalError(
            f"the written file {what}", file, "this is a defect of bayescal; nothing is written"
        )
