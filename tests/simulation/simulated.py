"""Simulated sessions and robots that the tests of this folder share."""

from functools import cache
from pathlib import Path

from cases import file_text

from bayescal.simulation import Options, Simulation, simulate

STANDARD = file_text("robots/standard.yaml")

SEVEN = file_text("robots/seven.yaml")

FOUR = file_text("robots/four.yaml")

SMALL = file_text("robots/small.yaml")

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
