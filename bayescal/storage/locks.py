"""Hidden names beside an output: its unfinished parts, its lock, the checkpoint of an interrupted run.

The name of an unfinished part contains the host and the process that writes it. If that process was killed,
the next command for the same output removes the part, or restores an earlier result from it. The lock is held
by the operating system for an open file: it ends with its process, however the process ends.
"""

import errno
import json
import os
import re
import secrets
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import get_ident
from typing import Any

from filelock import FileLock, Timeout

from bayescal.errors import BayescalError
from bayescal.storage.reading import open_regular

PART, ASIDE, LOCK, CHECKPOINT = "part", "old", "bayescal-lock", "bayescal-checkpoint"
TOKEN = secrets.token_hex(4)
"""Random token of this process: process numbers are reused, for example in a container."""
OTHER_OUT = "give another --out"
WAITING = 0.1
"""Seconds to wait for a lock: a run that ends removes it."""
NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP)
"""Errors of file systems that cannot lock: there runs are not kept apart."""
_HELD: dict[Path, int] = {}
"""Outputs that this process has locked, with the thread that did."""


def beside(path: Path, kind: str) -> Path:
    """A hidden name beside an output; it contains the host and the process that uses it."""
    return path.with_name(f".{path.name}.{socket.gethostname()}.{os.getpid()}.{TOKEN}.{kind}")


def checkpoint_of(path: Path) -> Path:
    """Where the state of an interrupted run that writes an output is kept."""
    path = path.resolve()
    return path.with_name(f".{path.name}.{CHECKPOINT}")


def leftovers(path: Path) -> list[tuple[Path, str]]:
    """Parts of an output that killed processes of this host have left, with their kind."""
    prefix = rf"\.{re.escape(path.name)}\.{re.escape(socket.gethostname())}"
    name = re.compile(rf"{prefix}\.(\d+)\.([0-9a-f]+)\.(?:[0-9a-f]+\.)?({PART}|{ASIDE})")
    try:
        there = sorted(p.name for p in path.parent.iterdir() if p.name.startswith(f".{path.name}."))
    except OSError:
        return []
    matches = filter(None, map(name.fullmatch, there))
    return [(path.with_name(m[0]), m[3]) for m in matches if not _runs(int(m[1]), m[2])]


def remove_leftovers(file: Path) -> None:
    """Remove the parts of a file that killed processes have left."""
    for part, _ in leftovers(file):
        with suppress(OSError):
            part.unlink()


def _runs(process: int, token: str) -> bool:
    """Whether a process of this host is alive."""
    if process == os.getpid():
        return token == TOKEN

    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Lock an output for this process; within, the same thread may lock it again.

    Missing folders above it are created; if they are empty at the end, they are removed.

    Raises
    ------
    BayescalError
        If another run has locked it, or nothing can be written there.
    """
    path = path.resolve()
    if _HELD.get(path) == get_ident():
        yield
        return
    if path in _HELD:
        raise _busy(path, "")
    made: list[Path] = []
    file = path.with_name(f".{path.name}.{LOCK}")
    lock = FileLock(file, timeout=WAITING, poll_interval=WAITING / 10, fallback_to_soft=False)
    try:
        for parent in reversed([p for p in path.parents if not p.exists()]):
            parent.mkdir(exist_ok=True)
            made.append(parent)
        _owner(file)
        lock.acquire()
    except Timeout:
        raise _busy(path, _owner(file)) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            _remove_empty(made)
            raise BayescalError(error.strerror or "cannot be written", str(path), OTHER_OUT) from None
    with suppress(OSError):  # the process is only named in messages: the disk may be full
        file.write_text(str(os.getpid()), encoding="ascii")
    _HELD[path] = get_ident()
    try:
        yield
    finally:
        del _HELD[path]

        with suppress(OSError):
            file.unlink()
        lock.release()
        _remove_empty(made)


def _remove_empty(made: list[Path]) -> None:
    """Remove folders, each above the next, that contain nothing."""
    for parent in reversed(made):
        with suppress(OSError):
            parent.rmdir()


def _owner(lock: Path) -> str:
    """The number of the process in a lock, "" of none.

    Raises
    ------
    BayescalError
        Of what is not a lock, for example a pipe or a file of the user.
    """
    content = ""
    with suppress(FileNotFoundError, PermissionError):
        try:
            with open_regular(lock) as file:
                content = file.read(20).decode("ascii", "replace")
        except BayescalError:
            content = "not a file"
    if not re.fullmatch(r"\d*", content):
        remedy = f"remove it, or {OTHER_OUT}"
        raise BayescalError("it has the name of a lock, and bayescal did not write it", str(lock), remedy)
    return content


def _busy(path: Path, owner: str) -> BayescalError:
    by = f" (process {owner})" if owner else ""
    return BayescalError(f"another run{by} writes to it", str(path), f"wait for its end, or {OTHER_OUT}")


LONGEST_LINE = 10_000
"""Bytes of the first line of a checkpoint that are read."""


def first_line(schema: str, **inputs: Any) -> bytes:
    """The first line of a checkpoint; `inputs` are what its content depends on."""
    return json.dumps({"schema": schema, **inputs}, sort_keys=True).encode() + b"\n"


def read_own(path: Path, family: str) -> bytes:
    """The content of a file whose first line states a schema ``family/...``; empty if there is none.

    Raises
    ------
    OSError
        If what has this name is another file, a link, a pipe or a folder.
    """
    foreign = OSError(errno.EEXIST, f"{path.name} is not a file of bayescal")
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return b""
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise foreign
    content = path.read_bytes()
    line = content[:LONGEST_LINE].partition(b"\n")[0]
    if content and _family(line) != family:
        raise foreign
    return content


def write_synchronised(path: Path, content: bytes) -> None:
    """Write a file, and wait until it is on the disk."""
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def write_own(path: Path, content: bytes, family: str) -> None:
    """Write a file atomically, in place of one of the same schema.

    Raises
    ------
    OSError
        If it cannot be written, or what has this name is another file.
    """
    read_own(path, family)
    remove_leftovers(path)
    part = beside(path, PART)
    try:
        write_synchronised(part, content)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def remove(path: Path, family: str) -> None:
    """Remove a file, if it is one of the schemas ``family/...``."""
    with suppress(OSError):
        read_own(path, family)
        path.unlink()


def _family(line: bytes) -> str:
    """The schema of a first line without its version; "" if it has none."""
    try:
        return str(json.loads(line)["schema"]).partition("/")[0]
    except (ValueError, TypeError, KeyError, RecursionError):
        return ""
