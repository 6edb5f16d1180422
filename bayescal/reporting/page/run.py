"""What a page is made of: the records of a run folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError
from bayescal.folders import check_unchanged
from bayescal.reading import read_record

Json = Mapping[str, Any]
SCHEMAS = {"fit.json": "bayescal-fit/1", "gap.json": "bayescal-gap/1"}
"""Record that identifies a run -> its schema."""
BUDGET, BUDGET_SCHEMA = "budget.json", "bayescal-budget/1"
FIGURES = {
    "fit-distances.png": "Errors of validation data, nominal and calibrated, with 95 % prediction intervals",
    "fit-posterior.png": "Posterior and prior of the least known parameters; draws of correlated pairs",
}
"""Figures of a run folder that show what its page does not draw itself, and their text alternatives."""


@dataclass(frozen=True)
class Run:
    """The records of a run folder.

    Parameters
    ----------
    kind : str
        "fit" or "gap".
    record : mapping
        The content of fit.json or gap.json.
    folder : str
        The name of the run folder, for commands.
    budget : mapping or None
        The content of budget.json.
    figures : mapping
        Content of PNG files, by file name; those of `FIGURES`.
    """

    kind: str
    record: Json
    folder: str
    budget: Json | None = None
    figures: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name of the dataset."""
        return str(self.record["dataset"]["name"])

    @property
    def refitted(self) -> bool:
        """Whether named effects were added to the model of a diagnosis."""
        return self.kind == "gap" and bool(self.record["named"])

    @property
    def rows(self) -> Json:
        """Rows with the residuals that the page shows: those that a diagnosis explains, before its refit."""
        rows: dict[str, Any] = dict(self.record["rows"])
        rows["residual_after_um"] = rows["residual_um"]
        rows["residual_um"] = rows.pop("residual_before_um", rows["residual_um"])
        rows["rejected"] = rows.pop("rejected_before", rows["rejected"])
        return rows

    @property
    def robot(self) -> str:
        """The name of the robot; "" in records without it."""
        return str(self.record.get("arm", {}).get("robot", ""))


def read_run(folder: Path, name: str = "") -> Run:
    """Read a run folder of `fit` or `gap`; `name` is the folder in commands, by default as given.

    Raises
    ------
    BayescalError
        If the folder has no such record, one of another version, or one that was changed after the run.
    """
    there = [record for record in SCHEMAS if (folder / record).is_file()]
    if not there:
        what = f"there is no {' or '.join(SCHEMAS)}"
        raise BayescalError(what, str(folder), "give a run folder of bayescal fit or gap")
    budget = _record(folder / BUDGET, BUDGET_SCHEMA) if (folder / BUDGET).is_file() else None
    figures = {file: content for file in FIGURES if (content := _png(folder / file))}
    record = _record(folder / there[0], SCHEMAS[there[0]])
    check_unchanged(folder, (there[0], *([BUDGET] if budget else [])))
    return Run(there[0].removesuffix(".json"), record, name or str(folder), budget, figures)


def _png(path: Path) -> bytes:
    """Content of a figure; b"" for what is none: a link could bring any file of the user into the page."""
    if path.is_symlink() or not path.is_file():
        return b""
    content = path.read_bytes()
    return content if content.startswith(b"\x89PNG") else b""


def _record(path: Path, schema: str) -> Json:
    return read_record(path, schema, "repeat the command with this version")
