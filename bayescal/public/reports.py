"""`report`: pages of results from run folders."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path


def report(
    runs: str | PathLike[str] | Sequence[str | PathLike[str]],
    out: str | PathLike[str] | None = None,
    *,
    pdf: bool = False,
) -> tuple[Path, ...]:
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
