"""The public API behind ``import bayescal``: functions in modules, and here results with their reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from html import escape
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bayescal.errors import BayescalError
from bayescal.public.positions import Positioned
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    import numpy as np
    from pandas import DataFrame
    from rich.console import Console, RenderableType

    from bayescal.assess.agreement import Agreement
    from bayescal.calibration import Fit
    from bayescal.dataset import Dataset
    from bayescal.gap.result import Gap
    from bayescal.methods import Comparison
    from bayescal.posterior.inference import Record
    from bayescal.simulation.record import Simulated

WIDTH = 100
"""Width of a printed summary, characters."""


def console(**options: Any) -> Console:
    """A terminal to which names of files are text: neither markup nor the code of an emoji."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False, **options)


def as_text(renderable: RenderableType) -> str:
    """Text as on a terminal of `WIDTH` columns, without colours."""
    out = StringIO()
    console(file=out, width=WIDTH, color_system=None).print(renderable)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


def drawing_beside(wanted: bool) -> AbstractContextManager[None]:
    """Within, a second process draws the figures of the first result that is saved."""
    from bayescal.reporting.figures import drawing_beside

    return drawing_beside(wanted)


class Printed:
    """A result whose report is printed."""

    def report(self) -> RenderableType:
        """The report, to be printed by a `rich.console.Console`."""
        raise NotImplementedError

    def __str__(self) -> str:
        return as_text(self.report())


