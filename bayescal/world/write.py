"""The files of a world as texts, and its truth as JSON knows it."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayescal.world.arm import LIMITS, LINK_FROM_READING, REDUCTIONS, nominal
from bayescal.world.scene import BALL, FACES, MIDDLE, NORMALS, SIDE, U_DISTANCE, U_SIZE, U_SQUARE, pairs
from bayescal.world.session import CUBE
from bayescal.world.touch import World

SCHEMA = "worlds-truth/1"


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
    s, sc = nominal(), world.scene
    tool = f"centre_mm: {_list(1e3 * s.tool)}, ball_radius_mm: 3.0, mass_kg: {s.tool_mass:g}"
    lines = [
        "schema: bayescal-dataset/1",
        f"name: {name}",
        "robot: robot.yaml",
        "readings: encoder",
        "gravity_mps2: [0, 0, -9.81]",
        "tools:",
        f"  ball: {{{tool}, centre_of_mass_mm: {_list(1e3 * s.tool_com)}}}",
        f"noise:\n  contact_mm: {1e3 * stated:.6f}\n  point_mm: 0.010\n  joint_deg: 0.0",
        "targets:",
    ]
    cube = world.session.stage == CUBE
    for f, normal in enumerate(NORMALS if cube else ()):
        offset = 1e3 * (MIDDLE @ normal + SIDE / 2)
        lines.append(f"  {FACES[f]}: {{kind: plane, normal: {_list(normal)}, offset_mm: {offset:.4f}}}")
    balls = sc.names[4:]
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
    if world.session.measured_temperature:
        lines.append("temperature_of: arm")
    return "\n".join([*lines, ""])


def _cube_certificates() -> list[str]:
    size = f"distance_mm: {1e3 * SIDE:g}, u_distance_mm: {1e3 * U_SIZE:g}, u_angle_rad: {U_SQUARE:g}"
    lines = [f"  - {{kind: parallel, faces: [{FACES[0]}, {FACES[1]}], {size}}}"]
    for f, g in ((0, 2), (0, 3), (2, 3)):
        square = f"faces: [{FACES[f]}, {FACES[g]}], u_angle_rad: {U_SQUARE:g}"
        lines.append(f"  - {{kind: perpendicular, {square}}}")
    return lines


def measurements_text(world: World, readings: np.ndarray, velocity: np.ndarray) -> str:
    """Return measurements.csv in the order of time; readings in rad, velocities in rad/s."""
    s, names = world.session, world.scene.names
    joints = [f"j{j}_deg" for j in range(1, 7)] + [f"j{j}_degps" for j in range(1, 7)]
    warm = ["temperature_c"] if s.measured_temperature else []
    lines = [",".join(["id", "role", "target", *joints, "time_s", *warm, "payload_kg", "repeat"])]
    for k in range(len(readings)):
        cells = [f"c{k:04d}", "validate" if s.phase[k] else "calibrate", names[s.target[k]]]
        cells += [f"{v:.7f}" for v in np.degrees(readings[k])] + [f"{v:.4f}" for v in np.degrees(velocity[k])]
        cells.append(f"{s.time[k]:.2f}")
        if warm:
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
