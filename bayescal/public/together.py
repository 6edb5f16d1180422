"""The result of a session of contacts and a joint log that were fitted together."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.public.motions import MotionFitResult
from bayescal.public.results import FitResult, Result, table
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.motion.together import Together


@dataclass(frozen=True, repr=False)
class TogetherResult(Result):
    """A session of contacts and a joint log, fitted together; `print` shows what each gains by the other.

    `record` is the content of fit.json.
    """

    data: Together | None = None

    def _contents(self) -> Json:
        from bayescal.reporting.motion.together import together_record

        return together_record(self._new())

    def report(self, verbose: bool = False) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`; `verbose` adds all masses and centres."""
        from bayescal.reporting.motion.together import together_summary

        return together_summary(self.record, verbose)

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write fit.json, and the run folders `contacts` and `log`; return their names."""
        from bayescal.reporting.motion.together import write_together

        return write_together(self._new(), Path(folder), self.record, pictures)

    @property
    def contacts(self) -> FitResult:
        """The calibration by the contacts, with the masses of both."""
        return FitResult(self.data.contacts) if self.data else FitResult(**self._part("contacts"))

    @property
    def log(self) -> MotionFitResult:
        """The calibration by the joint log, with the masses of both."""
        return MotionFitResult(self.data.log) if self.data else MotionFitResult(**self._part("log"))

    def _part(self, name: str) -> dict[str, Any]:
        from bayescal.storage.reading import read_record

        path = self._file(f"{name}/fit.json", "repeat the fit")
        return {"folder": path.parent, "content": read_record(path, "bayescal-fit/1", "repeat the fit")}

    @property
    def shared(self) -> DataFrame:
        """Parameters, by name: estimate and u, SI, by one measurement alone and by both."""
        entries = (
            {"name": p["name"], "unit": p["unit"], "source": p["source"]}
            | {f"{key}_{of}": p[of][key] for of in ("alone", "both") for key in ("estimate", "u")}
            for p in self.record["shared"]
        )
        return table(entries, "name")

    @property
    def _overview(self) -> DataFrame:
        return self.shared

    def __repr__(self) -> str:
        return f"<{self.record['session']} and the log {self.record['log']['name']}, fitted together>"
