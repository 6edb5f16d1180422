"""Simulated sessions and robots that the tests of this folder share."""

from functools import cache
from pathlib import Path

from bayescal.simulation import Options, Simulation, simulate

STANDARD = """\
schema: bayescal-robot/1
name: standard
convention: dh
joints:
  - {name: J1, alpha_deg: 90, a_mm: 0, d_mm: 400, offset_deg: 0, limits_deg: [-160, 160]}
  - {name: J2, alpha_deg: 0, a_mm: 432, d_mm: 0, offset_deg: 0, limits_deg: [-60, 200]}
  - {name: J3, alpha_deg: -90, a_mm: 20, d_mm: 149, offset_deg: 0, limits_deg: [-220, 50]}
  - {name: J4, alpha_deg: 90, a_mm: 0, d_mm: 433, offset_deg: 0, limits_deg: [-170, 170]}
  - {name: J5, alpha_deg: -90, a_mm: 0, d_mm: 0, offset_deg: 0, limits_deg: [-110, 110]}
  - {name: J6, alpha_deg: 0, a_mm: 0, d_mm: 56, offset_deg: 0, limits_deg: [-260, 260]}
links:
  - {mass_kg: 10, centre_of_mass_mm: [0, -100, 0]}
  - {mass_kg: 8, centre_of_mass_mm: [-200, 0, 80]}
  - {mass_kg: 4, centre_of_mass_mm: [0, 0, 60]}
  - {mass_kg: 2, centre_of_mass_mm: [0, -50, 0]}
  - {mass_kg: 1, centre_of_mass_mm: [0, 0, 10]}
  - {mass_kg: 0.1, centre_of_mass_mm: [0, 0, -5]}
reductions: [120, 121, 100, 100, 50, 50]
"""

SEVEN = """\
schema: bayescal-robot/1
name: seven
convention: mdh
joints:
  - {name: J1, alpha_deg: 0, a_mm: 0, d_mm: 333, offset_deg: 0, limits_deg: [-166, 166]}
  - {name: J2, alpha_deg: -90, a_mm: 0, d_mm: 0, offset_deg: 0, limits_deg: [-101, 101]}
  - {name: J3, alpha_deg: 90, a_mm: 0, d_mm: 316, offset_deg: 0, limits_deg: [-166, 166]}
  - {name: J4, alpha_deg: 90, a_mm: 82.5, d_mm: 0, offset_deg: 0, limits_deg: [-176, -4]}
  - {name: J5, alpha_deg: -90, a_mm: -82.5, d_mm: 384, offset_deg: 0, limits_deg: [-166, 166]}
  - {name: J6, alpha_deg: 90, a_mm: 0, d_mm: 0, offset_deg: 0, limits_deg: [-1, 215]}
  - {name: J7, alpha_deg: 90, a_mm: 88, d_mm: 107, offset_deg: 0, limits_deg: [-166, 166]}
base: {xyz_mm: [100, 50, 20], rpy_deg: [0, 0, 30]}
"""

FOUR = """\
schema: bayescal-robot/1
name: four
convention: mdh
joints:
  - {name: J1, alpha_deg: 0, a_mm: 0, d_mm: 200, offset_deg: 0, limits_deg: [-170, 170]}
  - {name: J2, alpha_deg: -90, a_mm: 0, d_mm: 0, offset_deg: -90, limits_deg: [-90, 120]}
  - {name: J3, alpha_deg: 0, a_mm: 400, d_mm: 0, offset_deg: 0, limits_deg: [-150, 150]}
  - {name: J4, alpha_deg: 0, a_mm: 350, d_mm: 0, offset_deg: 0, limits_deg: [-170, 170]}
"""

SMALL = """\
schema: bayescal-robot/1
name: small
convention: mdh
joints:
  - {name: J1, alpha_deg: 0, a_mm: 0, d_mm: 50, offset_deg: 0, limits_deg: [-170, 170]}
  - {name: J2, alpha_deg: -90, a_mm: 0, d_mm: 0, offset_deg: -90, limits_deg: [-20, 20]}
  - {name: J3, alpha_deg: 0, a_mm: 60, d_mm: 0, offset_deg: 0, limits_deg: [-20, 20]}
"""

ROBOTS = {"standard": STANDARD, "seven": SEVEN, "four": FOUR, "small": SMALL}
LITTLE = {"contacts": 60, "later": 12, "repeats": 3, "placements": 1, "sphere_contacts": 10}


@cache
def lrmate(**options: object) -> Simulation:
    """A little session of the built-in arm."""
    return simulate(Options(**{**LITTLE, "seed": 4, **options}))  # type: ignore[arg-type]


def robot_file(folder: Path, name: str) -> str:
    """Path of a robot.yaml in `folder`, by its name in `ROBOTS`."""
    out = folder / f"{name}.yaml"
    out.write_text(ROBOTS[name], encoding="utf-8")
    return str(out)
