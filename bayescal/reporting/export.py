"""The summary of an export: what the file cannot hold, with its size."""

from __future__ import annotations

import shlex

from rich.console import Group, RenderableType
from rich.text import Text

from bayescal.effects.selection import plain
from bayescal.effects.tool import TOOL
from bayescal.exporting.export import Exported
from bayescal.reporting.shared.text import facts, model_label, plain_table, um


def export_summary(export: Exported) -> RenderableType:
    """Model, state, effects that the file does not hold, and notes."""
    arm = export.arm
    m = arm.dataset.measurements
    tools = {p.name for p in arm.model.parameters if p.effect == TOOL.name}
    held = len({i.parameter for i in export.written.items} - tools)
    time = "" if m.time is None else f" ({m.time[export.options.state]:.0f} s)"
    rows = [
        ("arm", f"{arm.dataset.robot.name}, session {arm.dataset.name}", ""),
        ("model", model_label(arm.effects), ""),
        ("format", f"{export.format}: {held} of {len(arm.values) - len(tools)} parameters of the arm", ""),
        ("tool", f"its {len(tools)} parameters are in the sidecar", ""),
    ]
    if any(m.why.startswith("changes") for m in export.missing):
        rows.append(("state", f"that of row {m.ids[export.options.state]}{time}", ""))
    parts: list[RenderableType] = [facts(rows)]
    if export.missing:
        table = plain_table("not in the file (µm)", "RMS", "maximum")
        for missing in export.missing:
            table.add_row(missing.effect, um(missing.rms), um(missing.maximum))
        table.add_row("all of these", um(export.rest.rms), um(export.rest.maximum))
        parts += ["", table, ""]
        parts.append(facts([(missing.effect, missing.why, "dim") for missing in export.missing]))
        parts.append(facts(_alternative(export)))
    else:
        parts.append(Text("the file holds the complete model of the arm", "green"))
    if export.notes:
        parts.append(facts([("note", note, "yellow") for note in export.notes]))
    return Group(*parts)


def _alternative(export: Exported) -> list[tuple[str, str, str]]:
    """The model that the file can hold: fitted without the missing effects, it has the smaller error."""
    lacking = {missing.effect for missing in export.missing}
    less = [name for name in export.arm.effects if plain(name) in map(plain, lacking)]
    if not less or len(less) == len(export.arm.effects):
        return []
    words = (
        f"--without {shlex.quote(','.join(less))} fits the session again: the rest of the model then takes "
        "up what it can of these effects, and the file has smaller errors"
    )
    return [("alternative", words, "")]
