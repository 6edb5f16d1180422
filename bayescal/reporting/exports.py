"""What a compensation, an export and a verification print, and verify.json."""

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from bayescal import __version__
from bayescal.compensating import Compensation
from bayescal.effects.geometry import TOOL
from bayescal.effects.selection import plain as without_setting
from bayescal.exporting.export import Exported
from bayescal.exporting.log_arm import LogExport
from bayescal.fitted.arm import FittedArm
from bayescal.reporting.gap import per_vector
from bayescal.reporting.motion import fit as logs
from bayescal.reporting.origin import plain, scaled
from bayescal.reporting.sheet import Column, Sheet, screen
from bayescal.reporting.text import MM, facts, listed, model_label, um, um2, under
from bayescal.verifying.gap import Gap
from bayescal.verifying.log import LogVerification, record_of
from bayescal.verifying.result import Verification

SHOWN = 5
"""Targets without solution, and notes, that are listed."""


def compensation_summary(arm: FittedArm, done: Compensation) -> RenderableType:
    """The verdict if it is bad, numbers of targets, errors before, uncertainty, what has no solution."""
    good = [result for result in done.corrected if not result.reason]
    rows = [
        *([("warning", done.warning, "bold red")] if done.warning else []),
        ("compensation", f"{done.source}: {len(done.corrected)} targets, poses in {done.frame}", "bold"),
        ("arm", f"{arm.dataset.robot.name}, {model_label(arm.effects)}", ""),
    ]
    if good:
        error, u, most = (np.array([getattr(g, key) for g in good]) for key in ("error", "u", "expanded"))
        text = f"mean {MM * error.mean():.3f} mm, maximum {MM * error.max():.3f} mm"
        rows.append(("nominal error", text, ""))
        middle, high, expanded = (um2(float(x)) for x in (np.median(u), u.max(), np.median(most)))
        text = f"u of a point {middle} µm (median), {high} µm (maximum); U {expanded} µm (median, 95 %)"
        rows.append(("uncertainty", text, ""))
        outside = sum(not result.inside for result in good)
        text = "all targets are inside" if not outside else f"{outside} of {len(good)} targets are outside"
        rows.append(("probed region", text, "yellow" if outside else ""))
    each = zip(done.targets, done.corrected, strict=True)
    lacking = [f"{target.where}: {result.reason}" for target, result in each if result.reason]
    rows += [("note", note, "yellow") for note in arm.use.notes if note not in arm.use.warnings]
    rows += [*under("no solution", _some(lacking), "red"), *under("kept", _some(done.notes), "yellow")]
    return facts(rows)


def _some(texts: Sequence[str]) -> Sequence[str]:
    more = len(texts) - SHOWN
    return texts if more <= 0 else [*texts[:SHOWN], f"and {more} more"]


def export_summary(export: Exported | LogExport) -> RenderableType:
    """Model, state, effects that the file does not hold, and notes."""
    if isinstance(export, LogExport):
        return logs.export_summary(export)
    arm = export.arm
    m = arm.dataset.measurements
    tools = {p.name for p in arm.model.parameters if p.effect == TOOL.name}
    of_arm = {p.name for p in arm.model.parameters if p.site.of_arm}
    held = len({i.parameter for i in export.written.items} & of_arm)
    time = "" if m.time is None else f" ({m.time[export.options.state]:.0f} s)"
    rows = [
        ("arm", f"{arm.dataset.robot.name}, session {arm.dataset.name}", ""),
        ("model", model_label(arm.effects), ""),
        ("format", f"{export.format}: {held} of {len(of_arm)} parameters of the arm", ""),
        ("tool", f"its {len(tools)} parameters are in the sidecar", ""),
    ]
    if any(m.why.startswith("changes") for m in export.missing):
        rows.append(("state", f"that of row {m.ids[export.options.state]}{time}", ""))
    sizes = [(missing.effect, missing) for missing in export.missing]
    if not sizes:
        parts: tuple[Any, ...] = (Text("the file holds the complete model of the arm", "green"),)
    else:
        table = Sheet(MISSING_EFFECTS, [*sizes, ("all of these", export.total)])
        why = [(missing.effect, missing.why, "dim") for missing in export.missing]
        parts = ("", table, "", why, _alternative(export))
    return screen(rows, *parts, [("note", note, "yellow") for note in export.notes])


MISSING_EFFECTS = (
    Column("not in the file (µm)", 0),
    Column("RMS", lambda item: um(item[1].rms)),
    Column("maximum", lambda item: um(item[1].maximum)),
)


SMALL = 5e-8
"""m RMS, error of a file that is stated as 0.0 µm (rounding)."""


def _alternative(export: Exported) -> list[tuple[str, str, str]]:
    """The model that the file can hold: fitted without the missing effects, it has the smaller error."""
    # of an effect that moves no TCP nothing is gained
    lacking = {missing.effect for missing in export.missing if not missing.rms < SMALL}
    less = [name for name in export.arm.effects if without_setting(name) in map(without_setting, lacking)]
    if not less or len(less) == len(export.arm.effects):
        return []
    words = (
        f"--without {shlex.quote(','.join(less))} fits the session again: the rest of the model then takes "
        "up what it can of these effects, and the file has smaller errors"
    )
    return [("alternative", words, "")]


