"""Set-ups of new sessions, schemas of files, the check of a dataset; pages of run folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.public import Printed
from bayescal.public.arms import names
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.preparing.check import Check
    from bayescal.preparing.joint_log import LogCheck


def init(
    folder: str | PathLike[str], robot: str, artefact: Sequence[str] | str = "cube", *, tool: str = "",
    name: str = "", allow_xacro: bool = False,
) -> tuple[str, ...]:  # fmt: skip
    """Write the set-up of a new session: a commented dataset.yaml, an empty table, and what to measure.

    Parameters
    ----------
    folder : path
        A new or an empty folder.
    robot : str
        A built-in name or a part of it ('ur5e'), the path of a robot.yaml, URDF or xacro, or 'new' for a
        robot.yaml to be filled in.
    artefact : sequence of str, or str
        'cube', 'spheres', 'plate', 'socket', 'bar', 'tracker'; comma separated if in one string.
    tool : str
        Centre of the ball or reflector in the flange frame, '0 0 120 mm'; to be filled in if not given.
    name : str
        Name of the session; default: the name of the folder.
    allow_xacro : bool
        As of `read_dataset`.

    Returns
    -------
    tuple of str
        Names of the files.

    Raises
    ------
    BayescalError
        If the folder is not empty, or the robot or the artefact is not known.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     bc.init(f"{folder}/cell", "lrmate200ic", "tracker", tool="60 0 120 mm")
    ('dataset.yaml', 'measurements.csv', 'README.md')
    """
    import numpy as np

    from bayescal.importing.units import quantity
    from bayescal.preparing.folder import start
    from bayescal.robots import is_xacro, load_robot

    centre = np.array(quantity(tool, "length", 3, "--tcp")) if tool else None
    arm = load_robot(robot, allow_xacro=True)[0] if allow_xacro and is_xacro(robot) else None
    return start(Path(folder), robot, names(artefact), centre, name, arm)


def schema(name: str) -> dict[str, Any]:
    """Return the JSON schema of a file that users write.

    Parameters
    ----------
    name : str
        'dataset' (dataset.yaml) or 'robot' (robot.yaml).

    Returns
    -------
    dict
        JSON schema, draft 2020-12.

    Raises
    ------
    BayescalError
        If there is no such file.

    Examples
    --------
    >>> import bayescal as bc
    >>> sorted(bc.schema("robot")["required"])
    ['convention', 'joints', 'name', 'schema']
    """
    from bayescal.preparing.artefacts import schema_of

    return schema_of(name)


@dataclass(frozen=True, repr=False)
class CheckResult(Printed):
    """What is understood of a dataset or joint log, what is missing, what looks wrong; `print` shows it.

    Attributes
    ----------
    data : Check or LogCheck
        The complete result, in SI.
    """

    data: Check | LogCheck

    @cached_property
    def record(self) -> Json:
        """The content of `bayescal check --to json`."""
        from bayescal.preparing.check import Check, check_record

        if isinstance(self.data, Check):
            return check_record(self.data)
        from bayescal.preparing.joint_log import log_record

        return log_record(self.data)

    @cached_property
    def joints(self) -> DataFrame:
        """Of a joint log a row per joint: range, speeds, delays, filters; of a dataset empty."""
        from bayescal.reporting.check import joint_sheet
        from bayescal.reporting.sheet import frame

        return frame(joint_sheet({"joints": self.record.get("joints", [])}), "joint")

    @cached_property
    def findings(self) -> DataFrame:
        """A row per finding: code, kind, what, where, remedy."""
        from pandas import DataFrame

        columns = ["code", "kind", "what", "where", "remedy"]
        return DataFrame([vars(f) for f in self.data.findings], columns=columns)

    def report(self) -> RenderableType:
        """The report, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.check import check_summary

        return check_summary(self.data, self.record)

    def __repr__(self) -> str:
        from bayescal.reporting.check import said

        return f"<check of {self.data.name}: {said(self.data.findings)}>"


def check(
    folder: str | PathLike[str], *, calibration: Sequence[str | PathLike[str]] = (), allow_xacro: bool = False
) -> CheckResult:
    """Check a dataset or a joint log without fitting it: what is understood, missing, probably a mistake.

    Parameters
    ----------
    folder : path
        As of `read_dataset`.
    calibration : sequence of path
        Of a joint log: LeRobot's calibration of its servos, and others to compare with it.
    allow_xacro : bool
        As of `read_dataset`.

    Returns
    -------
    CheckResult
        Prints as a summary; `findings` is a table.

    Raises
    ------
    BayescalError
        If a file cannot be read, and for calibrations of what is no joint log.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.simulate(contacts=120, later=4, repeats=2, spheres=0).save(f"{folder}/session")
    ...     bc.check(f"{folder}/session")
    <check of simulated: no findings>
    """
    from bayescal.dataset.read import expanded_robot
    from bayescal.logs import is_log
    from bayescal.preparing.check import check as run

    if is_log(Path(folder)):
        from bayescal.preparing.joint_log import check_log  # and scipy.signal with it

        return CheckResult(check_log(Path(folder), [Path(file) for file in calibration]))
    if calibration:
        raise BayescalError("is an option of joint logs", "--calibration", "remove it")
    return CheckResult(run(Path(folder), expanded_robot(Path(folder)) if allow_xacro else None))


def report(
    runs: str | PathLike[str] | Sequence[str | PathLike[str]], out: str | PathLike[str] | None = None, *,
    pdf: bool = False,
) -> tuple[Path, ...]:  # fmt: skip
    """Write the page of a run folder again, or a page that compares several runs.

    Parameters
    ----------
    runs : path or sequence of paths
        Run folders of `fit` or `diagnose`. Several are shown side by side: verdicts, distance errors,
        parameters with their differences and u, model levels.
    out : path, optional
        The HTML file. By default report.html or gap.html in the run folder, and of several runs
        runs/<names>-report.html.
    pdf : bool
        Also print it to a PDF file of the same name, by Chromium or Chrome.

    Returns
    -------
    tuple of Path
        The files that were written.

    Raises
    ------
    BayescalError
        For a folder without a result, a changed run folder, a file that is no page of bayescal, or without
        a browser for the PDF.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> session = bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.fit(session, "geometry", samples=0).save(f"{folder}/run")
    ...     [path.name for path in bc.report(f"{folder}/run")]
    ['report.html']
    """
    from bayescal.reporting.page.build import write_report

    each = [runs] if isinstance(runs, str | PathLike) else list(runs)
    return write_report([Path(run) for run in each], None if out is None else Path(out), pdf)
