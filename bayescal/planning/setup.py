"""The setup of a session that is to be planned: read from a folder, or continued from a measured session."""

from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bayescal.arm.shapes import Box
from bayescal.dataset import Dataset, PlanSettings, Target
from bayescal.dataset.contacts import connected
from bayescal.dataset.read import SETTINGS, TABLE, check_folder, read_settings
from bayescal.dataset.regions import Probing, Region, Session
from bayescal.dataset.target_kinds import KINDS
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.planning.pool import Setup
from bayescal.probing.motions import CLEAR, cone_of
from bayescal.probing.scene import artefacts, box_of, table_height, up_of
from bayescal.robots import Loaded

EDGE = 0.07
"""Of the size of a face: the distance of contacts from its edges, which are chamfered (assumed)."""


def regions_of(dataset: Dataset) -> dict[str, Region]:
    """The region of every target with a place of its own, as its kind declares it.

    A stated region is taken; else a face is that of a box which the other faces of its artefact determine,
    less a margin at its edges; else the rectangle of the contacts that were made on it.

    Raises
    ------
    BayescalError
        If the extent of a face or a cylinder is not known, or its kind cannot be planned.
    """
    stated = dataset.plan.regions if dataset.plan else {}
    faces, up, out = _faces(dataset.targets), up_of(dataset), {}
    for target in dataset.targets:
        planned = _probing(target)
        if planned.region is None:
            continue
        name, probed = target.name, partial(_probed, dataset, target)
        session = Session(up, stated.get(name), faces.get(name), probed)
        if (region := planned.region(target, session)) is None:
            raise BayescalError(*_unknown_extent(target, planned.sizes))
        out[name] = region
    return out


def _probing(target: Target) -> Probing:
    """Where contacts on a target may be, or why none can be chosen."""
    planned = KINDS[target.kind].planned
    if planned is None:
        what = f"contacts on a target of kind {target.kind} cannot be planned or simulated"
        kinds = ", ".join(name for name, kind in KINDS.items() if kind.planned is not None)
        raise BayescalError(what, target.name, f"kinds: {kinds}")
    return planned


def _unknown_extent(target: Target, sizes: tuple[str, ...]) -> tuple[str, str, str]:
    line = f"`plan: {{regions: {{{target.name}: {{centre_mm: [x, y, z], size_mm: [{', '.join(sizes)}]}}}}}}`"
    flat = KINDS[target.kind].flat
    others = "; or add the opposite face, or plan `--after` a session on it" if flat else ""
    what = f"where `{target.name}` can be probed is not known: no size is stated, and no other face gives it"
    return what, "dataset.yaml", f"add {line}{others}"


def _faces(targets: tuple[Target, ...]) -> dict[str, Region]:
    """Faces of the boxes that planes with a common first part of their names determine."""
    out: dict[str, Region] = {}
    for faces in artefacts(targets).values():
        if (box := box_of(faces)) is not None:
            out |= {face.name: _face_of(box, np.asarray(face.values["normal"], float)) for face in faces}
    return out


def _face_of(box: Box, normal: np.ndarray) -> Region:
    """The face of a box in the direction of a unit normal (3,), less its edges."""
    axes, centre = box.pose[:3, :3], box.pose[:3, 3]
    along = axes.T @ normal
    k = int(np.argmax(np.abs(along)))
    half = (1 - 2 * EDGE) * (axes * box.half).T
    return Region(centre + np.sign(along[k]) * box.half[k] * axes[:, k], np.delete(half, k, axis=0))


def _probed(dataset: Dataset, target: Target) -> np.ndarray:
    """Nominal TCP positions (M, 3), m, in F0, of the rows of a target."""
    names = np.array([t.name for t in dataset.targets])
    rows = names[dataset.measurements.target] == target.name
    return Scene(dataset).points[rows] if rows.any() else np.empty((0, 3))


SHARE = 3
"""Where all targets are spheres of certified distances, one placement of this number is for validation."""


def read_setup(folder: Path | str, robot: Loaded | None = None) -> Setup:
    """Read the setup of a session: a dataset folder, of which the measurements are ignored.

    Parameters
    ----------
    folder : Path or str
        Holds ``dataset.yaml`` and, unless it is a built-in one, the robot.
    robot : Loaded, optional
        In place of the one that dataset.yaml names.

    Raises
    ------
    BayescalError
        If the folder breaks the contract, a noise or a ball is missing, or it is not known where a face can
        be probed.
    """
    dataset = stated(folder, robot)
    rows = _rows_in(Path(folder) / TABLE)
    notes = (f"the {rows} rows of {TABLE} are ignored: `--after` continues a session",) if rows else ()
    return _setup(dataset, (*notes, *assumed(dataset)))


