"""Checkpoint of a long sampling: an interrupted run continues with the draws of an uninterrupted one.

A sampler advances its ensembles in stretches of steps, in an order that follows from its inputs and the draws
so far. A checkpoint records the steps of every stretch, with the state after them (random generator, counts
of the moves), and the tests of convergence. A resumed sampler takes over what is recorded, and computes from
the first step that is missing.

The first line of the file contains a checksum of the starting points and of the density there, which are
computed again: a record of other data, another model, seed, version or machine is not used.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from bayescal import __version__
from bayescal.storage.locks import CHECKPOINT, block, first_line, read, remove, write
from bayescal.storage.stopping import completed, keeping

if TYPE_CHECKING:
    from bayescal.posterior.ensemble import Ensemble

SCHEMA = f"{CHECKPOINT}/2"
EVERY = 4.0
"""Seconds of sampling between two writes; a shorter run writes none."""
NEVER = float("inf")
LIBRARIES = ("numpy", "scipy", "emcee")
"""Draws follow from the inputs and from the versions of these."""
Kept = dict[str, np.ndarray]
"""Steps of an ensemble and the state after them (`Ensemble.kept`), or results; with their number."""


@dataclass(frozen=True)
class Checkpoint:
    """Where the state of an interrupted sampling is kept.

    Attributes
    ----------
    path : Path
        The file; it is removed by `remove` when the results are saved.
    say : callable
        Called with a text, if an earlier run is continued, or nothing can be kept.
    """

    path: Path
    say: Callable[[str], None] = lambda text: None

    @contextmanager
    def of(self, ensembles: Sequence[Ensemble], **inputs: Any) -> Iterator[Record]:
        """Yield a record that advances ensembles, or takes over what an earlier run has recorded.

        Parameters
        ----------
        ensembles : sequence of Ensemble
            Those with which the sampling begins, before their first step.
        **inputs
            What else determines the draws, for example the seed.
        """
        starts = sha256()
        for ensemble in ensembles:
            starts.update(np.ascontiguousarray(ensemble.state.coords).tobytes())
            starts.update(np.ascontiguousarray(ensemble.state.log_prob).tobytes())
        libraries = {name: version(name) for name in LIBRARIES}
        line = first_line(SCHEMA, bayescal=__version__, starts=starts.hexdigest(), **libraries, **inputs)
        record = Record(self, line)
        record.find()
        with keeping(record.kept):
            yield record
        record.write()
        if record.draws:
            completed(record.kept())  # until the results are

    def remove(self) -> None:
        """Remove the file."""
        remove(self.path, CHECKPOINT)


@dataclass
class Record:
    """Stretches of steps, recorded as they are taken; those of an earlier run are not taken again."""

    owner: Checkpoint
    line: bytes
    recorded: list[tuple[Kept, int]] = field(default_factory=list)  # and the place after them in the file
    number: int = -1  # of the present stretch or result
    steps: int = 0
    first: int = 0  # step of the ensemble that is not in the file
    ensemble: Ensemble | None = None
    unwritten: list[Kept] = field(default_factory=list)
    draws: int = 0  # in the file
    end: int = 0  # of what is valid in the file
    last: float = field(default_factory=time.monotonic)

    def find(self) -> None:
        """Read what an interrupted run has left."""
        try:
            blocks, self.end = read(self.owner.path, self.line)
        except OSError as error:
            self._give_up(error)
            return
        if blocks is None:
            self.owner.say(
                "the checkpoint of an interrupted run is of other inputs or another version: it starts afresh"
            )
        for content, place in blocks or ():
            if (kept := _unpacked(content)) is None:
                break
            self.recorded.append((kept, place))
        if self.recorded:
            self.draws = sum(_draws(kept) for kept, _ in self.recorded)
            self.owner.say(f"sampling continues after {self.draws:,} draws of an interrupted run")

    def advance(self, ensemble: Ensemble, steps: int) -> Iterator[None]:
        """Advance an ensemble by a number of steps; control returns after each that is computed."""
        self.number, self.steps, self.ensemble = self.number + 1, steps, ensemble
        begin = len(ensemble)
        while kept := self._next(steps):
            ensemble.restore(kept)
        self.first = len(ensemble)
        if self.first == begin + steps:
            return
        self._drop()
        for _ in ensemble.run(begin + steps - self.first):
            if time.monotonic() - self.last > EVERY:
                self.write()
            yield
        self._collect()
        self.ensemble = None

    def once(self, compute: Callable[[], Kept]) -> Kept:
        """The results of a computation; those of an earlier run are not computed again."""
        self.number += 1
        if kept := self._next():
            return kept
        self._drop()
        found = compute()
        if self.last != NEVER:
            self.unwritten.append(found | _place(self.number))
        return found

    def _next(self, steps: int = 0) -> Kept | None:
        """Take what is recorded next, if it is of the present number; `steps`: of its stretch."""
        if not self.recorded:
            return None
        kept, place = self.recorded[0]
        if int(kept["number"]) != self.number or int(kept["steps"]) != steps:
            return None
        self.end = place
        del self.recorded[0]
        return kept

    def _drop(self) -> None:
        """Drop what is recorded but does not follow."""
        self.draws -= sum(_draws(kept) for kept, _ in self.recorded)
        self.recorded.clear()

    def _collect(self) -> None:
        """Add the steps of the present stretch that are not in the file to those that will be written."""
        if self.ensemble is None or len(self.ensemble) == self.first or self.last == NEVER:
            return
        kept = self.ensemble.kept(self.first)
        self.first = len(self.ensemble)
        self.unwritten.append(kept | _place(self.number, self.steps))

    def write(self) -> None:
        """Append what is not yet in the file; without space there is no checkpoint."""
        if not self.end and time.monotonic() - self.last <= EVERY:
            return
        self._collect()
        if not self.unwritten:
            return
        content = b"".join([b"" if self.end else self.line, *(block(_packed(own)) for own in self.unwritten)])
        try:
            write(self.owner.path, self.line, content, self.end)
        except OSError as error:
            self.owner.remove()
            self._give_up(error)
            return
        self.draws += sum(map(_draws, self.unwritten))
        self.end += len(content)
        self.unwritten, self.last = [], time.monotonic()

    def _give_up(self, error: OSError) -> None:
        self.owner.say(f"no checkpoint is kept: {error.strerror}")
        self.unwritten, self.draws, self.end, self.last = [], 0, 0, NEVER

    def kept(self) -> str:
        """What is kept if the process is stopped."""
        if not self.draws:
            return "nothing was written"
        return f"{self.draws:,} draws are kept; the same command continues"


def _place(number: int, steps: int = 0) -> Kept:
    """Entries that say of which stretch or result a block is."""
    return {"number": np.array(number), "steps": np.array(steps)}


def _draws(kept: Kept) -> int:
    return kept["log_density"].size if "log_density" in kept else 0


def _packed(kept: Kept) -> bytes:
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **kept)
    return content.getvalue()


def _unpacked(content: bytes) -> Kept | None:
    """The arrays of a block; None if it is not one of ours."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            found = dict(arrays)
    except (OSError, ValueError, EOFError, BadZipFile):
        return None
    place = [found.get(name, np.empty(0)) for name in _place(0)]
    return found if all(own.shape == () and own.dtype.kind == "i" for own in place) else None