@dataclass(frozen=True, repr=False)
class Result(Printed):
    """A result with a record: new, or read from its run folder; its tables are the same.

    Attributes
    ----------
    data : object or None
        The complete result, in SI; None of a result that was read.
    agreement : Agreement or None
        Comparison of separate fits, of a new result of several sessions.
    folder : Path or None
        The run folder from which it was read.
    content : mapping or None
        The record that was read.
    """

    data: Any = None
    agreement: Agreement | None = None
    folder: Path | None = None
    content: Json | None = None
    _FORMAT: ClassVar[str] = "%.3g"
    """Of the numbers of `_overview`."""

    @cached_property
    def record(self) -> Json:
        """The content of the JSON file of a run folder."""
        return self._contents() if self.content is None else self.content

    def _contents(self) -> Json:
        raise NotImplementedError

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limitations of the result."""
        return tuple(self.record["warnings"])

    @property
    def _overview(self) -> DataFrame:
        """The table that a notebook shows, and `print` of a result that was read."""
        raise NotImplementedError

    def _file(self, name: str, remedy: str) -> Path:
        """A file of the run folder from which the result was read."""
        path = (self.folder or Path()) / name
        if not path.is_file():
            raise BayescalError("there is no such file", str(path), remedy)
        return path

    def _new(self) -> Any:
        """The complete result, which one that was read does not have."""
        if self.data is None:
            what = "the result was read from a run folder, which holds its record and tables only"
            raise BayescalError(
                what, str(self.folder), "read its page and figures there, or compute it again"
            )
        return self.data

    def __str__(self) -> str:
        if self.content is None:
            return super().__str__()
        warnings = "".join(f"\nwarning: {warning}" for warning in self.record.get("warnings", ()))
        return f"{self!r}\n{self._overview.to_string(float_format=self._FORMAT)}{warnings}"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self), quote=False)}</p>{self._overview.to_html(float_format=self._FORMAT)}"


def table(entries: Iterable[Json], index: str = "", columns: str = "") -> DataFrame:
    """Entries of a record as a table: of all their keys, or of some that are given with spaces between."""
    from pandas import DataFrame

    out = DataFrame(list(entries), columns=columns.split() or None)
    return out.set_index(index) if index else out


class Draws(Result):
    """A result with posterior draws."""

    def _posterior(self) -> Record:
        raise NotImplementedError

    def inference_data(self) -> Any:
        """The content of posterior.nc for ArviZ: InferenceData (ArviZ 0.x) or DataTree (1.x)."""
        from bayescal.posterior.inference import inference_data, load

        if self.data is None:
            return load(self._file("posterior.nc", "repeat the fit"))
        return inference_data(self._posterior())


@dataclass(frozen=True, repr=False)
class FitResult(Draws, Positioned):
    """A calibration; `print` shows its summary. `record` is the content of fit.json."""

    data: Fit | None = None
    _FORMAT: ClassVar[str] = "%.6g"

    def _contents(self) -> Json:
        from bayescal.reporting.fit.record import fit_record

        return fit_record(self._new(), self.agreement)

    def report(self, verbose: bool = False) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`; `verbose` adds details."""
        from bayescal.reporting.fit.summary import fit_summary

        return fit_summary(self._new(), self.record, verbose, self.agreement)

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write record, page, draws, budgets, robot.yaml, arm.json, dataset and, where `pictures`, figures.

        Returns the names of what was written.
        """
        from bayescal.reporting.fit.record import write_fit

        return write_fit(self._new(), Path(folder), self.record, pictures)

    def _posterior(self) -> Record:
        from bayescal.reporting.fit.files import fit_draws

        return fit_draws(self._new())

    def draws(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Draws (chains, draws) of parameters in the units of the record."""
        from bayescal.posterior.inference import read_draws
        from bayescal.reporting.fit.files import parameter_draws, variable

        if self.data is not None:
            return parameter_draws(self.data)
        path = self._file("posterior.nc", "repeat the fit")
        read = read_draws(path, [variable(name) for name in names])
        return {name: read[variable(name)] for name in names if variable(name) in read}

    @property
    def parameters(self) -> DataFrame:
        """One row per parameter, by name.

        Columns: `effect`, `unit`, `nominal`, `estimate`, `u` (posterior standard uncertainty), `prior_sd`,
        `low95` and `high95` (ends of the 95 % interval), and `identifiable` ("yes", "weakly", "no"; empty
        for the pose of a target).
        """
        from bayescal.reporting.fit import states

        state = states(self.record["identifiability"])
        entries = (
            p | _ends("95", p["interval95"]) | {"u": p["sd"], "identifiable": state.get(p["name"], "")}
            for p in self.record["parameters"]
        )
        columns = "name effect unit nominal estimate u prior_sd low95 high95 identifiable"
        return table(entries, "name", columns)

    _overview = parameters

    @property
    def levels(self) -> DataFrame:
        """Validation errors by model level, from the nominal model to the fitted one; keys of fit.json."""
        entries = (level | {"model": " + ".join(level["model"])} for level in self.record["ladder"])
        return table(entries, "model")

    @property
    def distances(self) -> DataFrame:
        """Certified distances, measured and predicted: `certified_mm`, errors and intervals in µm."""
        entries = (
            dict(zip(("from", "to"), d["between"], strict=True))
            | d
            | _ends("95_um", d["predicted_interval95_um"])
            for d in self.record["validation"]["distances"]
        )
        errors = "certified_mm nominal_error_um calibrated_error_um predicted_sd_um"
        return table(entries, columns=f"from to {errors} low95_um high95_um inside95")

    def __repr__(self) -> str:
        rms = self.record["predicted_distance"]["predicted_rms_um"]
        model = ", ".join(self.record["model"])
        name = self.record["dataset"]["name"]
        return f"<calibration of {name}: {model}; predicted distance error {rms:.1f} µm RMS>"


def _ends(suffix: str, interval: Sequence[float]) -> Json:
    """The ends of an interval by the names of their columns."""
    return {f"low{suffix}": interval[0], f"high{suffix}": interval[1]}