def stated(folder: Path | str, robot: Loaded | None = None) -> Dataset:
    """What a folder states, of no measurements; raises as `read_setup`, except for unknown places."""
    return read_settings(check_folder(folder) / SETTINGS, robot, assume=True)[0]


def assumed(dataset: Dataset) -> tuple[str, ...]:
    """A note on the values that are not filled in yet; none if there are none."""
    if not dataset.unfilled:
        return ()
    keys = Counter(".".join(map(str, [path[0], path[-1]])) for path in dataset.unfilled)
    some = ", ".join(f"{key} ({count})" if count > 1 else key for key, count in keys.items())
    return (f"not filled in, only assumed: {some}; `fit` refuses the dataset until they are",)


def continued(dataset: Dataset) -> Setup:
    """The setup that continues a measured session: its rows count, and its targets are probed again.

    Raises
    ------
    BayescalError
        If the rows are of several sessions, or as in `read_setup`.
    """
    if dataset.sessions:
        what = "several sessions joined cannot be continued"
        raise BayescalError(what, dataset.name, "continue one of them")
    return _setup(dataset, ())


def _setup(dataset: Dataset, notes: tuple[str, ...]) -> Setup:
    plan = dataset.plan or PlanSettings()
    _check(dataset)
    if any(KINDS[t.kind].posed for t in dataset.targets):
        text = "of what holds the camera or board on the flange, only a rod to it is checked for collisions"
        notes = (*notes, text)
    setup = Setup(
        dataset=dataset,
        regions=regions_of(dataset),
        volume=plan.volume,
        payloads=plan.payloads,
        table=plan.table,
        cone=cone_of(dataset.robot) if plan.cone is None else plan.cone,
        clearance=CLEAR if plan.clearance is None else plan.clearance,
        validated=_validated(dataset),
        notes=notes,
        poses=np.array(plan.poses).reshape(len(plan.poses), dataset.robot.n),
    )
    if setup.table is None and (height := table_height(setup.scene)) is not None:
        text = f"no table is stated; assumed: `plan: {{table_mm: {height * 1e3:.0f}}}`, below all targets"
        setup = replace(setup, notes=(*setup.notes, text))
    return setup


def _rows_in(path: Path) -> int:
    """Number of rows of a table, without its header; 0 where there is no file."""
    if not path.is_file():
        return 0
    with path.open(encoding="utf-8", errors="replace") as lines:
        return max(0, sum(1 for line in lines if line.strip()) - 1)


def _check(dataset: Dataset) -> None:
    """Refuse a setup without the noise or the ball that its targets need."""
    for target in dataset.targets:
        kind = KINDS[target.kind]
        _probing(target)
        if getattr(dataset.noise, kind.noise) is None and np.isnan(kind.usual):
            what = f"no noise of a {kind.noise} is stated, which `{target.name}` needs"
            raise BayescalError(what, SETTINGS, f"add `noise: {{{kind.noise}_mm: ...}}`")
        if kind.touched and all(tool.ball_radius is None for tool in dataset.tools):
            what = f"no tool has a ball that could touch `{target.name}`"
            raise BayescalError(what, SETTINGS, "add `ball_radius_mm` to a tool")


def _validated(dataset: Dataset) -> frozenset[str]:
    """Spheres of certified distances that are not calibrated on.

    Of a measured session those without rows to calibrate on. Otherwise all if there are other targets, else
    those of the last placements, a third of all.
    """
    named = {t.name: t for t in dataset.targets}
    pairs = [c.targets for c in dataset.certificates if c.kind == "distance"]
    spheres = [p for p in pairs if all(KINDS[named[name].kind].located for name in p)]
    certified = frozenset(name for pair in spheres for name in pair)
    m = dataset.measurements
    if len(m.ids):
        fitted = {dataset.targets[k].name for k in np.unique(m.target[m.role == "calibrate"])}
        return certified - fitted
    if certified != set(named):
        return certified
    placements = connected(list(named), spheres)
    last = len(placements) // SHARE or len(placements) // 2
    return frozenset(name for group in placements[len(placements) - last :] for name in group)
