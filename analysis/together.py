"""What a session of contacts and a joint log of one hidden arm give together: u before and after, and errors.

Contacts by `analysis.world`, torques by `analysis.world.motion`: neither shares code with what is tested.
Run from the top of the project: ``python -m analysis.together --arms 8``.
"""

from __future__ import annotations

import argparse
import gzip
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin

from analysis.world import arm, scene, session, write
from analysis.world.motion import noise as disturbance
from analysis.world.motion.dynamics import Chain, about_origin, regressor
from analysis.world.motion.plan import waves
from analysis.world.touch import World

GRAVITY = np.array([0.0, 0.0, -arm.GRAVITY])
RATE, LENGTH = 100.0, 10.0
"""Hz, s, of the motions of a log."""
KINDS = ("excitation",) * 3 + ("other",) * 5
"""Of the motions: the first three are one; the last two validate."""
HOME, SPAN = np.radians([0, 30, -10, 0, 40, 0]), np.radians([60, 35, 35, 70, 50, 100])
"""Readings about which the motions are, and their size to either side."""
ARMATURE = np.array([1.2, 1.6, 0.7, 0.16, 0.12, 0.06])
COULOMB, VISCOUS = np.array([6, 6.5, 3.6, 1.1, 0.9, 0.5]), np.array([7, 7.5, 3.2, 0.9, 0.7, 0.35])
"""kg m2, N m and N m s/rad, of the readings."""
LEVEL = np.array([0.4, 0.45, 0.25, 0.08, 0.07, 0.04])
"""N m, RMS of the noise of torques."""
SIGMA = 8e-6
"""m, noise of contacts."""


def contacts(folder: Path, rng: np.random.Generator, shape: arm.Shape) -> None:
    """Write a session of contacts on spheres of an arm."""
    things = scene.draw(rng)
    plan = session.plan(rng, things, {"payload": "none"}, session.SPHERES)
    world = World(arm.Arm(shape), things, plan, shape.give)
    readings, _ = world.touch((), SIGMA * rng.standard_normal(len(plan.time)))
    folder.mkdir(parents=True)
    (folder / "dataset.yaml").write_text(write.dataset_text(world, "contacts", SIGMA))
    (folder / "robot.yaml").write_text(write.robot_text())
    (folder / "measurements.csv").write_text(write.measurements_text(plan, readings, None, None))


def chain_of(s: arm.Shape) -> Chain:
    """Return the joints of an arm as origins, m, and roll, pitch, yaw, rad."""
    rows, rest = [], pin.SE3.Identity()
    for i in range(6):
        bend = pin.SE3(pin.utils.rotate("y", s.beta3 if i == 2 else 0.0), np.zeros(3))
        turn = pin.SE3(pin.utils.rotate("x", s.alpha[i]), np.zeros(3))
        zero = pin.SE3(pin.utils.rotate("z", s.zero[i]), np.zeros(3))
        rows.append(rest * turn * pin.SE3(np.eye(3), np.array([s.a[i], 0.0, 0.0])) * bend * zero)
        rest = pin.SE3(np.eye(3), np.array([0.0, 0.0, s.d[i]]))
    return Chain(
        np.array([r.translation for r in rows]), np.array([pin.rpy.matrixToRpy(r.rotation) for r in rows])
    )


