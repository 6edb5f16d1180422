"""Replay readings of the machine in its MuJoCo model: commands that contain the errors of the readings.

    python arm-replay.py readings.csv > points.csv

The table beside this program (arm-replay.json) has the law of the readings of one machine: scales, couplings,
periodic errors and lost motion. `Replay.command` is all that a controller needs: it gives the command of each
servo for a reading and the direction of motion before it. readings.csv has columns j1_deg ...; columns
j1_degps ... state the direction, payload_kg a further mass. points.csv is the tip of the tool, in mm, in the
frame of the model.

This program needs MuJoCo and NumPy alone.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

SETTLING, STEPS, REST = 0.05, 600, 1e-10
"""Step, s, number of steps, and speed at which the arm is at rest."""
HOLD = 1e10
"""Stiffness, N m/rad, of the springs that hold the joints of a scene."""

HELD = 1e16
"""Inertia, kg m2 and kg, of joints that carry the base."""


class Replay:
    """Commands for the readings of one machine.

    Parameters
    ----------
    table : mapping
        The content of the table beside this program.
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.table = table
        self.nominal, self.exact = np.array(table["nominal"]), np.array(table["exact"])
        self.offset, self.lost = np.array(table["offset_rad"]), np.array(table["lost_motion_rad"])
        self.geared = np.array(table["geared"])

    def command(self, readings: np.ndarray, direction: np.ndarray | None = None) -> np.ndarray:
        """Commands (n,) of the servos, rad.

        Parameters
        ----------
        readings : np.ndarray, shape (n,)
            rad, as the controller of the machine shows them.
        direction : np.ndarray, shape (n,), optional
            Motion of the readings before this pose, in any unit; 0: in the middle of the lost motion.
        """
        links, angles = self.exact @ readings, self.nominal @ readings + self.offset
        for wave in self.table["waves"]:
            phase = wave["order"] * angles[wave["joint"]]
            links[wave["joint"]] += wave["sine_rad"] * np.sin(phase) + wave["cosine_rad"] * np.cos(phase)
        if direction is not None:
            sense = np.sign(self.geared @ self.nominal @ direction)
            links = links - np.linalg.solve(self.geared, self.lost * sense)
        return np.linalg.solve(self.nominal, links)

    def contact_error(self, approach: np.ndarray, speed: float = 0.0) -> float:
        """Error of a probed contact, m, along the approach: positive where the probe triggers late.

        Parameters
        ----------
        approach : np.ndarray, shape (3,)
            Unit vector into the surface, in the flange's frame.
        speed : float
            Of the tip along it, m/s.
        """
        probe = self.table["probe"]
        across, azimuth = np.hypot(approach[0], approach[1]), 3.0 * np.arctan2(approach[1], approach[0])
        lobes = probe["lobing_sin_m"] * np.sin(azimuth) + probe["lobing_cos_m"] * np.cos(azimuth)
        return float(across * lobes + probe["latency_s"] * speed - probe["ball_radius_m"])


class Simulated:
    """The model in MuJoCo, commanded by a replay."""

    def __init__(self, file: Path, replay: Replay) -> None:
        import mujoco

        self.mj, self.replay, self.table = mujoco, replay, replay.table
        self.model = mujoco.MjModel.from_xml_path(str(file))
        self.data = mujoco.MjData(self.model)
        self.bodies = {self.model.body(k).name for k in range(self.model.nbody)}
        if not self.table["servos"]:  # a scene of the user: springs hold the joints in place of its actuators
            flags = mujoco.mjtDisableBit
            self.model.opt.disableflags |= flags.mjDSBL_ACTUATION | flags.mjDSBL_CONTACT
            self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
            hold_base(mujoco, self.model, self.table["joints"])
            for name in self.table["joints"]:
                k = self.model.joint(name).id
                self.model.jnt_stiffness[k], self.model.jnt_stiffnesspoly[k] = HOLD, 0.0
                self.model.jnt_limited[k] = 0  # a machine may stand beyond the limits of the scene

    def stand(
        self, readings: np.ndarray, direction: np.ndarray | None = None, payload: float = 0.0
    ) -> np.ndarray:
        """Tip of the tool (3,), m, of the arm at rest at readings (n,), rad, with a further mass, kg."""
        command = self.replay.command(readings, direction)
        self.mj.mj_resetData(self.model, self.data)
        if self.table["payload_body"] in self.bodies:  # a rigid arm carries none
            self.model.body(self.table["payload_body"]).mass[0] = self.table["payload_factor"] * payload
        angles = self.replay.nominal @ command
        for name, sign, angle in zip(self.table["joints"], self.table["signs"], angles, strict=True):
            self.data.joint(name).qpos[0] = sign * angle
            self.model.qpos_spring[self.model.joint(name).qposadr[0]] = sign * angle
        for name, value in zip(self.table["servos"], command, strict=False):
            self.data.actuator(name).ctrl[0] = value
        step, self.model.opt.timestep = self.model.opt.timestep, SETTLING
        for _ in range(STEPS):
            self.mj.mj_step(self.model, self.data)
            if np.max(np.abs(self.data.qvel)) < REST:
                break
        self.model.opt.timestep = step
        self.mj.mj_kinematics(self.model, self.data)
        return self.data.site(self.table["tip"]).xpos.copy()


def hold_base(mujoco: Any, model: Any, joints: Sequence[str]) -> None:
    """Let the base of an arm on a vehicle or an axis stand still: its joints get an immense inertia.

    Joints of an elastic stand are called stand_...: they stay as they are.
    """
    body = model.body(model.joint(joints[0]).bodyid[0]).parentid[0]
    while body:
        for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            first = model.jnt_dofadr[j]
            count = {0: 6, 1: 3}.get(int(model.jnt_type[j]), 1)
            if not model.joint(j).name.startswith("stand_"):
                model.dof_armature[first : first + count] = HELD
        body = model.body_parentid[body]
    mujoco.mj_setConst(model, mujoco.MjData(model))


def rows(path: Path, n: int) -> Iterator[tuple[np.ndarray, np.ndarray | None, float]]:
    """Readings, rad, directions and payloads of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            readings = np.radians([float(row[f"j{k}_deg"]) for k in range(1, n + 1)])
            moves = all(f"j{k}_degps" in row for k in range(1, n + 1))
            direction = np.array([float(row[f"j{k}_degps"]) for k in range(1, n + 1)]) if moves else None
            yield readings, direction, float(row.get("payload_kg") or 0.0)


def main() -> None:
    """Print the tip of the tool at the readings of a CSV file."""
    here = Path(__file__)
    replay = Replay(json.loads(here.with_suffix(".json").read_text(encoding="utf-8")))
    arm = Simulated(here.with_name(f"{here.stem.removesuffix('-replay')}.xml"), replay)
    write = csv.writer(sys.stdout, lineterminator="\n")
    write.writerow(["x_mm", "y_mm", "z_mm"])
    for readings, direction, payload in rows(Path(sys.argv[1]), len(replay.nominal)):
        write.writerow([f"{1e3 * x:.6f}" for x in arm.stand(readings, direction, payload)])


if __name__ == "__main__":
    main()
