"""Pairs of simulated sessions of one arm: unmodelled effects are in both, and at most two things change.

The arm, what stands before it and effects that are not modelled are the same in both sessions; each has its
contacts or poses, payloads, warm-up, noise and outliers. Between the sessions a joint zero may shift (a
crash), a joint become softer, its backlash grow, the tool be mounted anew, or the base move. The size of a
change follows from a drawn detectability: that of a fit of both sessions with one arm. Nothing is shared with
the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.world import arm, forms_joints, frames, joints, probe, scene, session, tracker, visible, write
from analysis.world.build import NOISE, _wild
from analysis.world.mix import ON_SURFACE
from analysis.world.size import modest, sized
from analysis.world.touch import Act, Moved, Seen, World
from analysis.world.tracker import Tracked

GOAL = (10.0, 1000.0)
"""Detectability of a change, from and to."""
NUISANCE = (
    joints.eccentricity,
    joints.second_harmonic,
    joints.gear_mesh,
    joints.backlash,
    joints.encoder_scale,
    joints.coupling,
    frames.bending,
    frames.base_compliance,
    probe.lobing,
    probe.plane_form,
    probe.artefact,
    forms_joints.eccentricity,
    forms_joints.second_harmonic,
    forms_joints.backlash,
    forms_joints.encoder_scale,
)
"""Effects that the model lacks, of both sessions: those whose form does not depend on the session."""
KINDS = (
    ("null",) * 7
    + ("zero",) * 4
    + ("compliance",) * 2
    + ("backlash",) * 2
    + ("tool",) * 2
    + ("base", "pair", "pair")
)
"""What changes, of every twenty pairs of sessions."""
SINGLE = ("zero", "compliance", "backlash", "tool", "base")
STAGES = (session.CUBE, session.CUBE, session.SPHERES, session.TRACKER)
SESSIONS = ("before", "after")
Made = tuple[World, Sequence[tuple[Act, float]]]
"""An arm in a session, and the effects that act on it."""


@dataclass(frozen=True)
class Change:
    """Something that changes: what, where, its unit, and the session after it at a size."""

    name: str
    site: str
    unit: str
    value: np.ndarray  # of size 1
    act: Callable[[Made, float], Made]


def _zero(rng: np.random.Generator, world: World) -> Change:
    # of spheres, each session may have others: then the first zero is that of the place of the targets
    j = int(rng.integers(1 if world.session.stage == session.SPHERES else 0, 6))
    sign = rng.choice([-1.0, 1.0])

    def act(of: Made, size: float) -> Made:
        shape = of[0].arm.shape
        return _shaped(of[0], zero=shape.zero + sign * size * np.eye(6)[j]), of[1]

    return Change("zero", f"joint {j + 1}", "rad", sign * np.ones(1), act)


def _compliance(rng: np.random.Generator, world: World) -> Change:
    j = int(rng.integers(1, 6))
    unit = 1e-5

    def act(of: Made, size: float) -> Made:
        give = of[0].give + unit * size * np.eye(6)[j]
        return replace(of[0], give=give), of[1]

    return Change("compliance", f"joint {j + 1}", "rad/(N m)", unit * np.ones(1), act)


def _backlash(rng: np.random.Generator, world: World) -> Change:
    """Return backlash that is new or has grown."""
    grown = joints.backlash(rng, world)
    least = float(rng.choice([0.0, rng.uniform(2e-5, 8e-5)]))

    def act(of: Made, size: float) -> Made:
        return of[0], [*of[1], (grown, least + 1e-4 * size)]

    return Change("backlash", grown.where[0]["site"], "rad", 1e-4 * np.ones(1), act)


def _tool(rng: np.random.Generator, world: World) -> Change:
    way = rng.standard_normal(3)

    def act(of: Made, size: float) -> Made:
        return _shaped(of[0], tool=of[0].arm.shape.tool + 1e-4 * size * way), of[1]

    return Change("tool", "tool", "m", 1e-4 * way, act)


def _base(rng: np.random.Generator, world: World) -> Change:
    way = np.concatenate([1e-4 * rng.standard_normal(3), 2e-4 * rng.standard_normal(3)])

    def act(of: Made, size: float) -> Made:
        def move(seen: Seen, amount: float, m: Moved) -> None:
            del seen
            m.base[:] += amount * way

        return of[0], [*of[1], (Act("base", [], "1", 1.0, 1e3, move), size)]

    return Change("base", "base", "m", way, act)


MAKERS = {"zero": _zero, "compliance": _compliance, "backlash": _backlash, "tool": _tool, "base": _base}


def _shaped(world: World, **values: np.ndarray) -> World:
    return replace(world, arm=arm.Arm(replace(world.arm.shape, **values)))


def _columns(
    models: Sequence[visible.Fitted], worlds: Sequence[World], sigma: float, tied: bool
) -> np.ndarray:
    """Return whitened columns of one arm in both sessions; targets of one name are one where `tied`."""
    rows, keys = [], []
    for k, (model, world) in enumerate(zip(models, worlds, strict=True)):
        stage = world.session.stage
        per = {session.CUBE: 3, session.SPHERES: 4, session.TRACKER: 6}[stage]
        of = np.arange(4) if stage == session.CUBE else world.session.calibrating
        arm_size = model.columns.shape[1] - per * len(of)
        names = [("arm", c) for c in range(arm_size)]
        names += [(int(t), c) if tied else (k, int(t), c) for t in of for c in range(per)]
        keys.append(names)
        rows.append(np.concatenate([model.columns[model.used] / sigma, model.certificates]))
    every = list(dict.fromkeys(key for names in keys for key in names))
    out = []
    for names, own in zip(keys, rows, strict=True):
        wide = np.zeros((len(own), len(every)))
        wide[:, [every.index(key) for key in names]] = own
        out.append(wide)
    return np.concatenate(out)


def _left(matrix: np.ndarray, shift: np.ndarray) -> float:
    """Return the squared norm of what no combination of columns absorbs."""
    scale = np.linalg.norm(matrix, axis=0)
    u, s, _ = np.linalg.svd(matrix / np.where(scale > 0, scale, 1.0), full_matrices=False)
    u = u[:, s > 1e-7 * s[0]]
    return float(np.sum((shift - u @ (u.T @ shift)) ** 2))


def _started(world: World) -> World:
    """Return the world with contacts that begin where the arm nearly touches, as `size.modest`."""
    first, _ = world.touch((), np.zeros(len(world.session.time)), straight=True)
    return replace(world, session=replace(world.session, start=first))


def build(
    seed: int, number: int, kind: str = "", goal: float = 0.0, stage: str = "", generator: int = 2
) -> tuple[dict[str, str], dict]:
    """Return the files of a pair of sessions by name, and its truth.

    Parameters
    ----------
    seed, number : int
        Of the set of pairs, and which of them.
    kind : str
        What changes; drawn of `KINDS` without one.
    goal : float
        Detectability of the change; drawn between the values of `GOAL` without one.
    stage : str
        What is measured; drawn of `STAGES` without one.
    generator : int
        Version; in the first, sessions with backlash may lack the velocities that tell it.
    """
    rng = np.random.default_rng([seed, 8, number])
    order = np.random.default_rng([seed, 9, number // len(KINDS)]).permutation(len(KINDS))
    kind = kind or KINDS[order[number % len(KINDS)]]
    body, things = arm.Arm(arm.draw(rng)), scene.draw(rng)
    drawn = str(rng.choice(STAGES))
    stage = stage or drawn
    names = [] if kind == "null" else [kind] if kind != "pair" else list(rng.choice(SINGLE, 2, replace=False))
    if "base" in names and stage == session.SPHERES:
        stage = session.CUBE  # of spheres, other ones may be probed in each session
    # backlash follows the direction of motion, which a tracker does not tell
    wishes = {"velocity": True} if generator > 1 and "backlash" in names else {}
    plans = [session.plan(rng, things, wishes, stage) for _ in SESSIONS]
    instrument = tracker.draw(rng)

    def placed(plan: session.Session, of: arm.Arm) -> World:
        if stage == session.TRACKER:
            return Tracked(of, things, plan, of.shape.give, instrument)
        return World(of, things, plan, of.shape.give)

    sigma = float(rng.uniform(*NOISE[stage]))
    stated = sigma * rng.uniform(0.75, 4 / 3)
    first, quiet, model = modest(placed(plans[0], body), True, sigma)
    second = _started(placed(plans[1], first.arm))
    usable = [m for m in NUISANCE if stage == session.CUBE or m not in ON_SURFACE]
    picked = rng.choice(len(usable), int(rng.integers(0, 3)), replace=False)
    nuisance = [sized(rng, usable[k], first, model, quiet, sigma)[:2] for k in picked]
    still, _ = second.touch((), np.zeros(len(second.session.time)))
    models = [model, visible.fitted(second, still, True)]
    made: list[Made] = [(first, nuisance), (second, nuisance)]
    told = []
    for name in names:
        change = MAKERS[name](rng, second)
        wanted = goal or float(np.exp(rng.uniform(*np.log(GOAL))))
        tied = name == "base" or change.site == "joint 1"
        matrix, size, found = _columns(models, [first, second], sigma, tied), 1.0, 0.0
        plain = (second, [])
        for _ in range(6):
            one, more = change.act(plain, size)
            none, least = change.act(plain, 0.0)
            shift = (one.gap(still, more) - none.gap(still, least))[models[1].used] / sigma
            whole = np.zeros(len(matrix))
            at = int(models[0].used.sum()) + len(models[0].certificates)
            whole[at : at + len(shift)] = shift
            found = _left(matrix, whole)
            if abs(found / wanted - 1) < 0.02:
                break
            size = float(np.clip(size * np.clip(np.sqrt(wanted / max(found, 1e-12)), 0.02, 50), 1e-9, 300))
        if name == "backlash":
            made[0] = change.act(made[0], 0.0)
        made[1] = change.act(made[1], size)
        value = (size * change.value).tolist()
        told.append({"name": name, "site": change.site, "unit": change.unit, "lambda": found, "value": value})
    texts = {}
    for label, (world, acts) in zip(SESSIONS, made, strict=True):
        plan = world.session
        noise = sigma * rng.standard_normal(len(plan.of_rows(plan.time))) + _wild(rng, plan)
        own, _ = write.texts(rng, world, acts, noise, f"pair-{number:03d}-{label}", stated)
        texts |= {f"{label}/{name}": text for name, text in own.items()}
    truth = {
        "schema": write.SCHEMA,
        "seed": seed,
        "world": f"{number:03d}",
        "kind": kind,
        "stage": stage,
        "changes": told,
        "nuisance": {a.name: size for a, size in nuisance},
        "noise_um": 1e6 * sigma,
        "lambda": min((c["lambda"] for c in told), default=0.0),
    }
    return texts, truth
