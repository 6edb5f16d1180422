"""What changed between sessions of an arm, and its history: results that print themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import RenderableType

from bayescal import changes as outcome
from bayescal.changes import history as runs
from bayescal.compensating import read_targets
from bayescal.programs.text import Target
from bayescal.public import Result, table
from bayescal.public.arms import names
from bayescal.public.functions import MODEL, session_of
from bayescal.reporting.changed import changed_record, changed_summary, write_changed
from bayescal.reporting.history import history_record, history_summary, write_history
from bayescal.storage.reading import Json
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    from pandas import DataFrame

    from bayescal.public.functions import Source


@dataclass(frozen=True, repr=False)
class ChangedResult(Result):
    """What changed between sessions; `print` shows it. `record` is the content of changed.json."""

    data: outcome.Changed | None = None

    def _contents(self) -> Json:
        return changed_record(self._new())

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        return changed_summary(self.record)

    def save(self, folder: str | PathLike[str]) -> tuple[str, ...]:
        """Write changed.json, changed.html and changed.csv; return their names."""
        return write_changed(self.record, Path(folder))

    @property
    def verdict(self) -> str:
        """The verdict: same, changed or ambiguous."""
        return str(self.record["verdict"])

    @property
    def items(self) -> DataFrame:
        """What changed or may have: `before`, `after`, `difference`, `u`, `U` (k = 2), `probability`."""
        return table(
            self.record["items"], columns="item parameter site unit before after difference u U probability"
        )

    _overview = items

    @property
    def detectable(self) -> DataFrame:
        """The smallest change of each parameter that would have been found: `value` and `tcp_um`."""
        return table(self.record["detectable"], columns="item parameter site unit value tcp_um")

    def __repr__(self) -> str:
        return f"<changes between {', '.join(self.record['sessions'])}: {self.verdict}>"


def changed(
    datasets: Sequence[Source], model: Sequence[str] | str = MODEL, *, at: str | PathLike[str] | None = None,
    remounted: bool = False, robust: bool = True, allow_xacro: bool = False, progress: Progress = silent,
) -> ChangedResult:  # fmt: skip
    """What changed between sessions of one arm, by how much, and what would have been seen.

    Parameters
    ----------
    datasets : sequence of Dataset, SimulatedSession or path
        Two or more sessions in the order of time. Targets of the same name and description are compared.
    model : sequence of str, or str
        Effects that all sessions have; see `fit`.
    at : path, optional
        A table of targets, as `compensate` reads it: the displacement of the TCP there, by its column `id`.
    remounted : bool
        The tools were remounted between the sessions: each has its own.
    robust : bool
        Exclude outliers.
    allow_xacro : bool
        As of `read_dataset`.
    progress : callable
        Called with the stage and its completed fraction.

    Raises
    ------
    BayescalError
        If the sessions are not of one arm, or a joint fit is not possible.

    Examples
    --------
    >>> import bayescal as bc
    >>> options = {"effects": "geometry", "contacts": 60, "later": 4, "spheres": 0, "arm_seed": 1}
    >>> sessions = [bc.simulate(name=name, seed=seed, **options) for seed, name in enumerate("AB")]
    >>> bc.changed(sessions, "geometry").record["arm"]  # the cube stands elsewhere
    'same'
    """
    read = [session_of(d, allow_xacro=allow_xacro) for d in datasets]
    targets: Sequence[Target] = ()
    unused: Sequence[str] = ()
    if at is not None and read:
        given = read_targets(Path(at), read[-1].robot)
        targets, unused = given.targets, given.kept
    result = outcome.changed(
        read, names(model), remounted=remounted, robust=robust, targets=targets, progress=progress
    )
    if unused:
        said = f"{at}: `{'`, `'.join(unused)}` states nothing of a target and was not used"
        result = replace(result, warnings=(*result.warnings, said))
    return ChangedResult(result)


@dataclass(frozen=True, repr=False)
class HistoryResult(Result):
    """The history of an arm; `print` shows the conclusion. `record` is the content of history.json."""

    data: runs.History | None = None

    def _contents(self) -> Json:
        return history_record(self._new())

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        return history_summary(self.record)

    def save(self, folder: str | PathLike[str]) -> tuple[str, ...]:
        """Write history.json, history.html and history.csv; return their names."""
        return write_history(self.record, Path(folder))

    @property
    def parameters(self) -> DataFrame:
        """All parameters: `change` (trend or step), `size`, `u`, `U` (k = 2) and its probability."""
        return table(self.record["parameters"], "name", "name effect site unit change size u U probability")

    _overview = parameters

    def __repr__(self) -> str:
        return f"<history of {self.record['robot']}: {self.record['words'][0]}>"


def history(
    folder: str | PathLike[str], *, order: Sequence[str] | str = (), limit_mm: float | None = None,
    progress: Progress = silent,
) -> HistoryResult:  # fmt: skip
    """The parameters of an arm over its sessions, their trends and steps, and when to calibrate again.

    Parameters
    ----------
    folder : path
        A folder with run folders of fit or gap of one arm.
    order : sequence of str, or str
        Names of the run folders in the order of time, comma separated if in one string. Default: by the
        dates that the datasets record, or by the names of the run folders where a date is missing.
    limit_mm : float, optional
        mm; RMS error of distances at which the arm is to be calibrated again.
    progress : callable
        Called with the stage and its completed fraction.

    Raises
    ------
    BayescalError
        For runs of different arms, or of fewer than two sessions.
    """
    limit = None if limit_mm is None else 1e-3 * limit_mm
    return HistoryResult(runs.history(Path(folder), names(order), limit, progress))
