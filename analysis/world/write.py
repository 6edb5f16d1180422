"""The files of a world as texts, and its truth as JSON knows it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.world.arm import LIMITS, LINK_FROM_READING, REDUCTIONS, nominal
from analysis.world.scene import (  # fmt: skip
    BALL,
    BALLS,
    FACES,
    INSTRUMENT,
    MIDDLE,
    NAMES,
    NORMALS,
    SIDE,
    U_DISTANCE,
    U_SIZE,
    U_SQUARE,
    pairs,
)
from analysis.world.session import CUBE, Session
from analysis.world.touch import Act, World
from analysis.world.tracker import Tracked

SCHEMA = "worlds-truth/1"
ROLES = ("calibrate", "validate", "validate", "calibrate")
"""Of the phases of a session."""


def _list(values: np.ndarray, form: str = "{:g}") -> str:
    return "[" + ", ".join(form.format(v) for v in values) + "]"


def robot_text() -> str:
    """Return robot.yaml of the nominal arm."""
    s = nominal()
    lines = ["schema: bayescal-robot/1", "name: fanuc-lrmate200ic", "convention: mdh", "joints:"]
    for i in range(6):
        row = np.degrees(s.alpha[i]), 1e3 * s.a[i], 1e3 * s.d[i], np.degrees(s.zero[i])
        cells = ", ".join(
            f"{k}: {v:g}" for k, v in zip(("alpha_deg", "a_mm", "d_mm", "offset_deg"), row, strict=True)
        )
        lines.append(f"  - {{name: J{i + 1}, {cells}, limits_deg: {_list(np.degrees(LIMITS[i]))}}}")
    lines += ["link_from_reading:", *(f"  - {_list(row)}" for row in LINK_FROM_READING), "links:"]
    for mass, com in zip(s.mass, s.com, strict=True):
        lines.append(f"  - {{mass_kg: {mass:g}, centre_of_mass_mm: {_list(1e3 * com)}}}")
    return "\n".join([*lines, f"reductions: {_list(REDUCTIONS)}", ""])


def dataset_text(world: World, name: str, stated: float) -> str:
    """Return dataset.yaml: everything nominal, noise as stated (m)."""
    s = nominal()
    of_targets = _instrument if isinstance(world, Tracked) else _cube_and_balls
    tool, ball, noise, targets = of_targets(world, stated)
    centre, mass = f"centre_mm: {_list(1e3 * s.tool)}", f"mass_kg: {s.tool_mass:g}"
    lines = [
        "schema: bayescal-dataset/1",
        f"name: {name}",
        "robot: robot.yaml",
        "readings: encoder",
        "gravity_mps2: [0, 0, -9.81]",
        "tools:",
        f"  {tool}: {{{centre}, {ball}{mass}, centre_of_mass_mm: {_list(1e3 * s.tool_com)}}}",
        f"noise:\n  {noise}\n  joint_deg: 0.0",
        "targets:",
        *targets,
    ]
    if world.session.measured_temperature:
        lines.append("temperature_of: arm")
    return "\n".join([*lines, ""])


def _instrument(world: World, stated: float) -> tuple[str, str, str, list[str]]:
    """Return the tool's name, its ball, the noise and the targets of a session with a tracker."""
    assert isinstance(world, Tracked)
    at = world.instrument
    turn = Rotation.from_matrix(at.stated_turn).as_euler("xyz", degrees=True)
    place = f"xyz_mm: {_list(1e3 * at.stated_origin, '{:.3f}')}, rpy_deg: {_list(turn, '{:.4f}')}"
    target = f"  {NAMES[INSTRUMENT]}: {{kind: instrument, {place}}}"
    return "reflector", "", f"point_mm: {1e3 * stated:.6f}", [target]


