"""The check of a dataset: facts, effects that can be assessed, findings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.checking.finding import KINDS, Finding
from bayescal.checking.missing import missing
from bayescal.checking.mistakes import hidden, judged, mistaken, model_of
from bayescal.checking.odd import odd
from bayescal.dataset import Certificate, Dataset
from bayescal.dataset.read import read_parts
from bayescal.effects import EFFECTS, Circumstances
from bayescal.effects.selection import plain
from bayescal.gap.search.candidates import Candidates, candidates, wide
from bayescal.model.scene import Scene

MODEL = ("geometry", "compliance")
UNPOSED = ("units", "convention")
"""Findings after which the poses of the arm are not known."""


@dataclass(frozen=True)
class Check:
    """What is known of a session before a fit.

    Attributes
    ----------
    dataset : Dataset
        As read, without any judgement.
    modelled : tuple of str
        Effects of the usual model that the session can have.
    unknowns : int
        Of that model: parameters and targets.
    values : int
        Values that are fitted, one per contact and three per point.
    assessed : tuple of str
        Effects that a diagnosis can assess, beyond the model.
    not_assessed : mapping of str to str
        Effects, or an effect at a site, that it cannot, with the reason.
    hidden : tuple of str
        Gross mistakes that these data would not show, in words.
    findings : tuple of Finding
        In the order of `KINDS`.
    """

    dataset: Dataset
    modelled: tuple[str, ...]
    unknowns: int
    values: int
    assessed: tuple[str, ...]
    not_assessed: dict[str, str]
    hidden: tuple[str, ...]
    findings: tuple[Finding, ...]


def check(folder: Path | str, allow_xacro: bool = False) -> Check:
    """Check a dataset folder without fitting it.

    Parameters
    ----------
    folder : Path or str
    allow_xacro : bool
        As of `read_dataset`.

    Raises
    ------
    BayescalError
        If the folder cannot be read: it breaks the format.
    """
    dataset, table, document = read_parts(folder, allow_xacro)
    scene = Scene(dataset)
    model, modelled = model_of(scene, MODEL)
    circumstances = scene.circumstances(scene.rows("calibrate"))
    known = None if model is None else candidates(circumstances, modelled)
    found = list(odd(dataset, table, document))
    posed = not any(f.code in UNPOSED for f in found)
    found += missing(scene, model, known, posed)
    tested = None if any(f.kind == "refused" for f in found) else judged(dataset)
    if tested is not None:
        told = [Finding(m.code, "odd", m.what, document.where(m.place), m.remedy) for m in mistaken(tested)]
        if any("diameter_mm" in f.what for f in told):
            found = [f for f in found if f.code != "diameter"]  # that the contacts show another one
        found += told
    return Check(
        dataset=dataset,
        modelled=modelled,
        unknowns=0 if model is None else model.size,
        values=0 if model is None else sum(block.residuals for block in model.blocks),
        assessed=() if known is None else _assessed(known, circumstances, modelled),
        not_assessed={} if known is None else dict(known.missing),
        hidden=() if tested is None else tuple(hidden(tested)),
        findings=tuple(sorted(found, key=lambda f: KINDS.index(f.kind))),
    )


def _assessed(known: Candidates, circumstances: Circumstances, modelled: tuple[str, ...]) -> tuple[str, ...]:
    """Effects with candidates, and those whose many settings a diagnosis screens first."""
    beyond = (e for e in EFFECTS.values() if e.name not in map(plain, modelled))
    return tuple(e.name for e in beyond if e.name in known.variants or wide(e, circumstances))


def check_record(of: Check) -> dict[str, Any]:
    """The content of `bayescal check --to json`."""
    d, m = of.dataset, of.dataset.measurements
    roles = {str(r): int(n) for r, n in zip(*np.unique(m.role, return_counts=True), strict=True)}
    targets = []
    for k, t in enumerate(d.targets):
        own = m.role[m.target == k]
        counts = {str(r): int(n) for r, n in zip(*np.unique(own, return_counts=True), strict=True)}
        targets.append({"name": t.name, "kind": t.kind, "rows": counts})
    names, uses = np.unique(m.tool, return_counts=True)
    return {
        "schema": "bayescal-check/1",
        "dataset": d.name,
        "sha256": d.sha256,
        "robot": {"name": d.robot.name, "joints": d.robot.n, "masses": d.robot.masses is not None},
        "readings": d.readings,
        "rows": {"total": len(m.ids), **roles},
        "tools": {d.tools[k].name: int(n) for k, n in zip(names, uses, strict=True)},
        "targets": targets,
        "certificates": [_certificate(c) for c in d.certificates if not c.derived],
        "noise": {
            "contact_mm": _scaled(d.noise.contact, 1e3),
            "point_mm": _scaled(d.noise.point, 1e3),
            "joint_deg": float(np.degrees(d.noise.joint)),
        },
        "repeats": _groups(m.repeat),
        "stops": _groups(m.stop),
        "duration_s": None if m.time is None else float(np.ptp(m.time)),
        "payloads_kg": [] if m.payload is None else sorted({float(p) for p in m.payload}),
        "velocities": m.velocity is not None,
        "temperature_of": d.temperature_of if m.temperature is not None else None,
        "model": list(of.modelled),
        "unknowns": of.unknowns,
        "values": of.values,
        "assessed": list(of.assessed),
        "not_assessed": of.not_assessed,
        "not_shown": list(of.hidden),
        "findings": [vars(f) for f in of.findings],
    }


def _certificate(c: Certificate) -> dict[str, Any]:
    length = {"distance_mm": _scaled(c.distance, 1e3), "u_um": _scaled(c.u_distance, 1e6)}
    angle = {"u_angle_urad": _scaled(c.u_angle, 1e6), "u_form_um": _scaled(c.u_form, 1e6)}
    stated: dict[str, Any] = {k: value for k, value in (length | angle).items() if value is not None}
    if c.points is not None:
        u = np.sqrt(np.mean(np.diag(c.points.covariance)))
        stated |= {"artefact": c.points.artefact, "points": len(c.points.names), "u_um": _scaled(u, 1e6)}
        stated |= {"placements": sorted(set(c.points.placements))}
    return {"kind": c.kind, "targets": list(c.targets), **stated}


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else float(f"{value * factor:.12g}")


def _groups(labels: np.ndarray | None) -> int:
    """Number of groups of rows with one label."""
    if labels is None:
        return 0
    _, counts = np.unique(labels[labels != ""], return_counts=True)
    return int(np.sum(counts > 1))
