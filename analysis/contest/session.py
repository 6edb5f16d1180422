"""A task as its files say it, and its targets by least squares. All lengths in mm.

Needs NumPy alone (and PyYAML to read), so that it works in the environment of any tool.

A target is located from the positions that a tool states for its `calibrate` and `locate` rows, or, if it has
too few of these, for its `validate` rows. Rows further off than `TRIM` robust standard deviations are left
out, so that gross outliers of a session count for no tool. The residual of a row is then that of the dataset
contract: the distance from the surface, or the difference from the instrument's reading, or from the centre.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

FEWEST = {"plane": 4, "sphere": 5, "fixed-point": 2, "instrument": 4}
"""Rows from which a target of each kind is located; the kinds that a task may have."""
TRIM, ROUNDS = 4.0, 4
NORMAL_MAD = 1.4826
State = dict[str, np.ndarray]
"""normal (3,), offset () of a plane; centre (3,), radius () of a sphere; centre; rotation (3, 3), origin."""


@dataclass(frozen=True)
class Session:
    """N rows of a task; `xyz` (N, 3) is nan where an instrument read nothing, or where it is hidden."""

    name: str
    ids: tuple[str, ...]
    role: np.ndarray  # (N,)
    target: np.ndarray  # (N,) names
    radius: np.ndarray  # (N,) of the ball, 0 without one
    xyz: np.ndarray
    targets: Mapping[str, Mapping[str, Any]]
    certificates: tuple[Mapping[str, Any], ...]
    noise: np.ndarray  # (N,) stated standard uncertainty of a residual

    def rows(self, target: str, *roles: str) -> np.ndarray:
        """Indices of the rows of a target with one of the roles."""
        return np.flatnonzero((self.target == target) & np.isin(self.role, roles))

    def locating(self, target: str) -> np.ndarray:
        """Rows that locate a target."""
        known = self.rows(target, "calibrate", "locate")
        enough = len(known) >= FEWEST[self.targets[target]["kind"]]
        return known if enough else self.rows(target, "validate")

    def only(self, *roles: str) -> tuple[Session, np.ndarray]:
        """The rows with some roles, and their indices."""
        at = np.flatnonzero(np.isin(self.role, roles))
        rows = {key: getattr(self, key)[at] for key in ("role", "target", "radius", "xyz", "noise")}
        return replace(self, ids=tuple(self.ids[k] for k in at), **rows), at

    def with_readings(self, xyz: Mapping[str, list[float]]) -> Session:
        """The session with hidden readings of an instrument, by row id."""
        out = self.xyz.copy()
        for k, name in enumerate(self.ids):
            out[k] = xyz.get(name, out[k])
        return replace(self, xyz=out)


def read(folder: Path) -> Session:
    """Read dataset.yaml and measurements.csv."""
    return of(*files(folder), folder.name)


def files(folder: Path) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Contents of dataset.yaml and measurements.csv."""
    import yaml

    with (folder / "measurements.csv").open(encoding="utf-8", newline="") as file:
        return yaml.safe_load((folder / "dataset.yaml").read_text(encoding="utf-8")), list(
            csv.DictReader(file)
        )


def of(said: dict[str, Any], rows: list[dict[str, str]], name: str) -> Session:
    """The session of these contents."""
    tools, (first, *_) = said["tools"], said["tools"]
    radius = [tools[r.get("tool") or first].get("ball_radius_mm", 0.0) for r in rows]
    xyz = [[float(r.get(c) or "nan") for c in ("x_mm", "y_mm", "z_mm")] for r in rows]
    noise, kinds = said["noise"], {name: t["kind"] for name, t in said["targets"].items()}
    usual = [
        noise["point_mm"] if kinds[r["target"]] == "instrument" else noise.get("contact_mm", 0.01)
        for r in rows
    ]
    return Session(
        name,
        tuple(r["id"] for r in rows),
        np.array([r.get("role") or "calibrate" for r in rows]),
        np.array([r["target"] for r in rows]),
        np.array(radius, float),
        np.array(xyz, float),
        said["targets"],
        tuple(said.get("certificates") or ()),
        np.array(usual, float),
    )


