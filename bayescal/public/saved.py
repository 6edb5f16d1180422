"""Results read from run folders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.public.positions import Positioned
from bayescal.public.tables import FitTables, GapTables, PlanTables, fit_line, gap_line, plan_line
from bayescal.storage.reading import Json, read_record

if TYPE_CHECKING:
    from pandas import DataFrame

SCHEMAS = {"fit.json": "bayescal-fit/1", "gap.json": "bayescal-gap/1", "plan.json": "bayescal-plan/1"}


@dataclass(frozen=True, repr=False)
class SavedFit(FitTables, Positioned):
    """A calibration read from a run folder: the same tables as those of a `FitResult`."""

    folder: Path
    content: Json

    @property
    def record(self) -> Json:
        """The content of fit.json."""
        return self.content

    def inference_data(self) -> Any:
        """The content of posterior.nc, read by ArviZ: InferenceData (0.x) or DataTree (1.x)."""
        from bayescal.posterior.inference import load as read

        path = self.folder / "posterior.nc"
        if not path.is_file():
            raise BayescalError("there is no such file", str(path), "repeat the fit")
        return read(path)

    def __str__(self) -> str:
        warnings = "".join(f"\nwarning: {warning}" for warning in self.warnings)
        return f"{self!r}\n{self.parameters.to_string(float_format='%.6g')}{warnings}"

    def __repr__(self) -> str:
        return fit_line(self.record)


@dataclass(frozen=True, repr=False)
class SavedGap(GapTables, Positioned):
    """A diagnosis read from a run folder: the same tables as those of a `GapResult`."""

    folder: Path
    content: Json

    @property
    def record(self) -> Json:
        """The content of gap.json."""
        return self.content

    def __str__(self) -> str:
        warnings = "".join(f"\nwarning: {warning}" for warning in self.warnings)
        return f"{self!r}\n{self.probability.to_string(float_format='%.3g')}{warnings}"

    def __repr__(self) -> str:
        return gap_line(self.record)


@dataclass(frozen=True, repr=False)
class SavedPlan(PlanTables):
    """A plan read from a run folder: the same tables as those of a `PlanResult`."""

    folder: Path
    content: Json

    @property
    def record(self) -> Json:
        """The content of plan.json."""
        return self.content

    @property
    def contacts(self) -> DataFrame:
        """The content of plan.csv, by id, and `purpose`."""
        path = self.folder / "plan.csv"
        if not path.is_file():
            raise BayescalError("there is no such file", str(path), "repeat the command")
        return self.contacts_of(path)

    def __str__(self) -> str:
        warnings = "".join(f"\nwarning: {warning}" for warning in self.warnings)
        return f"{self!r}\n{self.distances.to_string(float_format='%.3g')}{warnings}"

    def __repr__(self) -> str:
        return plan_line(self.record)


Saved = SavedFit | SavedGap | SavedPlan
READ: dict[str, Callable[[Path, Json], Saved]] = {
    "fit.json": SavedFit,
    "gap.json": SavedGap,
    "plan.json": SavedPlan,
}
"""Results by the file that identifies them."""


def load(run: str | PathLike[str]) -> Saved:
    """Read a run folder of `fit`, `diagnose` or `plan` back.

    Parameters
    ----------
    run : path
        Folder with fit.json (and posterior.nc), gap.json or plan.json.

    Returns
    -------
    SavedFit, SavedGap or SavedPlan
        With the tables of the result that was saved.

    Raises
    ------
    BayescalError
        If the folder contains no such result, or a result of another version.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.fit(session, samples=0).save(f"{folder}/run")
    ...     saved = bc.load(f"{folder}/run")
    >>> float(saved.parameters.loc["a2", "nominal"])
    300.0
    """
    folder = Path(run)
    there = [name for name in SCHEMAS if (folder / name).is_file()]
    if not there:
        remedy = "give a run folder of bayescal fit, gap or plan"
        raise BayescalError(f"there is no {' or '.join(SCHEMAS)}", str(folder), remedy)
    path = folder / there[0]
    content = read_record(path, SCHEMAS[path.name], "repeat the command with this version")
    return READ[path.name](folder, content)
