"""An arm in MuJoCo that stands still at given readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.mechanism import Load

APPROACH = 2e-3
"""Motion of every gear before a pose, rad: several times any lost motion."""
RAMP, STEP = 80, 2e-3
"""Steps of this motion, and their length, s."""
SETTLING = 0.05
"""Step, s, at which the arm comes to rest: the integrator damps all oscillations."""
MOST = 600
"""Maximum number of these steps."""
REST = 1e-10
"""Speed of all joints, rad/s and m/s, at rest."""


def mujoco() -> ModuleType:
    """The simulator.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    try:
        import mujoco as module
    except ImportError:
        remedy = "pip install 'bayescal[mujoco]'"
        raise BayescalError("MuJoCo is not installed", "bayescal verify", remedy) from None
    return module


@dataclass(frozen=True)
class Stood:
    """C poses in the simulator: readings that were reached (C, n), rad, and tool points (C, 3), m."""

    readings: np.ndarray
    points: np.ndarray


class Simulator:
    """A file in MuJoCo.

    Parameters
    ----------
    text : str
        Of the file.
    joints : sequence of str
        Sensors and actuators of the readings.
    where : str
        For messages.

    Raises
    ------
    BayescalError
        If MuJoCo is not installed, or refuses the file.
    """

    def __init__(self, text: str, joints: Sequence[str], where: str) -> None:
        self.mj: Any = mujoco()
        try:
            self.model = self.mj.MjModel.from_xml_string(text)
        except ValueError as error:
            raise BayescalError(f"MuJoCo refuses the file: {error}", where, "export it again") from None
        self.data = self.mj.MjData(self.model)
        self.joints, self.where = tuple(joints), where
        self.timestep = self.model.opt.timestep
        missing = [j for j in joints if self._id("ACTUATOR", j) < 0 or self._id("SENSOR", j) < 0]
        if missing:
            what = f"there is no actuator and sensor '{missing[0]}'"
            raise BayescalError(what, where, "give a file of bayescal export")

    def _id(self, kind: str, name: str) -> int:
        return int(self.mj.mj_name2id(self.model, getattr(self.mj.mjtObj, f"mjOBJ_{kind}"), name))

    def carry(self, load: Load, payload: float) -> None:
        """Take a tool, and a further mass, kg, at its centre of mass."""
        for name, mass, centre in (("tool", load.mass, load.centre), ("payload", payload, np.zeros(3))):
            body = self._id("BODY", name)
            self.model.body_mass[body] = mass
            if name == "tool":
                self.model.body_ipos[body] = centre
            else:
                self.model.body_pos[body] = load.centre
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
    ) -> Stood:
        """Move to readings from close starts, and come to rest.

        Parameters
        ----------
        postures : sequence of mapping
            Positions of the joints of the file at the starts, by name.
        starts, readings : np.ndarray, shape (C, n)
            rad; equal where no motion precedes.
        tip : str
            Site of the tool.
        """
        site = self._id("SITE", tip)
        reached, points = np.empty(readings.shape), np.empty((len(readings), 3))
        order = [self._id("ACTUATOR", j) for j in self.joints]
        sensors = [self.model.sensor_adr[self._id("SENSOR", j)] for j in self.joints]
        for k, posture in enumerate(postures):
            self._place(posture)
            if np.any(starts[k] != readings[k]):
                self.model.opt.timestep = self.timestep
                for share in np.linspace(0.0, 1.0, RAMP):
                    smooth = share * share * (3.0 - 2.0 * share)
                    self.data.ctrl[order] = starts[k] + smooth * (readings[k] - starts[k])
                    self.mj.mj_step(self.model, self.data)
            self.data.ctrl[order] = readings[k]
            self._settle()
            self.mj.mj_fwdPosition(self.model, self.data)
            self.mj.mj_sensorPos(self.model, self.data)
            reached[k], points[k] = self.data.sensordata[sensors], self.data.site_xpos[site]
        return Stood(reached, points)

    def _place(self, posture: Mapping[str, float]) -> None:
        model, data = self.model, self.data
        self.mj.mj_resetData(model, data)
        for name, value in posture.items():
            joint = self._id("JOINT", name)
            if joint >= 0:
                data.qpos[model.jnt_qposadr[joint]] = value
        self.mj.mj_fwdPosition(model, data)
        for t in np.flatnonzero(model.tendon_plasticadr >= 0):
            at = model.tendon_plasticadr[t]
            # a spring without dead band has no stiffness at exactly zero
            data.plastic[at : at + 2] = data.ten_length[t] + 1e-12

    def _settle(self) -> None:
        self.model.opt.timestep = SETTLING
        for _ in range(MOST):
            self.mj.mj_step(self.model, self.data)
            if np.max(np.abs(self.data.qvel), initial=0.0) < REST:
                return
        if not np.max(np.abs(self.data.qvel), initial=0.0) < 1e3 * REST:
            what = f"the arm does not come to rest within {MOST * SETTLING:g} s"
            raise BayescalError(what, self.where, "check the masses and the integrator of the file")
