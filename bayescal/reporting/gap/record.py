"""The run folder of a diagnosis: `gap.json`, by the output contract, and the files beside it."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset.target_kinds import plannable
from bayescal.effects import UNITS
from bayescal.errors import attempted
from bayescal.exporting.hand_eye import hand_eye_records
from bayescal.fitted import gate
from bayescal.fitted.arm import of_gap
from bayescal.fitted.file import write_arm
from bayescal.gap import result
from bayescal.gap.settings import OUTCOME
from bayescal.model.scene import Scene
from bayescal.reporting.body import arm_drawing
from bayescal.reporting.figures import begun
from bayescal.reporting.gap import causes, per_vector, phrases, table_of_contacts
from bayescal.reporting.origin import entry, images_record, origin, plain, rows_record, scaled, sized
from bayescal.reporting.page.build import write_page
from bayescal.reporting.text import UM
from bayescal.storage.files import json_text
from bayescal.storage.folders import put, whole

SCHEMA = "bayescal-gap/1"
MEASURES = ("planes", "distances")
"""Keys of ``shrinkage`` that are always present, null where nothing was measured."""
EVENT = "event"
"""Kind of driver of a sudden change."""
LEVER_DIGITS = 6
"""Decimals of a lever arm, m per rad or m per m."""
NAMED = ("effect", "model", "site", "setting", "sites", "probability", "log_evidence", "confirmed")
GROUP = ("label", "count", "rms_um", "mean_um", "p_value")
STEP = ("model", "heldout_rms_um=validation_rms", "distance_rms_um", "point_rms_um")
SHRUNK = ("before_rms_um=before", "after_rms_um=after", "floor_um")
SHRINKAGE = (
    *("count", *SHRUNK, "removed", "removed_interval95"),
    *("predicted_before_rms_um=predicted_before", "predicted_rms_um=predicted", "claimed"),
)
"""Fields of entries."""
CURVES = 12
"""Locations, the largest first, whose curves are stored."""
DIGITS = 4
"""Decimals of curves and residuals, in µm or the unit of the coordinate: below the resolution of a probe."""


def gap_record(gap: result.Gap) -> dict[str, Any]:
    """The contents of gap.json; a value that is not finite is null."""
    verdict = gap.verdict
    record = {
        **origin(SCHEMA, gap.dataset, gap.options.seed),
        **entry(gap, "baseline", "without=options.omitted", "prior_widths=options.widths"),
        "gap": _magnitude(gap.magnitude),
        "verdict": verdict.kind,
        "words": phrases.headline(gap),
        "effects": _effects(verdict),
        "named": [
            entry(n, *NAMED)
            | {"neighbours": list(map(str, n.neighbours))}
            | {"possible": bool(phrases.possible(gap, n)), "established": phrases.established(gap, n)}
            | {"events": [causes.event_record(event, gap.dataset) for event in n.events]}
            for n in verdict.named
        ],
        "use": None if gap.arm is None else gate.of_gap(gap).record(),
        "amplitudes": causes.amplitude_records(gap),
        "noise_scale": {} if gap.arm is None else dict(gap.arm.weights.scale),
        "refit": {"model": ",".join(gap.refit), "without": list(map(str, gap.still_without))},
        **entry(verdict, "credible_set90", "probability"),
        "hypotheses": [entry(h, "effects", "probability", "log_evidence") for h in verdict.hypotheses],
        "class": phrases.class_record(gap),
        "not_excluded": phrases.unshown(verdict),
        **entry(verdict, "footnotes", "missing", "notes"),
        "where": [_place(w, gap) | causes.records(w, gap.dataset) for w in gap.where],
        "where_marginal": {
            key: [entry(m, *GROUP) for m in gap.margins.get(key, ())] for key in result.MARGINS
        },
        "shrinkage": dict.fromkeys(MEASURES) | {s.what: entry(s, *SHRINKAGE) for s in gap.shrinkage},
        "lengths": _lengths(gap),
        "images": images_record(gap.arm or gap.calibrated),
        "ladder": [
            entry(step, *STEP)
            | {"point_length_rms_um": UM * per_vector("points", phrases.components(gap)) * step.point_rms}
            | entry(step, "delta_elpd", "delta_elpd_se")
            for step in gap.levels
        ],
        "next": [
            _advice(a, gap.dataset.robot) | {"contacts": contact_records(a, number, gap.dataset.robot)}
            for number, a in enumerate(gap.advice, 1)
        ],
        "undecided": undecided_records(gap),
        "plannable": plannable(gap.dataset),
        "blind_spots": [_blind(b) for b in gap.blind_spots],
        "curves": [_curve(gap, w) for w in gap.where[:CURVES]],
        "residuals": _residuals(gap),
        "arm": arm_drawing(Scene(gap.dataset)),
        "marked": _mark(gap),
        "not_located": list(gap.unlocated),
        "warnings": list(phrases.warnings(gap)),
        "masses": gap.masses,
    }
    if gap.arm is not None:
        record["rows"] = rows_record(gap.arm)
        if gap.calibrated is not None:
            before = rows_record(gap.calibrated)
            record["rows"] |= {
                "residual_before_um": before["residual_um"],
                "rejected_before": before["rejected"],
            }
    return plain(record)


def _effects(verdict: result.Verdict) -> list[str]:
    """The named effects, each once; 'unknown' for an unmodelled effect alone."""
    return ["unknown"] if verdict.kind == "unknown" else list(dict.fromkeys(n.effect for n in verdict.named))


def _magnitude(m: result.Magnitude) -> dict[str, Any]:
    keys = ("what", "count", "rms_um", "predicted_rms_um", "predicted_interval95_um")
    return (
        entry(m, "heldout=validation", "heldout_rms_um=validation_rms")
        | entry(m, "noise_um", "noise_interval95_um", "noise_from")
        | {"excess_um": {"value": UM * m.excess, "interval95": [UM * end for end in m.excess_interval95]}}
        | {"measured": [entry(x, *keys) for x in m.measured]}
    )


def _place(w: result.Place, gap: result.Gap) -> dict[str, Any]:
    """A location; its share is of the excess of the fitted contacts, None if validation shows none."""
    return (
        entry(w, "site", "driver")
        | {"text": phrases.place(w, gap.dataset)}
        | entry(w, "rms_um", "share", "p_value", "family_p_value", "log_evidence")
        | ({} if gap.magnitude.excess_interval95[0] > 0 else {"share": None})
        | {"explained_by": w.explained_by or None, "neighbours": list(map(str, w.neighbours))}
    )


def _lengths(gap: result.Gap) -> dict[str, Any]:
    """The errors as the summary states them: of points, the length of the error vector.

    `of` is the kind of measurement with which the gap is compared: contacts where there are any.
    """
    kinds = [x.what for x in gap.magnitude.measured] or [result.VALIDATION_CONTACTS]
    what = result.VALIDATION_CONTACTS if result.VALIDATION_CONTACTS in kinds else result.VALIDATION_POINTS
    sizes = entry(gap.magnitude, "validation_rms_um", "noise_um", "excess_um")
    shrunk = {s.what: entry(s, *SHRUNK) for s in gap.shrinkage}
    count = phrases.components(gap)
    return {
        "of": what,
        "components": count,
        **{key: scaled(size, per_vector(what, count)) for key, size in sizes.items()},
        "shrinkage": {
            kind: {key: scaled(size, per_vector(kind, count)) for key, size in errors.items()}
            for kind, errors in shrunk.items()
        },
    }


def _advice(a: result.Advice, robot: Robot) -> dict[str, Any]:
    poses = {"poses": [robot.shown(pose) for pose in a.poses], "poses_unit": robot.unit_words}
    return entry(a, "separates", "what") | poses | entry(a, "lambda_before", "lambda_after")


def contact_records(advice: result.Advice, number: int, robot: Robot) -> list[dict[str, Any]]:
    """The contacts of an advice in gap.json: ``next-1-001`` is the first contact of the first advice.

    Of an arm with prismatic joints `units` are those of its joints.
    """
    slides = bool(robot.slides.any())
    position, speed, more = (
        ("j", "j_per_s", {"units": list(robot.units)}) if slides else ("j_deg", "j_degps", {})
    )
    return [
        {
            "id": f"next-{number}-{k:03d}",
            "target": c.target,
            "tool": c.tool,
            position: list(robot.shown(c.readings)),
            speed: None if c.velocity is None else list(robot.shown(c.velocity)),
            **more,
            "payload_kg": c.payload,
            "repeat_of": c.repeat_of,
        }
        for k, c in enumerate(advice.contacts, start=1)
    ]


def undecided_records(gap: result.Gap) -> list[dict[str, Any]]:
    """Pairs of explanations, each side with its effects as for --model and their fitted parameters."""
    sides = ("a", "b", "common")
    return [{side: _side(getattr(pair, side)) for side in sides} for pair in gap.undecided]


def _side(side: result.Side) -> list[dict[str, Any]]:
    return [
        {
            "model": s.model,
            "values": [
                {"parameter": name, "value": value * factor, "unit": unit}
                for name, value in s.values.items()
                for unit, factor in (UNITS[s.units[name]],)
            ],
        }
        for s in side
    ]


def _blind(b: result.BlindSpot) -> dict[str, Any]:
    size = sized(b, "smallest", "plausible")
    return {
        **entry(b, "effect", "site"),
        "smallest_nameable": {"value": size["smallest"], "unit": size["unit"]},
        "plausible": {"value": size["plausible"], "unit": size["unit"]},
        **entry(b, "distance_error_um"),
    }


def _curve(gap: result.Gap, w: result.Place) -> dict[str, Any]:
    """The data of a curve of `gap-where.png`; x in the unit that the coordinate states.

    `lever` is the residual per unit of the displacement of the site, m per `lever_unit` (SI); null where the
    site has no single axis. `event`: a sudden change, which is one at whichever site it is seen.
    """
    ids, curve = gap.dataset.measurements.ids, w.curve
    return {
        **entry(w, "site", "driver"), "text": phrases.place(w, gap.dataset), "event": w.driver.kind == EVENT,
        "coordinate": curve.coordinate,
        "lever": None if curve.lever is None else np.round(curve.lever, LEVER_DIGITS),
        "lever_unit": curve.unit or None, "id": [ids[row] for row in curve.rows],
        "x": np.round(curve.x, DIGITS), "residual_um": np.round(UM * curve.residual, DIGITS),
        "fitted_um": np.round(UM * curve.fitted, DIGITS),
    }  # fmt: skip


def _mark(gap: result.Gap) -> str | None:
    """The site that a drawing of the arm marks: of a named effect, else a location that is significant."""
    if gap.verdict.kind == "null":
        return None
    stated = [n.sites[0] for n in gap.verdict.named if n.sites]
    clear = [w for w in gap.where if w.family_p_value < OUTCOME.significant]
    named = [w.site for w in clear if w.explained_by] if gap.verdict.named else []
    others = [w.site for w in clear if not w.explained_by]
    return next(map(str, (*stated, *named, *others)), None)


def _residuals(gap: result.Gap) -> dict[str, Any]:
    """The data of `gap-residuals.png`."""
    rows, before, after = gap.residuals
    ids = gap.dataset.measurements.ids
    excluded = zip(("before", "after"), gap.excluded, strict=True)
    return {
        "id": [ids[row] for row in rows],
        **{f"excluded_{when}": np.isin(rows, of) for when, of in excluded},
        "before_um": np.round(UM * before, DIGITS),
        "after_um": np.round(UM * after, DIGITS),
    }


GAP = "gap.json"
NEXT = "next.csv"
"""Contacts to be measured next; only where some are advised."""


def write_gap(
    gap: result.Gap, folder: Path, contents: Mapping[str, Any], pictures: bool = True
) -> tuple[str, ...]:
    """Write gap.json, gap.html, arm.json with the dataset, next.csv and the figures atomically.

    Parameters
    ----------
    gap : Gap
    folder : Path
        Where they are written; an earlier diagnosis there is replaced.
    contents : mapping
        The content of gap.json.
    pictures : bool
        Draw the figures too.

    Returns
    -------
    tuple of str
        File names.
    """
    names, lost = [GAP], list[str]()
    arm = None if gap.arm is None else attempted("the file of the arm", partial(of_gap, gap), None, lost)
    with whole(folder, GAP) as stage:
        drawn = begun(contents) if pictures else dict
        if arm is not None:
            hand_eye = attempted("hand-eye transforms", partial(hand_eye_records, arm), [], lost)
            names += write_arm(arm, stage, {"hand_eye": hand_eye})
        if advised := [c for advice in contents["next"] for c in advice["contacts"]]:
            names += put(stage, {NEXT: table_of_contacts(advised)})
        names += put(stage, attempted("figures", drawn, {}, lost))
        contents = {**contents, "warnings": [*contents["warnings"], *lost]}
        put(stage, {GAP: json_text(contents, rows=False)})
        names.insert(1, write_page(stage, folder))
    return tuple(names)
