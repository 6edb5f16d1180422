"""What all records have: origin (schema, dataset, software, seed), rows with residuals, values as JSON.

Whose error it is in images: ``images`` of the records, lines of the terminal, a table of the page.
"""

import platform
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from operator import attrgetter
from typing import Any

import numpy as np

from bayescal import __version__
from bayescal.assess.images import images
from bayescal.dataset import Dataset
from bayescal.dataset.types import Record
from bayescal.effects.common import STANDSTILL
from bayescal.effects.location import Driver, Site
from bayescal.effects.vocabulary import UNITS
from bayescal.estimate import Estimate
from bayescal.reporting.sheet import Column, Sheet
from bayescal.reporting.text import MDEG, MM, UM, Facts, amplitude, under, with_u
from bayescal.storage.reading import Json

LIBRARIES = ("gtsam", "numpy", "scipy", "numba")
"""Of which most results state the versions."""
SERIALS = ("arm", "probe", "artefact", "instrument")
NOT_STATED = "not stated"


def origin(schema: str, dataset: Dataset, seed: int, libraries: Iterable[str] = LIBRARIES) -> dict[str, Any]:
    """Schema, dataset (and each of several sessions) with its hash, its record, all software, seed."""
    named: dict[str, Any] = entry(dataset, "name", "sha256")
    if dataset.sessions:
        named["sessions"] = [
            entry(s, "name", "sha256") | {"rows": len(s.measurements.ids), "record": record_of(s.record)}
            for s in dataset.sessions
        ]
    return {
        "schema": schema,
        "dataset": named,
        "record": record_of(dataset.record),
        "software": software(libraries),
        "seed": seed,
    }


def record_of(record: Record) -> dict[str, Any]:
    """``record``: date, operator, serial numbers, certificates, temperature; null where not stated."""
    return {
        "date": record.date or None,
        "operator": record.operator or None,
        "serials": {what: record.serials.get(what) for what in SERIALS},
        "certificates": list(record.certificates),
        "temperature_degC": record.temperature,
    }


def filed(record: Mapping[str, Any]) -> list[tuple[str, dict[str, str]]]:
    """The header of a report: of each session its name ("" of a single one) what its ``record`` states.

    Sessions that state nothing are left out, as is the serial number of an instrument where it is not stated.
    """
    sessions = record["dataset"].get("sessions") or [{"name": "", "record": record["record"]}]
    return [(s["name"], stated) for s in sessions if (stated := _stated(s["record"]))]


def _stated(record: Mapping[str, Any]) -> dict[str, str]:
    serials, warm = record["serials"], record["temperature_degC"]
    values = {
        "Date": record["date"],
        "Operator": record["operator"],
        **{f"Serial number, {what}": serials[what] for what in SERIALS[:3]},
        **({"Serial number, instrument": serials["instrument"]} if serials["instrument"] else {}),
        "Certificates": ", ".join(record["certificates"]),
        "Temperature": None if warm is None else f"{warm:g} °C",
    }
    return {k: v or NOT_STATED for k, v in values.items()} if any(values.values()) else {}


def filed_lines(record: Mapping[str, Any]) -> Facts:
    """The same as lines of the terminal, without what is missing."""
    lines = [
        "; ".join(f"{k[:1].lower()}{k[1:]} {v}" for k, v in entries.items() if v != NOT_STATED)
        for _, entries in filed(record)
    ]
    return under("record", lines, "dim")


def software(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of bayescal, Python and the libraries."""
    ours = {"bayescal": __version__, "python": platform.python_version()}
    return ours | {name: version(name) for name in libraries}


def plain(value: Any) -> Any:
    """The same with lists, Python numbers and texts, None for every number that is not finite."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        finite = np.isfinite(value)
        return (value if np.all(finite) else np.where(finite, value, np.array(None))).tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value) if isinstance(value, Site | Driver) else value


FACTORS = {"um": UM, "mm": MM, "mdeg": MDEG}
"""From SI, by the unit at the end of a key."""


def entry(result: Any, *fields: str, unit: str = "") -> dict[str, Any]:
    """An entry of a record: values of a result as JSON, each by its key.

    A key is the name of the attribute, with the unit of the entry behind it: ``rms_um`` is ``rms``, m, in µm;
    or the attribute is another one: ``U_um=expanded``, ``site=parameter.site``. With `unit`, the other values
    are numbers in it (SI), and are stated in the unit of files.
    """
    out, of_files = {}, UNITS[unit][1] if unit else None
    for key, _, path in (field.partition("=") for field in fields):
        stem, _, end = key.rpartition("_")
        value = attrgetter(path or (stem if end in FACTORS else key))(result)
        out[key] = plain(scaled(value, FACTORS.get(end, of_files)))
    return out


def sized(result: Any, *fields: str) -> dict[str, Any]:
    """Sizes of an error, which a result has in SI, in the unit of files, lengths in µm; and this `unit`."""
    values = {field: plain(amplitude(getattr(result, field), result.unit)[0]) for field in fields}
    return values | {"unit": amplitude(0.0, result.unit)[1]}


def scaled(value: Any, factor: float | None) -> Any:
    """A number, or each of several, times a factor; None is None."""
    if factor is None or value is None:
        return value
    return [factor * part for part in value] if isinstance(value, tuple) else factor * value


ROLES = ("calibrate", "validate")