def log(folder: Path, rng: np.random.Generator, shape: arm.Shape) -> None:
    """Write a joint log of an arm without its tool."""
    size = 0.09 * np.exp(0.2 * rng.standard_normal((6, 3)))
    inertia = np.array([m * np.diag(np.sum(r**2) - r**2) for m, r in zip(shape.mass, size, strict=True)])
    centre = shape.com + np.column_stack([np.zeros((6, 2)), shape.d])
    parameters = about_origin(shape.mass, centre, inertia).ravel()
    friction = np.exp(0.2 * rng.standard_normal((2, 6)))
    t = np.arange(0.0, LENGTH, 1.0 / RATE)
    paths = [_excitation(rng) for _ in range(len(KINDS) - 2)]
    levels = disturbance.draw(rng, LEVEL)
    rows = []
    for k in range(len(KINDS)):
        q, dq, ddq = paths[max(k - 2, 0)](t)
        link = [x @ arm.LINK_FROM_READING.T for x in (q, dq, ddq)]
        torque = regressor(chain_of(shape), *link, gravity=GRAVITY) @ parameters @ arm.LINK_FROM_READING
        torque += ARMATURE * ddq + COULOMB * friction[0] * np.tanh(dq / 0.03) + VISCOUS * friction[1] * dq
        torque += disturbance.sampled(rng, levels, [slice(0, len(t))], 1.0 / RATE)
        shown = np.degrees(q) + 3e-4 * rng.standard_normal(q.shape)
        rows.append(np.column_stack([t + k * (LENGTH + 3.0), np.full(len(t), k + 1), shown, torque]))
    names = [f"q{j}_deg" for j in range(1, 7)] + [f"torque{j}_Nm" for j in range(1, 7)]
    lines = [",".join(["t_s", "motion", *names])]
    lines += [",".join(f"{v:.7g}" for v in row) for row in np.concatenate(rows).tolist()]
    motions = [
        f"  - {{id: {k + 1}, role: {'validate' if k > 5 else 'calibrate'}, kind: {kind}, "
        f"same_as: {1 if k < 3 else k + 1}}}"
        for k, kind in enumerate(KINDS)
    ]
    folder.mkdir(parents=True)
    head = ["schema: bayescal-motion/1", "name: log", "robot: robot.yaml", "gravity_mps2: [0, 0, -9.81]"]
    (folder / "dataset.yaml").write_text("\n".join([*head, "motions:", *motions, ""]))
    (folder / "robot.yaml").write_text(write.robot_text())
    (folder / "motion.csv.gz").write_bytes(gzip.compress("\n".join([*lines, ""]).encode(), 1))


def _excitation(rng: np.random.Generator):
    hertz = rng.uniform(0.06, 0.6, (6, 4))
    size = rng.uniform(0.3, 1.0, hertz.shape) / hertz
    size *= (SPAN * rng.uniform(0.6, 1.0, 6) / size.sum(axis=1))[:, None]
    return waves(HOME, size, 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi, hertz.shape), LENGTH)


def made(folder: Path, seed: int) -> arm.Shape:
    """Write FOLDER/contacts and FOLDER/log of one hidden arm, and return it."""
    rng = np.random.default_rng([seed, 28])
    shape = arm.draw(rng)
    contacts(folder / "contacts", rng, shape)
    log(folder / "log", rng, shape)
    return shape


def truth(shape: arm.Shape) -> dict[str, float]:
    """Return masses, kg, centres, m (in frames before d, as the robot file), compliances of the readings."""
    out = {f"compliance J{j + 1}": float(shape.give[j]) for j in range(6)}
    for k in range(6):
        out[f"mass of link {k + 1}"] = float(shape.mass[k])
        out |= {f"centre {x} of link {k + 1}": float(shape.com[k, i]) for i, x in enumerate("xyz")}
    return out


def main() -> None:
    """Print u alone and together, and chi-square of the errors."""
    import bayescal as bc

    parser = argparse.ArgumentParser()
    parser.add_argument("--arms", type=int, default=8)
    parser.add_argument("--first", type=int, default=1)
    asked = parser.parse_args()
    found: dict[str, list[tuple[float, float, float, float, float]]] = {}
    for seed in range(asked.first, asked.first + asked.arms):
        with tempfile.TemporaryDirectory() as folder:
            true = truth(made(Path(folder), seed))
            result = bc.fit([f"{folder}/contacts", f"{folder}/log"], samples=0)
        print(f"arm {seed}: {result!r}", flush=True)
        for s in result.data.shared:
            row = (true[s.name], *s.alone, *s.both)
            found.setdefault(s.name, []).append(row)
    print("parameter                u alone   u both  chi2/dof alone  both")
    for name, rows in found.items():
        x = np.array(rows)
        u = np.median(x[:, [2, 4]] / np.abs(x[:, :1]), axis=0)
        chi = [np.mean(((x[:, i] - x[:, 0]) / x[:, i + 1]) ** 2) for i in (1, 3)]
        print(f"{name:22s} {100 * u[0]:8.2f} % {100 * u[1]:8.2f} % {chi[0]:8.2f} {chi[1]:8.2f}")


if __name__ == "__main__":
    main()
