"""`python -m analysis.fleet_study`: what a fleet of simulated arms shows, and what it saves the next arm.

The arms are made by `analysis.world`, which shares no code with the model. Their deviations from nominal have
a common part (all of the stated priors' size) and an individual one (`SPREAD` of it). Three have backlash at
the same joint, another a joint zero far from those of the others, and a further arm changes a joint zero
between two sessions.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import bayescal as bc
from analysis.world import arm, joints, scene, session, write
from analysis.world.size import modest
from analysis.world.touch import SOLVED, Act, World
from bayescal.dataset import read_dataset
from bayescal.fitted.arm import of_fit
from bayescal.fleets.compare import Member, models_of, read_likelihood
from bayescal.public.fleet import fleet
from bayescal.public.fleet_results import robot_text
from bayescal.reporting.fleet import counted, findings, learnt
from bayescal.statistics import rms

ARMS, SPREAD = 12, 0.3
SHARING, JOINT, PLAY = (1, 4, 8), 4, 2.5e-4
"""Arms with backlash, its joint, and its half-width, rad."""
OUTLIER, ZERO, FAR = 6, 3, 5e-3
"""The arm that differs, the joint, and by how much its zero does, rad: 8 times the spread of the others."""
DRIFTED, MOVED, BY = 10, 5, 4e-4
"""The arm that changes, the joint, and the change of its zero, rad."""
NOISE = 7e-6
GEOMETRY = ("a", "alpha", "d", "zero", "beta3", "mass", "com")


def shapes(seed: int, count: int = ARMS, spread: float = SPREAD) -> list[arm.Shape]:
    """Arms with a common deviation from nominal and individual ones; each with its tool."""
    rng = np.random.default_rng([seed, 0])
    nominal, common = arm.nominal(), arm.draw(rng)
    out = []
    for _ in range(count):
        own = arm.draw(rng)
        values = {
            key: getattr(common, key) + spread * (getattr(own, key) - getattr(nominal, key))
            for key in GEOMETRY
        }
        give = common.give * np.exp(0.5 * spread * rng.standard_normal(6))
        out.append(replace(own, **values, give=give, hinge_at=common.hinge_at))
    return out


def probed(
    seed: int, shape: arm.Shape, name: str, *, serial: str, date: str, play: float = 0.0, noise: float = NOISE
) -> tuple[dict[str, str], np.ndarray]:
    """The files of a session on the cube, validated on spheres, and the true points (N, 3) of its rows."""
    rng = np.random.default_rng([seed, 1])
    things = scene.draw(rng)
    plan = session.plan(rng, things, {"reverse": 0.05, "payload": "none", "velocity": True})
    world, _, _ = modest(World(arm.Arm(shape), things, plan, shape.give), True, noise)
    acts = [(_backlash(rng, world), play)] if play else []
    readings, left = world.touch(acts, noise * rng.standard_normal(len(plan.time)))
    if left > SOLVED:
        msg = f"{name}: {left:g} m off the touch"
        raise RuntimeError(msg)
    velocity = plan.velocity + np.radians(0.002) * rng.standard_normal((len(readings), 6))
    record = f"record: {{date: {date}, serials: {{arm: {serial}}}}}\n"
    return {
        "dataset.yaml": write.dataset_text(world, name, noise) + record,
        "robot.yaml": write.robot_text(),
        "measurements.csv": write.measurements_text(world.session, readings, velocity, None),
    }, world.seen(readings, acts)[0].ball


def _backlash(rng: np.random.Generator, world: World) -> Act:
    while True:
        act = joints.backlash(rng, world)
        if act.detail["joint"] == JOINT and not act.detail["link_side"]:
            return act


def subset(texts: dict[str, str], calibrate: int, seed: int, validate: int | None = None) -> dict[str, str]:
    """The session with fewer rows to calibrate with; of `validate` rows, only so many of the faces."""
    head, *rows = texts["measurements.csv"].splitlines()
    rng = np.random.default_rng([seed, 2])
    kept: set[str] = set()
    for role, count in (("calibrate", calibrate), ("validate", validate)):
        own = [row for row in rows if row.split(",")[1] == role and (count is None or ",cube." in row)]
        some = range(len(own)) if count is None else rng.choice(len(own), count, replace=False)
        kept |= {own[k] for k in some}
    return texts | {"measurements.csv": "\n".join([head, *(row for row in rows if row in kept), ""])}


def put(folder: Path, texts: dict[str, str]) -> Path:
    """Write a session."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def made(
    folder: Path, seed: int, count: int = ARMS, noise: float = NOISE, spread: float = SPREAD
) -> list[Path]:
    """Write the sessions of a fleet, and the true points of their rows beside them; what is there is kept."""
    out = []
    for k, shape in enumerate(shapes(seed, count, spread)):
        zero = shape.zero.copy()
        zero[ZERO - 1] += FAR * (k == OUTLIER)
        for part in range(1 + (k == DRIFTED)):
            zero = zero.copy()
            zero[MOVED - 1] += BY * part
            name = f"arm-{k:02d}{'ab'[part] if k == DRIFTED else ''}"
            out.append(folder / name)
            truth = folder / f"{name}.npy"
            if truth.exists():
                continue
            texts, points = probed(
                1000 * seed + 10 * k + part, replace(shape, zero=zero), name,
                serial=f"SN-{k:02d}", date=f"2026-0{3 + part}-01", noise=noise,
                play=PLAY if k in SHARING else 0.0,
            )  # fmt: skip
            put(out[-1], texts)
            np.save(truth, points)
    return out


