"""Small joint logs of a three-axis arm: torques by MuJoCo, which shares no code with the model."""

import gzip
from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import yaml
from cases import file_text
from scipy.signal import lfilter

import bayescal as bc
from bayescal.logs.read import written_out
from bayescal.logs.schema import Arm

ARM = file_text("three_joints.yaml")
RATE, SECONDS = 60.0, 9.0
SIGMA = np.array([0.08, 0.08, 0.04])


def model_of(mechanism):
    """The arm in MuJoCo, from the fields of a mechanism."""

    def text(x):
        return " ".join(f"{v:.17g}" for v in np.ravel(x))

    def body(k):
        frame = mechanism.place[k]
        full = mechanism.inertia[k][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, frame[:3, :3].ravel())
        inside = body(k + 1) if k + 1 < mechanism.n else ""
        return (
            f'<body pos="{text(frame[:3, 3])}" quat="{text(quat)}"><joint axis="{text(mechanism.axis[k])}"/>'
            f'<inertial pos="{text(mechanism.centre[k])}" mass="{mechanism.mass[k]:.17g}" '
            f'fullinertia="{text(full)}"/>{inside}</body>'
        )

    xml = f'<mujoco><compiler angle="radian"/><worldbody>{body(0)}</worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(xml)


def nominal():
    """The arm as it is stated."""
    return written_out(Arm.model_validate(yaml.safe_load(ARM)), "made")


def inverse(model, q, dq, ddq, gravity=(0, 0, -9.81)):
    """Torques (N, n) of MuJoCo's inverse dynamics."""
    data = mujoco.MjData(model)
    model.opt.gravity[:] = gravity
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def beyond_nominal(arm, q, dq, ddq):
    """Torques (N, n) of an arm, less those of the stated one."""
    return inverse(model_of(arm), q, dq, ddq) - inverse(model_of(nominal()), q, dq, ddq)


def path(seed, late=0.0):
    """Sums of sines: time (N,), and position, speed, acceleration (N, 3) `late` s before."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1.0 / RATE) - late
    q, dq, ddq = np.zeros((3, len(t), 3))
    for j in range(3):
        for w in rng.uniform(0.6, 5.0, 4):
            a, phase = rng.uniform(0.1, 0.5) / w**0.7, rng.uniform(0, 6.28)
            q[:, j] += a * np.sin(w * t + phase)
            dq[:, j] += a * w * np.cos(w * t + phase)
            ddq[:, j] -= a * w**2 * np.sin(w * t + phase)
    return t + late, q, dq, ddq


def read_commands(path):
    """Name, times and readings, rad, of each motion in a table of commands."""
    table = pd.read_csv(path, dtype={"motion": str})
    parts = table.groupby("motion", sort=False)
    return [(n, p["t_s"].to_numpy(), np.radians(p.filter(regex="^q").to_numpy())) for n, p in parts]


def verified(run, folder):
    """The file of a simulator with the arm of a run, and its verification."""
    file, _ = bc.export(run, "mjcf").save(folder / "arm.xml")
    return file, bc.verify(run, file)


def of_rows(motion, rows):
    """A motion with some of its rows."""
    columns = ("time", "position", "torque", "payload")
    return replace(motion, **{name: getattr(motion, name)[rows] for name in columns})


LOADS = (0, 0, 0, 0, 0.8, 0.8, 0, 0.8)


def write(folder, extra=None, loads=LOADS, seed=0, late=0.0):
    """A log of eight motions, the first twice; `extra(q, dq, ddq, tau, t, load)` is added to the torque.

    Torques are those of `late` s before, of all joints or of each.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1000 + seed)
    roles = ["calibrate"] * 6 + ["validate"] * 2
    motions = "\n".join(
        f"  - {{id: {k + 1}, role: {r}, same_as: {1 if k < 2 else k + 1}, payload_kg: {loads[k]}}}"
        for k, r in enumerate(roles)
    )
    indented = "".join(f"  {line}\n" for line in ARM.strip().splitlines())
    (folder / "dataset.yaml").write_text(
        "schema: bayescal-motion/1\nname: made\nrobot:\n" + indented + "gravity_mps2: [0, 0, -9.81]\n"
        f"noise: {{torque_Nm: {SIGMA.tolist()}, autocorrelated: true}}\nmotions:\n{motions}\n"
    )
    joints = [form.format(j) for form in ("q{}_deg", "torque{}_Nm") for j in (1, 2, 3)]
    head = ["t_s", "motion", *joints, "payload_kg"]
    rows, true, clock = [], truth(rng), 0.0
    for k, load in enumerate(loads):
        of = 100 * seed + (0 if k < 2 else k)
        t, q, dq, ddq = path(of)
        tau = true(q, dq, ddq, load)
        for j in np.flatnonzero(np.broadcast_to(late, 3)):
            tau[:, j] = true(*path(of, np.broadcast_to(late, 3)[j])[1:], load)[:, j]
        if extra is not None:
            tau = tau + extra(q, dq, ddq, tau, t + clock, load)
        noise = lfilter([1.0], [1.0, -0.6], rng.standard_normal((len(t), 3)) * 0.8, axis=0) * SIGMA
        shown = np.round(np.rad2deg(q) + 3e-4 * rng.standard_normal(q.shape), 5)
        labels = np.full(len(t), k + 1)
        rows.append(np.column_stack([t + clock, labels, shown, tau + noise, np.full(len(t), load)]))
        clock += SECONDS + 1.0
    lines = (",".join(f"{v:.9g}" for v in row) for row in np.concatenate(rows).tolist())
    text = "\n".join([",".join(head), *lines])
    (folder / "motion.csv.gz").write_bytes(gzip.compress(text.encode(), 1))
    return folder


def truth(rng):
    """Torques of an arm whose masses and friction differ from nominal within the priors."""
    arm, share = nominal(), 1.0 + 0.08 * rng.standard_normal(3)
    true = replace(arm, mass=arm.mass * share, inertia=arm.inertia * share[:, None, None])
    model = model_of(true)
    loaded = {}

    def torque(q, dq, ddq, load):
        if load not in loaded:
            centre, gyration = np.array([0.15, 0.0, 0.02]), 0.03
            mass = true.mass[2] + load
            middle = (true.mass[2] * true.centre[2] + load * centre) / mass
            about = true.inertia[2] + load * gyration**2 * np.eye(3)
            for m, c in ((true.mass[2], true.centre[2]), (load, centre)):
                d = c - middle
                about = about + m * (d @ d * np.eye(3) - np.outer(d, d))
            masses, centres = np.r_[true.mass[:2], mass], np.vstack([true.centre[:2], middle])
            inertia = np.concatenate([true.inertia[:2], about[None]])
            whole = replace(true, mass=masses, centre=centres, inertia=inertia)
            loaded[load] = model_of(whole) if load else model
        out = inverse(loaded[load], q, dq, ddq)
        return out + arm.armature * ddq + arm.coulomb * np.tanh(dq / 0.03) + arm.viscous * dq

    return torque


def load_friction(q, dq, ddq, tau, t, load):
    """Friction of joint B that grows with its torque."""
    return [0.0, 0.04, 0.0] * np.abs(tau) * np.tanh(dq / 0.03)
