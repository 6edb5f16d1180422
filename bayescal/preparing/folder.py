"""The folder of a new session: dataset.yaml, measurements.csv, README.md, robot.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset.read import SETTINGS, TABLE
from bayescal.dataset.table import COLUMNS, JOINT, joint_columns
from bayescal.dataset.write import ROBOT
from bayescal.errors import BayescalError
from bayescal.preparing.artefacts import ARTEFACTS, JOINTS, ON_SPHERE, Room, schema_text
from bayescal.preparing.settings import Draft, rendered, robot_template, schema_name, settings_text
from bayescal.probing.artefacts import Sizes
from bayescal.robots import builtin_robots, full_name, load_robot, only_one_arm, robot_to_yaml
from bayescal.storage.folders import whole


def columns_of(draft: Draft) -> dict[str, tuple[str, ...]]:
    """Columns of measurements.csv by key of `COLUMNS`.

    They are those needed, and those that make more effects assessable.
    """
    keys = {"id", "role", "target", "jN_deg", "jN_degps", "stop", "time_s", "payload_kg", "repeat"}
    keys |= {c for name in draft.outlines for c in ARTEFACTS[name].columns}
    keys |= {"tool"} if len(draft.tools) > 1 else set()
    joints: dict[str, tuple[str, ...]] = {}
    for kind, slid in JOINT.items():
        for column, unit in zip(joint_columns(kind, draft.units), draft.units, strict=True):
            key = f"jN_{slid if unit == 'mm' else kind}"
            joints[key] = (*joints.get(key, ()), column)
    keys |= {f"jN_{JOINT[kind]}" for kind in ("deg", "degps")}
    wanted = {key: joints.get(key, () if key.startswith("jN_") else (key,)) for key in COLUMNS if key in keys}
    return {key: columns for key, columns in wanted.items() if columns}


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
    arm: Robot | None = None,
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
    arm : Robot, optional
        That of `robot`, if this is a xacro file.

    Raises
    ------
    BayescalError
        If the folder is not empty, the robot or an artefact is not known, or the arm is too small.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BayescalError("it exists already and is not empty", str(folder), "give a new folder")
    remedy = f"known: {', '.join(ARTEFACTS)}"
    for each in artefacts:
        if each not in ARTEFACTS:
            raise BayescalError(f"no artefact is called `{each}`", "--artefact", remedy)
    if not artefacts or len(set(artefacts)) < len(artefacts):
        raise BayescalError("each artefact is named once", "--artefact", remedy)
    described = robot != NEW
    reference = full_name(robot) if described else STAND_IN
    arm = arm or load_robot(reference)[0]
    only_one_arm(arm, "set-ups of init", "write dataset.yaml as docs/two_arms.md has it")
    builtin = described and reference in builtin_robots()
    room = Room.of(arm)
    draft = Draft(
        name=name or folder.resolve().name,
        robot=reference if builtin else ROBOT,
        units=arm.units if described else ("deg",) * JOINTS,
        outlines={each: ARTEFACTS[each].outline(room) for each in artefacts},
        tool_centre=tool,
        example=Sizes.of(arm).tool,
        placed=described,
        schema=schema_name(Path(SETTINGS)),
    )
    columns, chosen = columns_of(draft), [ARTEFACTS[each] for each in artefacts]
    known = {"columns": columns, "meaning": COLUMNS, "on_sphere": ON_SPHERE}
    files = {
        SETTINGS: settings_text(draft),
        TABLE: ",".join(chain(*columns.values())) + "\n",
        README: rendered("README.md.j2", folder=folder.name, draft=draft, artefacts=chosen, **known),
        schema_name(Path(SETTINGS)): schema_text("dataset"),
    }
    if not builtin:
        schema = schema_name(Path(ROBOT))
        line = f"yaml-language-server: $schema={schema}\n{arm.name}, from {Path(reference).name}"
        files[ROBOT] = robot_to_yaml(arm, line) if described else robot_template(schema)
        files[schema] = schema_text("robot")
    with whole(folder, SETTINGS) as stage:
        for file, text in files.items():
            (stage / file).write_text(text, encoding="utf-8", newline="")
    return tuple(file for file in files if not file.startswith("."))
