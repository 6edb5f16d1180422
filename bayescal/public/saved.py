"""Results read from run folders."""

from __future__ import annotations

import json
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError
from bayescal.public.tables import FitTables, GapTables, Json, fit_line, gap_line

SCHEMAS = {"fit.json": "bayescal-fit/1", "gap.json": "bayescal-gap/1"}


@dataclass(frozen=True, repr=False)
class SavedFit(FitTables):
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
class SavedGap(GapTables):
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


def load(run: str | PathLike[str]) -> SavedFit | SavedGap:
    """Read a run folder of `fit` or `diagnose` back.

    Parameters
    ----------
    run : path
        Folder with fit.json (and posterior.nc) or gap.json.

    Returns
    -------
    SavedFit or SavedGap
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
        remedy = "give a run folder of bayescal fit or gap"
        raise BayescalError(f"there is no {' or '.join(SCHEMAS)}", str(folder), remedy)
    path = folder / there[0]
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BayescalError(f"cannot be read: {error}", str(path), "repeat the command") from None
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != SCHEMAS[path.name]:
        what = f"the schema is {schema}, not {SCHEMAS[path.name]}"
        raise BayescalError(what, str(path), "repeat the command with this version")
    return SavedFit(folder, content) if path.name == "fit.json" else SavedGap(folder, content)
