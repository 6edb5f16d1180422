"""The public function for exports, and its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.public.results import FitResult, GapResult, as_text

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bayescal.exporting.export import Exported
    from bayescal.fitted.arm import FittedArm


@dataclass(frozen=True, repr=False)
class ExportResult:
    """An exported arm; `print` shows what the file cannot hold. `data` is the complete result, in SI."""

    data: Exported

    @property
    def content(self) -> str | bytes:
        """The content of the file."""
        return self.data.written.content

    @property
    def name(self) -> str:
        """Default name of the file: that of the robot."""
        return f"{self.data.arm.dataset.robot.name}-calibrated{self.data.suffix}"

    @property
    def record(self) -> dict[str, Any]:
        """The content of the sidecar."""
        return self.data.record(self.name)

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.exports import export_summary

        return export_summary(self.data)

    def save(self, path: str | PathLike[str] | None = None) -> tuple[Path, ...]:
        """Write the file and its sidecar ``<name>.bayescal.json``; return their paths."""
        return self.data.save(Path(path or self.name))

    def __str__(self) -> str:
        return as_text(self.report())

    def __repr__(self) -> str:
        return f"<{self.data.format} of {self.data.arm.dataset.robot.name}>"


def export(
    run: FitResult | GapResult | str | PathLike[str],
    to: str,
    *,
    into: str | PathLike[str] = "",
    with_: Sequence[str] | str = (),
    without: Sequence[str] | str = (),
    readings: str = "plain",
    at_time: float | None = None,
    at_row: str | None = None,
    force: bool = False,
) -> ExportResult:
    """Export the arm of a calibration or a diagnosis: robot.yaml, URDF, SDF, ...

    Parameters
    ----------
    run : FitResult, GapResult or path
        A path is that of a run folder. The arm of a diagnosis has the named effects that the validation data
        confirm.
    to : str
        Format: a name of `bayescal.exporting.FORMATS`.
    into : path
        A file of the user, which is patched in a copy; ``arm.urdf#tool0`` names the link with the tool.
    with_, without : sequence of str, or str
        Effects to add to the model, and to leave out: the session is fitted again.
    readings : str
        'plain' or 'script', of mjcf.
    at_time : float, optional
        s since the session began, at which the file holds (drift, steps).
    at_row : str, optional
        id of the row at which it holds; default: the last fitted row.
    force : bool
        Export in spite of reasons against it: no convergence, priors that decide, a negative compliance, an
        effect that the validation data do not confirm.

    Returns
    -------
    ExportResult
        Prints what the file cannot hold, with its size at the poses of the session.

    Raises
    ------
    BayescalError
        If the arm should not be exported, with the reason, or `into` is a file of another arm.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1)
    >>> urdf = bc.export(bc.fit(session, "geometry", samples=0), "urdf")
    >>> urdf.content[:21]
    '<?xml version="1.0"?>'
    >>> urdf.data.missing
    ()
    """
    from bayescal.exporting.export import export as work
    from bayescal.exporting.export import format_of

    format_of(to)  # before a session is fitted again
    arm = arm_of(run, names(with_), names(without))
    name = f"{arm.dataset.robot.name}-calibrated"
    return ExportResult(
        work(
            arm, to, into=str(into), readings=readings, time=at_time, row=at_row, force=force, name=name
        )
    )  # fmt: skip


def names(effects: Sequence[str] | str) -> tuple[str, ...]:
    """Names of effects, from a sequence or from a text with commas."""
    each = effects.split(",") if isinstance(effects, str) else effects
    return tuple(name.strip() for name in each if name.strip())


def arm_of(run: object, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """The arm of a result, new or read back, or of a run folder, with other effects fitted again."""
    from bayescal.fitted import of_fit, of_gap, open_run, refitted
    from bayescal.public.saved import SavedFit, SavedGap

    if isinstance(run, FitResult):
        arm = of_fit(run.data)
        return refitted(arm, with_, without) if with_ or without else arm
    if isinstance(run, GapResult):
        return of_gap(run.data, with_, without)
    if isinstance(run, SavedFit | SavedGap):
        return open_run(run.folder, with_, without)
    if isinstance(run, str | PathLike):
        return open_run(Path(run), with_, without)
    what = f"{type(run).__name__} has no arm"
    raise BayescalError(what, "run", "give a result of fit or diagnose, or its folder")
