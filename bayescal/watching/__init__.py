"""A session is watched: what every contact tells, a complete fit in the pauses, and the moment to stop.

Rows are read as they are written: a line counts when it ends. A line that breaks the format is stated once,
and read again when the file changes.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path

from bayescal.calibration import Fit, fit, usual_model
from bayescal.dataset import Dataset, read
from bayescal.dataset.target_kinds import KINDS
from bayescal.effects.gravity import masses
from bayescal.errors import BayescalError, attempted
from bayescal.estimate import Estimate
from bayescal.estimate.families import with_compliances
from bayescal.gap.advise import blind_spots, unseen
from bayescal.gap.linear.problem import problem
from bayescal.gap.linear.state import fit_state
from bayescal.gap.result import BlindSpot
from bayescal.gap.search.candidates import unscreened
from bayescal.model import USUAL, FitOptions
from bayescal.predict.forecast import DistanceErrors
from bayescal.storage.reading import content_of
from bayescal.watching import update
from bayescal.watching.update import Contact

END = b"\n"


@dataclass(frozen=True)
class Written:
    """What was read of a session: `dataset` with all rows so far, `content` of the lines that have them.

    `settings` is the content of dataset.yaml. `fault` is what is wrong with the lines behind, in words, or
    "". `again` tells that what had been read before was changed.
    """

    dataset: Dataset
    settings: bytes
    content: bytes = b""
    fault: str = ""
    again: bool = False


def begun(folder: Path) -> Written:
    """A session of which no row is read yet: its dataset.yaml.

    Raises
    ------
    BayescalError
        If dataset.yaml breaks the format.
    """
    dataset, document, _ = read.read_settings(folder / read.SETTINGS)
    return Written(dataset, document.content)


def followed(written: Written, folder: Path, ended: bool = False) -> Written:
    """The same with the rows that were written since; the argument itself if there are none.

    A fault is no error: the person who probes may correct the line. `ended`: nothing more is written, and
    the last line counts as it is.
    """
    try:
        settings = content_of(folder / read.SETTINGS)
        content = read.content_of_table(folder) if (folder / read.TABLE).exists() else b""
    except BayescalError as error:
        return replace(written, fault=str(error), again=False)
    if not ended:
        content = content[: content.rfind(END) + 1]
    if (settings, content) == (written.settings, written.content):
        return replace(written, fault="", again=False) if written.fault else written
    again = settings != written.settings or not content.startswith(written.content)
    before = written
    try:
        before = begun(folder) if again else written
        if content.partition(END)[2].strip():  # more than a header
            judge = placed_by_rows(before.dataset)
            dataset = read.read_dataset(folder, judge, rows=content)
        else:
            dataset = before.dataset
    except BayescalError as error:
        return replace(before, fault=str(error), again=again)
    return replace(before, dataset=dataset, content=content, fault="", again=again)


def placed_by_rows(dataset: Dataset) -> bool:
    """Whether all rows together say where targets are, as those of cameras: every row changes the model."""
    return any(KINDS[t.kind].prepared is not None for t in dataset.targets)


POLL, PAUSE = 0.1, 1.0
"""s: between two looks at the file, and without a new row before a complete fit."""
GROWTH = 1.05
"""Factor of the number of rows from one complete fit to the next while contacts are as expected."""
RECENT, SEVERAL = 5, 3
"""Of the last contacts that many, odd: something has shifted."""


@dataclass(frozen=True)
class WatchOptions:
    """What a session is watched for.

    Attributes
    ----------
    effects : tuple of str
        The model: names of `effects.MODELS`; none: the usual ones that the session allows.
    fit : FitOptions
    enough : float
        Expanded uncertainty of a distance, m, at which the session has enough contacts.
    planned : int
        Number of rows of the plan; 0 if there is none.
    idle : float
        s without a new row, after which watching ends.
    """

    effects: tuple[str, ...] = ()
    fit: FitOptions = USUAL
    enough: float = 0.0
    planned: int = 0
    idle: float = inf


@dataclass(frozen=True)
class Complete:
    """A complete fit of the rows so far, and what they would show.

    `moved` is how far the estimate that was continued contact by contact was from it: the largest difference
    of a parameter of the arm in standard uncertainties; nan without one.
    """

    fit: Fit
    spots: tuple[BlindSpot, ...]
    moved: float
    seconds: float

    @property
    def hidden(self) -> tuple[BlindSpot, ...]:
        """Effects that the contacts would not show at their plausible size, most harmful first."""
        return unseen(self.spots)

    @property
    def rows(self) -> int:
        """Number of rows of the session."""
        return len(self.fit.dataset.measurements.ids)

    @property
    def distance(self) -> DistanceErrors:
        """A distance in the probed workspace."""
        return self.fit.forecast.workspace

    @property
    def U(self) -> float:
        """Its expanded uncertainty, m."""
        return self.distance.expanded


@dataclass(frozen=True)
class Notice:
    """A text for the person who probes; `kind` is one of those below."""

    kind: str
    text: str


FAULT, WAITING, SHIFTED = "fault", "waiting", "shifted"
ENOUGH, PLANNED, QUIET = "enough", "planned", "quiet"
"""Kinds of notices."""
Event = Contact | Complete | Notice


class Watch:
    """The state of a session that is watched.

    Parameters
    ----------
    folder : Path
        Of the dataset; its measurements.csv may not exist yet.
    options : WatchOptions
    """

    def __init__(self, folder: Path, options: WatchOptions = WatchOptions()) -> None:
        self.folder, self.options, self.effects = folder, options, options.effects
        self.written = begun(folder)
        self.contacts: list[Contact] = []
        self.odd: set[int] = set()
        self.estimate: Estimate | None = None
        self.last: Complete | None = None
        self._last_text: Mapping[str, str] = {}
        self._u_then = nan

    @property
    def pending(self) -> int:
        """Rows since the last complete fit."""
        return len(self.contacts) - (0 if self.last is None else self.last.rows)

    def look(self, ended: bool = False) -> Iterator[Event]:
        """Take the rows that were written since the last look; `ended`: nothing more is written."""
        self.written = followed(self.written, self.folder, ended)
        yield from self._tell(FAULT, self.written.fault)
        if self.written.again:
            self.contacts, self.odd, self.estimate, self.last = [], set(), None, None
        count, dataset = len(self.contacts), self.written.dataset
        m = dataset.measurements
        new = [
            Contact(k, m.ids[k], dataset.targets[m.target[k]].name, str(m.role[k]))
            for k in range(count, len(m.ids))
        ]
        self.contacts += new
        if not new or self.estimate is None or placed_by_rows(dataset):
            yield from new
            return
        self.estimate = update.followed(self.estimate, dataset, self.effects, self._options, self.odd)
        yield from self._judged(new)
        yield from self._shift()

    def _judged(self, new: Sequence[Contact]) -> list[Contact]:
        """New contacts, judged by all others; odd ones are set aside, the most improbable first."""
        assert self.estimate is not None
        assert self.last is not None
        wider, remaining = max(self.last.distance.u / self._u_then, 1.0), list(new)
        while remaining:
            judged = []
            for c in remaining:
                residual, u, p = update.judged(self.estimate, c.row, wider)
                judged.append(replace(c, residual=residual, u=u, p_value=p))
            worst = min(judged, key=lambda c: c.p_value if c.odd else 1.0)
            remaining = [c for c in remaining if worst.odd and c.row != worst.row]
            for c in [worst] if worst.odd else judged:
                self.contacts[c.row] = c
            if worst.odd:
                self.odd.add(worst.row)
                model, z = self.estimate.model, self.estimate.z
                self.estimate = update.refined(model, z, self.odd, self.estimate)
        U = self.last.distance.k * wider * update.distance_u(self.estimate)
        for c in new:
            self.contacts[c.row] = replace(self.contacts[c.row], U=U)
        return [self.contacts[c.row] for c in new]

    def _shift(self) -> Iterator[Notice]:
        """Whether several of the last contacts are odd, and what they have in common."""
        some = [c for c in self.contacts[-RECENT:] if c.odd]
        if len(some) < SEVERAL:
            self._last_text = {**self._last_text, SHIFTED: ""}
            return
        names = sorted({c.target for c in some})
        where = f"all on {names[0]}: it" if len(names) == 1 else "on several targets: tool, base or a joint"
        first = next(c.id for c in some)
        if not self._last_text.get(SHIFTED):
            text = f"{len(some)} of the last {RECENT} contacts are odd, from {first}, {where} may"
            yield from self._tell(SHIFTED, f"{text} have shifted")

    def _tell(self, kind: str, text: str) -> Iterator[Notice]:
        """A notice, unless it was the last of its kind."""
        if text and self._last_text.get(kind) != text:
            yield Notice(kind, text)
        self._last_text = {**self._last_text, kind: text}

    @property
    def _options(self) -> FitOptions:
        assert self.last is not None
        return replace(self.last.fit.options, tolerance=None)

    def complete(self) -> Iterator[Event]:
        """Fit all rows so far completely, as `bayescal fit` does, if they are enough."""
        begin = time.perf_counter()
        try:
            dataset = read.read_dataset(self.folder, rows=self.written.content)
            self.effects = self.options.effects or usual_model(dataset)
            calibration = fit(dataset, self.effects, self.options.fit, samples=0)
        except BayescalError as error:
            yield from self._tell(WAITING, str(error))
            return
        self.written = replace(self.written, dataset=dataset)
        level = calibration.final.estimate
        moved = nan if self.estimate is None else _apart(self.estimate, level)
        spots = attempted("what the contacts would show", lambda: _spots(calibration), (), [])
        self.odd = set(level.rejected.tolist())
        self.last = Complete(calibration, spots, moved, time.perf_counter() - begin)
        self.estimate = update.begun(level, self.effects, self._options)
        self._u_then = update.distance_u(self.estimate)
        yield self.last
        if (enough := self.options.enough) >= self.last.U:
            text = f"U of a distance is {1e6 * self.last.U:.3g} µm, the aim {1e6 * enough:.3g} µm"
            yield Notice(ENOUGH, text)

    def due(self, quiet: float) -> bool:
        """Whether a complete fit is due, `quiet` seconds after the last row."""
        if not self.pending or quiet < PAUSE:
            return False
        grown = self.last is None or len(self.contacts) >= GROWTH * self.last.rows
        near = bool(self.contacts) and self.options.enough >= self.contacts[-1].U
        return grown or near or quiet > 10 * PAUSE or self.contacts[-1].odd


def watched(
    watch: Watch, wait: Callable[[float], None] = time.sleep, clock: Callable[[], float] = time.monotonic
) -> Iterator[Event]:
    """Events of a session until it has enough contacts, or none came for the given time.

    The last event is a complete fit of all rows, or a notice of why there is none.
    """
    last = clock()
    while True:
        events = list(watch.look())
        if any(isinstance(e, Contact) for e in events):
            last = clock()
        yield from events
        quiet = clock() - last
        if watch.due(quiet):
            events = list(watch.complete())
            yield from events
            if any(isinstance(e, Notice) and e.kind == ENOUGH for e in events):
                return
        if watch.options.planned and len(watch.contacts) >= watch.options.planned and not watch.pending:
            yield Notice(PLANNED, f"all {watch.options.planned} contacts of the plan are measured")
            return
        if quiet > watch.options.idle:
            yield from watch.look(ended=True)
            if watch.pending:
                yield from watch.complete()
            yield Notice(QUIET, f"no new row for {quiet:.0f} s")
            return
        wait(POLL)


def _apart(estimate: Estimate, complete: Estimate) -> float:
    """Largest difference of a parameter of the arm, in the standard uncertainties of the second."""
    first = dict(zip(estimate.model.names, estimate.z.tolist(), strict=True))
    z = complete.z - [first.get(name, 0.0) for name in complete.model.names]
    return float(max(abs(z / complete.sd)[: len(complete.model.parameters)], default=nan))


def _spots(calibration: Fit) -> tuple[BlindSpot, ...]:
    """What the contacts of a fit would show of every effect that it lacks."""
    fitted, effects = calibration.final.estimate, calibration.final.effects
    scene = fitted.model.scene
    c = with_compliances(scene.circumstances(scene.rows("calibrate")), fitted)
    candidates = unscreened(c, effects, calibration.options.without)
    p = problem(fitted, candidates.pool, tuple(masses(c)) if scene.moments is not None else ())
    return blind_spots(fitted, candidates, fit_state(p, (), ()))
