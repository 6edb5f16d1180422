"""The arm of a result put to use: exported, compensated for, verified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.public import FitResult, GapResult, Printed
from bayescal.public.motions import fitted_log
from bayescal.public.positions import arm_of
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    import numpy as np
    from rich.console import RenderableType

    from bayescal.compensating import Compensation
    from bayescal.exporting.export import Exported
    from bayescal.exporting.log_arm import LogExport
    from bayescal.fitted.arm import FittedArm
    from bayescal.verifying.log import LogVerification
    from bayescal.verifying.result import Verification


@dataclass(frozen=True, repr=False)
class ExportResult(Printed):
    """An exported arm; `print` shows what the file cannot hold. `data` is the complete result, in SI."""

    data: Exported | LogExport

    @property
    def content(self) -> str | bytes:
        """The content of the file."""
        return self.data.content

    @property
    def name(self) -> str:
        """Default name of the file: that of the robot."""
        return f"{self.data.robot}-calibrated{self.data.suffix}"

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

    def __repr__(self) -> str:
        return f"<{self.data.format} of {self.data.robot}>"


def export(
    run: FitResult | GapResult | str | PathLike[str], to: str, *, into: str | PathLike[str] = "",
    with_: Sequence[str] | str = (), without: Sequence[str] | str = (), readings: str = "plain",
    at_time: float | None = None, at_row: str | None = None, force: bool = False,
) -> ExportResult:  # fmt: skip
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
    from bayescal.exporting import export as work
    from bayescal.exporting.log_arm import export_log

    if (log := fitted_log(run)) is not None:
        if into or with_ or without or at_time is not None or at_row or readings != "plain":
            raise BayescalError(
                "the arm of a joint log is a new file", f"--to {to}", "leave other options out"
            )
        if log.folder is None:
            raise BayescalError("the result is not saved", "export", "save it, and export its run folder")
        return ExportResult(export_log(log.folder, log.record, to))
    work.format_of(to)  # before a session is fitted again
    arm = arm_of(run, names(with_), names(without))
    name = f"{arm.dataset.robot.name}-calibrated"
    return ExportResult(
        work.export(
            arm, to, into=str(into), readings=readings, time=at_time, row=at_row, force=force, name=name
        )
    )  # fmt: skip


def names(effects: Sequence[str] | str) -> tuple[str, ...]:
    """Names of effects, from a sequence or from a text with commas."""
    each = effects.split(",") if isinstance(effects, str) else effects
    return tuple(name.strip() for name in each if name.strip())


@dataclass(frozen=True, repr=False)
class CompensationResult(Printed):
    """Corrected targets; `print` shows their errors before and their uncertainty.

    Attributes
    ----------
    arm : FittedArm
        The arm for which they hold.
    data : Compensation
        The complete result, in SI.
    """

    arm: FittedArm
    data: Compensation

    @property
    def readings(self) -> np.ndarray:
        """Corrected readings (M, n), rad; nan where a target has no solution."""
        import numpy as np

        nothing = np.full(self.arm.dataset.robot.n, np.nan)
        rows = [nothing if target.readings is None else target.readings for target in self.data.corrected]
        return np.array(rows).reshape(len(rows), len(nothing))

    @property
    def u(self) -> np.ndarray:
        """Standard uncertainty (M,) of the TCP positions, m; nan where a target has no solution."""
        import numpy as np

        return np.array([target.u for target in self.data.corrected])

    @property
    def U(self) -> np.ndarray:
        """Length (M,), m, that the error of the TCP does not exceed (95.45 %); nan without one."""
        import numpy as np

        return np.array([target.expanded for target in self.data.corrected])

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.exports import compensation_summary

        return compensation_summary(self.arm, self.data)

    def save(self, path: str | PathLike[str]) -> tuple[str, ...]:
        """Write the corrected file, and beside a program the table of its positions; return their names."""
        return self.data.save(Path(path))

    def __repr__(self) -> str:
        return f"<compensation of {self.data.source}: {len(self.data.corrected)} targets>"


def compensate(
    run: FitResult | GapResult | str | PathLike[str], targets: str | PathLike[str], *, format: str = "",
    frame: str | None = None, tool: str | None = None, tcp: Sequence[float] | None = None,
    payload_kg: float = 0.0, with_: Sequence[str] | str = (), without: Sequence[str] | str = (),
    at_time: float | None = None, at_row: str | None = None, force: bool = False,
) -> CompensationResult:  # fmt: skip
    """Correct targets or a robot program for all fitted effects of an arm.

    Parameters
    ----------
    run : FitResult, GapResult or path
        A path is that of a run folder.
    targets : path
        A table (CSV) of poses or nominal readings, or a robot program; see ``docs/compensate.md``.
    format : str
        'csv', 'urscript', 'fanuc', 'kuka', 'abb' or 'robodk'; by default by the name of the file.
    frame : str, optional
        Frame of the poses: 'base', or a target of the session; default: base.
    tool : str, optional
        Name of a tool of dataset.yaml that is brought to the targets; needed if the session has several.
    tcp : sequence of float, optional
        x, y, z in m, and fixed-axis roll, pitch, yaw in rad, of another tool in the frame of the flange.
    payload_kg : float
        kg at the flange beyond the tool, of targets that state none.
    with_, without : sequence of str, or str
        Effects to add to the model, and to leave out: the session is fitted again.
    at_time : float, optional
        s since the session began: the state of the arm (drift, step) is that of this time.
    at_row : str, optional
        id of the row whose state holds; default: the last fitted row.
    force : bool
        Compensate in spite of reasons against the arm; see `export`.

    Returns
    -------
    CompensationResult

    Raises
    ------
    BayescalError
        With file and line, if a target cannot be read, or a position of a program has no solution; with the
        reason, if the arm should not be used.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> session = bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1)
    >>> fitted = bc.fit(session, "geometry", samples=0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = f"{folder}/targets.csv"
    ...     text = "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\\n450,0,200,180,0,0\\n"
    ...     _ = open(name, "w").write(text)
    ...     done = bc.compensate(fitted, name)
    >>> done.readings.shape, bool(done.u[0] < 1e-3)
    ((1, 6), True)
    """
    import numpy as np

    from bayescal.compensating import compensate_file
    from bayescal.fitted import gate

    arm = arm_of(run, names(with_), names(without))
    gate.check(arm.use, force, "compensated")
    done = compensate_file(
        arm, Path(targets), format_=format, frame=frame, tool=tool,
        tcp=None if tcp is None else np.asarray(tcp, float), payload=payload_kg, time=at_time, row=at_row,
        warning="; ".join((*(f"not to be used: {each}" for each in arm.use.against), *arm.use.warnings)),
    )  # fmt: skip
    return CompensationResult(arm, done)


def check_out(out: Path, targets: Path) -> None:
    """Refuse an output that would replace the targets, or lie in a folder that does not exist."""
    if out.exists() and targets.exists() and out.samefile(targets):
        raise BayescalError("the output would replace the targets", "--out", "choose another name")
    if out.is_dir() or not out.parent.is_dir():
        what = "is a folder" if out.is_dir() else f"there is no folder {out.parent}"
        raise BayescalError(what, f"--out {out}", "name a file in a folder that exists")


@dataclass(frozen=True, repr=False)
class VerificationResult(Printed):
    """An exported file in its simulator. `data` is the complete result, in SI."""

    data: Verification | LogVerification

    @property
    def passed(self) -> bool:
        """Whether the simulator has the fitted arm, within the limits of its effects."""
        return self.data.passed

    @property
    def record(self) -> dict[str, Any]:
        """The content of verify.json."""
        from bayescal.reporting.exports import record

        return record(self.data)

    def report(self) -> RenderableType:
        """The text that `bayescal verify` prints, for rich."""
        from bayescal.reporting.exports import report

        return report(self.data)

    def save(self, folder: str | PathLike[str]) -> tuple[str, ...]:
        """Write verify.json to a run folder; return the name of the file."""
        from bayescal.storage.files import json_text
        from bayescal.storage.folders import filled

        return filled(Path(folder), {"verify.json": json_text(self.record)})

    def __repr__(self) -> str:
        levels = getattr(self.data, "levels", ())  # none of a joint log
        most = f", {1e6 * levels[-1].maximum:.2g} µm at most" if levels else ""
        return f"<verification of {self.data.path.name}: {'passed' if self.passed else 'failed'}{most}>"


def verify(
    run: str | PathLike[str], file: str | PathLike[str], *, progress: Progress = silent
) -> VerificationResult:
    """Load an exported arm in its simulator, and compare it with the fitted arm and with the measurements.

    Parameters
    ----------
    run : path
        Run folder of `fit` or `diagnose`.
    file : path
        File that was exported from it.
    progress : callable
        Called with the stage and its completed fraction.

    Raises
    ------
    BayescalError
        If the run folder has no arm, the simulator is not installed, or the file is not of this arm.

    Examples
    --------
    >>> import bayescal as bc
    >>> result = bc.verify("runs/session-fit", "arm.xml")  # doctest: +SKIP
    >>> result.passed  # doctest: +SKIP
    True
    """
    from bayescal.verifying.log import verify_log
    from bayescal.verifying.result import verify as verified

    if fitted_log(run) is not None:
        return VerificationResult(verify_log(Path(run), Path(file)))
    return VerificationResult(verified(Path(run), Path(file), progress))
