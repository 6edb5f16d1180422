"""Hidden names beside an output: its unfinished parts, and the lock of the process that writes it.

The name of an unfinished part contains the host and the process that writes it. If that process was killed,
the next command for the same output removes the part, or restores an earlier result from it. The lock is held
by the operating system for an open file: it ends with its process, however the process ends.

A file that grows by blocks while a process works, for a later process to read.

A first line of JSON states the schema and the inputs. Every block has a checksum: what a killed process has
written of its last block is ignored. Whatever else has the name of the file (a symbolic link, a pipe, a file
of the user) is not read, written or removed.
"""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import shutil
import socket
import stat
import struct
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import get_ident
from typing import Any, BinaryIO

from bayescal.errors import BayescalError

PART, ASIDE, LOCK, CHECKPOINT = "part", "old", "bayescal-lock", "bayescal-checkpoint"
TOKEN = secrets.token_hex(4)
"""Random token of this process: process numbers are reused, for example in a container."""
OTHER_OUT = "give another --out"
ATTEMPTS = 100
"""To lock a file that other processes create and remove at the same time."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
"""Open no file through a symbolic link, and wait for no writer of a pipe."""
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
    own = rf"\.{re.escape(path.name)}\.{re.escape(socket.gethostname())}"
    name = re.compile(rf"{own}\.(\d+)\.([0-9a-f]+)\.(?:[0-9a-f]+\.)?({PART}|{ASIDE})")
    try:
        there = sorted(p.name for p in path.parent.iterdir() if p.name.startswith(f".{path.name}."))
    except OSError:
        return []
    found = filter(None, map(name.fullmatch, there))
    return [(path.with_name(m[0]), m[3]) for m in found if not _runs(int(m[1]), m[2])]


def remove_leftovers(file: Path) -> None:
    """Remove the parts of a file, or of a temporary folder, that killed processes have left."""
    for part, _ in leftovers(file):
        with suppress(OSError):
            if part.is_dir() and not part.is_symlink():
                shutil.rmtree(part, ignore_errors=True)
            else:
                part.unlink()


def _runs(process: int, token: str) -> bool:
    """Whether a process of this host is alive."""
    if process == os.getpid():
        return token == TOKEN
    if os.name == "nt":
        return True  # os.kill would terminate the process on Windows; the user removes the folder
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


@contextmanager
def scratch(name: str) -> Iterator[Path]:
    """A temporary folder; those of this name that killed processes have left are removed."""
    general = Path(tempfile.gettempdir()) / name
    remove_leftovers(general)
    folder = beside(general, f"{secrets.token_hex(4)}.{PART}")
    folder.mkdir(mode=0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


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
    lock = path.with_name(f".{path.name}.{LOCK}")
    try:
        for parent in reversed([p for p in path.parents if not p.exists()]):
            parent.mkdir(exist_ok=True)
            made.append(parent)
        handle = _locked(lock, path)
    except OSError as error:
        _remove_empty(made)
        raise BayescalError(error.strerror or "cannot be written", str(path), OTHER_OUT) from None
    _HELD[path] = get_ident()
    try:
        yield
    finally:
        del _HELD[path]
        if os.name == "nt":  # an open file cannot be removed there
            os.close(handle)
        with suppress(OSError):
            lock.unlink()
        if os.name != "nt":
            os.close(handle)
        _remove_empty(made)


def _remove_empty(made: list[Path]) -> None:
    """Remove folders, each above the next, that contain nothing."""
    for parent in reversed(made):
        with suppress(OSError):
            parent.rmdir()


def _locked(lock: Path, path: Path) -> int:
    """The handle of a locked file; it is the file that has this name when the lock is held."""
    for _ in range(ATTEMPTS):
        handle = _opened(lock)
        try:
            if not _exclusive(handle):
                raise _busy(path, _content(handle))
            if _has_name(handle, lock):
                with suppress(OSError):  # the process is only named in messages: the disk may be full
                    os.ftruncate(handle, 0)
                    os.write(handle, f"{os.getpid()}".encode())
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # the run that held it has removed it: lock the new one
    raise _busy(path, "")


def _opened(lock: Path) -> int:
    """Open or create a lock; what is not one, for example a pipe or a file of the user, is refused."""
    handle = os.open(lock, os.O_RDWR | os.O_CREAT | NO_LINK, 0o666)
    try:
        if not (stat.S_ISREG(os.fstat(handle).st_mode) and re.fullmatch(r"\d*", _content(handle))):
            remedy = f"remove it, or {OTHER_OUT}"
            raise BayescalError("it has the name of a lock, and bayescal did not write it", str(lock), remedy)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _content(handle: int) -> str:
    """The number of a process in a lock, "" where it cannot be read: Windows locks the first byte."""
    with suppress(OSError):
        os.lseek(handle, 0, os.SEEK_SET)
        return os.read(handle, 20).decode("ascii", "replace")
    return ""


def _has_name(handle: int, path: Path) -> bool:
    """Whether an open file is the one of this name."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False


