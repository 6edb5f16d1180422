"""What is printed of an exported arm of a joint log, and of its verification."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from bayescal.exporting.log_arm import LEFT_OUT, LogExport
from bayescal.reporting.motion.sheets import newton_metres
from bayescal.reporting.shared.sheet import sheet_of_cells, terminal
from bayescal.verifying.log_torque import LogVerification


def export_summary(e: LogExport) -> RenderableType:
    """The parts of the model that the file does not hold, with their size."""
    rows = []
    for key, sizes in e.missing.items():
        words, unit = LEFT_OUT[key]
        rows.append((words, " ".join(newton_metres(x) for x in np.abs(sizes)), unit))
    title = Text.assemble(
        (e.name, "bold"), f"  {e.format}: bodies, friction" + (", rotors" if e.format == "mjcf" else "")
    )
    return Group(title, terminal(sheet_of_cells(("not in the file", "joint by joint", "unit"), rows)))


def verify_summary(v: LogVerification) -> RenderableType:
    """Torque errors of withheld motions in the simulator, joint by joint."""
    rows = [
        (joint, newton_metres(before), newton_metres(after), f"{difference:.1e}")
        for joint, before, after, difference in zip(v.joints, v.nominal, v.fitted, v.difference, strict=True)
    ]
    headings = ("torque residual in the simulator (N m RMS)", "nominal", "fitted", "simulator - model")
    verdict = Text("the file is the arm that was fitted", "bold green")
    if not v.passed:
        verdict = Text("the file is not the arm that was fitted", "bold red")
    title = Text.assemble((v.name, "bold"), f"  {v.path} in {v.software}, {v.rows} rows of withheld motions")
    return Group(title, verdict, terminal(sheet_of_cells(headings, rows)))
