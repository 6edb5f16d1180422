"""``python -m analysis.compensation.coverage --seed 8 --count 60``: does U of a point hold.

Sessions of `analysis.world`, which shares no code with the model. An arm is fitted to each: with the hidden
effects where they are in the list of effects, else without. The true arm is brought to readings beside the
measurements of the session, with their history, load and time; its TCPs are compared with those of the
fitted arm. A compensation puts the fitted arm on its target within 0.01 µm, so that these are the errors of
compensated targets.

The frame of the base of an arm that is calibrated on loosely placed artefacts is its own. So a rigid motion
is taken out of the errors (least squares), and out of the covariance of all points together.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from analysis.compensation.session import COUNT, MOVED, stands
from analysis.pages import table as markdown
from analysis.world.build import Made, make
from analysis.world.mix import recipe
from bayescal.calibration import fit
from bayescal.compensating.position import Region, expanded
from bayescal.dataset import read_dataset
from bayescal.errors import BayescalError
from bayescal.fitted.arm import FittedArm, of_fit, refitted
from bayescal.statistics import rms

UM = 1e6


@dataclass(frozen=True)
class Checked:
    """Errors of the points of a session, their u and U, m, without the motion of the frame."""

    number: int
    kind: str  # right name, outside, reserved
    hidden: str
    stage: str
    errors: np.ndarray
    u: np.ndarray
    limits: np.ndarray

    @property
    def within(self) -> np.ndarray:
        """Which points are within U."""
        return self.errors <= self.limits


def checked(made: Made, arm: FittedArm, number: int, kind: str, hidden: str) -> Checked:
    """Compare the TCP positions of the true arm and the fitted one beside rows of the session."""
    m, rng = arm.dataset.measurements, np.random.default_rng(number)
    rows = rng.choice(len(m.ids), COUNT, replace=False)
    readings = m.readings[rows] + rng.uniform(-MOVED, MOVED, (COUNT, arm.dataset.robot.n))
    poses = arm.at(
        readings,
        payload_kg=np.zeros(COUNT) if m.payload is None else m.payload[rows],
        direction=None if m.velocity is None else m.velocity[rows],
        time=None if m.time is None else m.time[rows],
    )
    good = np.flatnonzero(Region.of(arm).contains(poses.points, readings))
    away = stands(made, m.readings, rows[good], readings[good]) - poses.points[good]
    own = poses.errors_by(poses.by_all)
    root = own[good].reshape(3 * len(good), -1)
    free = without_motion(poses.points[good])
    every = free @ (root @ root.T + arm.beyond.excess**2 * np.eye(len(root))) @ free
    covariance = np.array([every[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(good))])
    total = np.trace(covariance, axis1=1, axis2=2)
    errors = np.linalg.norm((free @ away.ravel()).reshape(-1, 3), axis=1)
    limits = expanded(
        covariance, poses.dof_by(poses.by_all, np.trace(poses.covariance, axis1=1, axis2=2))[good]
    )
    stage = str(made.truth["session"].get("stage", ""))
    return Checked(number, kind, hidden, stage, errors, np.sqrt(total), limits)


def without_motion(points: np.ndarray) -> np.ndarray:
    """Projection (3 C, 3 C) that takes shifts and turns of points (C, 3) out of their displacements."""
    arms = points - points.mean(axis=0)
    motion = np.concatenate(
        [np.tile(np.eye(3), (len(points), 1, 1)), np.stack([np.cross(a, arms) for a in np.eye(3)], axis=2)],
        axis=2,
    ).reshape(-1, 6)
    basis, _ = np.linalg.qr(motion)
    return np.eye(len(basis)) - basis @ basis.T


def session(seed: int, number: int, reserved: bool) -> Checked | None:
    """A session of the simulator, its arm fitted and compared; None where the fit is refused."""
    kind, _ = recipe(seed, number, 4, reserved=reserved)
    if reserved and kind != "outside":
        return None
    made = make(seed, number, generator=4, reserved=reserved)
    with TemporaryDirectory() as folder:
        for name, text in made.texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        dataset = read_dataset(Path(folder))
    baseline, hidden = tuple(made.truth["baseline"]), made.truth["effects"]
    further = [name for name in hidden if name not in baseline and name != "unknown"]
    try:
        arm = of_fit(fit(dataset, baseline, samples=0))
        arm = refitted(arm, further) if further else arm
    except BayescalError as error:
        sys.stderr.write(f"{number}: {error}\n")
        return None
    outside = kind == "outside"
    return checked(made, arm, number, "outside" if outside else "right name",
                   made.truth["outside"] if outside else ", ".join(hidden) or "none")  # fmt: skip


def pooled(found: Sequence[Checked], what: str) -> tuple[object, ...]:
    """The cells of a line of the table."""
    errors, u, within = (
        np.concatenate([getattr(c, key) for c in found]) for key in ("errors", "u", "within")
    )
    lowest, sizes = min(c.within.mean() for c in found), (UM * np.median(errors), UM * np.median(u))
    return (
        what, len(found), f"{within.sum()} of {len(within)}", f"{100 * within.mean():.1f} %",
        f"{100 * lowest:.0f} %", f"{rms(errors / u):.2f}", *(f"{size:.0f}" for size in sizes),
    )  # fmt: skip


def table(found: Sequence[Checked]) -> str:
    """Pooled figures of the sessions with a right name, of those without, and by cause."""
    heads = (
        "hidden", "sessions", "points within U", "share", "lowest session", "error over u (RMS)",
        "error (median, µm)", "u (median, µm)",
    )  # fmt: skip
    lines = []
    for kind in ("right name", "outside"):
        own = [c for c in found if c.kind == kind]
        if own:
            lines.append(pooled(own, f"**{kind}**"))
        for hidden in sorted({c.hidden for c in own}) if kind == "outside" else ():
            lines.append(pooled([c for c in own if c.hidden == hidden], hidden))
    return markdown(heads, lines)


def main() -> None:
    """Print the table after each session."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--outside", action="store_true", help="only causes outside the list of effects")
    parser.add_argument(
        "--reserved", action="store_true", help="also the reserved causes, and only causes outside"
    )
    asked = parser.parse_args()
    found: list[Checked] = []
    for number in range(asked.first, asked.first + asked.count):
        if asked.outside and recipe(asked.seed, number, 4, reserved=asked.reserved)[0] != "outside":
            continue
        if (one := session(asked.seed, number, asked.reserved)) is not None:
            found.append(one)
            share = f"{100 * one.within.mean():.0f} % of {len(one.errors)}"
            sys.stderr.write(f"{number} {one.hidden} ({one.stage}): {share} within U\n")
    print(table(found))


if __name__ == "__main__":
    main()