def _exclusive(handle: int) -> bool:
    """Lock an open file without waiting; true also where the file system has no locks."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def _busy(path: Path, owner: str) -> BayescalError:
    by = f" (process {owner})" if owner.isdigit() else ""
    return BayescalError(f"another run{by} writes to it", str(path), f"wait for its end, or {OTHER_OUT}")


HEAD = struct.Struct("<QI")
"""Of a block: its length, and the checksum of its content."""
LONGEST_LINE = 10_000
"""Bytes of the first line that are read."""


def first_line(schema: str, **inputs: Any) -> bytes:
    """The first line of a file; `inputs` are what its content depends on."""
    return json.dumps({"schema": schema, **inputs}, sort_keys=True).encode() + b"\n"


def block(content: bytes) -> bytes:
    """A block with its length and checksum."""
    return HEAD.pack(len(content), zlib.crc32(content)) + content


def read(path: Path, line: bytes) -> tuple[list[tuple[bytes, int]] | None, int]:
    """Complete blocks of a file.

    Parameters
    ----------
    path : Path
    line : bytes
        The expected first line.

    Returns
    -------
    list of (bytes, int)
        Every block, and the place in the file after it. None if the first line is another one of the schema.
    int
        The place after the first line; 0 if there is no file, or another line.

    Raises
    ------
    OSError
        If what has this name is not a file of the schema.
    """
    try:
        with _growing_opened(path, _family(line)) as file:
            content = file.read()
    except FileNotFoundError:
        return [], 0
    if not content.startswith(line):
        return (None if content else []), 0
    out, at = [], len(line)
    while at + HEAD.size <= len(content):
        size, checksum = HEAD.unpack_from(content, at)
        own = content[at + HEAD.size : at + HEAD.size + size]
        if len(own) < size or zlib.crc32(own) != checksum:
            break
        at += HEAD.size + size
        out.append((own, at))
    return out, len(line)


def write(path: Path, line: bytes, content: bytes, place: int) -> None:
    """Write `content` at a place of a file, remove what was after it, and synchronise it with the disk.

    Raises
    ------
    OSError
        If it cannot be written, or what has this name is not a file of the schema of `line`.
    """
    with _growing_opened(path, _family(line), os.O_CREAT) as file:
        file.truncate(place)  # before new content: blocks of another run must not follow it
        file.seek(place)
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def remove(path: Path, family: str) -> None:
    """Remove a file, if it is one of the schemas ``family/...``."""
    with suppress(OSError):
        with _growing_opened(path, family):
            pass
        path.unlink()


@contextmanager
def _growing_opened(path: Path, family: str, flags: int = 0) -> Iterator[BinaryIO]:
    """An open file, at its begin: an empty one, or one of the schemas ``family/...``."""
    foreign = OSError(errno.EEXIST, f"{path.name} is not a file of bayescal")
    if path.is_symlink():
        raise foreign
    handle = os.open(path, os.O_RDWR | NO_LINK | getattr(os, "O_BINARY", 0) | flags, 0o666)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise foreign
    with os.fdopen(handle, "r+b") as file:
        line = file.readline(LONGEST_LINE)
        if line and _family(line) != family:
            raise foreign
        file.seek(0)
        yield file


def _family(line: bytes) -> str:
    """The schema of a first line without its version; "" if it has none."""
    try:
        return str(json.loads(line)["schema"]).partition("/")[0]
    except (ValueError, TypeError, KeyError, RecursionError):
        return ""