def _cube_and_balls(world: World, stated: float) -> tuple[str, str, str, list[str]]:
    """Return the same of a probe, with the certificates of what it touches."""
    sc, cube, lines = world.scene, world.session.stage == CUBE, []
    for f, normal in enumerate(NORMALS if cube else ()):
        offset = 1e3 * (MIDDLE @ normal + SIDE / 2)
        lines.append(f"  {FACES[f]}: {{kind: plane, normal: {_list(normal)}, offset_mm: {offset:.4f}}}")
    balls = NAMES[BALLS]
    for ball, at in zip(balls, sc.ball_drawn, strict=True):
        centre = _list(1e3 * at, "{:.3f}")
        lines.append(f"  {ball}: {{kind: sphere, centre_mm: {centre}, diameter_mm: {1e3 * BALL:g}}}")
    lines.append("certificates:")
    if cube:
        lines += _cube_certificates()
    for (i, j), d in zip(pairs(), sc.certified, strict=True):
        length = f"distance_mm: {1e3 * d:.6f}, u_distance_mm: {1e3 * U_DISTANCE:g}"
        lines.append(f"  - {{kind: distance, between: [{balls[i]}, {balls[j]}], {length}}}")
    lines += [f"  - {{kind: diameter, target: {ball}, u_diameter_mm: 0.001}}" for ball in balls]
    return "ball", "ball_radius_mm: 3.0, ", f"contact_mm: {1e3 * stated:.6f}\n  point_mm: 0.010", lines


def _cube_certificates() -> list[str]:
    size = f"distance_mm: {1e3 * SIDE:g}, u_distance_mm: {1e3 * U_SIZE:g}, u_angle_rad: {U_SQUARE:g}"
    lines = [f"  - {{kind: parallel, faces: [{FACES[0]}, {FACES[1]}], {size}}}"]
    for f, g in ((0, 2), (0, 3), (2, 3)):
        square = f"faces: [{FACES[f]}, {FACES[g]}], u_angle_rad: {U_SQUARE:g}"
        lines.append(f"  - {{kind: perpendicular, {square}}}")
    return lines


def measurements_text(
    s: Session, readings: np.ndarray, velocity: np.ndarray | None, points: np.ndarray | None, first: int = 0
) -> str:
    """Return measurements.csv in the order of time.

    Parameters
    ----------
    s : Session
        What is measured, and when.
    readings : numpy.ndarray
        Of the joints (n, 6), rad.
    velocity : numpy.ndarray, optional
        Of the joints as they approach (n, 6), rad/s.
    points : numpy.ndarray, optional
        What the tracker reads (n, 3), m.
    first : int
        The first contact that is written.
    """
    columns = ["id", "role", "target", *(f"j{j}_deg" for j in range(1, 7))]
    columns += [f"j{j}_degps" for j in range(1, 7)] if velocity is not None else []
    columns += ["x_mm", "y_mm", "z_mm"] if points is not None else []
    columns += ["time_s", *(["temperature_c"] if s.measured_temperature else []), "payload_kg", "repeat"]
    lines = [",".join(columns)]
    for k in range(first, len(readings)):
        cells = [f"c{k:04d}", ROLES[s.phase[k]], NAMES[s.target[k]]]
        cells += [f"{v:.7f}" for v in np.degrees(readings[k])]
        cells += [f"{v:.4f}" for v in np.degrees(velocity[k])] if velocity is not None else []
        cells += [f"{1e3 * v:.5f}" for v in points[k]] if points is not None else []
        cells.append(f"{s.time[k]:.2f}")
        if s.measured_temperature:
            cells.append(f"{s.temperature[k]:.2f}")
        cells += [f"{s.payload[k]:.1f}", f"r{s.repeat[k]:02d}" if s.repeat[k] >= 0 else ""]
        lines.append(",".join(cells))
    return "\n".join([*lines, ""])


def plain(value: Any) -> Any:
    """Return a value as JSON knows it, to nine digits."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{value:.9g}")
    return value


def texts(
    rng: np.random.Generator,
    world: World,
    acts: Sequence[tuple[Act, float]],
    noise: np.ndarray,
    name: str,
    stated: float,
) -> tuple[dict[str, str], float]:
    """Return the files of a session by name, and how far contacts are off the touch (m); with its noise."""
    plan = world.session
    readings, worst = world.touch(acts, noise)
    points = world.points(acts, noise) if isinstance(world, Tracked) else None
    velocity = plan.velocity + np.radians(0.002) * rng.standard_normal((len(plan.time), 6))
    return {
        "dataset.yaml": dataset_text(world, name, stated),
        "robot.yaml": robot_text(),
        "measurements.csv": measurements_text(
            plan, readings, velocity if plan.says_velocity else None, points
        ),
    }, worst
