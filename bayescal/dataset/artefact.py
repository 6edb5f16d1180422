"""Certified coordinates of an artefact (artefact.yaml): certificates of the targets that are its points.

A target is the point of its name before ``@``; what follows names the placement (``ball.A@2``). The
certificates are one of kind ``points``, which a fit uses, and the distances that follow from it, which are
validated.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Certificate, Points, Target
from bayescal.errors import BayescalError
from bayescal.storage import files
from bayescal.storage.reading import check_inside
from bayescal.storage.writing import Block, block_lines, flow, flow_list, number, scalar

SCHEMA = "bayescal-artefact/1"
NEAREST = 1e-6
"""m: points of less distance are one point."""
SYMMETRIC, NEGATIVE = 1e-6, 1e-6
"""Relative asymmetry, and relative size of a negative eigenvalue, that rounded digits explain."""


class PointEntry(files.Keys):
    """A point of the artefact: the centre of a ball or of a seat."""

    mm: files.Vector
    """Certified coordinates in the frame of the certificate, mm."""
    u_mm: (
        files.Uncertain | tuple[files.UncertainOrKnown, files.UncertainOrKnown, files.UncertainOrKnown] | None
    ) = None
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


def certificates_of(
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
    placed: dict[str, list[Target]] = {}
    for target in targets:
        point, _, placement = target.name.partition("@")
        if point in file.points and KINDS[target.kind].form == "point" and KINDS[target.kind].placed:
            placed.setdefault(placement, []).append(target)
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
