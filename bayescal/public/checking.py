"""The check of a dataset before a fit, of the public API."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from bayescal.public.results import as_text
from bayescal.public.tables import Json

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.checking.check import Check


@dataclass(frozen=True, repr=False)
class CheckResult:
    """What is understood of a dataset, what is missing and what looks wrong; `print` shows it.

    Attributes
    ----------
    data : Check
        The complete result, in SI.
    """

    data: Check

    @cached_property
    def record(self) -> Json:
        """The content of `bayescal check --to json`."""
        from bayescal.checking.check import check_record

        return check_record(self.data)

    @cached_property
    def findings(self) -> DataFrame:
        """A row per finding: code, kind, what, where, remedy."""
        from pandas import DataFrame

        columns = ["code", "kind", "what", "where", "remedy"]
        return DataFrame([vars(f) for f in self.data.findings], columns=columns)

    def report(self) -> RenderableType:
        """The report, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.check import check_summary

        return check_summary(self.data)

    def __str__(self) -> str:
        return as_text(self.report())

    def __repr__(self) -> str:
        from bayescal.reporting.check import said

        return f"<check of {self.data.dataset.name}: {said(self.data.findings)}>"


def check(folder: str | PathLike[str], *, allow_xacro: bool = False) -> CheckResult:
    """Check a dataset folder without fitting it: what is understood, missing, and probably a mistake.

    Parameters
    ----------
    folder : path
        As of `read_dataset`.
    allow_xacro : bool
        As of `read_dataset`.

    Returns
    -------
    CheckResult
        Prints as a summary; `findings` is a table.

    Raises
    ------
    BayescalError
        If the folder cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.simulate(contacts=120, later=4, repeats=2, spheres=0).save(f"{folder}/session")
    ...     bc.check(f"{folder}/session")
    <check of simulated: no findings>
    """
    from bayescal.checking.check import check as run

    return CheckResult(run(Path(folder), allow_xacro))
