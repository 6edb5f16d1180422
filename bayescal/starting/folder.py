"""Write the set-up of a new session: dataset.yaml, measurements.csv, README.md, robot.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayescal.dataset.read import SETTINGS, TABLE
from bayescal.dataset.write import ROBOT
from bayescal.errors import BayescalError
from bayescal.folders import whole
from bayescal.robots import builtin_robots, full_name, load_robot, robot_to_yaml
from bayescal.starting.artefacts import ARTEFACTS, Room
from bayescal.starting.readme import columns_of, readme_text
from bayescal.starting.robot import JOINTS, robot_template
from bayescal.starting.schemas import schema_text
from bayescal.starting.settings import Draft, schema_name, settings_text

README = "README.md"
NEW = "new"
"""Robot that is not described yet: a robot.yaml to be filled in is written."""
STAND_IN = "fanuc-lrmate200ic"
"""Robot that gives the targets of a new robot their form; their places are to be filled in."""


def start(
    folder: Path,
    robot: str,
    artefacts: Sequence[str],
    tool: np.ndarray | None = None,
    name: str = "",
    allow_xacro: bool = False,
) -> tuple[str, ...]:
    """Write the set-up of a new session atomically, and return the names of its files.

    Parameters
    ----------
    folder : Path
        A new or an empty folder.
    robot : str
        A built-in name or a part of it (``ur5e``), a robot.yaml, URDF or xacro, or ``new``.
    artefacts : sequence of str
        Names of `ARTEFACTS`.
    tool : np.ndarray, optional, shape (3,)
        Centre of the ball or reflector in the flange frame, m; to be filled in if not given.
    name : str
        Of the session; default: the name of the folder.
    allow_xacro : bool
        Whether a robot in a xacro file, which is a program, may be executed.

    Raises
    ------
    BayescalError
        If the folder is not empty, the robot or an artefact is not known, or the arm is too small.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BayescalError("it exists already and is not empty", str(folder), "give a new folder")
    for each in artefacts:
        if each not in ARTEFACTS:
            raise BayescalError(
                f"no artefact is called `{each}`", "--artefact", f"known: {', '.join(ARTEFACTS)}"
            )
    if not artefacts or len(set(artefacts)) < len(artefacts):
        raise BayescalError("each artefact is named once", "--artefact", f"known: {', '.join(ARTEFACTS)}")
    known = robot != NEW
    reference = full_name(robot) if known else STAND_IN
    arm, _ = load_robot(reference, allow_xacro=allow_xacro)
    builtin = known and reference in builtin_robots()
    room = Room.of(arm)
    draft = Draft(
        name=name or folder.resolve().name,
        robot=reference if builtin else ROBOT,
        joints=arm.n if known else JOINTS,
        outlines={each: ARTEFACTS[each].outline(room) for each in artefacts},
        tool_centre=tool,
        placed=known,
        schema=schema_name(Path(SETTINGS)),
    )
    files = {
        SETTINGS: settings_text(draft),
        TABLE: ",".join(columns_of(draft)) + "\n",
        README: readme_text(draft, folder.name),
        schema_name(Path(SETTINGS)): schema_text("dataset"),
    }
    if not builtin:
        own = schema_name(Path(ROBOT))
        line = f"yaml-language-server: $schema={own}\n{arm.name}, from {Path(reference).name}"
        files |= {
            ROBOT: robot_to_yaml(arm, line) if known else robot_template(own),
            own: schema_text("robot"),
        }
    with whole(folder, SETTINGS) as stage:
        for file, text in files.items():
            (stage / file).write_text(text, encoding="utf-8", newline="")
    return tuple(file for file in files if not file.startswith("."))
