"""Logs of position servos that MuJoCo simulates step by step: the drives act on errors of position."""

from dataclasses import replace

import mujoco
import numpy as np
from motion.made import model_of

from bayescal.logs.types import Controller, Log, Motion

STEP, EVERY = 1e-3, 8
KP, KD = np.array([900.0, 1200.0, 400.0]), np.array([30.0, 40.0, 12.0])


def commanded(seed, seconds):
    """Commands (N, 3) of smooth sines from rest, at `STEP`."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP)
    out = np.zeros((len(t), 3))
    edge = np.clip(np.minimum(t, t[-1] - t), 0.0, 1.0)[:, None]
    for f in (0.15, 0.4, 0.9):
        out += np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6, 3)) / (1 + 2 * f)
    return 0.6 * edge**3 * (10 - 15 * edge + 6 * edge**2) * out


def simulated(mechanism, u, load=0.0, kp=KP, kd=KD, further=None):
    """Positions, speeds and torques (N, 3) by `mj_step`; `further(q, dq)` acts beside."""
    model = model_of(mechanism)
    model.opt.timestep, model.opt.gravity[:] = STEP, (0, 0, -9.81)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_armature[:], model.dof_frictionloss[:] = mechanism.armature, mechanism.coulomb
    model.dof_damping[:] = np.reshape(mechanism.viscous + kd, model.dof_damping.shape)
    model.dof_solref[:] = (0.004, 1.0)
    data = mujoco.MjData(model)
    q, dq, tau = np.zeros((3, *u.shape))
    data.qpos[:] = u[0]
    for k in range(len(u)):
        q[k], dq[k] = data.qpos, data.qvel
        tau[k] = kp * (u[k] - q[k]) - kd * dq[k]
        data.qfrc_applied[:] = kp * (u[k] - q[k]) + (0.0 if further is None else further(q[k], dq[k]))
        mujoco.mj_step(model, data)
    return q, dq, tau


def servo_log(mechanism, truth, stated=True, torque=True, further=None, motions=6, seconds=9.0):
    """A log of which the last two motions are withheld; positions and torques are those of the simulator."""
    out, clock = [], 0.0
    for k in range(motions):
        u = commanded(100 + k, seconds)
        q, _, tau = simulated(truth, u, further=further)
        rows = slice(0, None, EVERY)
        time = clock + STEP * EVERY * np.arange(len(q[rows]))
        role = "validate" if k >= motions - 2 else "calibrate"
        out.append(
            Motion(str(k + 1), role, "", str(k + 1), time, q[rows], None, u[rows],
                   tau[rows] if torque else None, None, None, np.zeros(len(time)), 2)
        )  # fmt: skip
        clock += seconds + 1.0
    control = Controller("position", KP if stated else None, KD if stated else None)
    return Log(
        "servo", mechanism, tuple(out), np.array([0.0, 0.0, -9.81]), control, "motor" if torque else "",
        True, 0.0, 0.0, 1e-4, False, (), "",
    )  # fmt: skip


def without_stiffness(log):
    """The same log, which does not state the stiffness of its controller."""
    return replace(log, controller=replace(log.controller, stiffness=None))


def another(mechanism):
    """An arm of other masses and friction than nominal."""
    share = np.array([1.1, 0.93, 1.08])
    return replace(
        mechanism, mass=mechanism.mass * share, inertia=mechanism.inertia * share[:, None, None],
        coulomb=mechanism.coulomb * 1.3, viscous=mechanism.viscous * 0.8,
    )  # fmt: skip
