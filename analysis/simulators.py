"""Fitted arms in MuJoCo: error of every construct, by effect and arm.

    python -m analysis.simulators [--robots universal-robots-ur5e,...] [--poses 100]
    python -m analysis.simulators --robots universal-robots-ur5e --into tests/data/ur5e_scene.xml

An arm has parameters drawn from the priors of its effects. Its file, new or patched into a scene, is
replayed in MuJoCo, and the TCP positions are compared with the model at the readings that it reached.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import Parameter
from bayescal.exporting.export import export
from bayescal.fitted.arm import FittedArm
from bayescal.model import build
from bayescal.model.equilibrium import standing_model
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate
from bayescal.verifying.simulator import TOGETHER, TOGETHER_RMS, File, Machine, limit, modelled

ROBOTS = ("fanuc-lrmate200ic", "universal-robots-ur5e", "franka-panda")
BASE = ("geometry", "compliance")
CASES = (
    ("geometry",),
    BASE,
    (*BASE, "payload"),
    (*BASE, "payload@elsewhere"),
    (*BASE, "base-compliance"),
    (*BASE, "bending"),
    (*BASE, "hardening"),
    (*BASE, "hardening@0.3"),
    (*BASE, "hysteresis"),
    (*BASE, "encoder-scale"),
    (*BASE, "coupling"),
    (*BASE, "eccentricity"),
    (*BASE, "second-harmonic"),
    (*BASE, "gear-mesh@100"),
    (*BASE, "backlash"),
    (*BASE, "base-compliance", "bending", "hardening", "hysteresis", "encoder-scale", "coupling",
     "eccentricity", "second-harmonic", "gear-mesh@100", "backlash"),
)  # fmt: skip


@cache
def session(robot: str, seed: int) -> Dataset:
    """A simulated session: its poses are replayed."""
    counts = {"contacts": 120, "repeats": 2, "later": 10, "spheres": 0, "placements": 0}
    return simulate(Options(robot=robot, seed=seed, **counts)).dataset


def drawn(robot: str, effects: Sequence[str], seed: int = 0) -> FittedArm:
    """An arm of a simulated session, with parameters drawn from their priors."""
    model = build(Scene(session(robot, seed)), tuple(effects))
    rng = np.random.default_rng(seed)
    values = np.array([_value(p, rng) for p in model.parameters])
    return FittedArm(standing_model(model, values), values, np.zeros((len(values),) * 2), model.effects, {})


def _value(p: Parameter, rng: np.random.Generator) -> float:
    """A deviation from nominal, SI."""
    z = float(rng.standard_normal())
    if p.positive:
        return p.centre * float(np.exp(0.5 * z)) - p.nominal
    if p.effect == "backlash":
        return -abs(p.sd * z)
    if p.effect == "hysteresis":
        return abs(p.sd * z)
    if p.effect == "hardening":  # a spring whose stiffness stays positive
        return 0.5 * p.sd * z / max(1.0, float(np.max(np.abs(p.terms[0].driver))) * p.sd / 3e-4)
    loose = p.site.kind in ("base", "tool") and not p.driver.joint and p.effect in ("geometry", "tool")
    return 1e-3 * z if loose else p.sd * z


def differences(arm: FittedArm, poses: int, file: File | None = None) -> tuple[np.ndarray, float]:
    """Differences (C,), m, of the TCP positions from the model, and the RMS size of the last effect, m."""
    rows = np.unique(np.linspace(0, len(arm.dataset.measurements.ids) - 1, poses).astype(int))
    state = int(rows[-1])
    file = file or File.new(arm, state)
    reached, points = Machine.of(arm, state, file).replayed(rows)
    model = modelled(arm, rows, reached, state)
    without = modelled(arm.level(arm.levels[-2]), rows, reached, state)
    size = float(np.sqrt(np.mean(np.sum((model - without) ** 2, axis=1))))
    return np.linalg.norm(points - model, axis=1), size


def patched(arm: FittedArm, into: Path) -> File:
    """The file of an arm in a scene."""
    found = export(arm, "mjcf", into=str(into), force=True)
    return File.of(arm, str(found.written.content), into, found.record(into.name))


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--robots", default=",".join(ROBOTS))
    options.add_argument("--poses", type=int, default=100)
    options.add_argument("--into", type=Path, help="scene (MJCF) of the arm to patch; default: a new file")
    asked = options.parse_args()
    print("| arm | effects | size of the last, µm rms | difference, µm rms | max | limit | s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for robot in asked.robots.split(","):
        for effects in CASES:
            begin = time.perf_counter()
            arm = drawn(robot, effects)
            off, size = differences(arm, asked.poses, patched(arm, asked.into) if asked.into else None)
            rms, most = float(np.sqrt(np.mean(off**2))), float(np.max(off))
            within = most <= min(limit(effects), TOGETHER) and rms <= TOGETHER_RMS
            name = effects[-1] if len(effects) <= len(BASE) + 1 else "all together"
            print(
                f"| {robot} | {name} | {1e6 * size:.0f} | {1e6 * rms:.4f} | {1e6 * most:.4f} | "
                f"{1e6 * limit(effects):.3g}{'' if within else ' EXCEEDED'} | "
                f"{time.perf_counter() - begin:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
