"""An arm in MuJoCo that stands still at given readings; its differences from the fitted arm by level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.effects import MODELS
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.exporting.mjcf import holds, mjcf
from bayescal.exporting.mjcf.elastic import Content
from bayescal.exporting.mjcf.mechanism import Load, loads, places
from bayescal.exporting.mjcf.readings import STIFF, Joints, Law, bare, error, law_of, posture
from bayescal.exporting.mjcf.replay import hold_base
from bayescal.exporting.mjcf.scene_arm import compiled
from bayescal.exporting.written import IN_F0, mujoco
from bayescal.fitted.arm import NOMINAL, FittedArm
from bayescal.robots.urdf import parse_markup
from bayescal.storage.stopping import Progress, silent

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
            self.model.qpos_spring[self.model.joint(name).qposadr[0]] = angle

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
        for k, start in enumerate(postures):
            self.mj.mj_resetData(self.model, self.data)
            self._place(start)
            if len(self.data.plastic):  # the arm sinks into its springs, which may push a gear off its place
                self._command(starts[k])
                self._settle()
                self._place(start)
            if np.any(starts[k] != readings[k]):
                self.model.opt.timestep = self.timestep
                for share in np.linspace(0.0, 1.0, RAMP):
                    smooth = share * share * (3.0 - 2.0 * share)
                    self._command(starts[k] + smooth * (readings[k] - starts[k]))
                    self.mj.mj_step(self.model, self.data)
            self._command(readings[k])
            self._check_still(k, self._settle())
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


NOMINAL_WITHIN = 1e-9
"""Maximum difference of the TCP positions, m, of the nominal arm."""
TOGETHER, TOGETHER_RMS = 3e-6, 1e-6
"""Maximum and RMS difference, m, of any model."""


def limit(effects: Sequence[str]) -> float:
    """Maximum difference of a model with these effects, m."""
    within = [MODELS[plain(name)].simulated_within for name in effects] or [NOMINAL_WITHIN]
    return min(sum(within), TOGETHER)


APPROACH = 3.0
"""Motion of every gear before a pose, in half-widths of the largest lost motion: it passes twice that."""
MOVED = 0.999
"""Place in the lost motion beyond which a gear has moved through it."""


@dataclass(frozen=True)
class Machine:
    """An arm in its file in MuJoCo, in the state of a row: the law of its readings and its tools."""

    arm: FittedArm
    file: File
    simulator: Simulator
    law: Law
    loads: tuple[Load, ...]

    @classmethod
    def of(cls, arm: FittedArm, row: int, file: File) -> Machine:
        """The machine of an arm in a file that has the state of a row."""
        content = Content(arm, row)
        law = law_of(content)
        return cls(arm, file, Simulator(file, law.nominal), law, loads(content))

    def at_row(self, row: int) -> Machine:
        """The machine in the state of another row, to which the bodies of a new file are brought."""
        content = Content(self.arm, row)
        law = law_of(content)
        self.simulator.take(places(content, bare(law) if self.file.script else law))
        return replace(self, law=law, loads=loads(content))

    def replayed(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readings reached (C, n), rad, and TCP positions (C, 3), m, in rows of the session.

        Each pose is approached in the direction in which the arm moved, with tool and payload of the row.
        """
        m, law, joints = self.arm.dataset.measurements, self.law, self.file.joints
        payload = np.zeros(len(m.ids)) if m.payload is None else m.payload
        reached, points = np.empty((len(rows), m.readings.shape[1])), np.empty((len(rows), 3))
        carried = np.column_stack([m.tool[rows], payload[rows]])
        for tool, extra in np.unique(carried, axis=0):
            mine = np.flatnonzero((carried == (tool, extra)).all(axis=1))
            load = self.loads[int(tool)]
            self.simulator.carry(load, float(extra))
            readings = m.readings[rows[mine]]
            # places of gears in their lost motion; the middle where no velocity is recorded
            sense = np.zeros(readings.shape) if m.velocity is None else law.sense(m.velocity[rows[mine]])
            if self.file.script:
                links = law.turned(readings) + law.lag(sense)
                starts = goals = np.linalg.solve(law.nominal, links.T).T
                postures = [dict(posture(bare(law), joints, goal)) for goal in goals]
            else:
                goals, starts = readings, self.starts(readings, sense)
                postures = self.postures(starts, sense)
            stood, points[mine] = self.simulator.stand(postures, starts, goals, load.name)
            reached[mine] = stood - goals + readings
        world = self.file.world
        return reached, points @ world[:3, :3].T + world[:3, 3]

    def starts(self, readings: np.ndarray, sense: np.ndarray) -> np.ndarray:
        """Readings (C, n), rad, from which the poses are approached: gears that moved, move."""
        if not self.law.lost.any():
            return readings
        moved = APPROACH * np.max(self.law.lost) * np.where(np.abs(sense) > MOVED, np.sign(sense), 0.0)
        return readings - np.linalg.solve(self.law.geared @ self.law.nominal, moved.T).T

    def postures(self, starts: np.ndarray, sense: np.ndarray) -> list[dict[str, float]]:
        """Positions of all joints at the starts (C, n); gears that rest are at their places."""
        names = self.file.joints.names
        lags = self.law.lag(np.where(np.abs(sense) > MOVED, 0.0, sense))
        out = [dict(posture(self.law, self.file.joints, start)) for start in starts]
        for positions, lag in zip(out, lags, strict=True):
            for j in np.flatnonzero(lag).tolist():
                positions[error(names[j])] += float(lag[j])
        return out


