"""gap.json of a joint log, by the output contract, and its folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset.types import Record
from bayescal.exporting.log_arm import ARM_FILE
from bayescal.logs import Log, Mechanism
from bayescal.logs.schema import arm_text
from bayescal.logs.types import SERVO, TORQUE
from bayescal.motion.diagnose import Amplitude, MotionGap, Place, Shrinkage
from bayescal.motion.effects import EFFECTS, Form, at_speed, title_of
from bayescal.motion.quantities import UNKNOWN
from bayescal.motion.search import OTHER, Hypothesis
from bayescal.motion.signals import root_mean_square, where_moving
from bayescal.reporting.motion import size_text
from bayescal.reporting.origin import entry, plain, record_of, software
from bayescal.reporting.page.build import write_page
from bayescal.reporting.text import LEAST, SURE, listed, probability
from bayescal.storage.files import json_text
from bayescal.storage.folders import put, whole

SCHEMA = "bayescal-gap/1"
GAP = "gap.json"
LIBRARIES = ("numpy", "scipy")
UNIT = "Nm"
COPY = "dataset"
MOST_COPIED = 100_000_000
"""Bytes of a log that is copied into its run folder."""


MOST_REMOVED = 0.99
"""Share of a variance that is stated as a number: no model removes all."""
GROWN = 1.1
"""Factor on the withheld error of a joint from which on the headline states its increase (convention)."""
SITES = {"tool": "the tool", "base": "the base", "log": "the log"}
"""Sites other than joints in words."""


def origin(schema: str, log: Log, seed: int) -> dict[str, Any]:
    """Schema, log with its hash, software, seed."""
    return {
        "schema": schema, "dataset": {"name": log.name, "sha256": log.digest}, "record": record_of(Record()),
        "software": software(LIBRARIES), "seed": seed, "unit": shown_unit(log)[0],
        "robot": log.mechanism.name, "joints": list(log.mechanism.joint_names),
    }  # fmt: skip


def site_of(form: Form) -> str:
    """The site of a form; of one with a value for each joint these."""
    return "all joints" if form.of_each else form.site


def size_of(a: Amplitude) -> str:
    """An amplitude with its standard uncertainty and unit; where each joint has its own, all of them."""
    if a.form.of_each:
        return ", ".join(f"{name} {size_text(value, u, a.unit)}" for name, (value, u) in a.components.items())
    return f"{a.part} {size_text(a.value, a.u, a.unit)}".strip()


CORRECT = "Correct what the warnings state of the log, or of the masses of its robot. Then diagnose it again."


def motion_record(gap: MotionGap) -> dict[str, Any]:
    """The contents of gap.json; a value that is not finite is null."""
    v, log, s = gap.verdict, gap.estimate.parts[0].log, gap.shrinkage
    unit, by = shown_unit(log)
    errors = {
        f"before_rms_{unit}": by * s.before,
        f"after_rms_{unit}": by * s.after,
        f"floor_{unit}": by * s.expected.rms,
        f"expected_interval95_{unit}": (by * s.expected.interval95).T,
        **entry(s, "removed", "removed_interval95", "delta_elpd=gain"),
    }
    servo = log.torque_kind == SERVO
    record = {
        **origin(SCHEMA, log, 0),
        "baseline": ["inertials", "armature", "coulomb", "viscous", "offset", "alignment"],
        "verdict": v.kind,
        "words": words(gap),
        "effects": v.named.names,
        "named": [_named(gap, m.form.effect) for m in v.named.members],
        "amplitudes": [_amplitude(a) for a in gap.amplitudes],
        **entry(v, "credible_set90=credible", "probability"),
        "hypotheses": [
            {"effects": list(n), "probability": p, "log_evidence": nats} for n, p, nats in gap.hypotheses
        ],
        "class": _class(v.members, v.leading),
        "where": [_place(p, unit, by) for p in gap.where],
        "torque_rms_Nm": None if servo else {"before": s.before, "after": s.after},
        "shrinkage": {
            "torque": None if servo else errors,
            "tracking": {**errors, "replay": _replay(gap)} if servo else _replay(gap),
        },
        "withheld": {
            **entry(s.course, "motion", "time_s=time"),
            f"before_{unit}": (by * s.course.before).T,
            f"after_{unit}": (by * s.course.after).T,
        },
        "noise": {
            "lag1": gap.estimate.noise.lag1[: log.n],
            f"floor_{unit}": by * s.expected.floor,
            "stated_Nm": None if servo else log.noise,
        },
        "not_assessed": [{"effect": name, "why": why} for name, why in gap.not_assessed.items()],
        "missing": gap.not_assessed,
        "mistaken": log.mistaken,
        "next": [CORRECT] if log.mistaken else gap.advice,
        "parameters": [{"name": n, "deviation": v, "u": gap.u[n]} for n, v in gap.values.items()],
        "motions": [{"id": m.name, "role": m.role, "kind": m.kind, "rows": len(m.time)} for m in log.motions],
        "arm": gap.arm.values,
        "beside": [
            {"effect": name, "unit": unit, "of_joints": x} for name, (unit, x) in gap.arm.sizes().items()
        ],
        "gravity_mps2": gap.arm.gravity,
        "controller": controller(log),
        "torque_shift_ms": 1e3 * (log.alignment + gap.arm.values.get("alignment", 0.0)),
        "warnings": gap.warnings,
    }
    return plain(record)


def controller(log: Log) -> dict[str, Any]:
    """The controller of a log."""
    c = log.controller
    return {"kind": c.kind, "kp_Nm_per_rad": c.stiffness, "kd_Nms_per_rad": c.damping}


def shown_unit(log: Log) -> tuple[str, np.ndarray]:
    """Unit of residuals in keys, and the factor (n,) to it: of servos without torques errors of position."""
    if log.torque_kind != SERVO or log.controller.stiffness is None:
        return UNIT, np.ones(log.n)
    return "deg", np.rad2deg(1.0 / log.controller.stiffness)


def _replay(gap: MotionGap) -> dict[str, Any]:
    """Errors of withheld motions that MuJoCo moves by the logged commands, or why there are none."""
    of = gap.tracking
    if isinstance(of, str):
        return {"not_assessed": of}
    before, after = of["model"], of.get("effects", of["model"])
    removed, interval = after.removed(before) if "effects" in of else (None, None)
    control, deg = gap.estimate.parts[0].log.controller, 180.0 / np.pi
    stated = control.stiffness is not None and control.stated
    arms = {"nominal": of["nominal"], "before": before, "after": after}
    return {
        **{f"{name}_rms_deg": deg * arm.rms for name, arm in arms.items()},
        "removed": removed,
        "removed_interval95": interval,
        **{f"{name}_torque_rms_Nm": arm.torque for name, arm in arms.items()},
        "simulator": "MuJoCo",
        "motions": before.motions,
        "controller": "stated" if stated else "estimated from the log",
    }


def _named(gap: MotionGap, effect: str) -> dict[str, Any]:
    sizes = [a for a in gap.amplitudes if a.form.effect == effect]
    form = sizes[0].form
    return {
        **vars(form),
        "probability": gap.verdict.probability[effect],
        "relevant": any(a.relevant for a in sizes),
        "text": f"{site_of(form)}: {title_of(form)}, {size_of(sizes[0])}",
        "remedy": EFFECTS[effect].remedy,
    }


def _amplitude(a: Amplitude) -> dict[str, Any]:
    return {
        **vars(a.form),
        **entry(a, "value", "u", "unit"),
        "text": size_of(a),
        "components": {
            name: {"value": value, "u": u} | ({"unit": a.units[name]} if a.units else {})
            for name, (value, u) in a.components.items()
        },
        **entry(a, "relevant", "removed_share=removed"),
    }


def _class(members: Mapping[str, float], leading: Hypothesis) -> dict[str, Any] | None:
    if not members:
        return None
    form = leading.members[0].form
    return {"sites": [form.site], "arguments": [form.driver], "members": dict(members)}


def _place(p: Place, unit: str, by: np.ndarray) -> dict[str, Any]:
    form, (key, size) = p.form, place_rms(p, unit, by)
    return {
        **entry(form, "site", "driver", "setting"),
        "text": f"{form.site}, {form.driver}" + (f" ({form.setting})" if form.setting else ""),
        **{f"rms_{unit}": None, key: size},
        "of_joint": p.joint + 1,
        "log_evidence": p.nats,
        "explained_by": p.explained_by or None,
    }


def place_rms(p: Place, unit: str, by: np.ndarray) -> tuple[str, float]:
    """The key of the size of a place, and the size: of torques in `unit`, of angles in degrees."""
    return (f"rms_{unit}", by[p.joint] * p.rms) if p.kind == TORQUE else ("rms_deg", np.rad2deg(p.rms))


def words(gap: MotionGap) -> list[str]:
    """The verdict in words, a line each."""
    v, (unit, by) = gap.verdict, shown_unit(gap.estimate.parts[0].log)
    out = []
    for m in v.named.members:
        a = next(a for a in gap.amplitudes if a.form is m.form)
        effect = EFFECTS[m.form.effect]
        p = v.probability[effect.name]
        site, word = site_of(m.form), "Effect found" if p >= SURE else "Probable effect"
        what = f"{title_of(m.form)}, {size_of(a)}{_at_speed(gap, a)}"
        out.append(f"{word} at {SITES.get(site, site)}: {what} ({_sure(p)}).")
        if not a.relevant:
            out.append(f"{effect.name} is not relevant: the withheld error changes by < 1 %.")
    if v.kind in ("unknown", "named+unexplained") and gap.where:
        place = next((p for p in gap.where if not p.explained_by), gap.where[0])
        what = "A further error" if out else "Unmodelled error: it"
        what += f" varies with {place.form.driver} at {place.form.site}"
        key, size = place_rms(place, unit, by)
        shown = f"{1e3 * size:.3g} {'mdeg' if key == 'rms_deg' else 'mN m'} RMS in joint {place.joint + 1}"
        out.append(f"{what} ({shown}); {_why_open(gap, place)}.")
    if v.kind == "class":
        names = [f"{_member(name)} ({_sure(p)})" for name, p in v.members.items()]
        form = v.leading.members[0].form
        what = f"an error at {form.site} that varies with {form.driver}"
        out.append(f"Class of causes: {what}: {listed(names, 'or')}.")
    if v.kind == "ambiguous":
        out.append(f"Ambiguous: {listed([_member(name) for name in v.credible], 'or')}.")
    if v.kind == "null":
        largest = max((LEAST, *(p for n, p in v.probability.items() if n != "null")))
        out.append(f"No effect above noise (no other cause has a probability above {largest:.2g}).")
    s, what = gap.shrinkage, "N m" if unit == UNIT else "deg"
    rows = zip(gap.estimate.parts[0].log.mechanism.joint_names, by, s.after, s.expected.rms, strict=True)
    each = [f"{name} {x * a:.3g} for {x * e:.3g} {what}" for name, x, a, e in rows]
    beyond = [text for text, over in zip(each, s.after > s.expected.interval95[1], strict=True) if over]
    if beyond and v.kind in ("null", "named"):
        out.append(
            f"Withheld motions have more error than is expected ({', '.join(beyond)}; each beyond its 95 %): "
            "something may be left."
        )
    if v.named.members and np.isfinite(gap.shrinkage.removed):
        what = "torque" if unit == UNIT else "servo error"
        change = _change(gap.shrinkage, what)
        out.append(f"On withheld motions the named effects {change}{_more(gap, unit, by)}.")
    return out


def _change(s: Shrinkage, what: str) -> str:
    """What named effects do to the withheld variance of all joints together, as the end of a sentence."""
    low, high = s.removed_interval95
    of = f"variance of the {what} above noise"
    if s.removed > 0.0:
        some = _per_cent(s.removed)
        some += "" if _per_cent(low) == some else f" ({100 * low:.0f} to {100 * high:.0f} %)"
        return f"remove {some} of the {of}"
    more = f"increases by {-100 * s.removed:.0f} % ({-100 * high:.0f} to {-100 * low:.0f} %)"
    return f"do not reduce the error of all joints together: the {of} {more}"


def _more(gap: MotionGap, unit: str, by: np.ndarray) -> str:
    """Joints whose withheld error increases with the named effects, as the end of a sentence."""
    s, what = gap.shrinkage, "N m" if unit == UNIT else "deg"
    rows = zip(gap.estimate.parts[0].log.mechanism.joint_names, by, s.before, s.after, strict=True)
    more = [f"{name} from {x * b:.3g} to {x * a:.3g} {what}" for name, x, b, a in rows if a > GROWN * b > 0.0]
    return f"; that of some joints increases ({', '.join(more)})" if more else ""


def _why_open(gap: MotionGap, place: Place) -> str:
    """Why an error has no name."""
    if place.form.effect not in EFFECTS:
        return "no known effect explains it"
    name, why = place.form.effect, "withheld motions deny it"
    if place.form in gap.unseen:
        why = "fitted motions do not show it"
    elif UNKNOWN in gap.verdict.leading.names:
        why = "it is not established beside an unknown cause"
    return f"{name} ({title_of(place.form)}) would, but {why}"


def _at_speed(gap: MotionGap, a: Amplitude) -> str:
    """Of friction by speed: its form, and its torque at the RMS speed of its joint; "" of others."""
    if not EFFECTS[a.form.effect].at_speed or not a.form.site.startswith("joint "):
        return ""
    j = int(a.form.site.split()[1]) - 1
    speed = float(root_mean_square(where_moving(s.unfiltered(s.dq), s) for s in gap.estimate.parts)[j])
    torque = float(at_speed(a.form.setting, np.array(speed)))
    what = f" {a.form.setting}" if a.form.setting else ""
    return f"{what}: {size_text(a.value * torque, a.u * torque, 'N m')} at {speed:.2g} rad/s"


def _per_cent(x: float) -> str:
    return "more than 99 %" if x > MOST_REMOVED else f"{100 * x:.0f} %"


def _member(name: str) -> str:
    if name in (OTHER, "unknown"):
        return "a cause that is not in the list"
    return "noise only" if name == "null" else EFFECTS[name].title


def _sure(p: float) -> str:
    return f"probability {probability(p)}"


def write_motion(
    gap: MotionGap, folder: Path, contents: Mapping[str, Any], further: Mapping[str, str]
) -> tuple[str, ...]:
    """Write gap.json, gap.html and further texts by name atomically; return their names."""
    with whole(folder, GAP) as stage:
        put(stage, {GAP: json_text(contents, rows=False), **further})
        written = write_arm(gap.arm.mechanism, gap.model.estimate.parts[0].log, stage)
        return GAP, write_page(stage, folder), *further, *written


def write_arm(m: Mechanism, log: Log, stage: Path) -> tuple[str, ...]:
    """Write arm.yaml, and copy the log, to be verified against; a large one is not, nor coupled joints."""
    arm = put(stage, {} if m.coupled else {ARM_FILE: arm_text(m)})
    if sum(path.stat().st_size for path in log.files) > MOST_COPIED:
        return arm
    (stage / COPY).mkdir()
    put(stage / COPY, {path.name: path.read_bytes() for path in log.files})
    return *arm, COPY
