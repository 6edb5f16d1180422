"""From a parsed dataset.yaml to tools, targets and certificates in SI units, checked against each other."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import contacts
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Box, Certificate, Patch, PlanSettings, Record, Target
from bayescal.errors import BayescalError
from bayescal.storage.files import Document, Keys, in_si, stem_of, unknown

if TYPE_CHECKING:
    from bayescal.dataset import schema

NAMING = ("faces", "between", "target")
"""Keys of certificates that name targets; each kind has one of them."""

FIELDS = {"u_diameter_mm": "u_distance", "u_rad": "u_angle"}
"""Keys that fill a field of another name than their own without its unit."""

STRONGEST_GRAVITY = 20.0  # m/s2: more was written in other units


def field_of(key: str) -> str:
    """The field of a type of `dataset.types` that a key of dataset.yaml fills."""
    return FIELDS.get(key) or stem_of(key)[0]


def fields_of(entry: Keys) -> dict[str, Any]:
    """Values of an entry in SI, by the fields that they fill."""
    return {field_of(key): in_si(key, value) for key, value in entry}


def targets_of(document: Document, file: schema.DatasetFile) -> tuple[Target, ...]:
    """The targets, in the file's order; directions are normalised, or refused if far from unit length."""
    targets = []
    for name, entry in file.targets.items():
        values: dict[str, np.ndarray | float] = {}
        texts: dict[str, str] = {}
        for key in KINDS[entry.kind].keys:
            stated = getattr(entry, key)
            if isinstance(stated, str):
                texts[key] = stated
                continue
            value = in_si(key, stated)
            if key == KINDS[entry.kind].direction:
                value = _direction(document, ("targets", name), key, value)
            values[stem_of(key)[0]] = np.nan if value is None else value
        targets.append(Target(name, entry.kind, values, in_si("u_mm", entry.u_mm), entry.u_rad, texts=texts))
    return tuple(targets)


def certificates_of(
    document: Document, file: schema.DatasetFile, targets: tuple[Target, ...]
) -> tuple[Certificate, ...]:
    """The certificates; each names targets that exist and are of its kind, and nothing twice."""
    by_name = {t.name: t for t in targets}
    certificates: list[Certificate] = []
    seen: dict[tuple[str, frozenset[str]], int] = {}
    for i, entry in enumerate(file.certificates):
        where = document.where(("certificates", i))
        named = next(value for key, value in entry if key in NAMING)
        names = (named,) if isinstance(named, str) else tuple(named)
        for name in names:
            if name not in by_name:
                _, remedy = unknown("target", name, by_name)
                raise BayescalError(f"a certificate names `{name}`, which is no target", where, remedy)
            kinds = [k.name for k in KINDS.values() if len(names) == 2 or entry.kind in k.certificates]
            if by_name[name].kind not in kinds:  # of a pair, see `joins`
                what = f"a `{entry.kind}` certificate names `{name}`, a {by_name[name].kind}"
                raise BayescalError(what, where, f"name a target of kind {' or '.join(kinds)}")
        if len(set(names)) < len(names):
            raise BayescalError(f"a certificate names `{names[0]}` twice", where, "name two targets")
        first = seen.setdefault((entry.kind, frozenset(names)), i)
        if first != i:
            other = document.where(("certificates", first)).rpartition(":")[2]
            what = f"a second `{entry.kind}` certificate of {', '.join(names)}"
            raise BayescalError(what, where, f"the first is in line {other}; keep one")
        stated = {field_of(k): in_si(k, value) for k, value in entry if stem_of(k)[1]}
        if len(names) == 2:
            contacts.check(entry.kind, stated.get("distance"), [by_name[n] for n in names], where)
        certificates.append(Certificate(entry.kind, names, **stated))
    return tuple(certificates)


def gravity_of(document: Document, file: schema.DatasetFile) -> np.ndarray:
    """Gravity in F0, m/s2; zero is allowed (not modelled)."""
    gravity = np.array(file.gravity_mps2)
    if np.linalg.norm(gravity) > STRONGEST_GRAVITY:
        where = document.where(("gravity_mps2",))
        raise BayescalError(f"gravity of {np.linalg.norm(gravity):g} m/s2", where, "on earth it is 9.81 m/s2")
    return gravity


def holding(document: Document, file: schema.DatasetFile, robot: Robot) -> Robot:
    """The robot with what its first flange carries; refused of an arm that stands on F0."""
    if file.held is None:
        return robot
    if robot.ground is None:
        remedy = "leave it out; a tool has `mass_kg`"
        raise BayescalError(
            "`held` is of two arms, and F0 of this one stands still", document.where(("held",)), remedy
        )
    stated = fields_of(file.held)
    ground = replace(robot.ground, held=stated["mass"], held_centre=stated["centre_of_mass"])
    return replace(robot, ground=ground)


def plan_of(
    document: Document, file: schema.DatasetFile, targets: tuple[Target, ...], robot: Robot
) -> PlanSettings | None:
    """What is stated under `plan`; every region is on the target of its name."""
    stated, n = file.plan, robot.n
    if stated is None:
        return None
    by_name = {t.name: t for t in targets}
    regions = {}
    for name, entry in stated.regions.items():
        path = ("plan", "regions", name)
        if name not in by_name:
            _, remedy = unknown("target", name, by_name)
            raise BayescalError(f"a region of `{name}`, which is no target", document.where(path), remedy)
        along = None if entry.along is None else _direction(document, path, "along", np.array(entry.along))
        regions[name] = Patch(**fields_of(entry) | {"along": along})
        if reason := contacts.reason_against(by_name[name], regions[name]):
            raise BayescalError(f"the region of `{name}` {reason[0]}", document.where(path), reason[1])
    where = document.where(("plan", "poses_deg"))
    if any(len(pose) != n for pose in stated.poses_deg):
        remedy = f"give {n} readings in deg (prismatic joints: mm) for each pose"
        raise BayescalError(f"a pose that has not {n} readings", where, remedy)
    if len(stated.poses_deg) == 1:
        raise BayescalError("a single pose has no distance", where, "give two poses or more")
    volume = stated.volume_of_interest
    return PlanSettings(
        volume=None if volume is None else Box(**fields_of(volume)),
        regions=regions,
        table=in_si("table_mm", stated.table_mm),
        payloads=stated.payload_kg,
        cone=in_si("cone_deg", stated.cone_deg),
        clearance=in_si("clearance_mm", stated.clearance_mm),
        poses=tuple(tuple(robot.read(np.array(pose)).tolist()) for pose in stated.poses_deg),
    )


def record_of(file: schema.DatasetFile) -> Record:
    """What is stated under `record`."""
    stated = file.record
    return Record(
        date=stated.date or "",
        operator=stated.operator or "",
        serials={key: value for key, value in stated.serials if value is not None},
        certificates=stated.certificates,
        temperature=stated.temperature_degC,
    )


def _direction(document: Document, path: tuple[str, ...], key: str, vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    if abs(length - 1) <= 0.01:
        return vector / length
    unit = ", ".join(f"{c:.6g}" for c in vector / length) if length else "x, y, z"
    name, where = path[-1], document.where((*path, key))
    raise BayescalError(f"the {key} of `{name}` has length {length:.4g}, not 1", where, f"write [{unit}]")
