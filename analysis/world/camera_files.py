"""Files of a simulated camera session: what it states of the camera and the board, and its corners."""

from __future__ import annotations

import numpy as np

from analysis.world import arm

COLUMNS, ROWS, SQUARE = 7, 5, 30e-3
IMAGE = np.array([1280.0, 720.0])
FOCAL, CENTRE = np.array([905.0, 902.0]), np.array([642.0, 357.0])
LENS = np.array([-0.12, 0.06, 4e-4, -3e-4, 0.0])
U_FOCAL, U_CENTRE, U_LENS, U_SCALE, U_FLAT = 1.0, 1.0, np.array([2e-3, 5e-3, 2e-4, 2e-4, 2e-3]), 2e-4, 5e-5
"""What the session states of the calibration of the camera and of the board, px and m."""


def settings(name: str, carried: bool, stated: float) -> str:
    """Return dataset.yaml, with the calibration of the camera as stated."""
    nominal = arm.nominal()
    lens = ", ".join(f"{v:g}" for v in LENS)
    u_lens = ", ".join(f"{v:g}" for v in U_LENS)
    com = ", ".join(f"{1e3 * v:g}" for v in nominal.tool_com)
    return f"""schema: bayescal-dataset/1
name: {name}
robot: robot.yaml
readings: encoder
gravity_mps2: [0, 0, -9.81]
tools:
  on-flange: {{centre_mm: [0, 0, 0], mass_kg: {nominal.tool_mass:g}, centre_of_mass_mm: [{com}]}}
noise:
  pixel_px: {stated:.4f}
targets:
  camera:
    kind: camera
    mount: {"flange" if carried else "fixed"}
    board: charuco:{COLUMNS}x{ROWS}:{1e3 * SQUARE:g}mm:22mm
    size_px: [{IMAGE[0]:g}, {IMAGE[1]:g}]
    fx_px: {FOCAL[0]:g}
    fy_px: {FOCAL[1]:g}
    cx_px: {CENTRE[0]:g}
    cy_px: {CENTRE[1]:g}
    distortion: [{lens}]
    u_focal_px: {U_FOCAL:g}
    u_centre_px: {U_CENTRE:g}
    u_distortion: [{u_lens}]
    u_scale: {U_SCALE:g}
    u_flatness_mm: {1e3 * U_FLAT:g}
"""


def table(q: np.ndarray, velocity: np.ndarray | None, seen: np.ndarray, kept: np.ndarray) -> str:
    """Return measurements.csv: a row for every corner that was found."""
    joints = [f"j{j}_deg" for j in range(1, 7)]
    rates = [f"j{j}_degps" for j in range(1, 7)] if velocity is not None else []
    lines = [",".join(["id", "target", *joints, *rates, "u_px", "v_px", "point", "stop", "time_s"])]
    for i, k in np.argwhere(kept):
        cells = [f"i{i:03d}c{k:02d}", "camera", *(f"{v:.7f}" for v in np.degrees(q[i]))]
        cells += [f"{v:.5f}" for v in np.degrees(velocity[i])] if velocity is not None else []
        cells += [f"{v:.4f}" for v in seen[i, k]]
        lines.append(",".join([*cells, str(k), f"i{i:03d}", f"{8.0 * i:g}"]))
    return "\n".join([*lines, ""])
