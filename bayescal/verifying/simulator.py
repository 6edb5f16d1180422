"""An arm in MuJoCo that stands still at given readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.format import mjcf
from bayescal.exporting.mjcf.mechanism import Load
from bayescal.exporting.mjcf.readings import STIFF, Joints
from bayescal.exporting.mjcf.replay import hold_base
from bayescal.exporting.mjcf.scene_arm import compiled
from bayescal.exporting.sidecar import mujoco
from bayescal.exporting.written import IN_F0
from bayescal.fitted.arm import FittedArm
from bayescal.robots.markup import parse_markup

RAMP = 120
"""Steps, with the time step of the file, of the motion before a pose."""
SETTLING = 0.05
"""Step, s, at which the arm comes to rest: the integrator damps all oscillations."""
MOST = 600
"""Maximum number of these steps."""
REST = 1e-10
"""Speed of all joints, rad/s and m/s, at rest."""


@dataclass(frozen=True)
class File:
    """A file of an arm: text, folder of its meshes, name, joints, and its world in F0, (4, 4), m.

    Actuators and sensors of a new file, with the names of the joints, command and show the readings. In a
    user's file (`of_user`) the joints have the user's actuators, and added parts may be `renamed`, by kind.
    With a `script` the file has no errors of the readings; they are in its commands.
    """

    text: str
    folder: Path
    name: str
    joints: Joints
    world: np.ndarray = field(default_factory=lambda: np.eye(4))
    of_user: bool = False
    script: bool = False
    renamed: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @classmethod
    def of(cls, arm: FittedArm, text: str, path: Path, sidecar: Mapping[str, Any]) -> File:
        """A written file with its sidecar; without entries it is a new file."""
        script = sidecar.get("readings") == "script"
        if "root_in_f0" not in sidecar:
            joints = Joints.of(arm.dataset.robot.joint_names)
            return cls(text, path.parent, str(path), joints, script=script)
        joints = Joints(tuple(sidecar["joints"].values()), np.array(sidecar["signs"]))
        world, renamed = np.array(sidecar["root_in_f0"]), sidecar.get("renamed", {})
        return cls(text, path.parent, str(path), joints, world, True, script, renamed)

    @classmethod
    def new(cls, arm: FittedArm, state: int, script: bool = False) -> File:
        """A new file of an arm in the state of a row."""
        joints = Joints.of(arm.dataset.robot.joint_names)
        return cls(mjcf(arm, state, script), Path(), "new file", joints, script=script)


class Simulator:
    """A file in MuJoCo.

    Parameters
    ----------
    file : File
        Stiff springs hold the joints of a user's file in place of its actuators.
    nominal : np.ndarray, shape (n, n)
        Angles of the joints from readings.

    Raises
    ------
    BayescalError
        If MuJoCo is not installed, or refuses the file, or the file has no such joints.
    """

    def __init__(self, file: File, nominal: np.ndarray) -> None:
        self.mj: Any = mujoco()
        parse_markup(file.text.encode(), file.name)
        self.model = compiled(file.text, file.folder, file.name)
        self.data = self.mj.MjData(self.model)
        self.file, self.joints, self.nominal, self.servos = file, file.joints, nominal, not file.of_user
        self.timestep = self.model.opt.timestep
        kinds = ("ACTUATOR", "SENSOR") if self.servos else ("JOINT",)
        for name in self.joints.names:
            if any(self._id(kind, name) < 0 for kind in kinds):
                what = f"there is no {' and '.join(kinds).lower()} `{name}`"
                raise BayescalError(what, file.name, "give a file of bayescal export")
        if not self.servos:
            flags = self.mj.mjtDisableBit
            self.model.opt.disableflags |= flags.mjDSBL_ACTUATION | flags.mjDSBL_CONTACT
            self.model.opt.integrator = self.mj.mjtIntegrator.mjINT_DISCRETE
            hold_base(self.mj, self.model, self.joints.names)
            for name in self.joints.names:
                joint = self._id("JOINT", name)
                self.model.jnt_stiffness[joint], self.model.jnt_stiffnesspoly[joint] = STIFF, 0.0
                self.model.jnt_limited[joint] = 0

    @cached_property
    def _of_arm(self) -> np.ndarray:
        """Degrees of freedom of the arm; those of other parts of a scene may move."""
        starts = (*self.joints.names, "stand_")
        names = (self.model.joint(j).name for j in self.model.dof_jntid)
        return np.array([name.startswith(starts) for name in names], bool)

    def _command(self, readings: np.ndarray) -> None:
        """Command readings (n,), rad."""
        if self.servos:
            self.data.ctrl[[self._id("ACTUATOR", name) for name in self.joints.names]] = readings
            return
        for name, angle in zip(self.joints.names, self.joints.signs * (self.nominal @ readings), strict=True):
            joint = self.model.joint(name)
            self.model.qpos_spring[joint.qposadr[0]] = angle

    def _reached(self) -> np.ndarray:
        """Readings (n,), rad."""
        if self.servos:
            sensors = [self.model.sensor_adr[self._id("SENSOR", name)] for name in self.joints.names]
            return self.data.sensordata[sensors].copy()
        angles = np.array([self.data.joint(name).qpos[0] for name in self.joints.names])
        return np.linalg.solve(self.nominal, self.joints.signs * angles)

    def _id(self, kind: str, name: str) -> int:
        name = self.file.renamed.get(kind.lower(), {}).get(name, name)
        return int(self.mj.mj_name2id(self.model, getattr(self.mj.mjtObj, f"mjOBJ_{kind}"), name))

    def carry(self, load: Load, payload: float) -> None:
        """Take a tool, and a further mass, kg, at its centre of mass."""
        for name, mass, place, point in (
            ("tool", load.mass, self.model.body_ipos, load.centre),
            ("payload", load.factor * payload, self.model.body_pos, load.hangs_at),
        ):
            body = self._id("BODY", name)
            if body >= 0:  # a rigid arm in a file of the user has no mass of the tool
                self.model.body_mass[body], place[body] = mass, point
        self.mj.mj_setConst(self.model, self.data)

    def take(self, poses: Mapping[str, np.ndarray]) -> None:
        """Take other poses (4, 4) of bodies in their parents."""
        for name, pose in poses.items():
            body = self._id("BODY", name)
            self.model.body_pos[body] = pose[:3, 3]
            self.mj.mju_mat2Quat(self.model.body_quat[body], pose[:3, :3].ravel())
        self.mj.mj_setConst(self.model, self.data)

    def stand(
        self, postures: Sequence[Mapping[str, float]], starts: np.ndarray, readings: np.ndarray, tip: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move to readings from close starts, and come to rest; readings reached (C, n) and TCPs (C, 3), m.

        Parameters
        ----------
        postures : sequence of mapping
            Positions of the joints of the file at the starts, by name.
        starts, readings : np.ndarray, shape (C, n)
            rad; equal where no motion precedes.
        tip : str
            Site of the tool.
        """
        site, of_two = self._id("SITE", tip), self._id("BODY", IN_F0)
        reached, points = np.empty(readings.shape), np.empty((len(readings), 3))
        for k, posture in enumerate(postures):
            self.mj.mj_resetData(self.model, self.data)
            self._place(posture)
            if len(self.data.plastic):  # the arm sinks into its springs, which may push a gear off its place
                self._command(starts[k])
                self._settle()
                self._place(posture)
            if np.any(starts[k] != readings[k]):
                self.model.opt.timestep = self.timestep
                for share in np.linspace(0.0, 1.0, RAMP):
                    smooth = share * share * (3.0 - 2.0 * share)
                    self._command(starts[k] + smooth * (readings[k] - starts[k]))
                    self.mj.mj_step(self.model, self.data)
            self._command(readings[k])
            speed = self._settle()
            self._check_still(k, speed)
            self.mj.mj_fwdPosition(self.model, self.data)
            self.mj.mj_sensorPos(self.model, self.data)
            reached[k], points[k] = self._reached(), self.data.site_xpos[site]
            if of_two >= 0:
                turn, place = self.data.xmat[of_two].reshape(3, 3), self.data.xpos[of_two]
                points[k] = (points[k] - place) @ turn
        return reached, points

    def _check_still(self, pose: int, speed: float) -> None:
        """Refuse a simulation that diverged, which MuJoCo starts again elsewhere, or still moves."""
        kinds = self.mj.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        if any(self.data.warning[int(kind)].number for kind in bad):
            what = f"the simulation is unstable at pose {pose + 1}"
            raise BayescalError(what, self.file.name, "check stiffness, damping and time step of the file")
        if not speed < 1e3 * REST:
            what = f"the arm does not come to rest within {MOST * SETTLING:g} s"
            raise BayescalError(what, self.file.name, "check the masses and the integrator of the file")

    def _place(self, posture: Mapping[str, float]) -> None:
        """Put joints at positions, at rest; others stay where they are."""
        model, data = self.model, self.data
        data.qvel[:] = 0.0
        for name, value in posture.items():
            joint = self._id("JOINT", name)
            if joint >= 0:
                data.qpos[model.jnt_qposadr[joint]] = value
        self.mj.mj_fwdPosition(model, data)
        for t in np.flatnonzero(model.tendon_plasticadr >= 0):
            address = model.tendon_plasticadr[t]
            # a spring without dead band has no stiffness at exactly zero
            data.plastic[address : address + 2] = data.ten_length[t] + 1e-12

    def _settle(self) -> float:
        """Step until all joints of the arm rest; their largest speed."""
        self.model.opt.timestep = SETTLING
        speed = np.inf
        for _ in range(MOST):
            self.mj.mj_step(self.model, self.data)
            speed = float(np.max(np.abs(self.data.qvel[self._of_arm]), initial=0.0))
            if speed < REST:
                break
        return speed