def checked(folder: Path, seed: int, noise: float, spread: float) -> None:
    """What the table of the fleet states, beside the truth."""
    made(folder / "sessions", seed, ARMS, noise, spread)
    found = fleet([folder / "sessions"], folder / "fleet", workers=2)
    print(f"seed {seed}: {counted(found.record)}; truth: backlash at joint {JOINT} of {len(SHARING)} arms, "
          f"theta{ZERO} of SN-{OUTLIER:02d} {np.degrees(FAR):.3f} deg, theta{MOVED} of SN-{DRIFTED:02d} "
          f"{np.degrees(BY):.4f} deg")  # fmt: skip
    for heading, lines in findings(found.record).items():
        for line in lines:
            print(f"  {heading}: {line}")
    print("  " + "; ".join(map(learnt, found.record["models"])))


FEW, MORE = 40, (40, 50, 60, 80, 100)
"""Contacts with the learnt prior, and those with the stated prior beside them."""


def saved(folder: Path, seed: int, noise: float, spread: float) -> None:
    """Few contacts with the prior learnt from the other arms, beside more with the stated prior."""
    sessions = made(folder / "sessions", seed, ARMS, noise, spread)
    found = fleet([folder / "sessions"], folder / "fleet", workers=2)
    model = found.record["inputs"]["model"]
    members = [
        Member(s["session"], s["arm"], s["robot"], read_likelihood(found.folder / s["folder"] / "gap", model))
        for s in found.record["sessions"]
    ]
    rows = []
    for path in sessions:
        own = next(m.arm for m in members if m.session == path.name)
        (others,) = models_of([m for m in members if m.arm != own])
        true, files = np.load(folder / "sessions" / f"{path.name}.npy"), files_of(path)
        learnt_robot = {"robot.yaml": robot_text(others, read_dataset(path).robot)}
        cases = [*(subset(files, count, seed) for count in MORE), subset(files, FEW, seed) | learnt_robot]
        row = [judged(put(folder / "subset", texts), true) for texts in cases]
        rows.append([cell[:3] for cell in row])
        cells = "".join(f"  {u:4.0f}/{e:4.0f}" for u, e, *_ in row)
        print(f"{path.name:<8}{cells}  {'; '.join(row[-1][3])}", flush=True)
    values = np.array(rows)
    for k, name in enumerate((*(f"{count} stated" for count in MORE), f"{FEW} learnt")):
        (u, error), within = np.median(values[:, k, :2], axis=0), np.mean(values[:, k, 2])
        print(f"{name:<12} U {u:5.0f}, true distance error {error:5.0f} µm (medians); {within:.0%} within U")
    for k, what in enumerate(("U", "true distance error")):
        *stated, learnt_value = np.log(np.median(values[:, :, k], axis=0))
        equal = float(np.interp(-learnt_value, -np.minimum.accumulate(stated), MORE))
        print(f"{FEW} contacts with the learnt prior have the {what} of {equal:.0f} with the stated prior")


