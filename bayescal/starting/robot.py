"""Text of a robot.yaml to be filled in, for a robot that is not built in."""

from __future__ import annotations

from bayescal.files import FILL_IN
from bayescal.robots.schema import SCHEMA, Joint, Link, RobotFile

JOINTS = 6


def robot_template(schema: str) -> str:
    """A robot.yaml with six joints whose values are to be filled in; no value is assumed."""
    blank = f"{FILL_IN} ''"
    of_joint, of_link, of_file = Joint.model_fields, Link.model_fields, RobotFile.model_fields
    lines = [
        f"# yaml-language-server: $schema={schema}",
        "# A robot for bayescal: nominal values of its data sheet. The units are in the keys (mm, deg, kg).",
        f"# {FILL_IN} marks a value that is needed: write it in place of the quotes, and delete the mark.",
        "# Add or remove rows for an arm with another number of joints, and columns in measurements.csv.",
        f"schema: {SCHEMA}",
        f"name: {blank}",
        f"# {of_file['convention'].description}",
        f"convention: {blank}",
        f"# {of_file['joints'].description}",
    ]
    keys = ("alpha_deg", "a_mm", "d_mm", "offset_deg", "limits_deg")
    lines += [f"#   {key}: {of_joint[key].description}" for key in keys]
    row = ", ".join(f"{key}: {blank}" for key in keys)
    lines += ["joints:", *(f"  - {{name: J{k + 1}, {row}}}" for k in range(JOINTS))]
    identity = [", ".join("1" if k == j else "0" for k in range(JOINTS)) for j in range(JOINTS)]
    lines += [
        f"# {of_file['link_from_reading'].description}",
        "# link_from_reading:",
        *(f"#   - [{row}]" for row in identity),
        f"# {of_file['links'].description} Without them delete this part; compliance is then not modelled.",
        *(f"#   {key}: {of_link[key].description}" for key in ("mass_kg", "centre_of_mass_mm", "radius_mm")),
        "links:",
        *(f"  - {{mass_kg: {blank}, centre_of_mass_mm: {blank}}}" for _ in range(JOINTS)),
        f"# {of_file['reductions'].description} Optional.",
        "# reductions: [100, 100, 100, 100, 100, 100]",
    ]
    return "\n".join(lines) + "\n"
