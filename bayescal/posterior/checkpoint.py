"""Checkpoint of a long sampling: an interrupted run continues with the draws of an uninterrupted one.

A sampler is deterministic for a seed, and most of its time is spent on the density. A checkpoint therefore
records the values of the density in the order in which they were computed. A resumed sampler repeats its
proposals with the recorded values, and computes from the first one that is missing. Its state (random
generators, chains, adaptation) is then computed as without an interruption.

The file grows by blocks with a checksum; an incomplete last block is ignored. Values are bound to their
points by a checksum, and the first and the last recorded values are computed again and compared bit by bit:
a record of other data, another model, seed, version or machine is not used.
"""

from __future__ import annotations

import json
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from os import fsync
from pathlib import Path
from typing import Any

import numpy as np

from bayescal import __version__
from bayescal.stopping import keeping

SCHEMA = "bayescal-checkpoint/1"
EVERY = 4.0
"""Seconds of sampling between two writes; a shorter run writes none."""
HEAD = struct.Struct("<III")
"""Of a block: number of values, checksum of their points, checksum of the values."""
Values = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Checkpoint:
    """Where the state of an interrupted sampling is kept.

    Attributes
    ----------
    path : Path
        The file; it is removed by `remove` when the results are saved.
    say : callable
        Called with a text, if an earlier run is continued or cannot be.
    """

    path: Path
    say: Callable[[str], None] = lambda text: None

    @contextmanager
    def of(self, density: Values, **inputs: Any) -> Iterator[Values]:
        """Yield a density with the same values that records them, and repeats recorded ones.

        Parameters
        ----------
        density : callable
            Values (W,) of points (W, D); the sampler calls it in a reproducible order.
        **inputs
            What determines this order, for example the seed.
        """
        head = {"schema": SCHEMA, "bayescal": __version__, "numpy": np.__version__, **inputs}
        line = json.dumps(head, sort_keys=True).encode() + b"\n"
        record = _Record(self, density, line, *_read(self.path, line))
        with keeping(record.kept):
            yield record
        record.write()

    def remove(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)


Blocks = list[tuple[int, np.ndarray]]
"""Checksums of points, and values."""


def _read(path: Path, line: bytes) -> tuple[Blocks | None, int]:
    """Complete blocks of a file, None if it is of other inputs, and their end in it."""
    try:
        content = path.read_bytes()
    except OSError:
        return [], 0
    if not content.startswith(line):
        return None, 0
    out, at = [], len(line)
    while at + HEAD.size <= len(content):
        count, points, values = HEAD.unpack_from(content, at)
        block = content[at + HEAD.size : at + HEAD.size + 8 * count]
        if len(block) < 8 * count or zlib.crc32(block) != values:
            break
        out.append((points, np.frombuffer(block, "<f8").astype(float)))
        at += HEAD.size + len(block)
    return out, at


def _block(points: int, values: np.ndarray) -> bytes:
    content = np.asarray(values, "<f8").tobytes()
    return HEAD.pack(len(values), points, zlib.crc32(content)) + content


@dataclass
class _Record:
    """A density that repeats its recorded values first."""

    owner: Checkpoint
    density: Values
    line: bytes
    recorded: Blocks | None
    end: int  # of the complete blocks in the file
    place: int = 0
    unwritten: list[bytes] = field(default_factory=list)
    written: int = 0  # draws in the file
    last: float = field(default_factory=time.monotonic)
    begun: bool = False  # whether the file is ours

    def __call__(self, x: np.ndarray) -> np.ndarray:
        points = zlib.crc32(np.ascontiguousarray(x).tobytes())
        if self.recorded is None or self.place < len(self.recorded):
            if (known := self._known(x, points)) is not None:
                return known
            self._renew()
        values = self.density(x)
        self.unwritten.append(_block(points, values))
        if time.monotonic() - self.last > EVERY:
            self.write()
        return values

    def _known(self, x: np.ndarray, points: int) -> np.ndarray | None:
        """The recorded values of the next points, or None if the record is of other inputs."""
        if self.recorded is None or self.recorded[self.place][0] != points:
            return None
        values = self.recorded[self.place][1]
        ends = self.place in (0, len(self.recorded) - 1)
        if ends and not np.array_equal(self.density(x), values):
            return None
        if not self.place:
            self.written = sum(len(own) for _, own in self.recorded)
            self.owner.say(f"sampling continues after {self.written:,} draws of an interrupted run")
        self.place += 1
        self.begun = True
        return values.copy()

    def _renew(self) -> None:
        """Drop a record of other inputs; values that were used of it are kept."""
        used = (self.recorded or [])[: self.place]
        found = f"only {sum(len(own) for _, own in used):,} draws are used" if used else "it starts afresh"
        self.owner.say(f"the checkpoint of an interrupted run is of other inputs or another version: {found}")
        self.unwritten = [_block(*own) for own in used]
        self.recorded, self.written, self.end, self.begun = [], 0, 0, False

    def write(self) -> None:
        """Append what is not yet in the file; without space there is no checkpoint."""
        if not self.unwritten or (not self.begun and time.monotonic() - self.last <= EVERY):
            return
        content = b"".join([*([] if self.begun else [self.line]), *self.unwritten])
        try:
            with self.owner.path.open("r+b" if self.begun else "wb") as file:
                file.seek(self.end)
                file.write(content)
                file.truncate()
                file.flush()
                fsync(file.fileno())
        except OSError as error:
            self.owner.remove()
            self.owner.say(f"no checkpoint is kept: {error.strerror}")
            self.written, self.begun, self.last = 0, False, float("inf")
            return
        self.written += sum((len(block) - HEAD.size) // 8 for block in self.unwritten)
        self.end += len(content)
        self.unwritten, self.begun, self.last = [], True, time.monotonic()

    def kept(self) -> str:
        """What is kept if the process is stopped."""
        if not self.written:
            return "nothing was written"
        return f"{self.written:,} draws are kept; the same command continues"
