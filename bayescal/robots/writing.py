"""A `Robot` as the text of a robot.yaml, one joint a line."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import yaml

from bayescal.arm.robot import Robot
from bayescal.arm.transforms import rpy_of


def number(value: float, digits: int = 14) -> str:
    """Shortest text of a number to so many significant digits; no minus zero."""
    text = f"{float(value):.{digits}g}"
    return "0" if text == "-0" else text


def scalar(text: str) -> str:
    """A text as a YAML scalar on one line, also inside brackets: quoted where it must be."""
    if re.fullmatch(r"[A-Za-z][\w.@+/-]*( [\w.@+/-]+)*", text, re.ASCII) and yaml.safe_load(text) == text:
        return text
    return yaml.safe_dump(text, default_style='"', allow_unicode=True, width=10**9).removesuffix("\n")


def sequence(values: Iterable[float], digits: int = 14) -> str:
    """Numbers as a YAML list on one line."""
    return "[" + ", ".join(number(v, digits) for v in values) + "]"


def robot_to_yaml(robot: Robot, comment: str = "") -> str:
    """Text of a robot.yaml that reads back as `robot`, to 1e-12.

    Parameters
    ----------
    robot : Robot
        In SI units.
    comment : str
        Put at the head of the file, behind ``#``.

    Returns
    -------
    str
        YAML of schema ``bayescal-robot/1``: mm, deg, kg.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += ["schema: bayescal-robot/1", f"name: {scalar(robot.name)}"]
    lines += [f"convention: {robot.convention}", "joints:"]
    alpha, beta, offset, limits = (
        np.rad2deg(v) for v in (robot.alpha, robot.beta, robot.offset, robot.limits)
    )
    for i, name in enumerate(robot.joint_names):
        cells = [
            f"name: {scalar(name)}",
            f"alpha_deg: {number(alpha[i])}",
            f"a_mm: {number(robot.a[i] * 1e3)}",
            f"d_mm: {number(robot.d[i] * 1e3)}",
            f"offset_deg: {number(offset[i])}",
            f"limits_deg: {sequence(limits[i])}",
        ]
        cells += [f"beta_deg: {number(beta[i])}"] if robot.beta[i] else []
        for key, values, factor in (
            ("max_velocity_degps", robot.velocities, np.rad2deg(1.0)),
            ("max_torque_nm", robot.torques, 1.0),
        ):
            if values is not None and not np.isnan(values[i]):
                cells.append(f"{key}: {number(values[i] * factor)}")
        lines.append(f"  - {{{', '.join(cells)}}}")
    if not np.array_equal(robot.link_from_reading, np.eye(robot.n)):
        lines += ["link_from_reading:"] + [f"  - {sequence(row)}" for row in robot.link_from_reading]
    for key, frame in (("base", robot.base), ("flange", robot.flange)):
        if not np.array_equal(frame, np.eye(4)):
            rpy = np.rad2deg(rpy_of(frame[:3, :3]))
            lines.append(f"{key}: {{xyz_mm: {sequence(frame[:3, 3] * 1e3)}, rpy_deg: {sequence(rpy)}}}")
    if robot.masses is not None and robot.centres_of_mass is not None:
        radii = np.full(robot.n, np.nan) if robot.radii is None else robot.radii
        around = ["" if np.isnan(radius) else f", radius_mm: {number(radius * 1e3)}" for radius in radii]
        lines += ["links:"] + [
            f"  - {{mass_kg: {number(mass)}, centre_of_mass_mm: {sequence(centre * 1e3)}{last}}}"
            for mass, centre, last in zip(robot.masses, robot.centres_of_mass, around, strict=True)
        ]
    if robot.reductions is not None:
        lines.append(f"reductions: {sequence(robot.reductions)}")
    if robot.compliance is not None:
        lines.append(f"joint_compliance_rad_per_nm: {sequence(robot.compliance)}")
    if robot.coupling != "display" or not np.array_equal(robot.link_from_reading, np.eye(robot.n)):
        lines.append(f"coupling: {robot.coupling}")
    return "\n".join(lines) + "\n"
