"""A session that is watched while it is measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bayescal.errors import BayescalError
from bayescal.public import FitResult, Result, table
from bayescal.public.arms import names
from bayescal.storage.reading import Json, read_record

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType
    from rich.text import Text

    from bayescal.calibration import Fit
    from bayescal.watching import Event, WatchOptions
    from bayescal.watching.update import Contact

PLAN = "plan.json"


@dataclass(frozen=True, repr=False)
class WatchResult(Result):
    """A session that was watched; `record` is the content of watch.json, `fit` the last complete fit.

    Attributes
    ----------
    data : Fit
        The last complete fit, of all rows.
    events : tuple
        Contacts, complete fits and notices, in order.
    contacts : tuple
        All rows, each with what the rows before it say of it.
    options : WatchOptions
    """

    data: Fit | None = None
    events: tuple[Event, ...] = ()
    contacts: tuple[Contact, ...] = ()
    options: WatchOptions | None = None
    _FORMAT: ClassVar[str] = "%.4g"

    def _contents(self) -> Json:
        from bayescal.reporting.watch import watch_record

        assert self.options is not None
        return watch_record(self.events, self.contacts, self.options)

    @property
    def fit(self) -> FitResult:
        """The last complete fit."""
        return FitResult(self._new())

    def report(self) -> RenderableType:
        """What was watched, and the summary of the last complete fit."""
        from rich.console import Group

        from bayescal.reporting.watch import outcome

        return Group(self.fit.report(), "", outcome(self.record))

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write the run folder of the last complete fit, watch.json, watch.csv and, if wanted, figures.

        Returns the names of what was written.
        """
        from bayescal.reporting.watch import write_watch

        return write_watch(self.events, self.contacts, self.record, Path(folder), pictures)

    @property
    def _overview(self) -> DataFrame:
        return table(self.record["contacts"], "id")


def words(event: Event) -> Text:
    """What a person who probes reads of an event: a line for a terminal."""
    from bayescal.reporting.watch import line

    return line(event)


def watch(
    dataset: str | PathLike[str], model: Sequence[str] | str = (), *, enough_um: float | None = None,
    plan: str | PathLike[str] | None = None, idle_s: float = 600.0, seed: int = 0, robust: bool = True,
    prior_width: float = 1.0, say: Callable[[Event], None] = lambda event: None,
) -> WatchResult:  # fmt: skip
    """Watch a session while it is measured: its measurements.csv grows.

    Returns when the session has enough contacts, when all of a plan are measured, or when no row came for
    some time; then with a complete fit of all rows, the same as that of `fit` with samples=0.

    Parameters
    ----------
    dataset : path
        Folder of the session, with dataset.yaml; measurements.csv may not exist yet.
    model, seed, robust, prior_width
        As of `fit`.
    enough_um : float, optional
        µm; end when the expanded uncertainty of a distance in the probed workspace is not larger.
    plan : path, optional
        Run folder of `plan`: end when its contacts are measured, or when its U is reached.
    idle_s : float
        s without a new row, after which to end.
    say : callable
        Called with each event: a `Contact`, a `Complete` fit or a `Notice`.

    Raises
    ------
    BayescalError
        If dataset.yaml cannot be read, or the rows at the end cannot be fitted.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.simulate(contacts=60, later=8, repeats=5, spheres=0).save(f"{folder}/session")
    ...     result = bc.watch(f"{folder}/session", idle_s=0.0)
    >>> len(result.contacts), len(result.record["fits"])
    (68, 1)
    """
    from bayescal.dataset import read_dataset
    from bayescal.model.options import FitOptions
    from bayescal.watching import Complete, Watch, WatchOptions, watched

    if enough_um is not None and not enough_um > 0:
        raise BayescalError(f"an uncertainty of {enough_um} µm", "--enough-um", "give a number above 0")
    if idle_s < 0:
        raise BayescalError(f"{idle_s} s without a row", "--idle-s", "give 0 or more")
    aim, planned = _planned(plan)
    aim = aim if enough_um is None else 1e-6 * enough_um
    options = WatchOptions(
        names(model), FitOptions(robust=robust, prior_width=prior_width, seed=seed), aim, planned, idle_s
    )
    state, events = Watch(Path(dataset), options), []
    for event in watched(state):
        events.append(event)
        say(event)
    fits = [e.fit for e in events if isinstance(e, Complete)]
    if not fits or state.pending or state.written.fault:
        from bayescal.calibration import fit  # it says what is wrong

        fit(read_dataset(Path(dataset)), state.effects, options.fit, samples=0)
        raise BayescalError("the session changed when watching ended", str(dataset), "repeat the command")
    return WatchResult(fits[-1], events=tuple(events), contacts=tuple(state.contacts), options=options)


def _planned(plan: str | PathLike[str] | None) -> tuple[float, int]:
    """Expanded uncertainty of a distance, m, and number of rows of a plan; zeros without one."""
    if plan is None:
        return 0.0, 0
    path = Path(plan)
    path = path / PLAN if path.is_dir() else path
    if not path.is_file():
        raise BayescalError("no such file", str(path), "give the run folder of bayescal plan")
    record: Any = read_record(path, "bayescal-plan/1", "repeat bayescal plan with this version")
    from bayescal.planning.goals import REGION, VOLUME

    try:
        aims = [d["distance_sd_um"] for d in record["expected"]["distances"] if d["over"] in (VOLUME, REGION)]
        return 2e-6 * aims[0] if aims else 0.0, int(record["rows"]) + int(record["measured"])
    except (KeyError, TypeError, ValueError):
        what = "incomplete: no `expected`, `rows` or `measured`"
        raise BayescalError(what, str(path), "repeat bayescal plan with this version") from None
