"""Ensembles of emcee, and the checkpoint of a long sampling of them.

An interrupted run continues with the draws of an uninterrupted one. A sampler advances its ensembles in an
order that follows from its inputs and the draws so far. A checkpoint holds the chain of every ensemble with
the state after its last step (emcee's HDF5 backend), and the tests of convergence. A resumed sampler takes
over what is recorded, and computes from the first step that is missing.

The first line of the file contains a checksum of the starting points and of the density there, which are
computed again: a record of other data, another model, seed, version or machine is not used.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np

from bayescal import __version__
from bayescal.posterior.linearised import Linearised
from bayescal.storage.locks import CHECKPOINT, first_line, read_own, remove, write_own
from bayescal.storage.stopping import completed, keeping

Values = Callable[[np.ndarray], np.ndarray]
"""Log density (W,) of points (W, D)."""


class _Counted:
    """A move that counts its accepted proposals."""

    proposed = 0
    accepted = 0

    def propose(self, model: Any, state: Any) -> Any:
        state, accepted = super().propose(model, state)  # type: ignore[misc]
        self.proposed += len(accepted)
        self.accepted += int(np.sum(accepted))
        return state, accepted

    @property
    def rate(self) -> float:
        return self.accepted / max(self.proposed, 1)


class Independence(_Counted, emcee.moves.MHMove):
    """Proposals drawn from the linearised posterior, independent of the current point."""

    def __init__(self, linearised: Linearised) -> None:
        def propose(x: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
            new = linearised.draw(len(x), rng)
            return new, linearised(x) - linearised(new)

        super().__init__(propose)


class Evolution(_Counted, emcee.moves.DEMove):
    """Differential evolution among the walkers."""


class Ensemble:
    """Walkers that take steps of two kinds.

    Parameters
    ----------
    values : callable
    moves : Independence, Evolution
    share : float
        Of the steps that are of the first kind.
    state : emcee.State
        Points (W, D) and the state of the random generator. Log densities are computed where it has none.
    """

    def __init__(
        self, values: Values, moves: tuple[Independence, Evolution], share: float, state: emcee.State
    ) -> None:
        weighed = list(zip(moves, (share, 1.0 - share), strict=True))
        walkers, size = state.coords.shape
        self._sampler = emcee.EnsembleSampler(walkers, size, values, moves=weighed, vectorize=True)
        self._sampler.log_prob_fn = values  # emcee's wrapper prints every exception, also that of a stop
        # the ensemble uses the generator of the sampler for its proposals: set its state too
        self._sampler._random.set_state(state.random_state)
        if state.log_prob is None:
            state.log_prob = self._sampler.compute_log_prob(state.coords)[0]
        self.moves, self.state = moves, state
        self.counts = self._counts()

    def _counts(self) -> list[tuple[int, int]]:
        """Proposals of each move after the last step, and those that were accepted."""
        return [(move.proposed, move.accepted) for move in self.moves]

    @property
    def walkers(self) -> int:
        """Number of walkers, W."""
        return len(self.state.coords)

    def __len__(self) -> int:
        """Steps taken."""
        return int(self._sampler.backend.iteration)

    def run(self, steps: int) -> Iterator[None]:
        """Take steps; control returns after each."""
        for state in self._sampler.sample(
            self.state, iterations=steps, skip_initial_state_check=len(self) > 0
        ):
            self.state, self.counts = state, self._counts()
            yield

    def chain(self, first: int = 0, thin: int = 1) -> np.ndarray:
        """Points (T, W, D) after each step."""
        return np.asarray(self._sampler.get_chain(discard=first, thin=thin))

    def log_density(self, first: int = 0, thin: int = 1) -> np.ndarray:
        """Log densities (T, W) of `chain`."""
        return np.asarray(self._sampler.get_log_prob(discard=first, thin=thin))

    def add_to(self, store: emcee.backends.Backend) -> None:
        """Add the steps that a store lacks, with the state of the random generator after the last."""
        if not store.initialized:
            store.reset(*self.state.coords.shape)
        first = store.iteration
        if first == len(self):
            return
        store.grow(len(self) - first, None)
        for x, lp in zip(self.chain(first), self.log_density(first), strict=True):
            state = emcee.State(x, log_prob=lp, random_state=self.state.random_state)
            store.save_step(state, np.zeros(len(x), dtype=bool))

    def take(self, store: emcee.backends.Backend, end: int, counts: Sequence[Sequence[int]]) -> None:
        """Take over the steps of a store before the step `end`; `counts` are those after its last."""
        first, end = len(self), min(end, store.iteration)
        if end <= first:
            return
        self._sampler.backend.grow(end - first, None)
        chain, log_density = store.get_chain(discard=first), store.get_log_prob(discard=first)
        random_state = store.random_state
        for x, lp in zip(chain[: end - first], log_density[: end - first], strict=True):
            self.state = emcee.State(x, log_prob=lp, random_state=random_state)
            self._sampler.backend.save_step(self.state, np.zeros(len(x), dtype=bool))
        for move, (proposed, accepted) in zip(self.moves, counts, strict=True):
            move.proposed, move.accepted = proposed, accepted
        self.counts = self._counts()


SCHEMA = f"{CHECKPOINT}/3"
EVERY = 4.0
"""Seconds of sampling between two writes; a shorter run writes none."""
SHARE = 0.1
"""Largest share of the time that is used to write: the whole file is replaced."""
LIBRARIES = ("numpy", "scipy", "emcee")
"""Draws follow from the inputs and from the versions of these."""
Results = dict[str, np.ndarray]


class _Chain(emcee.backends.HDFBackend):
    """A chain in a group of an open file."""

    def __init__(self, file: h5py.File, name: str) -> None:
        super().__init__("", name)
        self._file = file

    @property
    def initialized(self) -> bool:
        return self.name in self._file

    def open(self, mode: str = "r") -> AbstractContextManager[h5py.File]:
        return nullcontext(self._file)


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
        inputs |= {"bayescal": __version__, "starts": starts.hexdigest()} | libraries
        record = Record(self, inputs)
        record.read()
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
    """Chains and results, recorded as they are computed; those of an earlier run are not computed again."""

    owner: Checkpoint
    inputs: dict[str, Any]
    content: io.BytesIO = field(default_factory=io.BytesIO)  # of the HDF5 file
    ensembles: list[Ensemble] = field(default_factory=list)  # in the order of their first steps
    results: int = 0
    draws: int = 0  # in the file
    next: float = field(default_factory=lambda: time.monotonic() + EVERY)  # time of the next write

    def __post_init__(self) -> None:
        self.file = h5py.File(self.content, "w")

    def read(self) -> None:
        """Read what an interrupted run has left."""
        try:
            line, _, content = read_own(self.owner.path, CHECKPOINT).partition(b"\n")
        except OSError as error:
            self._give_up(error)
            return
        if line and line + b"\n" != self._line(content):
            self.owner.say(
                "the checkpoint of an interrupted run is of other inputs or another version: it starts afresh"
            )
        elif line:
            self.content = io.BytesIO(content)
            self.file = h5py.File(self.content, "r+")
            self.draws = sum(int(np.prod(group["log_prob"].shape)) for group in self._chains())
            self.owner.say(f"sampling continues after {self.draws:,} draws of an interrupted run")

    def _line(self, content: bytes) -> bytes:
        return first_line(SCHEMA, content=sha256(content).hexdigest(), **self.inputs)

    def _chains(self) -> list[h5py.Group]:
        return [group for group in self.file.values() if "log_prob" in group]

    def advance(self, ensemble: Ensemble, steps: int) -> Iterator[None]:
        """Advance an ensemble by a number of steps; control returns after each that is computed."""
        if ensemble not in self.ensembles:
            self.ensembles.append(ensemble)
        end = len(ensemble) + steps
        chain = self._chain(ensemble)
        if chain.initialized:
            ensemble.take(chain, end, json.loads(self.file[chain.name].attrs["counts"]))
        for _ in ensemble.run(end - len(ensemble)):
            if time.monotonic() > self.next:
                self.write()
            yield

    def _chain(self, ensemble: Ensemble) -> _Chain:
        return _Chain(self.file, f"ensemble {self.ensembles.index(ensemble)}")

    def once(self, compute: Callable[[], Results]) -> Results:
        """The results of a computation; those of an earlier run are not computed again."""
        name = f"results {self.results}"
        self.results += 1
        if name not in self.file:
            for key, values in compute().items():
                self.file[f"{name}/{key}"] = values
        return {key: values[()] for key, values in self.file[name].items()}

    def write(self) -> None:
        """Write what is recorded, if it is time; without space there is no checkpoint."""
        begin = time.monotonic()
        if begin <= self.next:
            return
        for ensemble in self.ensembles:
            chain = self._chain(ensemble)
            ensemble.add_to(chain)
            self.file[chain.name].attrs["counts"] = json.dumps(ensemble.counts)
        self.file.flush()
        content = self.content.getvalue()
        try:
            write_own(self.owner.path, self._line(content) + content, CHECKPOINT)
        except OSError as error:
            self.owner.remove()
            self._give_up(error)
            return
        self.draws = sum(len(e) * e.walkers for e in self.ensembles)
        end = time.monotonic()
        self.next = end + max(EVERY, (end - begin) / SHARE)

    def _give_up(self, error: OSError) -> None:
        self.owner.say(f"no checkpoint is kept: {error.strerror}")
        self.draws, self.next = 0, float("inf")

    def kept(self) -> str:
        """What is kept if the process is stopped."""
        if not self.draws:
            return "nothing was written"
        return f"{self.draws:,} draws are kept; the same command continues"
