"""From a parsed dataset.yaml to tools, targets and certificates in SI units, checked against each other.

Certified coordinates of an artefact (artefact.yaml) are certificates of the targets that are its points. A
target is the point of its name before ``@``; what follows names the placement (``ball.A@2``). The
certificates are one of kind ``points``, which a fit uses, and the distances that follow from it, which are
validated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from bayescal.arm.chain import Robot
from bayescal.dataset import contacts
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Box, Certificate, Patch, PlanSettings, Points, Record, Target
from bayescal.errors import BayescalError
from bayescal.statistics import grouped
from bayescal.storage import files
from bayescal.storage.files import Document, Keys, in_si, stem_of, unknown
from bayescal.storage.reading import check_inside
from bayescal.storage.writing import Block, block_lines, flow, flow_list, number, scalar

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
        what = "`held` is of two arms, and F0 of this one stands still"
        raise BayescalError(what, document.where(("held",)), "leave it out; a tool has `mass_kg`")
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
    volume = None if stated.volume_of_interest is None else Box(**fields_of(stated.volume_of_interest))
    plain = {field_of(k): in_si(k, getattr(stated, k)) for k in ("table_mm", "cone_deg", "clearance_mm")}
    poses = tuple(tuple(robot.read(np.array(pose)).tolist()) for pose in stated.poses_deg)
    return PlanSettings(volume, regions, payloads=stated.payload_kg, poses=poses, **plain)


def record_of(file: schema.DatasetFile) -> Record:
    """What is stated under `record`."""
    stated, serials = file.record, {key: value for key, value in file.record.serials if value is not None}
    date, operator, warm = stated.date or "", stated.operator or "", stated.temperature_degC
    return Record(date, operator, serials, stated.certificates, temperature=warm)


def _direction(document: Document, path: tuple[str, ...], key: str, vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    if abs(length - 1) <= 0.01:
        return vector / length
    unit = ", ".join(f"{c:.6g}" for c in vector / length) if length else "x, y, z"
    name, where = path[-1], document.where((*path, key))
    raise BayescalError(f"the {key} of `{name}` has length {length:.4g}, not 1", where, f"write [{unit}]")


SCHEMA = "bayescal-artefact/1"
NEAREST = 1e-6
"""m: points of less distance are one point."""
SYMMETRIC, NEGATIVE = 1e-6, 1e-6
"""Relative asymmetry, and relative size of a negative eigenvalue, that rounded digits explain."""


class PointEntry(files.Keys):
    """A point of the artefact: the centre of a ball or of a seat."""

    mm: files.Vector
    """Certified coordinates in the frame of the certificate, mm."""
    u_mm: files.Uncertain | tuple[files.MaybeKnown, files.MaybeKnown, files.MaybeKnown] | None = None
    """Standard uncertainty (k = 1) of each coordinate, one for all three or one for each."""


class ArtefactFile(files.Keys):
    """Certified coordinates of the points of an artefact, and their uncertainty."""

    schema_: Literal["bayescal-artefact/1"] = Field(alias="schema")
    """Version of the format."""
    name: files.Name
    """Name of the artefact."""
    points: Annotated[dict[str, PointEntry], Field(min_length=2)]
    """Points by name: a target `ball.A@2` is the point `ball.A` at placement 2."""
    covariance_mm2: tuple[tuple[files.Number, ...], ...] | None = None
    """Covariance of all coordinates (x, y, z of each point in order), instead of `u_mm`; mm2."""


def certificates_of_points(
    folder: Path, name: str, targets: Sequence[Target], stated: Sequence[Certificate]
) -> tuple[tuple[Certificate, ...], bytes]:
    """The certificates that follow from an artefact file, and its content.

    Parameters
    ----------
    folder : Path
        Of the dataset.
    name : str
        The file in it.
    targets : sequence of Target
        Of the session.
    stated : sequence of Certificate
        Those of dataset.yaml: a distance is certified once.

    Raises
    ------
    BayescalError
        If the file is no artefact, no two targets of one placement are its points, or a pair is stated twice.
    """
    path = folder / name
    check_inside(path, folder, "the artefact")
    document = files.read_document(path)
    files.check_schema(document, SCHEMA)
    file = document.parse(ArtefactFile)
    names = tuple(file.points)
    coordinates = np.array([p.mm for p in file.points.values()]) * 1e-3
    covariance = _covariance(document, file) * 1e-6
    for a, b in combinations(range(len(names)), 2):
        if np.linalg.norm(coordinates[a] - coordinates[b]) < NEAREST:
            what = f"points `{names[a]}` and `{names[b]}` have the same coordinates"
            raise BayescalError(what, document.where(("points", names[b])), "check both")
    of_points = (t for t in targets if KINDS[t.kind].form == "point" and KINDS[t.kind].placed)
    parts = ((t, t.name.partition("@")) for t in of_points)
    placed = grouped((placement, t) for t, (point, _, placement) in parts if point in file.points)
    used = [t for together in placed.values() if len(together) > 1 for t in together]
    if not used:
        what = f"no two targets of one placement are points of the artefact ({', '.join(names[:3])}, ...)"
        remedy = "name targets as the points, with `@` and the placement behind: `ball.A@1`"
        raise BayescalError(what, document.where(("points",)), remedy)
    of = tuple(names.index(t.name.partition("@")[0]) for t in used)
    placements = tuple(t.name.partition("@")[2] for t in used)
    points = Points(file.name, names, _rows(coordinates), _rows(covariance), of, placements)
    whole = Certificate("points", tuple(t.name for t in used), points=points)
    derived = distances_of(whole)
    certified = {frozenset(c.targets) for c in stated if c.kind == "distance"}
    for c in derived:
        where = document.where(("points", c.targets[1].partition("@")[0]))
        pair = " and ".join(f"`{name}`" for name in c.targets)
        if frozenset(c.targets) in certified:
            what = f"the distance of {pair} is certified by dataset.yaml too"
            raise BayescalError(what, where, "keep one: the same certificate would count twice")
        if not c.u_distance:
            what = f"the distance of {pair} has no uncertainty"
            raise BayescalError(what, where, "state that of the points")
    return (whole, *derived), document.content


def _rows(values: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in values.tolist())


def _covariance(document: files.Document, file: ArtefactFile) -> np.ndarray:
    """Covariance (3 K, 3 K), mm2, of all coordinates: as stated, or from the uncertainties of the points."""
    stated, where = file.covariance_mm2, document.where(("covariance_mm2",))
    for name, point in file.points.items():
        if (point.u_mm is None) == (stated is None):
            both = "both `u_mm` and `covariance_mm2`" if stated else "neither `u_mm` nor `covariance_mm2`"
            place = document.where(("points", name))
            raise BayescalError(f"point `{name}` has {both}", place, "state the uncertainty once")
    if stated is None:
        return np.diag(np.concatenate([np.broadcast_to(p.u_mm or 0.0, 3) for p in file.points.values()]) ** 2)
    size = 3 * len(file.points)
    if len(stated) != size or any(len(row) != size for row in stated):
        remedy = f"{len(file.points)} points have {size} coordinates: write {size} rows of {size} numbers"
        raise BayescalError(f"`covariance_mm2` is not {size} x {size}", where, remedy)
    matrix = np.array(stated)
    largest = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > SYMMETRIC * largest:
        i, j = np.unravel_index(np.argmax(np.abs(matrix - matrix.T)), matrix.shape)
        what = f"`covariance_mm2` is not symmetric: row {i + 1}, column {j + 1}"
        raise BayescalError(what, where, "check both entries")
    values, axes = np.linalg.eigh(0.5 * (matrix + matrix.T))
    if values[0] < -NEGATIVE * largest or not largest:
        what = f"`covariance_mm2` is no covariance: it has the eigenvalue {values[0]:.3g}"
        raise BayescalError(what, where, "give it with more digits, and check its signs")
    return np.asarray((axes * np.maximum(values, 0.0)) @ axes.T)


def artefact_text(points: Points) -> str:
    """The content of an artefact.yaml that reads back as these points."""

    def written(values: Sequence[float], factor: float, digits: int) -> str:
        return flow_list(number(round(v * factor, 12), digits) for v in values)

    u = np.sqrt(np.diag(points.covariance)).reshape(-1, 3)
    plain = np.count_nonzero(np.array(points.covariance) - np.diag(u.ravel() ** 2)) == 0
    entries = {}
    for name, coordinates, sd in zip(points.names, points.coordinates, u.tolist(), strict=True):
        stated = [("u_mm", written(sd, 1e3, 9))] if plain else []
        entries[name] = flow([("mm", written(coordinates, 1e3, 12)), *stated])
    block: Block = {
        "schema": SCHEMA,
        "name": scalar(points.artefact),
        "points": entries,
        "covariance_mm2": None if plain else [written(row, 1e6, 12) for row in points.covariance],
    }
    return "\n".join(block_lines(block)) + "\n"


def distances_of(whole: Certificate) -> tuple[Certificate, ...]:
    """The certified distances within each placement that follow from coordinates."""
    points = whole.points
    assert points is not None
    coordinates, covariance = np.array(points.coordinates), np.array(points.covariance)
    out = []
    for a, b in combinations(range(len(whole.targets)), 2):
        if points.placements[a] != points.placements[b]:
            continue
        i, j = points.of[a], points.of[b]
        apart = coordinates[i] - coordinates[j]
        length = float(np.linalg.norm(apart))
        gradient = np.zeros(len(covariance))
        gradient[3 * i : 3 * i + 3], gradient[3 * j : 3 * j + 3] = apart / length, -apart / length
        u = float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
        pair = (whole.targets[a], whole.targets[b])
        out.append(Certificate("distance", pair, distance=length, u_distance=u, derived=True))
    return tuple(out)