class Diagnosis(Result):
    """The diagnosis of a session of contacts or of a joint log."""

    _OF: ClassVar[str] = ""
    """What is diagnosed, before its name."""

    @property
    def verdict(self) -> str:
        """The kind of verdict: null, named, named+unexplained, class, unknown or ambiguous."""
        return str(self.record["verdict"])

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the verdict."""
        return tuple(self.record["effects"])

    @property
    def amplitudes(self) -> DataFrame:
        """Named effects, site by site: `what`, `value`, `u` (standard uncertainty) and `unit`; see gap.md."""
        return table(self.record.get("amplitudes", ()))

    @property
    def where(self) -> DataFrame:
        """Locations of the error, largest first: site, driver, RMS, share of the excess, p-values."""
        return table(self.record["where"])

    def __repr__(self) -> str:
        names = ", ".join(self.effects or self.record["credible_set90"])
        return f"<diagnosis of {self._OF}{self.record['dataset']['name']}: {self.verdict}; {names}>"


@dataclass(frozen=True, repr=False)
class GapResult(Diagnosis, Positioned):
    """A diagnosis; `print` shows its summary. `record` is the content of gap.json."""

    data: Gap | None = None

    def _contents(self) -> Json:
        from bayescal.reporting.gap.record import gap_record

        return gap_record(self._new())

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.gap.summary import gap_summary

        return gap_summary(self._new(), self.record, self.agreement)

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write gap.json, gap.html, arm.json, the dataset, the figures where `pictures`; return the names."""
        from bayescal.reporting.gap.record import write_gap

        return write_gap(self._new(), Path(folder), self.record, pictures)

    @property
    def probability(self) -> DataFrame:
        """Probability of every effect, of the noise-only model ('null') and of an unmodelled effect."""
        ranked = sorted(self.record["probability"].items(), key=lambda item: -(item[1] or 0.0))
        entries = ({"effect": effect, "probability": p} for effect, p in ranked)
        return table(entries, "effect", "effect probability")

    _overview = probability

    @property
    def undecided(self) -> bool:
        """Whether a plan of contacts could decide: effects not separated, not confirmed or not known."""
        open_ = self.verdict not in ("null", "named") or bool(self.record.get("undecided"))
        return open_ and self.record.get("plannable", True)

    @property
    def shrinkage(self) -> DataFrame:
        """Validation errors without and with the named effects in the model, in µm."""
        from pandas import DataFrame

        rows = {what: row for what, row in self.record["shrinkage"].items() if row}
        return DataFrame.from_dict(rows, orient="index")


@dataclass(frozen=True, repr=False)
class ComparisonResult(Printed):
    """All methods on one session; `print` shows the table. `data` is the complete result, in SI."""

    data: Comparison

    @cached_property
    def record(self) -> Json:
        """The content of compare.json."""
        from bayescal.reporting.comparison import comparison_record

        return comparison_record(self.data)

    def report(self) -> RenderableType:
        """The table, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.comparison import comparison_summary

        return comparison_summary(self.data)

    def save(self, folder: str | PathLike[str]) -> tuple[str, ...]:
        """Write compare.json to a run folder; return its name."""
        from bayescal.reporting.comparison import write_comparison

        return write_comparison(self.data, Path(folder))

    def __repr__(self) -> str:
        names = ", ".join(row.method.name for row in self.data.rows)
        return f"<comparison on {self.data.dataset.name}: {names}>"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self), quote=False)}</pre>"


@dataclass(frozen=True, repr=False)
class SimulatedSession:
    """A simulated session. `data` is the complete result, in SI; `truth` is the content of truth.json."""

    data: Simulated

    @property
    def dataset(self) -> Dataset:
        """The simulated measurement."""
        return self.data.dataset

    @property
    def truth(self) -> dict[str, Any]:
        """True parameters and distances, units in the keys."""
        return self.data.truth

    def save(self, folder: str | PathLike[str]) -> tuple[str, ...]:
        """Write a dataset folder with its truth.json; return the names of its files."""
        from bayescal.simulation.record import write

        write(self.data, Path(folder))
        return tuple(sorted(p.name for p in Path(folder).iterdir() if not p.name.startswith(".")))

    def __str__(self) -> str:
        from bayescal.simulation.record import summary

        return summary(self.data)

    def __repr__(self) -> str:
        return f"<simulated session {self.dataset.name}: {len(self.dataset.measurements.ids)} rows>"
