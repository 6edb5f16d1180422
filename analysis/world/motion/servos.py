"""Logs of an arm with position servos that measure no torque: commands and positions, as of hobby arms.

Each joint is integrated with its stiction, velocity-implicit, so that it sticks exactly; gravity and torques
of the other links follow from the motion of the simulation before. `python -m analysis.world.motion.servos
OUT` writes OUT/NNN and OUT/truth/NNN.json.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import typer
import yaml
from scipy.signal import butter, lfilter, sosfiltfilt

from analysis.world.motion import arms
from analysis.world.motion.dynamics import Chain, regressor
from analysis.world.motion.log import GRAVITY

# origin mm, rpy deg, mass kg, centre mm, gyration mm; armature, Coulomb, viscous (back-EMF), home, span deg
_SO = (
    ((0, 0, 62), (0, 0, 0), 0.16, (0, -12, 30), (26, 24, 22), 0.028, 0.06, 0.60, 0, 70),
    ((0, 30, 55), (90, 0, 0), 0.14, (68, 0, 0), (18, 38, 38), 0.028, 0.07, 0.62, -40, 40),
    ((116, 0, 0), (0, 0, 0), 0.13, (72, 6, 0), (17, 40, 40), 0.026, 0.06, 0.60, 60, 45),
    ((135, 0, 0), (0, 0, 0), 0.10, (40, 0, 4), (15, 24, 24), 0.026, 0.05, 0.58, -20, 60),
    ((61, 0, 0), (0, 90, 0), 0.11, (6, 0, 38), (22, 22, 16), 0.025, 0.05, 0.55, 0, 80),
)
COUNTS, STEP, PASSES = 4096, 2e-3, 4
"""Of an encoder a turn; of the integration, s; simulations."""
NOISE, ROUGH = 0.003, 0.12
"""Noise of the torque, N m, and of the friction, relative."""
SIZES = {
    "null": 0.0, "load-friction": 0.25, "stribeck": 0.12, "asymmetric-friction": 0.25, "payload": 0.05,
    "servo-stiffness": 0.3, "cable": 0.25, "late": 0.06,
}  # fmt: skip
"""Kinds of logs with the usual size of what is hidden, SI."""


def nominal() -> arms.Arm:
    """The arm as its file states it."""
    origin, rpy, mass, centre, gyration, *drive = (np.array(c, dtype=float) for c in zip(*_SO, strict=True))
    armature, coulomb, viscous, home, span = drive
    return arms.Arm(
        name="five servos", chain=Chain(1e-3 * origin, np.radians(rpy)), mass=mass, centre=1e-3 * centre,
        inertia=((1e-3 * gyration) ** 2 * mass[:, None])[:, :, None] * np.eye(3), gear=np.full(5, 345.0),
        armature=armature, rated=np.full(5, 2.9), coulomb=coulomb, viscous=viscous, transition=0.03,
        home=np.radians(home), span=np.radians(span), load_centre=np.array([0.0, 0.0, 0.08]),
        load_gyration=0.02, load=0.12, centre_u=0.004,
    )  # fmt: skip


def _commands(
    rng: np.random.Generator, arm: arms.Arm, kind: str, length: float
) -> Callable[[np.ndarray], np.ndarray]:
    if kind == "sines":
        hertz = np.exp(rng.uniform(np.log(0.08), np.log(0.7), (arm.size, 3)))
        size = rng.uniform(0.4, 1.0, hertz.shape) / hertz**0.8
        size *= (arm.span * rng.uniform(0.5, 0.9, arm.size) / size.sum(axis=1))[:, None]
        phase = rng.uniform(0, 2 * np.pi, hertz.shape)

        def path(t: np.ndarray) -> np.ndarray:
            x = np.clip(np.minimum(t, length - t), 0, 1)[:, None]
            waves = np.sum(size * np.sin(2 * np.pi * hertz * t[:, None, None] + phase), axis=2)
            return arm.home + x**3 * (10 - 15 * x + 6 * x**2) * waves

        return path
    count = int(length // 1.6)
    poses = arm.home + arm.span * rng.uniform(-0.8, 0.8, (count + 1, arm.size))
    each = length / count

    def legs(t: np.ndarray) -> np.ndarray:
        leg = np.minimum((t / each).astype(int), count - 1)
        x = np.clip((t - leg * each) / (0.8 * each), 0, 1)[:, None]
        return poses[leg] + (poses[leg + 1] - poses[leg]) * x**3 * (10 - 15 * x + 6 * x**2)

    return legs


def _wander(rng: np.random.Generator, shape: tuple[int, ...], tau: float) -> np.ndarray:
    """Return noise of unit variance with a time constant, s, along the first axis."""
    out = lfilter([1.0], [1.0, -np.exp(-STEP / tau)], rng.standard_normal(shape), axis=0)
    return out / np.std(out, axis=0)


def follow(
    u: np.ndarray, load: np.ndarray, share: np.ndarray, arm: arms.Arm, stiffness: np.ndarray,
    inertia: np.ndarray, friction: Callable[[np.ndarray, np.ndarray], np.ndarray],
    viscous: Callable[[np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Positions and speeds (rows, ...) of joints at commands u with torques `load`, from rest."""
    q, v = np.empty_like(u), np.empty_like(u)
    at, speed = u[0] - load[0] / stiffness, np.zeros_like(u[0])
    for k in range(len(u)):
        q[k], v[k] = at, speed
        net = stiffness * (u[k] - at) - load[k]
        free = (speed + STEP / inertia * net) / (1.0 + STEP / inertia * viscous(speed))
        stop = STEP / inertia * share[k] * friction(speed, load[k])
        speed = np.sign(free) * np.maximum(np.abs(free) - stop, 0.0)
        at = at + STEP * speed
    return q, v


