"""A xacro file expanded in a process of its own, where the user allowed it.

xacro evaluates Python expressions and has no sandbox: from `${...}` any object of the interpreter can be
reached, so the file is a program with the rights of the user. No filter of its text can change that. It is
expanded only where the user says so; the process has none of the user's environment (tokens, paths), and
limits of time and memory against a file that is only wrong.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError

SECONDS, WAITING = 8, 40
"""Of processor time, and of waiting on a busy machine. The largest descriptions of arms take one or two."""

BYTES = 2**30
"""Of memory. The interpreter and xacro take some 30 MB."""

KEPT = ("LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT")
"""Variables without which some interpreters do not start."""

LONGEST = 300
"""Characters that are shown of what xacro says."""


def expanded(path: Path, allowed: bool) -> bytes:
    """XML that a xacro file stands for, with its arguments' defaults.

    Parameters
    ----------
    path : Path
        Files that it includes are looked for beside it.
    allowed : bool
        Whether the user allowed this file to be executed.

    Raises
    ------
    BayescalError
        If it is not allowed, or xacro cannot expand it within the limits.
    """
    urdf = path.name[: -len(path.suffix)].removesuffix(".urdf") + ".urdf"
    by_hand = f"`xacro {shlex.quote(path.name)} > {shlex.quote(urdf)}`"
    if not allowed:
        remedy = f"expand it, {by_hand}, and name {urdf}; or, if you trust its author, give --allow-xacro"
        raise BayescalError("a xacro file is a program, which is not executed unasked", path.name, remedy)
    if not path.is_file():
        raise BayescalError("no such file", path.name, f"looked in {path.parent}")
    asked = {"file": path.name, "path": sys.path, "seconds": SECONDS, "bytes": BYTES}
    command = [sys.executable, "-I", str(Path(__file__).with_name("xacro_child.py")), json.dumps(asked)]
    environment = {name: os.environ[name] for name in KEPT if name in os.environ}
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:  # a pipe would hold any amount
        try:
            streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": err}
            done = subprocess.run(command, cwd=path.parent, env=environment, timeout=WAITING, **streams)
            code = done.returncode
        except subprocess.TimeoutExpired:
            code = -1
        out.seek(0)
        err.seek(0)
        content, message = out.read(), " ".join(err.read(BYTES).decode(errors="replace").split())
    if code == 0:
        return content
    if code < 0:
        message = f"it was stopped after {SECONDS} s"
    remedy = (
        "include files by their path from this one and give arguments a default; or expand it where ROS is "
        f"installed, {by_hand}, and name {urdf}"
    )
    raise BayescalError(f"xacro cannot expand it: {message[:LONGEST]}", path.name, remedy)
