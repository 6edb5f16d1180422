"""The check of a dataset: facts, effects that can be assessed, and what is probably a mistake."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.assess.mistakes import hidden, judged, mistaken, model_of
from bayescal.dataset import Certificate, Dataset, consistency, plausibility
from bayescal.dataset.consistency import contradictions, doubled, nominal, planned, rounded
from bayescal.dataset.image_changes import CHECK_IMAGE, odd_images
from bayescal.dataset.plausibility import explanation
from bayescal.dataset.read import read_parts
from bayescal.dataset.table import Table
from bayescal.dataset.target_kinds import KINDS as KINDS_OF_TARGET
from bayescal.effects import BASELINE, EFFECTS, Circumstances
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.gap.search.candidates import Candidates, candidates, wide
from bayescal.model.scene import Scene
from bayescal.predict.locate import centres
from bayescal.preparing.missing import KINDS, Finding, missing, said
from bayescal.robots import Loaded
from bayescal.storage.files import Document

COARSE = 0.1e-3
"""m: greatest standard uncertainty of a certified length; certificates state micrometres (assumed)."""
ROUND = 0.3
"""Relative difference of a sphere's diameter from its contacts: an arm's nominal error is some mm."""
BALL_ROWS = 8
"""Contacts from which on they state a diameter."""
SPREAD = 0.25
"""Smallest singular value of contact directions, relative: fewer directions do not state a diameter."""


def odd(dataset: Dataset, table: Table, document: Document) -> Iterator[Finding]:
    """All findings of this kind, and what the reader refuses."""
    yield from _names(dataset, document)
    yield from _lengths(dataset, document)
    yield from _doubled(dataset, table)
    if coarse := rounded(dataset):
        yield said("odd", "rounded_readings", table.name, what=coarse)
    yield from _clock(dataset, table)
    convention = explanation(dataset, document)
    refused = list(_refused(dataset, table, document))
    if convention is not None and not any(f.code == "units" for f in refused):
        finding = Finding.of(convention, "convention")
        yield finding if refused else replace(finding, kind="odd")
        return
    yield from refused
    if not refused:
        yield from _diameters(dataset, document)
        if (contacts := planned(dataset)) is not None:  # they were never made
            place = place_of(dataset, table, int(contacts.rows[0]))
            yield said("odd", "planned_pose", place, what=contacts.words(dataset))
        yield from _images(dataset, table)


def _images(dataset: Dataset, table: Table) -> Iterator[Finding]:
    """Images whose corners do not fit the board."""
    for k, target in enumerate(dataset.targets):
        for image in odd_images(dataset, k) if KINDS_OF_TARGET[target.kind].posed else ():
            more, remedy = f"; {image.what}".rstrip("; "), image.remedy or CHECK_IMAGE
            sizes = {"misfit": 100 * image.misfit, "usual": 100 * image.usual}
            place = place_of(dataset, table, int(image.rows[0]))
            yield said("odd", "odd_image", place, name=image.name, **sizes, more=more, remedy=remedy)


def _refused(dataset: Dataset, table: Table, document: Document) -> Iterator[Finding]:
    """What `fit` refuses, each line once."""
    findings = [Finding.of(e, _code(e)) for e in plausibility.problems(dataset, table, document)]
    for code, check in (
        ("torque_sign", lambda: consistency.check_sign(dataset, document)),
        ("orientations", lambda: consistency.check(dataset, table)),
    ):
        try:
            check()
        except BayescalError as error:
            findings.append(Finding.of(error, code))
    first: dict[str, Finding] = {}
    for finding in findings:
        first.setdefault(finding.where, finding)
    yield from first.values()


def _code(error: BayescalError) -> str:
    words = {"certified": "certified_length", "limits are": "limits", "look like": "units"}
    words |= {"impossible": "impossible_row"}
    return next((code for word, code in words.items() if word in error.what), "misplaced_target")


def _names(dataset: Dataset, document: Document) -> Iterator[Finding]:
    """Names that differ only in case or blanks."""
    for key, named in (("targets", dataset.targets), ("tools", dataset.tools)):
        first: dict[str, str] = {}
        for name in (each.name for each in named):
            other = first.setdefault("".join(name.lower().split()), name)
            if other != name:
                where = document.where((key, name))
                yield said("odd", "similar_names", where, key=key, other=other, name=name)


def _lengths(dataset: Dataset, document: Document) -> Iterator[Finding]:
    """Certified lengths that contradict the nominal places, or whose uncertainty is no micrometres."""
    for k, c in enumerate(dataset.certificates):
        if c.u_distance is not None and c.u_distance > COARSE and not c.derived:
            names = " and ".join(f"`{name}`" for name in c.targets)
            key = "u_diameter_mm" if c.kind == "diameter" else "u_distance_mm"
            where, u = document.where(("certificates", k)), 1e3 * c.u_distance
            yield said("odd", "coarse_certificate", where, key=key, names=names, u=u)
    for length in (c for c in contradictions(dataset) if not c.impossible):
        where = document.where(length.place)
        yield Finding("certified_length", "odd", length.what, where, length.remedy)


def _doubled(dataset: Dataset, table: Table) -> Iterator[Finding]:
    """Rows with the readings of another row of the same target, that no repeat and no standstill explains."""
    m = dataset.measurements
    if pairs := doubled(dataset):
        row, one = pairs[0]
        more = f" ({len(pairs) - 1} more rows repeat another)" if len(pairs) > 1 else ""
        place = place_of(dataset, table, row)
        yield said("odd", "doubled_row", place, row=m.ids[row], one=m.ids[one], more=more)


def _clock(dataset: Dataset, table: Table) -> Iterator[Finding]:
    """Times that go back: the order of rows is the order of time."""
    time = dataset.measurements.time
    if time is None or not (back := np.flatnonzero(np.diff(time) < 0)).size:
        return
    row = int(back[0]) + 1
    more = f", and {len(back) - 1} more times" if len(back) > 1 else ""
    yield said("odd", "clock", place_of(dataset, table, row), back=time[row - 1] - time[row], more=more)


def _diameters(dataset: Dataset, document: Document) -> Iterator[Finding]:
    """Spheres whose contacts lie on one of another diameter."""
    m = dataset.measurements
    p = nominal(dataset, m.readings)
    for k, target in enumerate(dataset.targets):
        rows = np.flatnonzero(m.target == k)
        if target.kind != "sphere" or len(rows) < BALL_ROWS:
            continue
        middle = p[rows] - p[rows].mean(axis=0)
        scale = np.linalg.svd(middle, compute_uv=False)
        if scale[-1] < SPREAD * scale[0]:
            continue
        centre = centres(middle.T, np.zeros(len(rows)))[0]
        reach = float(np.sqrt(np.mean(np.sum((middle - centre) ** 2, axis=1))))
        radius = float(np.mean([dataset.tools[t].ball_radius or 0.0 for t in m.tool[rows]]))
        stated, seen = float(np.asarray(target.values["diameter"])), 2 * (reach - radius)
        if abs(seen - stated) > ROUND * max(stated, seen):
            where = document.where(("targets", target.name))
            yield said("odd", "diameter", where, name=target.name, stated=1e3 * stated, seen=1e3 * seen)


def place_of(dataset: Dataset, table: Table, row: int) -> str:
    """File and line of a row, with its id."""
    return f"{table.name}:{table.line[row]} (`{dataset.measurements.ids[row]}`)"


MODEL = BASELINE
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

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.dataset.name


def check(folder: Path | str, robot: Loaded | None = None) -> Check:
    """Check a dataset folder without fitting it.

    Parameters
    ----------
    folder : Path or str
    robot : Loaded, optional
        As of `read_dataset`.

    Raises
    ------
    BayescalError
        If the folder cannot be read: it breaks the format.
    """
    dataset, table, document = read_parts(folder, robot)
    scene = Scene(dataset)
    model, modelled = model_of(scene, MODEL)
    circumstances = scene.circumstances(scene.rows("calibrate"))
    tests = None if model is None else candidates(circumstances, modelled)
    findings = list(odd(dataset, table, document))
    posed = not any(f.code in UNPOSED for f in findings)
    findings += missing(scene, model, tests, posed)
    tested = None if any(f.kind == "refused" for f in findings) else judged(dataset)
    if tested is not None:
        mistakes = list(mistaken(tested))
        if any("diameter_mm" in m.what for m in mistakes):
            findings = [f for f in findings if f.code != "diameter"]  # that the contacts show another one
        findings += [Finding(m.code, "odd", m.what, document.where(m.place), m.remedy) for m in mistakes]
    return Check(
        dataset=dataset,
        modelled=modelled,
        unknowns=0 if model is None else model.size,
        values=0 if model is None else sum(block.residuals for block in model.blocks),
        assessed=() if tests is None else _assessed(tests, circumstances, modelled),
        not_assessed={} if tests is None else dict(tests.missing),
        hidden=() if tested is None else tuple(hidden(tested)),
        findings=tuple(sorted(findings, key=lambda f: KINDS.index(f.kind))),
    )


def _assessed(tests: Candidates, circumstances: Circumstances, modelled: tuple[str, ...]) -> tuple[str, ...]:
    """Effects with candidates, and those whose many settings a diagnosis screens first."""
    beyond = (e for e in EFFECTS.values() if e.name not in map(plain, modelled))
    return tuple(e.name for e in beyond if e.name in tests.variants or wide(e, circumstances))


def check_record(of: Check) -> dict[str, Any]:
    """The content of `bayescal check --to json`."""
    d, m = of.dataset, of.dataset.measurements
    targets = [
        {"name": t.name, "kind": t.kind, "rows": _counts(m.role[m.target == k])}
        for k, t in enumerate(d.targets)
    ]
    return {
        "schema": "bayescal-check/1", "dataset": d.name, "sha256": d.sha256,
        "robot": {"name": d.robot.name, "joints": d.robot.n, "masses": d.robot.masses is not None}
        | ({"two_arms": d.robot.two_arms} if d.robot.ground else {}),
        "readings": d.readings, "rows": {"total": len(m.ids), **_counts(m.role)},
        "tools": {d.tools[int(k)].name: n for k, n in _counts(m.tool).items()}, "targets": targets,
        "certificates": [_certificate(c) for c in d.certificates if not c.derived],
        "noise": {
            "contact_mm": _scaled(d.noise.contact, 1e3),
            "point_mm": _scaled(d.noise.point, 1e3),
            "joint_deg": float(np.degrees(d.noise.joint)),
            "slide_mm": _scaled(d.noise.slide, 1e3),
            "orientation_deg": _scaled(d.noise.orientation, np.degrees(1.0)),
            "pixel_px": d.noise.pixel,
        },
        "repeats": _groups(m.repeat), "stops": _groups(m.stop),
        "duration_s": None if m.time is None else float(np.ptp(m.time)),
        "payloads_kg": [] if m.payload is None else sorted({float(p) for p in m.payload}),
        "velocities": m.velocity is not None, "temperatures": m.temperature is not None,
        "temperature_of": d.temperature_of if m.temperature is not None else None, "model": list(of.modelled),
        "unknowns": of.unknowns, "values": of.values, "assessed": list(of.assessed),
        "not_assessed": of.not_assessed, "not_shown": list(of.hidden),
        "findings": [vars(f) for f in of.findings],
    }  # fmt: skip


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
    return 0 if labels is None else sum(n > 1 for n in _counts(labels[labels != ""]).values())


def _counts(labels: np.ndarray) -> dict[str, int]:
    """Number of rows by label, in the order of the labels."""
    return {str(k): int(n) for k, n in zip(*np.unique(labels, return_counts=True), strict=True)}
