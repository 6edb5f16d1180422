"""What is printed of an exported arm of a joint log, and of its verification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from bayescal.exporting.log_arm import LogExport
from bayescal.motion.result import Tracking
from bayescal.reporting.motion.sheets import newton_metres
from bayescal.reporting.shared.sheet import Sheet, screen, sheet_of_cells, terminal
from bayescal.verifying.log_torque import LogVerification

CONTENT = {
    "mjcf": "bodies, friction, rotors, drives",
    "urdf": "bodies, friction",
    "sdf": "bodies, friction",
    "bam": "friction and rotors of the drives; kt, R and actuator are those of the motor, to be added",
}
"""What the file of a format holds."""


def export_summary(e: LogExport) -> RenderableType:
    """The parts of the model that the file does not hold, with their size."""

    def joined(values: Sequence[float] | None) -> str:
        return "-" if values is None else " ".join(newton_metres(abs(x)) for x in values)

    rows = [(words, unit, joined(x), joined(e.mrad(unit, x))) for words, unit, x in e.left_out]
    title = Text.assemble((e.name, "bold"), f"  {e.format}: {CONTENT[e.format]}")
    heads = ("not in the file", "unit", "joint by joint", "mrad of position")
    return screen(title, terminal(sheet_of_cells(heads, rows)))


def verify_summary(v: LogVerification) -> RenderableType:
    """Torque errors of withheld motions in the simulator, joint by joint."""
    errors = (map(newton_metres, x) for x in (v.nominal, v.fitted))
    rows = list(zip(v.joints, *errors, map("{:.1e}".format, v.difference), strict=True))
    headings = ("torque residual in the simulator (N m RMS)", "nominal", "fitted", "simulator - model")
    no, colour = ("", "green") if v.passed else ("not ", "red")
    verdict = Text(f"the file is {no}the arm that was fitted", f"bold {colour}")
    title = Text.assemble((v.name, "bold"), f"  {v.path} in {v.software}, {v.rows} rows of withheld motions")
    parts = title, verdict, sheet_of_cells(headings, rows), ""
    if isinstance(v.tracking, str):
        return screen(*parts, Text(f"not replayed: {v.tracking}", "dim"))
    return screen(*parts, replay_sheet(v.joints, v.tracking))


def replay_sheet(joints: Sequence[str], arms: Mapping[str, Tracking]) -> Sheet:
    """Errors of withheld motions that the simulator moves by the logged commands alone, joint by joint."""
    names = {"nominal": "nominal", "model": "fitted", "effects": "with the effects"}
    heads = [f"{names[a]}, {unit}" for unit in ("deg", "N m") for a in arms]
    columns = [[f"{x:.3g}" for x in np.rad2deg(of.rms)] for of in arms.values()]
    columns += [[newton_metres(x) for x in of.torque] for of in arms.values()]
    rows = list(zip(joints, *columns, strict=True))
    return sheet_of_cells(("open-loop replay of the commands (RMS)", *heads), rows)
