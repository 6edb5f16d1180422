"""Candidate contacts, distributed over all targets, as rows of a session behind those that were measured."""

from collections import Counter
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from bayescal.arm.chain import link_angles
from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.dataset import Dataset, Measurements
from bayescal.dataset.join import column
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.write import followed
from bayescal.errors import BayescalError
from bayescal.model.block import tool_frames
from bayescal.model.scene import Scene
from bayescal.planning.pool import POSE, Pool, Setup
from bayescal.planning.search import EACH, Search, chosen, goals, located, tools_for, tried_once
from bayescal.probing.contacts import TURNING, WALLED, Contacts, Rows
from bayescal.robots import only_one_arm
from bayescal.storage.stopping import Progress, silent
from factors.camera import Camera

SESSION = 3600.0
"""s: the time over which candidates are distributed (assumed: 200 contacts at 18 s)."""
SETTLING = 6
"""Corrections of readings for compliances in the robot file; each reduces the error more than tenfold."""


@dataclass(frozen=True)
class Possible(Rows):
    """M contacts: role, target, tool (M,); readings and velocities (M, n), rad, rad/s; payload (M,), kg.

    A contact has `points` (M,) rows: one, or those of an image.
    """

    role: np.ndarray
    target: np.ndarray
    tool: np.ndarray
    readings: np.ndarray
    velocity: np.ndarray
    payload: np.ndarray
    points: np.ndarray


def session_of(dataset: Dataset, possible: Possible, rng: np.random.Generator) -> Dataset:
    """The session with the contacts behind its rows.

    Measured columns are continued: the time over an hour, the temperature at random from those measured.
    Columns that every measured row needs (velocities, times) are not added to a session that lacks them.
    Torques are those computed, because none are measured yet.
    """
    of = np.repeat(np.arange(len(possible)), possible.points)
    times, heat = rng.uniform(0.0, SESSION, len(possible))[of], rng.random(len(possible))[of]
    seen = possible.points[of] > 1
    point = np.arange(len(of)) - (np.cumsum(possible.points) - possible.points)[of]
    stop = np.array([f"i{k}" if image else "" for k, image in zip(of, seen, strict=True)])
    possible = possible[of]
    m, before, new = dataset.measurements, len(dataset.measurements.ids), len(possible.target)
    prefix = next(f"p{k}." for k in count(1) if not any(i.startswith(f"p{k}.") for i in m.ids))
    start = 0.0 if m.time is None or not before else float(np.max(m.time))
    moving = m.velocity is not None or (not before and possible.velocity.any())
    rows = Measurements(
        ids=tuple(f"{prefix}{k:05d}" for k in range(new)),
        role=possible.role,
        target=possible.target,
        tool=possible.tool,
        readings=possible.readings,
        line=np.zeros(new, int),
        command=possible.readings if before else None,
        time=start + times,
        velocity=possible.velocity if moving else None,
        payload=possible.payload if possible.payload.any() else None,
        temperature=None if m.temperature is None else m.temperature[(heat * before).astype(int)],
        stop=stop if seen.any() else None,
        pixel=np.where(seen[:, None], np.column_stack([point] * 3), np.nan) if seen.any() else None,
    )
    rows = followed(m, rows)[0] if before else rows
    return _read(_settled(replace(dataset, measurements=rows, torques="computed"), before), before, rng)


def _settled(session: Dataset, before: int) -> Dataset:
    """Readings of the new rows that bring the nominal arm there with the compliances of its file."""
    robot = session.robot
    if robot.compliance is None or not np.any(robot.compliance):
        return session
    m = session.measurements
    wanted = link_angles(robot, m.readings)
    back = np.linalg.inv(robot.link_from_reading).T
    readings = m.readings
    for _ in range(SETTLING):
        scene = Scene(replace(session, measurements=replace(m, readings=readings)))
        off = (wanted - scene.q) @ back
        off[:before] = 0.0
        readings = readings + off
    return replace(session, measurements=replace(m, readings=readings))