SCHEMA = "bayescal-verify/1"


def record(v: Verification | LogVerification) -> dict[str, Any]:
    """The content of verify.json."""
    if isinstance(v, LogVerification):
        return record_of(v)
    measured = v.gap and {"before_model": v.gap.before_is} | _measured(v.gap)
    return {
        "schema": SCHEMA, "format": v.format, "file": v.path.name,
        "software": {"bayescal": __version__, "simulator": v.software}, "model": list(v.arm.effects),
        "state_row": v.arm.dataset.measurements.ids[v.state], "poses": len(v.levels[-1].differences),
        "max_difference_um": {level.name: 1e6 * level.maximum for level in v.levels},
        "rms_difference_um": {level.name: 1e6 * level.rms for level in v.levels},
        "limit_um": {level.name: 1e6 * level.limit for level in v.levels},
        "not_in_file_rms_um": {name: 1e6 * size for name, size in v.missing.items()},
        "use": v.arm.use.record(), "passed": v.passed, "worse": _worse(v.gap), "measured": measured,
    }  # fmt: skip


MEASURED = ("before_rms_um", "after_rms_um", "predicted_before_rms_um", "predicted_after_rms_um")


def _measured(gap: Gap) -> dict[str, dict[str, Any]]:
    """Number and RMS errors of each kind: before and after, measured and predicted by the run.

    Those of points are of their coordinates.
    """
    errors = {kind: (gap.before[kind], gap.after[kind], *gap.predicted[kind]) for kind in gap.after}
    return {
        kind: {"count": gap.count[kind]}
        | {key: plain(1e6 * size) for key, size in zip(MEASURED, sizes, strict=True)}
        for kind, sizes in errors.items()
    }


def _worse(gap: Gap | None) -> list[str]:
    """Kinds of measurements whose errors the file makes larger than the arm before had."""
    return [] if gap is None else [kind for kind, size in gap.after.items() if size > gap.before[kind]]


def _worse_words(v: Verification) -> str:
    """What is worse with the file, and what to do; "" for nothing."""
    if v.gap is None or not (kinds := _worse(v.gap)):
        return ""
    sizes = {kind: [um(per_vector(kind, 3) * e[kind]) for e in (v.gap.after, v.gap.before)] for kind in kinds}
    each = listed([f"{kind} ({after} µm, {before} before)" for kind, (after, before) in sizes.items()])
    words = f"the file has larger errors than before ({v.gap.before_is}): {each}"
    less = shlex.quote(",".join(v.missing))
    remedy = f"; export to a format that holds these effects, or with --without {less}"
    return f"{words}{remedy if v.missing else ''}"


def report(v: Verification | LogVerification) -> RenderableType:
    """The verification in a few lines."""
    if isinstance(v, LogVerification):
        return logs.verify_summary(v)
    title = f"{v.path.name} in {v.software}, {len(v.levels[-1].differences)} poses of {v.arm.dataset.name}"
    if v.gap is None:
        measured: Any = Text("The session has no validation measurements of positions: no gap is measured.")
    else:
        headings = (f"before ({v.gap.before_is})", "after", "run: before", "run: after")
        columns = (
            Column("simulator against measurements: RMS (µm)", "kind"),
            Column("count", "count"),
            *(Column(heading, key, "{:.3g}".format) for heading, key in zip(headings, MEASURED, strict=True)),
        )
        measured = Sheet(columns, [
            {"kind": kind} | errors | {key: scaled(errors[key], per_vector(kind, 3)) for key in MEASURED}
            for kind, errors in _measured(v.gap).items()
        ])  # fmt: skip
    sizes = ", ".join(f"{name} ({um(size)} µm RMS)" for name, size in v.missing.items())
    lacking = Text(f"not in the file, and part of the gap after: {sizes}") if sizes else None
    remarks = [Text(remark, style="yellow") for remark in v.arm.use.remarks]
    condition = " without these effects" if v.missing else ""
    verdict = Text(f"passed: the simulator has the fitted arm{condition}")
    if worst := next((level for level in v.levels if not level.passed), None):
        what = f"FAILED: {worst.name} differs by up to {1e6 * worst.maximum:.3g} µm"
        load = f"; it carries {v.carried:.3g} kg beside the tool of the session" if v.carried > 1e-6 else ""
        verdict = Text(f"{what} (limit {1e6 * worst.limit:.3g} µm, RMS 1 µm){load}", style="red")
    worse = Text(words, style="red") if (words := _worse_words(v)) else None
    head = Text(title, style="bold"), Sheet(LEVELS, v.levels), measured
    return screen(*head, lacking, *remarks, worse, verdict)


LEVELS = (
    Column("simulator against model", "name"),
    *(
        Column(f"{heading} (µm)", key, lambda size: f"{1e6 * size:.2g}" if size else "0")
        for heading, key in (("RMS", "rms"), ("maximum", "maximum"), ("limit", "limit"))
    ),
)