def make(
    seed: int, number: int, kind: str, motions: int = 8, length: float = 12.0, rate: float = 0.0,
    smooth: float = 0.0,
) -> tuple[dict, dict, dict]:  # fmt: skip
    """Settings, columns and ground truth of a log; `kind` of `SIZES`.

    Friction holds the joints, or reverses within a speed `smooth`, rad/s, which the log states.
    """
    rng = np.random.default_rng([seed, 28, number])
    drawn = nominal()
    arm = arms.true(rng, drawn)
    rate = rate or float(rng.choice([25, 30, 50]))
    stated = rng.uniform(12, 18, arm.size)
    stiffness, late = stated * (1 + 0.03 * rng.standard_normal(arm.size)), float(rng.uniform(0.005, 0.02))
    j = int(rng.integers(1, 4))
    size = SIZES[kind] * float(rng.uniform(0.8, 1.3))
    one = np.eye(arm.size)[j]
    if kind == "servo-stiffness":
        stiffness = stiffness * (1 - size * one)
    if kind == "late":
        late += size
    loads = [0.0 if k % 2 else arm.load for k in range(motions)]
    roles = ["calibrate"] * (motions - 2) + ["validate"] * 2
    kinds = ["sines" if k < motions - 2 else "pick-place" for k in range(motions)]
    paths = [_commands(rng, drawn, w, length) for w in kinds]
    paths[1] = paths[0]
    loads[1] = loads[0]
    t = np.arange(0.0, length, STEP)
    every = round(1.0 / rate / STEP)
    ticks = np.arange(0, len(t), every)
    sent = [_counted(path(t[ticks])) for path in paths]
    last = np.maximum(np.floor((t - late) / STEP / every).astype(int), 0)
    held = np.stack([s[last] for s in sent], axis=1)

    def friction(v: np.ndarray, load: np.ndarray) -> np.ndarray:
        out = np.broadcast_to(arm.coulomb, v.shape)
        if kind == "load-friction":
            out = out + size * one * np.abs(load)
        if kind == "stribeck":
            out = out + size * one * np.exp(-((v / 0.15) ** 2))
        return out * np.tanh(np.abs(v) / smooth) if smooth else out

    def viscous(v: np.ndarray) -> np.ndarray:
        return arm.viscous + (size * one * np.sign(v) if kind == "asymmetric-friction" else 0.0)

    inertia, load, q = _own(arm), np.zeros_like(held), held
    shaken, rough = (_wander(rng, held.shape, tau) for tau in (0.05, 0.3))
    for _ in range(PASSES):
        carried = [kilos + size if kilos and kind == "payload" else kilos for kilos in loads]
        load = np.stack([_load(arm, q[:, k], kilos, inertia) for k, kilos in enumerate(carried)], axis=1)
        if kind == "cable":
            taut = np.maximum(q - arm.home - 0.2, 0.0) - 0.5 * np.maximum(arm.home - 0.4 - q, 0.0)
            load = load + size * one * taut
        moving = inertia + arm.armature
        pulled, rubbing = load + NOISE * shaken, 1.0 + ROUGH * rough
        q, _ = follow(held, pulled, rubbing, arm, stiffness, moving, friction, viscous)
    rows = [np.degrees(_counted(q[ticks, k])) for k in range(motions)]
    time = np.concatenate([5.0 + k * (length + 4.0) + t[ticks] for k in range(motions)])
    columns = {"t_s": time, "motion": np.repeat(np.arange(motions) + 1, len(ticks))}
    columns |= {f"q{i + 1}_deg": np.concatenate(rows)[:, i] for i in range(arm.size)}
    columns |= {f"command{i + 1}_deg": np.degrees(np.concatenate(sent))[:, i] for i in range(arm.size)}
    keys = ("id", "role", "kind", "same_as", "payload_kg")
    same = [str(1 if k < 2 else k + 1) for k in range(motions)]
    each = zip([str(k + 1) for k in range(motions)], roles, kinds, same, loads, strict=True)
    entries = [dict(zip(keys, values, strict=True)) for values in each]
    robot = _robot(drawn) | ({"friction_transition_degps": float(np.degrees(smooth))} if smooth else {})
    settings = {
        "schema": "bayescal-motion/1", "name": f"servo log {number:03d}", "robot": robot,
        "gravity_mps2": [0, 0, -9.81], "rate_hz": rate,
        "controller": {"kind": "position", "kp_Nm_per_rad": [float(f"{v:.3g}") for v in stated]},
        "motions": entries,
    }  # fmt: skip
    names = {"null": [], "cable": ["unknown"], "late": []}.get(kind, [kind])
    site = "tool" if kind == "payload" else f"joint {j + 1}"
    drives = {"stiffness": stiffness.tolist(), "late_s": late, "coulomb": arm.coulomb.tolist()}
    drives["viscous"] = arm.viscous.tolist()
    truth = {"kind": kind, "effects": names, "site": site, "size": size, **drives}
    return settings, columns, truth