def residuals(kind: str, state: State, p: np.ndarray, radius: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Residuals of positions p (C, 3): (C, 1) of a surface, (C, 3) of a point."""
    if kind == "plane":
        return np.asarray(p @ state["normal"] - state["offset"] - radius)[:, None]
    if kind == "sphere":
        return np.asarray(np.linalg.norm(p - state["centre"], axis=1) - state["radius"] - radius)[:, None]
    if kind == "instrument":
        return np.asarray((p - state["origin"]) @ state["rotation"] - xyz)
    return np.asarray(p - state["centre"])


def fitted(kind: str, said: Mapping[str, Any], p: np.ndarray, radius: np.ndarray, xyz: np.ndarray) -> State:
    """The target of least squares."""
    middle = p.mean(axis=0)
    if kind == "plane":
        normal = np.array(said["normal"], float)
        for _ in range(3):  # balls of several radii: their contacts depend on the normal
            at = p - radius[:, None] * normal
            found = np.linalg.svd(at - at.mean(axis=0))[2][2]
            normal = found * np.sign(found @ normal)
        return {"normal": normal, "offset": np.mean(p @ normal - radius)}
    if kind == "sphere":
        half = said["diameter_mm"] / 2
        x = np.append(_with_diameter(p, half + radius, np.array(said["centre_mm"], float)), half)
        for _ in range(30):
            away = p - x[:3]
            length = np.linalg.norm(away, axis=1)
            slopes = np.column_stack([-away / length[:, None], -np.ones(len(p))])
            step = np.linalg.lstsq(slopes, -(length - x[3] - radius), rcond=None)[0]
            x += step
            if np.max(np.abs(step)) < 1e-10:
                break
        return {"centre": x[:3], "radius": x[3]}
    if kind == "instrument":
        u, _, v = np.linalg.svd((xyz - xyz.mean(axis=0)).T @ (p - middle))
        turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
        return {"rotation": turn, "origin": middle - turn @ xyz.mean(axis=0)}
    return {"centre": middle}


def _with_diameter(p: np.ndarray, reach: np.ndarray, stated: np.ndarray) -> np.ndarray:
    """A centre with the stated diameter: Gauss-Newton from where the file says that it is."""
    x = stated.copy()
    for _ in range(30):
        away = p - x
        length = np.linalg.norm(away, axis=1)
        x += np.linalg.lstsq(-away / length[:, None], reach - length, rcond=None)[0]
    return x


def normals(session: Session, points: np.ndarray, targets: Mapping[str, State]) -> np.ndarray:
    """Outward normals (N, 3) of surfaces at each row; nan of points."""
    out = np.full_like(points, np.nan)
    for name, state in targets.items():
        rows = np.flatnonzero(session.target == name)
        if "normal" in state:
            out[rows] = state["normal"]
        elif "radius" in state:
            away = points[rows] - state["centre"]
            out[rows] = away / np.linalg.norm(away, axis=1)[:, None]
    return out


def located(session: Session, points: np.ndarray, trim: float = TRIM) -> dict[str, State]:
    """All targets, from the positions (N, 3) that a tool states."""
    out = {}
    for name in dict.fromkeys(session.target.tolist()):
        rows, said = session.locating(name), session.targets[name]
        kind = said["kind"]
        keep = np.ones(len(rows), bool)
        for _ in range(ROUNDS):
            own = rows[keep]
            state = fitted(kind, said, points[own], session.radius[own], session.xyz[own])
            r = residuals(kind, state, points[rows], session.radius[rows], session.xyz[rows])
            size = np.linalg.norm(r, axis=1)
            near = size <= trim * NORMAL_MAD * max(float(np.median(size)), 1e-9)
            if np.array_equal(near, keep) or near.sum() < FEWEST[kind] or not np.isfinite(trim):
                break
            keep = near
        out[name] = state
    return out


def residuals_of(
    session: Session, points: np.ndarray, targets: Mapping[str, State], *roles: str
) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    """Rows and residuals (C, 1 or 3) of each target, for rows with some roles."""
    for name, state in targets.items():
        rows = session.rows(name, *roles)
        if len(rows):
            kind = session.targets[name]["kind"]
            yield rows, residuals(kind, state, points[rows], session.radius[rows], session.xyz[rows])


def certified(session: Session, targets: Mapping[str, State]) -> Iterable[tuple[str, tuple[str, str], float]]:
    """Kind of certificate, its targets, and what it says over its u (dimensionless), where a u is stated.

    Distances of centres, distances and parallelism of faces, right angles of faces.
    """
    for c in session.certificates:
        pair = tuple(c.get("between") or c.get("faces") or ())
        if len(pair) != 2 or not set(pair) <= set(targets):
            continue
        a, b = (targets[name] for name in pair)
        if c["kind"] == "distance" and "centre" in a and "centre" in b:
            yield (
                "distance",
                pair,
                (np.linalg.norm(a["centre"] - b["centre"]) - c["distance_mm"]) / c["u_distance_mm"],
            )
        elif "normal" in a and "normal" in b:
            if c["kind"] == "perpendicular":
                yield c["kind"], pair, a["normal"] @ b["normal"] / c["u_angle_rad"]
            elif c["kind"] == "parallel":
                across = np.cross(a["normal"], b["normal"])
                for value in across[np.argsort(-np.abs(np.eye(3) @ a["normal"]))][1:]:
                    yield c["kind"], pair, value / c["u_angle_rad"]
                if "distance_mm" in c:
                    apart = abs(a["offset"] - (a["normal"] @ b["normal"]) * b["offset"])
                    yield c["kind"], pair, (apart - c["distance_mm"]) / c["u_distance_mm"]