def by_target(estimate: Estimate) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Of each target of the model and each role that it has: both names, rows (R,), residuals (C, R), m."""
    model, scene = estimate.model, estimate.model.scene
    for k, target in enumerate(scene.dataset.targets):
        for role in ROLES:
            rows = scene.rows_of(k, scene.rows(role))
            if len(rows) and target.name in model.block_of:
                yield target.name, role, rows, estimate.residuals(model.block(k, rows))


DIGITS = 4
"""Decimals of residuals (µm), angles (deg) and times (s)."""


def rows_record(estimate: Estimate) -> dict[str, Any]:
    """``rows`` of fit.json and gap.json: one list for each quantity, in the order of the session.

    `residual_um` is the distance of a contact from its surface (signed), of a point the length of its error
    vector, under the model of the estimate; null where the target is not part of the model. `point_mm` is
    the stylus tip (or reflector) in F0 by the nominal arm, `angle_deg` are link angles (of an arm with
    prismatic joints `joint`, in the units of ``arm.units``), and `direction` has a sign for each joint.
    """
    scene, robot = estimate.model.scene, estimate.model.scene.dataset.robot
    m, targets = scene.dataset.measurements, scene.dataset.targets
    count = len(m.ids)
    residual = np.full(count, np.nan)
    roles = np.full(count, "", dtype=object)
    for role in ROLES:
        roles[scene.rows(role)] = role
    for _, _, rows, r in by_target(estimate):
        residual[rows] = r[0] if len(r) == 1 else np.linalg.norm(r, axis=0)
    record = {
        "id": list(m.ids),
        "target": [targets[t].name for t in m.target],
        "role": roles.tolist(),
        "time_s": None if m.time is None else np.round(m.time, DIGITS),
        "point_mm": np.round(MM * scene.points, 3),
        "joint" if robot.slides.any() else "angle_deg": np.round(robot.shown(scene.q), DIGITS),
        "direction": None if m.velocity is None else _signs(m.velocity),
        "residual_um": np.round(UM * residual, DIGITS),
        "rejected": np.isin(np.arange(count), estimate.rejected),
    }
    return plain(record)


def _signs(velocity: np.ndarray) -> list[str]:
    """Directions of motion at joint velocities (N, n), a sign for each joint: ``+-0++-``."""
    moving = np.where(velocity > 0, "+", "-")
    return ["".join(row) for row in np.where(np.abs(velocity) < STANDSTILL, "0", moving).tolist()]


PART = ("side", "effect", "rms_px=rms", "u_px=u", "max_px=largest", "max_mm=length")
"""Fields of ``parts``."""


def images_record(estimate: Estimate | None) -> list[dict[str, Any]]:
    """``images``: of each fitted camera its noise, and what every side changes in its images."""
    return [
        entry(camera, "target", "images", "corners", "noise_px=noise")
        | {"parts": [entry(part, *PART) for part in camera.parts]}
        for camera in (images(estimate) if estimate is not None else ())
    ]


def images_lines(record: Json) -> Facts:
    """A line for each camera: effects and its sides, the largest first, and its noise."""
    several = len(record.get("images", ())) > 1
    lines = (f"{target}: " * several + "; ".join(words) for target, *words in _words(record))
    return under("in the images", lines)


def hand_eye_lines(record: Json) -> Facts:
    """A line for each camera: what is on the flange, in the frame of the flange, with the largest u."""
    for k, camera in enumerate(record.get("hand_eye", ())):
        t = camera["on_flange"]
        translation = ", ".join(f"{x:.3f}" for x in t["translation_mm"])
        turn = ", ".join(f"{x:.6f}" for x in t["quaternion_xyzw"])
        u = f"u {max(t['u_translation_mm']):.2g} mm, {max(t['u_rotation_deg']):.2g} deg"
        words = f"{t['child']} in {t['parent']}: {translation} mm; x y z w {turn}; {u}"
        yield "" if k else "hand-eye", words, ""


def images_keys(record: Json) -> Iterator[tuple[str, str, str]]:
    """The same as key figures of a page: a name, the largest part, and the others."""
    for target, first, *others in _words(record):
        yield f"In the images of {target}", first, "; ".join(others)


def _words(record: Json) -> Iterator[list[str]]:
    """Of each camera its target, effects, what calibration corrects, the largest first, and its noise."""
    for camera in record.get("images", ()):
        words, before = [camera["target"]], None
        for p in camera["parts"]:
            name = p["side"]
            if effect := p.get("effect", ""):
                name = f"{effect} of the {name}"
            elif before != "":
                name = f"corrected by calibration: {name}"
            size = f" RMS, at most {p['max_px']:.2g} px or {p['max_mm']:.2g} mm" if effect != before else ""
            words.append(f"{name} {_rms(p)} px{size}")
            before = effect
        yield [*words, f"noise {camera['noise_px']:.2g} px per coordinate"]


def images_sheet(record: Json) -> Sheet:
    """The same as a table."""
    columns = (
        Column("side", "side"),
        Column("effect", lambda p: p.get("effect") or "calibration"),
        Column("camera", "target"),
        Column("RMS (px)", _rms),
        Column("largest (px)", lambda p: f"{p['max_px']:.2g}"),
        Column("largest across the line of sight (mm)", lambda p: f"{p['max_mm']:.2g}"),
    )
    caption = "What the estimate changes in the images, without the place of camera and board"
    cameras = record.get("images", ())
    parts = [part | {"target": camera["target"]} for camera in cameras for part in camera["parts"]]
    return Sheet(columns, parts, caption)


def _rms(part: Json) -> str:
    return with_u(part["rms_px"], part["u_px"])