def files_of(path: Path) -> dict[str, str]:
    """The files of a session."""
    return {name: (path / name).read_text() for name in ("dataset.yaml", "robot.yaml", "measurements.csv")}


def judged(folder: Path, true: np.ndarray) -> tuple[float, float, float, list[str]]:
    """U of a distance in the probed volume, true RMS error (µm), share within U, what was said of priors."""
    dataset = read_dataset(folder)
    found = bc.fit(dataset, samples=0).data
    rows = np.flatnonzero(dataset.measurements.role == "validate")
    points = of_fit(found).at_rows(rows).points
    at = np.array([int(dataset.measurements.ids[row][1:]) for row in rows])
    a, b = np.random.default_rng(0).integers(0, len(rows), (2, 400))
    error = np.linalg.norm(points[a] - points[b], axis=1) - np.linalg.norm(true[at[a]] - true[at[b]], axis=1)
    u = found.forecast.workspace.expanded
    told = [f.text for f in found.findings if f.code in ("prior_width", "far_from_prior")]
    return 1e6 * u, 1e6 * rms(error), float(np.mean(np.abs(error) < u)), told


def speed(folder: Path, seed: int, count: int = 200) -> None:
    """Wall time of one worker and of two for small sessions, and the processor time of both."""
    sources = made(folder / "sessions", seed)
    small = []
    for k in range(count):
        texts = files_of(sources[k % len(sources)])
        small.append(put(folder / "small" / f"small-{k:03d}", subset(texts, 60, 7000 + k, 40)))
    wall, used = {}, {}
    for workers in (2, 1):
        out = folder / f"speed-{workers}"
        shutil.rmtree(out, ignore_errors=True)
        for again in (False, True):
            line = [sys.executable, "-m", "bayescal.cli", "fleet", *map(str, small), "--out", str(out)]
            before, begin = os.times(), time.perf_counter()
            subprocess.run([*line, "--workers", str(workers)], check=True, capture_output=True)
            wall[workers, again], now = time.perf_counter() - begin, os.times()
            used[workers, again] = sum(now[2:4]) - sum(before[2:4])
            what = f"{workers} workers{', all kept' if again else ''}: {wall[workers, again]:.0f} s"
            spent = f"processor time {used[workers, again]:.0f} s, load {os.getloadavg()[0]:.1f}"
            print(f"{count} sessions, {what}, {spent}", flush=True)
    # on two processors alone: what a single process does, and half of the rest
    alone = used[2, True]
    ideal = alone + 0.5 * (used[2, False] - alone)
    print(f"efficiency of two workers: {wall[1, False] / wall[2, False] / 2:.2f} by wall time, "
          f"{used[1, False] / ideal / 2:.2f} by processor time")  # fmt: skip


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("table", "saved", "speed"))
    parser.add_argument("--out", type=Path, default=Path("runs/fleet-study"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise-um", type=float, default=1e6 * NOISE, help="of a contact")
    parser.add_argument("--spread", type=float, default=SPREAD, help="of arms, of the stated priors")
    parser.add_argument("--count", type=int, default=200, help="sessions of `speed`")
    asked = parser.parse_args()
    folder = asked.out / f"{asked.seed}-{asked.noise_um:g}-{asked.spread:g}"
    if asked.part == "speed":
        speed(folder, asked.seed, asked.count)
    else:
        part = checked if asked.part == "table" else saved
        part(folder, asked.seed, 1e-6 * asked.noise_um, asked.spread)


if __name__ == "__main__":
    main()
