"""`gap.json`: a diagnosis as numbers, by the output contract; units are in the keys.

The run folder of a diagnosis.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayescal.fitted import gate
from bayescal.fitted.arm import of_gap
from bayescal.fitted.file import write_arm
from bayescal.gap.result import Advice, BlindSpot, Gap, Magnitude, Margin, Place, Shrinkage, Verdict
from bayescal.model.scene import Scene
from bayescal.reporting.figures.process import begun
from bayescal.reporting.gap import causes, contacts
from bayescal.reporting.gap.contacts import as_lengths, length, main, table_of_contacts
from bayescal.reporting.gap.phrases import headline, place, warnings
from bayescal.reporting.page.build import write_page
from bayescal.reporting.shared.body import arm_drawing
from bayescal.reporting.shared.origin import origin, plain, rows_record
from bayescal.reporting.shared.text import UM, amplitude
from bayescal.storage.files import indented
from bayescal.storage.folders import whole

SCHEMA = "bayescal-gap/1"
LIBRARIES = ("gtsam", "numpy", "scipy", "numba")
MARGINS = ("target", "joint", "region", "time", "direction")
MEASURES = ("planes", "distances")
"""Keys of ``shrinkage`` that are always present, null where nothing was measured."""
EVENT = "event"
"""Kind of driver of a sudden change."""
SIGNIFICANT = 0.01
"""Corrected p-value below which figures mark a location."""
LEVER_DIGITS = 6
"""Decimals of a lever arm, m per rad or m per m."""
CURVES = 12
"""Locations, the largest first, whose curves are stored."""
DIGITS = 4
"""Decimals of curves and residuals, in µm or the unit of the coordinate: below the resolution of a probe."""


def gap_record(gap: Gap) -> dict[str, Any]:
    """The contents of gap.json; a value that is not finite is null."""
    verdict = gap.verdict
    record = {
        **origin(SCHEMA, gap.dataset, gap.seed, LIBRARIES),
        "baseline": list(gap.baseline),
        "without": list(gap.without),
        "gap": _magnitude(gap.magnitude),
        "verdict": verdict.kind,
        "words": headline(gap),
        "effects": _effects(verdict),
        "named": [
            {
                "effect": n.effect,
                "model": n.model,
                "site": n.site,
                "setting": n.setting,
                "sites": [str(site) for site in n.sites],
                "probability": n.probability,
                "log_evidence": n.log_evidence,
                "confirmed": n.confirmed,
            }
            for n in verdict.named
        ],
        "use": None if gap.arm is None else gate.of_gap(gap).record(),
        "amplitudes": causes.amplitude_records(gap),
        "refit": {"model": ",".join(gap.refit), "without": list(gap.still_without)},
        "credible_set90": list(verdict.credible_set90),
        "probability": dict(verdict.probability),
        "hypotheses": [
            {"effects": list(h.effects), "probability": h.probability, "log_evidence": h.log_evidence}
            for h in verdict.hypotheses
        ],
        "footnotes": list(verdict.footnotes),
        "missing": dict(verdict.missing),
        "notes": list(verdict.notes),
        "where": [_place(w) | causes.records(w, gap.dataset) for w in gap.where],
        "where_marginal": {key: [_margin(m) for m in gap.margins.get(key, ())] for key in MARGINS},
        "shrinkage": dict.fromkeys(MEASURES) | {s.what: _shrinkage(s) for s in gap.shrinkage},
        "lengths": _lengths(gap),
        "ladder": [
            {
                "model": list(step.model),
                "heldout_rms_um": UM * step.validation_rms,
                "distance_rms_um": UM * step.distance_rms,
                "point_rms_um": UM * step.point_rms,
                "point_length_rms_um": UM * length("points", step.point_rms),
                "delta_elpd": step.delta_elpd,
                "delta_elpd_se": step.delta_elpd_se,
            }
            for step in gap.levels
        ],
        "next": [_advice(a) | {"contacts": contacts.records(gap, a)} for a in gap.advice],
        "undecided": contacts.undecided_records(gap),
        "blind_spots": [_blind(b) for b in gap.blind_spots],
        "curves": [_curve(gap, w) for w in gap.where[:CURVES]],
        "residuals": _residuals(gap),
        "arm": arm_drawing(Scene(gap.dataset)),
        "marked": _mark(gap),
        "warnings": list(warnings(gap)),
    }
    if gap.arm is not None:
        record["rows"] = rows_record(gap.arm)
        if gap.calibrated is not None:
            before = rows_record(gap.calibrated)
            record["rows"] |= {
                "residual_before_um": before["residual_um"],
                "rejected_before": before["rejected"],
            }
    return {key: plain(value) for key, value in record.items()}


def _effects(verdict: Verdict) -> list[str]:
    """The named effects, each once; 'unknown' for an unmodelled effect alone."""
    return ["unknown"] if verdict.kind == "unknown" else list(dict.fromkeys(n.effect for n in verdict.named))


def _um(interval: tuple[float, float]) -> list[float]:
    return [UM * end for end in interval]


def _magnitude(m: Magnitude) -> dict[str, Any]:
    return {
        "heldout": m.validation,
        "heldout_rms_um": UM * m.validation_rms,
        "noise_um": UM * m.noise,
        "noise_interval95_um": _um(m.noise_interval95),
        "noise_from": m.noise_from,
        "excess_um": {"value": UM * m.excess, "interval95": _um(m.excess_interval95)},
        "measured": [
            {
                "what": x.what,
                "count": x.count,
                "rms_um": UM * x.rms,
                "predicted_rms_um": UM * x.predicted_rms,
                "predicted_interval95_um": _um(x.predicted_interval95),
            }
            for x in m.measured
        ],
    }


def _place(w: Place) -> dict[str, Any]:
    return {
        "site": str(w.site),
        "driver": str(w.driver),
        "text": place(w),
        "rms_um": UM * w.rms,
        "share": w.share,
        "p_value": w.p_value,
        "family_p_value": w.family_p_value,
        "log_evidence": w.log_evidence,
        "explained_by": w.explained_by or None,
    }


def _margin(m: Margin) -> dict[str, Any]:
    return {
        "label": m.label,
        "count": m.count,
        "rms_um": UM * m.rms,
        "mean_um": UM * m.mean,
        "p_value": m.p_value,
    }


def _shrinkage(s: Shrinkage) -> dict[str, Any]:
    return {
        "count": s.count,
        "before_rms_um": UM * s.before,
        "after_rms_um": UM * s.after,
        "floor_um": UM * s.floor,
        "removed": s.removed,
        "removed_interval95": list(s.removed_interval95),
        "predicted_before_rms_um": UM * s.predicted_before,
        "predicted_rms_um": UM * s.predicted,
        "claimed": s.claimed,
    }


def _lengths(gap: Gap) -> dict[str, Any]:
    """The errors as the summary states them: of points, the length of the error vector."""
    m, what = gap.magnitude, main(gap)
    return {
        "of": what,
        "validation_rms_um": UM * length(what, m.validation_rms),
        "noise_um": UM * length(what, m.noise),
        "excess_um": UM * length(what, m.excess),
        "shrinkage": {
            s.what: {"before_rms_um": UM * s.before, "after_rms_um": UM * s.after, "floor_um": UM * s.floor}
            for s in map(as_lengths, gap.shrinkage)
        },
    }


def _advice(a: Advice) -> dict[str, Any]:
    return {
        "separates": list(a.separates),
        "what": a.what,
        "poses": [np.degrees(pose) for pose in a.poses],
        "poses_unit": "deg",
        "lambda_before": a.lambda_before,
        "lambda_after": a.lambda_after,
    }


def _blind(b: BlindSpot) -> dict[str, Any]:
    smallest, unit = amplitude(b.smallest, b.unit)
    plausible, _ = amplitude(b.plausible, b.unit)
    return {
        "effect": b.effect,
        "site": str(b.site),
        "smallest_nameable": {"value": smallest, "unit": unit},
        "plausible": {"value": plausible, "unit": unit},
        "distance_error_um": UM * b.distance_error,
    }


def _curve(gap: Gap, w: Place) -> dict[str, Any]:
    """The data of a curve of `gap-where.png`; x in the unit that the coordinate states.

    `lever` is the residual per unit of the displacement of the site, m per `lever_unit` (SI); null where the
    site has no single axis. `event`: a sudden change, which is one at whichever site it is seen.
    """
    ids, curve = gap.dataset.measurements.ids, w.curve
    return {
        "site": str(w.site),
        "driver": str(w.driver),
        "text": place(w),
        "event": w.driver.kind == EVENT,
        "coordinate": curve.coordinate,
        "lever": None if curve.lever is None else np.round(curve.lever, LEVER_DIGITS),
        "lever_unit": curve.unit or None,
        "id": [ids[row] for row in curve.rows],
        "x": np.round(curve.x, DIGITS),
        "residual_um": np.round(UM * curve.residual, DIGITS),
        "fitted_um": np.round(UM * curve.fitted, DIGITS),
    }


def _mark(gap: Gap) -> str | None:
    """The site that a drawing of the arm marks: of a named effect, else a location that is significant."""
    if gap.verdict.kind == "null":
        return None
    for n in gap.verdict.named:
        if n.sites:
            return str(n.sites[0])
    clear = [w for w in gap.where if w.family_p_value < SIGNIFICANT]
    named = [w for w in clear if w.explained_by] if gap.verdict.named else []
    unexplained = [w for w in clear if not w.explained_by]
    return next((str(w.site) for w in (*named, *unexplained)), None)


def _residuals(gap: Gap) -> dict[str, Any]:
    """The data of `gap-residuals.png`."""
    rows, before, after = gap.residuals
    ids = gap.dataset.measurements.ids
    return {
        "id": [ids[row] for row in rows],
        "before_um": np.round(UM * before, DIGITS),
        "after_um": np.round(UM * after, DIGITS),
    }


GAP = "gap.json"
NEXT = "next.csv"
"""Contacts to be measured next; only where some are advised."""


def write_gap(gap: Gap, folder: Path, pictures: bool = True) -> tuple[str, ...]:
    """Write gap.json, gap.html, arm.json with the dataset, next.csv and the figures atomically.

    Parameters
    ----------
    gap : Gap
    folder : Path
        Where they are written; an earlier diagnosis there is replaced.
    pictures : bool
        Draw the figures too.

    Returns
    -------
    tuple of str
        File names.
    """
    contents = gap_record(gap)
    record = indented(contents) + "\n"
    names = [GAP]
    arm = None if gap.arm is None else of_gap(gap)
    with whole(folder, GAP) as stage:
        drawn = begun(contents) if pictures else dict
        (stage / GAP).write_text(record, encoding="utf-8")
        if arm is not None:
            names += write_arm(arm, stage)
        if any(a.contacts for a in gap.advice):
            (stage / NEXT).write_text(table_of_contacts(gap), encoding="utf-8")
            names.append(NEXT)
        for name, content in drawn().items():
            (stage / name).write_bytes(content)
            names.append(name)
        names.insert(1, write_page(stage, folder))
    return tuple(names)
