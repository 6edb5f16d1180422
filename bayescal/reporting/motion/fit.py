"""fit.json of a joint log, and of a session and a log that were fitted together: record, terminal, folder.

What is printed of an exported arm of a joint log, and of its verification.

Motions that are to be logged next: record, table, and the files of commands.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import RenderableType
from rich.text import Text

from bayescal.assess.findings import FAR
from bayescal.exporting.log_arm import LogExport
from bayescal.logs.schema import commands_text
from bayescal.motion.calibrate import MotionFit
from bayescal.motion.diagnose import Tracking
from bayescal.motion.estimate import contradicted
from bayescal.motion.fit_settings import CALIBRATION
from bayescal.motion.together import Together
from bayescal.posterior.inference import Record, save
from bayescal.preparing.next_motions import PAUSE, MotionPlan
from bayescal.reporting import motion as sheets
from bayescal.reporting.fit import record as contacts
from bayescal.reporting.motion.record import LIBRARIES, controller, origin, shown_unit, write_arm
from bayescal.reporting.origin import plain, software
from bayescal.reporting.page.build import write_page
from bayescal.reporting.sheet import Column, Sheet, below, headed, screen, sheet_of_cells, terminal
from bayescal.reporting.text import Facts, listed, p_value, under
from bayescal.statistics import chi2_sf
from bayescal.storage.files import json_text
from bayescal.storage.folders import filled, put, whole
from bayescal.storage.reading import TOGETHER, Json
from bayescal.verifying.log import SLIDING, LogVerification

SCHEMA = "bayescal-fit/1"
FIT, POSTERIOR = "fit.json", "posterior.nc"


def fit_record(fit: MotionFit) -> dict[str, Any]:
    """The contents of fit.json; a value that is not finite is null."""
    unit, by = shown_unit(fit.log)
    record = {
        **origin(SCHEMA, fit.log, fit.seed),
        "model": ["inertials", "armature", "coulomb", "viscous", "offset", "alignment"],
        "parameters": [{**vars(p), "identifiable": p.identifiable} for p in fit.parameters],
        "determined": fit.determined,
        "combinations": list(fit.combinations),
        "withheld": [
            {
                "joint": w.joint,
                f"nominal_rms_{unit}": x * w.nominal,
                f"rms_{unit}": x * w.fitted,
                f"expected_rms_{unit}": x * w.expected,
                f"expected_interval95_{unit}": [x * end for end in w.interval95],
            }
            for w, x in zip(fit.withheld, by, strict=False)
        ],
        "noise": {"lag1": fit.lag1},
        "gravity_mps2": fit.log.gravity,
        "controller": controller(fit.log),
        "torque_shift_ms": 1e3 * fit.shift,
        "draws": fit.draws.shape[0] * fit.draws.shape[1],
        "motions": [{"id": m.name, "role": m.role, "kind": m.kind} for m in fit.log.motions],
        "words": (words := doubts(fit)),
        "warnings": [*words, *fit.limits, *_warnings_of(fit)],
    }
    return plain(record)


def doubts(fit: MotionFit) -> list[str]:
    """Joints whose withheld errors the fit does not explain, and those that it predicts worse than no fit."""
    (unit, by), out = shown_unit(fit.log), []
    errors = list(zip(fit.withheld, by, strict=False))
    what, word = ("servo error", "deg") if unit == "deg" else ("torque", "N m")
    beyond = [(w, x, w.expected) for w, x in errors if w.fitted > w.interval95[1]]
    worse = [(w, x, w.nominal) for w, x in errors if w.fitted > CALIBRATION.worse * w.nominal]
    for which, than in ((beyond, "is expected"), (worse, "the nominal arm does")):
        if which:
            each = ", ".join(f"{w.joint} {x * w.fitted:.3g} for {x * of:.3g} {word}" for w, x, of in which)
            out.append(
                f"the fit does not explain the {what} of withheld motions: more error than {than} ({each}); "
                "bayescal gap looks for the cause"
            )
    return out


def _warnings_of(fit: MotionFit) -> list[str]:
    """Parameters far from their priors, chains that disagree, and what is not written."""
    far = [p.name for p in fit.parameters if abs(p.estimate - p.nominal) > FAR * p.prior_sd]
    out = contradicted(far)
    if fit.r_hat > CALIBRATION.r_hat:
        out.append(f"chains of the sampler disagree (R-hat {fit.r_hat:.2f}): u of parameters may be wrong")
    if fit.mechanism.coupled:
        out.append("the joints are coupled, which arm.yaml cannot hold: it is not written")
    return out


def fit_summary(record: Json, verbose: bool = False) -> RenderableType:
    """Withheld errors, parameters that the log determines, combinations."""
    words = (Text(f"{line[0].upper()}{line[1:]}.", "bold red") for line in record["words"])
    parameters = terminal(sheets.parameter_sheet(record, verbose))
    withheld = below(sheets.withheld_sheet(record))
    return screen(sheets.title(record), *words, *withheld, "", parameters, _facts(record))


def _facts(record: Json) -> Facts:
    total = len(record["parameters"])
    words = f"{record['determined']} of {total} directions of the parameters, better than half their prior"
    yield "determined", words, ""
    yield from under("only together", record["combinations"], "dim")
    shift = record["torque_shift_ms"]
    if record["unit"] == "deg":
        yield "commands", f"acted on after {shift:.0f} ms, beside viscous friction", "dim"
    else:
        when = "later" if shift >= 0 else "earlier"
        yield "torque", f"{abs(shift):.2f} ms {when} than the positions", "dim"
    yield from under("warning", [x for x in record["warnings"] if x not in record["words"]], "yellow")


def draws_of(fit: MotionFit) -> Record:
    """The posterior for ArviZ, one variable for all parameters."""
    names = [p.name for p in fit.parameters]
    groups = {"posterior": {"parameter_value": (("parameter",), fit.draws)}}
    units = {"parameter_value": "SI, see the coordinate unit"}
    labels = {"unit": ("parameter", [p.unit for p in fit.parameters])}
    return Record(groups, {"parameter": names}, units, {"log": fit.log.name}, labels)


def write_fit(
    fit: MotionFit, folder: Path, contents: Mapping[str, Any], shown: Path | None = None
) -> tuple[str, ...]:
    """Write fit.json, report.html, posterior.nc, arm.yaml and the log atomically; return their names.

    `shown` is where the folder will be, for the page.
    """
    with whole(folder, FIT) as stage:
        put(stage, {FIT: json_text(contents, rows=False)})
        save(draws_of(fit), stage / POSTERIOR)
        return FIT, write_page(stage, shown or folder), POSTERIOR, *write_arm(fit.mechanism, fit.log, stage)


CONTACTS, LOG = "contacts", "log"
"""Run folders of the two, in that of both."""
UNLIKELY = 0.01
"""P of the change of the masses, below which the two contradict each other (convention)."""


def together_record(result: Together) -> dict[str, Any]:
    """The contents of fit.json."""
    log, session = result.log.log, result.contacts.dataset
    p = float(chi2_sf(result.chi2, result.dof)) if result.dof else 1.0
    record = {
        "schema": SCHEMA, "unit": TOGETHER, "session": session.name,
        "log": {"name": log.name, "sha256": log.digest}, "software": software(LIBRARIES),
        "seed": result.log.seed, "robot": session.robot.name,
        "shared": [vars(s) | {"alone": _with_u(s.alone), "both": _with_u(s.both)} for s in result.shared],
        "agreement": {"chi2": result.chi2, "dof": result.dof, "p": p}, "fits_of_session": result.rounds,
        "warnings": _warnings(result, p),
    }  # fmt: skip
    return plain(record)


def _with_u(value: tuple[float, float]) -> Json:
    return dict(zip(("estimate", "u"), value, strict=True))


def _warnings(result: Together, p: float) -> list[str]:
    out = [f"{CONTACTS}: {text}" for text in result.contacts.warnings]
    out += [f"{LOG}: {text}" for text in result.log.limits]
    if p < UNLIKELY:
        out.append(
            f"the session and the log contradict each other in the masses (P {p_value(p)}): another tool, "
            "payload or model; fit them one by one"
        )
    return out


def together_summary(record: Json, verbose: bool = False) -> RenderableType:
    """Parameters by one alone and by both."""
    title = headed(f"{record['session']} + {record['log']['name']}", record["robot"], "fitted together")
    return screen(title, "", terminal(sheets.together_sheet(record, verbose)), _shared(record))


def _shared(record: Json) -> Facts:
    a = record["agreement"]
    words = f"chi-square {a['chi2']:.3g} of {a['dof']} directions of the masses that both determine"
    yield "agreement", f"{words} (P {p_value(a['p'])})", ""
    yield "", f"{CONTACTS}/ and {LOG}/ are the run folders of the two", "dim"
    yield from under("warning", record["warnings"], "yellow")


def write_together(
    result: Together, folder: Path, contents: Mapping[str, Any], pictures: bool
) -> tuple[str, ...]:
    """Write fit.json and the run folders of both atomically; return the names."""
    with whole(folder, FIT) as stage:
        put(stage, {FIT: json_text(contents, rows=False)})
        of_both = contacts.fit_record(result.contacts)
        contacts.write_fit(result.contacts, stage / CONTACTS, of_both, pictures, folder / CONTACTS)
        write_fit(result.log, stage / LOG, fit_record(result.log), folder / LOG)
        return FIT, CONTACTS, LOG


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
        return "-" if values is None else " ".join(sheets.newton_metres(abs(x)) for x in values)

    rows = [(words, unit, joined(x), joined(e.mrad(unit, x))) for words, unit, x in e.left_out]
    title = headed(e.robot, f"{e.format}: {CONTENT[e.format]}")
    heads = ("not in the file", "unit", "joint by joint", "mrad of position")
    return screen(title, terminal(sheet_of_cells(heads, rows)))


def verify_summary(v: LogVerification) -> RenderableType:
    """Torque errors of withheld motions in the simulator, joint by joint."""
    errors = (map(sheets.newton_metres, x) for x in (v.nominal, v.fitted))
    rows = list(zip(v.joints, *errors, map("{:.1e}".format, v.difference), strict=True))
    what = f"torque residual in the simulator, joints faster than {SLIDING} rad/s (N m RMS)"
    headings = (what, "nominal", "fitted", "simulator - model")
    no, colour = ("", "green") if v.passed else ("not ", "red")
    verdict = Text(f"the file is {no}the arm that was fitted", f"bold {colour}")
    title = headed(v.name, f"{v.path} in {v.software}, {v.rows} rows of withheld motions")
    parts = title, verdict, sheet_of_cells(headings, rows), ""
    if isinstance(v.tracking, str):
        return screen(*parts, Text(f"not replayed: {v.tracking}", "dim"))
    return screen(*parts, replay_sheet(v.joints, v.tracking))


def replay_sheet(joints: Sequence[str], arms: Mapping[str, Tracking]) -> Sheet:
    """Errors of withheld motions that the simulator moves by the logged commands alone, joint by joint."""
    names = {"nominal": "nominal", "model": "fitted", "effects": "with the effects"}
    sizes = {f"{names[a]}, deg": np.rad2deg(of.rms) for a, of in arms.items()}
    sizes |= {f"{names[a]}, N m": of.torque for a, of in arms.items()}
    rows = zip(joints, *(map(sheets.newton_metres, x) for x in sizes.values()), strict=True)
    return sheet_of_cells(("open-loop replay of the commands (RMS)", *sizes), rows)


PLAN_SCHEMA = "bayescal-plan/1"
STATED = ("rate_hz", "pause_s", "first_pose_deg", "bounds", "warnings", "left_out", "motions")
"""Keys of plan.json that are also beside the commands."""
PLAN, COMMANDS, PURPOSES = "plan.json", "next-motions.csv", "next-motions.yaml"


def motions_of(plan: MotionPlan) -> list[dict[str, Any]]:
    """The motions as entries of a record."""
    return [
        {"id": m.name, "kind": m.purpose.kind, "role": m.purpose.role, "same_as": m.same_as or m.name,
         "loaded": m.loaded, "times": m.purpose.times, "from_s": round(float(time[0]), 6),
         "to_s": round(float(time[-1]), 6), "for": list(m.purpose.effects), "words": m.purpose.words}
        for m, time in plan.timed
    ]  # fmt: skip


def plan_record(plan: MotionPlan) -> dict[str, Any]:
    """The contents of plan.json."""
    b = plan.bounds
    sizes = {
        "lowest_deg": np.degrees(b.low),
        "highest_deg": np.degrees(b.high),
        "speed_degps": np.degrees(b.speed),
        "acceleration_degps2": np.degrees(b.acceleration),
        "torque_Nm": b.torque,
    }
    bounds = {key: [round(x, 3) if np.isfinite(x) else None for x in v.tolist()] for key, v in sizes.items()}
    record = {
        **origin(PLAN_SCHEMA, b.log, 0), "rate_hz": round(1.0 / b.step, 6), "pause_s": PAUSE,
        "first_pose_deg": np.degrees(b.home),
        "bounds": {**bounds, "clear_of_itself": b.clearance is not None}, "motions": motions_of(plan),
        "left_out": list(plan.left_out), "warnings": list(b.assumed),
    }  # fmt: skip
    return plain(record)


def files_of(plan: MotionPlan) -> dict[str, str]:
    """The table of commands and what each motion is for, by the names of the files; none without motions."""
    if not plan.motions:
        return {}
    record = {"commands": COMMANDS} | {key: plan_record(plan)[key] for key in STATED}
    table = commands_text((m.name, time, m.position) for m, time in plan.timed)
    text = yaml.safe_dump(record, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    return {COMMANDS: table, PURPOSES: text}


def motion_sheet(record: Json) -> Sheet:
    """The motions that are to be logged."""
    columns = (
        Column("motion", "id"),
        Column("from (s)", "from_s", lambda x: f"{x:.0f}"),
        Column("to (s)", "to_s", lambda x: f"{x:.0f}"),
        Column("payload", "loaded", lambda x: "yes" if x else "no"),
        Column("times", "times"),
        Column("for", "words", words=True),
    )
    return Sheet(columns, record["motions"])


def plan_summary(record: Json) -> RenderableType:
    """The motions, and what is left out."""
    title = sheets.headed(record["dataset"]["name"], record["robot"], "motions to log next")
    if not record["motions"] and not record["left_out"]:
        return screen(title, "The log lacks no motion.")
    rows = [*under("left out", record["left_out"]), *under("assumed", record["warnings"], "yellow")]
    return screen(title, "", terminal(motion_sheet(record)), rows)


def advice_of(plan: MotionPlan) -> list[str]:
    """The motions in a line, for the advice of a diagnosis."""
    if not plan.motions:
        return list(plan.left_out)
    names = dict.fromkeys(m.same_as or m.name for m in plan.motions)
    count = len(plan.motions)
    which = "the motion" if count == 1 else f"the {count} motions"
    return [f"run {which} of {COMMANDS}: {listed(names)}", *plan.left_out]


def write_plan(plan: MotionPlan, folder: Path, record: Json) -> tuple[str, ...]:
    """Write plan.json and the files of commands atomically; return their names."""
    return filled(folder, {PLAN: json_text(record, rows=False), **files_of(plan)})
