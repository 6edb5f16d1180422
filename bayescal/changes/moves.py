"""What changes of an arm do to distances and at given poses, by slopes of the TCP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.inverse import nearest, solutions
from bayescal.changes.joint import Joint
from bayescal.dataset import Dataset
from bayescal.dataset.write import appended
from bayescal.effects import Parameter
from bayescal.errors import BayescalError
from bayescal.estimate.further import model_with
from bayescal.programs.text import Target
from bayescal.programs.tools import nominal_arm

AT = "at"
"""Role of poses that are given: they are neither fitted nor validated."""
STEP = 1e-2
"""Of a parameter, in prior standard deviations, for its slopes."""
PAIRS, DRAWS = 3000, 400
"""Pairs of poses whose distances are compared, and draws for their u."""


@dataclass(frozen=True)
class DistanceChange:
    """Change of the distances between poses; m."""

    rms: float
    u_rms: float
    largest: float
    u_largest: float


@dataclass(frozen=True)
class Shift:
    """Displacement of the TCP in F0 at a given pose, m; `reason` why there is none."""

    where: str
    shift: np.ndarray | None = None  # (3,)
    covariance: np.ndarray | None = None
    reason: str = ""


def tcp_slopes(joint: Joint, parameters: Sequence[tuple[Parameter, bool]]) -> np.ndarray:
    """Displacements (K, 3, N), m, of the TCP in all rows by a prior standard deviation of parameters.

    Zero for parameters of which they are not wanted.
    """
    wanted = [p for p, used in parameters if used]
    wide, _, _ = model_with(joint.found.model, wanted)
    motion = wide.motion(np.arange(len(joint.found.model.scene.q)))
    values = np.append(joint.found.arm, np.zeros(len(wanted)))
    out, still = np.zeros((len(parameters), 3, len(joint.found.model.scene.q))), motion.points(values)
    places = np.flatnonzero([used for _, used in parameters])
    for k, (at, p) in enumerate(zip(places, wanted, strict=True), start=len(joint.found.arm)):
        step = STEP * p.sd * np.eye(len(values))[k]
        out[at] = (motion.points(values + step) - still) / STEP
    return out


def distance_slopes(points: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Changes (K, pairs), m, of distances between random pairs of points (3, N) moved by `by` (K, 3, N)."""
    a, b = np.random.default_rng(0).integers(points.shape[1], size=(2, PAIRS))
    apart = points[:, a] - points[:, b]
    size = np.linalg.norm(apart, axis=0)
    a, b, apart = a[size > 0], b[size > 0], apart[:, size > 0] / size[size > 0]
    return np.einsum("kcp,cp->kp", by[:, :, a] - by[:, :, b], apart)


def distance_change(by: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> DistanceChange:
    """Change of distances with slopes (K, pairs) by K amplitudes of a mean (K,) and covariance (K, K)."""
    draws = drawn(mean, covariance) @ by
    value = mean @ by
    most = int(np.argmax(np.abs(value)))
    rms, spread = np.sqrt(np.mean(value**2)), np.std(np.sqrt(np.mean(draws**2, axis=1)))
    return DistanceChange(float(rms), float(spread), float(value[most]), float(np.std(draws[:, most])))


def drawn(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Draws (DRAWS, K) of amplitudes."""
    return np.random.default_rng(0).multivariate_normal(mean, covariance, DRAWS, method="eigh")


def with_poses(dataset: Dataset, targets: Sequence[Target]) -> tuple[Dataset, list[str]]:
    """A session with rows at given poses, by the nominal arm; and for each of these why it has no row, or "".

    Raises
    ------
    BayescalError
        For a tool that the session does not have.
    """
    if not targets:
        return dataset, []
    m, names = dataset.measurements, [t.name for t in dataset.tools]
    readings, tools, kept, reasons = [], [], [], []
    for target in targets:
        if target.tool is not None and target.tool not in names:
            raise BayescalError(
                f"there is no tool `{target.tool}`", target.where, f"known: {', '.join(names)}"
            )
        tool = names.index(target.tool) if target.tool else int(np.bincount(m.tool).argmax())
        found = target.readings
        if target.pose is not None:
            arm = nominal_arm(dataset.robot, dataset.tools[tool])
            near = m.readings[:1] if found is None else found[None]
            every = solutions(arm, target.pose[None], near[None, :1])[0]
            found = nearest(arm, every, m.readings if found is None else near)
        reasons.append("" if found is not None else "the nominal arm does not reach it")
        if found is not None:
            readings.append(found)
            tools.append(tool)
            kept.append(target)
    if not kept:
        return dataset, reasons
    still = np.zeros(dataset.robot.n)
    velocity = [still if t.velocity is None else t.velocity for t in kept]
    given = {"readings": readings, "tool": tools, "velocity": velocity, "repeat": "", "stop": ""}
    if m.payload is not None:
        given["payload"] = [t.payload for t in kept]
    ids = [f"{AT} {k}" for k in range(1, len(kept) + 1)]
    longer = appended(m, np.full(len(kept), len(m.ids) - 1), given, ids)
    role = np.append(m.role, [AT] * len(kept))
    return replace(dataset, measurements=replace(longer, role=role)), reasons