def _counted(angle: np.ndarray) -> np.ndarray:
    """Return an angle, rad, as an encoder shows it."""
    return 2 * np.pi / COUNTS * np.round(angle * COUNTS / 2 / np.pi)


def _own(arm: arms.Arm) -> np.ndarray:
    """Inertia (n,) of the links about each axis at home."""
    q = np.tile(arm.home, (arm.size, 1))
    zero = np.zeros_like(q)
    return np.diag(regressor(arm.chain, q, zero, np.eye(arm.size), np.zeros(3)) @ arm.parameters)


def _load(arm: arms.Arm, q: np.ndarray, kilos: float, inertia: np.ndarray) -> np.ndarray:
    """Torques (rows, n) of links and payload, without `inertia` times acceleration."""
    smooth = sosfiltfilt(butter(4, 10.0, fs=1 / STEP, output="sos"), q, axis=0)
    dq = np.gradient(smooth, STEP, axis=0)
    ddq = np.gradient(dq, STEP, axis=0)
    some = slice(None, None, 4)
    columns = regressor(arm.chain, q[some], dq[some], ddq[some], GRAVITY)
    parameters = arm.parameters.copy()
    if kilos:
        parameters[-10:] += arm.payload(kilos)
    torque = columns @ parameters - inertia * ddq[some]
    rows = np.arange(len(q))
    return np.column_stack([np.interp(rows, rows[some], column) for column in torque.T])


def _robot(arm: arms.Arm) -> dict:
    joints = [
        {"name": f"J{k + 1}", "origin_mm": (1e3 * arm.chain.origin[k]).round(3).tolist(),
         "rpy_deg": np.degrees(arm.chain.rpy[k]).round(6).tolist(),
         "axis": [0, 0, 1], "gear_ratio": 345.0, "armature_kgm2": float(arm.armature[k]),
         "rated_torque_Nm": 2.9,
         "mass_kg": float(arm.mass[k]), "centre_of_mass_mm": (1e3 * arm.centre[k]).round(3).tolist(),
         "inertia_kgm2": [*np.diag(arm.inertia[k]).tolist(), 0.0, 0.0, 0.0]}
        for k in range(arm.size)
    ]  # fmt: skip
    load = {
        "centre_of_mass_mm": (1e3 * arm.load_centre).tolist(),
        "radius_of_gyration_mm": 1e3 * arm.load_gyration,
    }
    return {
        "joints": joints,
        "payload": load,
        "u": {"mass": 0.15, "centre_of_mass_mm": 4.0, "inertia": 0.15, "armature": 0.15},
    }


def write(folder: Path, settings: dict, columns: dict) -> Path:
    """Write a log into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dataset.yaml").write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "motion.csv", table, "%.9g", ",", header=",".join(columns), comments="")
    return folder


def main(out: Path, logs: int = 16, seed: int = 1, kinds: str = ",".join(SIZES), first: int = 0) -> None:
    """Simulate logs of position servos, and their ground truth."""
    chosen = kinds.split(",")
    (out / "truth").mkdir(parents=True, exist_ok=True)
    for number in range(first, first + logs):
        settings, columns, truth = make(seed, number, chosen[number % len(chosen)])
        write(out / f"{number:03d}", settings, columns)
        (out / "truth" / f"{number:03d}.json").write_text(
            json.dumps(truth, indent=1) + "\n", encoding="utf-8"
        )
    typer.echo(f"{logs} logs in {out}")


if __name__ == "__main__":
    typer.run(main)
