"""Set-ups of new sessions, and schemas of the files that users write."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from bayescal.public.exports import names


def init(
    folder: str | PathLike[str],
    robot: str,
    artefact: Sequence[str] | str = "cube",
    *,
    tool: str = "",
    name: str = "",
    allow_xacro: bool = False,
) -> tuple[str, ...]:
    """Write the set-up of a new session: a commented dataset.yaml, an empty table, and what to measure.

    Parameters
    ----------
    folder : path
        A new or an empty folder.
    robot : str
        A built-in name or a part of it ('ur5e'), the path of a robot.yaml, URDF or xacro, or 'new' for a
        robot.yaml to be filled in.
    artefact : sequence of str, or str
        'cube', 'spheres', 'plate', 'socket', 'bar', 'tracker'; comma separated if in one string.
    tool : str
        Centre of the ball or reflector in the flange frame, '0 0 120 mm'; to be filled in if not given.
    name : str
        Name of the session; default: the name of the folder.
    allow_xacro : bool
        As of `read_dataset`.

    Returns
    -------
    tuple of str
        Names of the files.

    Raises
    ------
    BayescalError
        If the folder is not empty, or the robot or the artefact is not known.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     bc.init(f"{folder}/cell", "lrmate200ic", "tracker", tool="60 0 120 mm")
    ('dataset.yaml', 'measurements.csv', 'README.md')
    """
    import numpy as np

    from bayescal.importing.units import quantity
    from bayescal.starting.folder import start

    centre = np.array(quantity(tool, "length", 3, "--tcp")) if tool else None
    return start(Path(folder), robot, names(artefact), centre, name, allow_xacro)


def schema(name: str) -> dict[str, Any]:
    """Return the JSON schema of a file that users write.

    Parameters
    ----------
    name : str
        'dataset' (dataset.yaml) or 'robot' (robot.yaml).

    Returns
    -------
    dict
        JSON schema, draft 2020-12.

    Raises
    ------
    BayescalError
        If there is no such file.

    Examples
    --------
    >>> import bayescal as bc
    >>> sorted(bc.schema("robot")["required"])
    ['convention', 'joints', 'name', 'schema']
    """
    from bayescal.starting.schemas import schema_of

    return schema_of(name)