def _read(session: Dataset, before: int, rng: np.random.Generator) -> Dataset:
    """The session with what instruments and wires read of the nominal arm in the new rows."""
    m, scene = session.measurements, Scene(session)
    columns: dict[str, Any] = {}

    def cells(name: str, *width: int) -> np.ndarray:
        return np.asarray(columns.setdefault(name, column(m, name, width)))

    for t, target in enumerate(session.targets):
        rows = np.flatnonzero(m.target == t)
        rows = rows[rows >= before]
        if not len(rows):
            continue
        if KINDS[target.kind].reads == "length":
            if np.isnan(float(target.values["length"])):
                away = scene.points[rows] - np.asarray(target.values["centre"])
                cells("length")[rows] = np.linalg.norm(away, axis=1)
        elif KINDS[target.kind].reads == "xyz":
            frame = rpy_matrix(np.asarray(target.values["rpy"], float))
            cells("xyz", 3)[rows] = (scene.points[rows] - np.asarray(target.values["xyz"])) @ frame
            if m.rpy is not None or session.noise.orientation is not None:
                tools = tool_frames(session, scene.flange)[m.tool[rows]]
                turned = frame.T @ scene.flange[rows] @ tools
                cells("rpy", 3)[rows] = [rpy_of(one) for one in turned]
        elif KINDS[target.kind].reads == "pixel":
            kind, noise = scene.kind(t, rows), session.noise.pixel or KINDS[target.kind].usual
            assert isinstance(kind, Camera)
            pixel = kind.pixels(np.zeros(len(kind.sd)), scene.nominal(t, rows)).T
            # images without noise would make those that were measured look blurred
            cells("pixel", 3)[rows, :2] = pixel + noise * rng.standard_normal(pixel.shape)
    return replace(session, measurements=replace(m, **columns)) if columns else session


COUNT = 5000
"""Candidates of a pool."""
ROUNDS = 12  # of tries; each tries as many places as seem to be needed
FEW = 0.5  # of its share of the candidates: a target with fewer is reported
LOCATED = 6
"""Measured contacts on a sphere from which on it is not probed again for validation."""