def modelled(arm: FittedArm, rows: np.ndarray, reached: np.ndarray, state: int) -> np.ndarray:
    """TCPs (C, 3), m, of the fitted arm at readings reached (C, n) in rows, in the state of a row."""
    m = arm.dataset.measurements
    out = np.empty((len(rows), 3))
    for tool in np.unique(m.tool[rows]):
        mine, name = np.flatnonzero(m.tool[rows] == tool), arm.dataset.tools[int(tool)].name
        payload = 0.0 if m.payload is None else m.payload[rows[mine]]
        direction = None if m.velocity is None else m.velocity[rows[mine]]
        poses = arm.at(reached[mine], tool=name, payload_kg=payload, direction=direction, row=state)
        out[mine] = poses.points
    return out


POSES = 100


@dataclass(frozen=True)
class Level:
    """One model level: differences of C TCP positions, m, and the limit of the largest."""

    name: str
    differences: np.ndarray  # (C,)
    limit: float

    @property
    def rms(self) -> float:
        """RMS difference, m."""
        return float(np.sqrt(np.mean(self.differences**2)))

    @property
    def maximum(self) -> float:
        """Largest difference, m."""
        return float(np.max(self.differences))

    @property
    def passed(self) -> bool:
        """Whether the differences are within the limits."""
        return self.maximum <= self.limit and self.rms <= TOGETHER_RMS


def chosen(arm: FittedArm) -> np.ndarray:
    """Rows of the session whose poses are compared: evenly spread, without outliers."""
    rows = np.flatnonzero(~np.isin(np.array(arm.dataset.measurements.ids), arm.rejected))
    return rows[np.unique(np.linspace(0, len(rows) - 1, POSES).round().astype(int))]


def levels(arm: FittedArm, file: File, state: int, progress: Progress = silent) -> tuple[Level, ...]:
    """Compare every model level of an arm, as far as MJCF holds it, with a simulator.

    The last level is the written file; the others are files written in the same way.

    Parameters
    ----------
    arm : FittedArm
    file : File
        The written one.
    state : int
        Row of the session whose state the file has.
    progress : callable
        As of `verify`.
    """
    rows, out = chosen(arm), []
    for k, name in enumerate(arm.levels):
        progress("levels", k / len(arm.levels))
        arm_of_level = arm if name == arm.levels[-1] else arm.level(name)
        used = file if arm_of_level is arm else File.new(arm_of_level, state, file.script)
        reached, points = Machine.of(arm_of_level, state, used).replayed(rows)
        off = np.linalg.norm(points - modelled(_held(arm_of_level), rows, reached, state), axis=1)
        out.append(Level(name, off, limit(arm.effects[:k] if name != NOMINAL else ())))
    return tuple(out)


def _held(arm: FittedArm) -> FittedArm:
    """The arm without the parameters that no MJCF file holds."""
    held = [holds(arm, k) for k in range(len(arm.values))]
    return arm if all(held) else replace(arm, values=np.where(held, arm.values, 0.0))
