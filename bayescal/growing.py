"""A file that grows by blocks while a process works, for a later process to read.

A first line of JSON states the schema and the inputs. Every block has a checksum: what a killed process has
written of its last block is ignored. Whatever else has the name of the file (a symbolic link, a pipe, a file
of the user) is not read, written or removed.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from bayescal.beside import NO_LINK

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
        with _opened(path, _family(line)) as file:
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
    with _opened(path, _family(line), os.O_CREAT) as file:
        file.truncate(place)  # before new content: blocks of another run must not follow it
        file.seek(place)
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def remove(path: Path, family: str) -> None:
    """Remove a file, if it is one of the schemas ``family/...``."""
    with suppress(OSError):
        with _opened(path, family):
            pass
        path.unlink()


@contextmanager
def _opened(path: Path, family: str, flags: int = 0) -> Iterator[BinaryIO]:
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