def candidates(
    setup: Setup,
    count: int = COUNT,
    seed: int = 0,
    progress: Progress = silent,
    turning: float = TURNING,
    validation: bool = True,
) -> Pool:
    """Possible contacts of a setup.

    Parameters
    ----------
    setup : Setup
    count : int
        Number of candidates, equally many on every target that is calibrated on, where they can be reached.
        Of images a sixth.
    seed : int
        The same seed gives the same candidates.
    progress : callable
        Called with a stage and the fraction done.
    turning : float
        Rotation of the tool during the approach, rad, by which joints come to a contact from both sides.
    validation : bool
        Whether spheres that validate are located.

    Returns
    -------
    Pool
        Half of its candidates carry one of the payloads of the setup.

    Raises
    ------
    BayescalError
        If no candidate is reached on any target, or for two arms.
    """
    only_one_arm(setup.dataset.robot, "plans and simulated sessions")
    rng = np.random.default_rng(seed)
    searches = _searches(setup)
    count = max(1, count // _share(setup))
    fitted = [s for s in searches if setup.dataset.targets[s.target].name not in setup.validated]
    for k in range(ROUNDS):
        if not tried_once(setup, fitted, count, turning, rng):
            break
        progress("candidates", 0.9 * max(min(1.0, sum(s.have for s in fitted) / count), k / ROUNDS))
    walled = [s for s in fitted if not s.have and s.dropped[WALLED]]
    for search in walled:  # nothing else serves
        search.tried, search.by_hand = 0, True
    for _ in range(ROUNDS if walled else 0):
        if not tried_once(setup, walled, count * len(walled) // len(fitted), turning, rng):
            break
    if not any(s.have for s in fitted):
        what = f"no contact is reached: {_reasons(sum((s.dropped for s in fitted), Counter()))}"
        remedy = "check the places of the targets, and the cone of the tool"
        raise BayescalError(what, setup.dataset.name, remedy)
    parts = [
        ("calibrate", s, *chosen(s, goal, rng))
        for s, goal in zip(fitted, goals(fitted, count), strict=True)
        if s.have
    ]
    warnings = [_few(setup, s, count / len(fitted)) for s in fitted if s.have < FEW * count / len(fitted)]
    warnings += [
        f"{setup.dataset.targets[s.target].name} can only be reached by hand: {WALLED}"
        for s in walled
        if s.have
    ]
    missing = _unlocated(setup, searches) if validation else []
    for tool in sorted({min(s.tools) for s in missing}):
        of_tool = [s for s in missing if min(s.tools) == tool]
        contacts = located(setup, of_tool, tool, rng)
        for s, reached in zip(of_tool, contacts, strict=True):
            parts.append(("validate", s, np.full(len(reached), tool), reached))
            if not len(reached):
                warnings.append(_few(setup, s, EACH))
    progress("candidates", 1.0)
    return _pool(setup, parts, sum((s.dropped for s in searches), Counter()), warnings, rng)


CONTACTS = 200
"""Contacts of a plan where no number is asked for."""


def usual_count(setup: Setup) -> int:
    """Contacts of a plan where no number is asked for; of images fewer, as each tells more."""
    return CONTACTS // _share(setup)


def _share(setup: Setup) -> int:
    """For how many contacts a candidate counts: an image for several."""
    return POSE if np.all(_points(setup.dataset) > 1) else 1


def _points(dataset: Dataset) -> np.ndarray:
    """Rows (T,) that are measured at a pose, by target."""
    return np.array([KINDS[t.kind].probing.points(t) for t in dataset.targets])


def _searches(setup: Setup) -> list[Search]:
    """A search for every target, with the tools that measure it."""
    dataset = setup.dataset
    solids = setup.scene.touched([t.name for t in dataset.targets])
    return [Search(k, tools_for(dataset, k), int(solid)) for k, solid in enumerate(solids)]


def _unlocated(setup: Setup, searches: list[Search]) -> list[Search]:
    """Searches of the spheres that validate, and were not located yet."""
    m, targets = setup.dataset.measurements, setup.dataset.targets
    done = np.bincount(m.target[m.role == "validate"], minlength=len(targets))
    return [s for s in searches if targets[s.target].name in setup.validated and done[s.target] < LOCATED]


def _reasons(dropped: Counter[str]) -> str:
    """The three most frequent reasons, with their share."""
    return ", ".join(f"{w} ({n / dropped.total():.0%})" for w, n in dropped.most_common(3))


def _few(setup: Setup, search: Search, wanted: float) -> str:
    name = setup.dataset.targets[search.target].name
    number = f"{search.have} of {wanted:.0f}" if search.have else "no"
    return f"{number} possible contacts on {name}: {_reasons(search.dropped)}"


Part = tuple[str, Search, np.ndarray, Contacts]
"""Role, search, tools (K,) and contacts on one target."""


def _pool(
    setup: Setup, parts: list[Part], dropped: Counter[str], warnings: list[str], rng: np.random.Generator
) -> Pool:
    """All contacts as rows; candidates are in random order, validation contacts behind them."""
    reached = Contacts.join([contacts for *_, contacts in parts])
    counts = [len(contacts) for *_, contacts in parts]
    role = np.repeat([role for role, *_ in parts], counts)
    target = np.repeat([search.target for _, search, *_ in parts], counts)
    tool = np.concatenate([tools for _, _, tools, _ in parts])
    fitted = np.flatnonzero(role == "calibrate")
    order = np.concatenate([rng.permutation(fitted), np.flatnonzero(role == "validate")])
    loaded = (rng.random(len(role)) < 0.5) & (role == "calibrate")
    payload = np.where(loaded, rng.choice(setup.payloads or (0.0,), len(role)), 0.0)
    each = _points(setup.dataset)[target]
    rows = Possible(role, target, tool, reached.readings, reached.velocity, payload, each)[order]
    session = session_of(setup.at_its_noise, rows, rng)
    before = len(setup.dataset.measurements.ids)
    of = np.repeat(np.arange(len(rows)), rows.points)
    shift = session.measurements.readings[before:] - rows.readings[of]
    approach = np.concatenate([setup.dataset.measurements.readings, reached.approach[order][of] + shift])
    return Pool(setup, session, before, approach, dict(dropped.most_common()), tuple(warnings))
