"""Which worlds there are: kinds in fixed shares, every effect in its turn, and a form of each at random."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from analysis.world import (
    forms_frames,
    forms_joints,
    forms_probe,
    frames,
    joints,
    outside,
    outside_more,
    probe,
)
from analysis.world.session import CUBE, SPHERES, TRACKER
from analysis.world.touch import Act, World

Maker = Callable[[np.random.Generator, World], Act]
NAMED: tuple[Maker, ...] = (
    joints.eccentricity, joints.second_harmonic, joints.gear_mesh, joints.backlash, joints.hysteresis,
    joints.encoder_scale, joints.coupling, joints.hardening, joints.compliance,
    frames.thermal_drift, frames.step, frames.bending, frames.base_compliance, frames.payload,
    probe.lobing, probe.latency, probe.plane_form, probe.artefact,
)  # fmt: skip
FORMS: dict[Maker, tuple[Maker, ...]] = {
    **{m: (getattr(forms_joints, m.__name__),) for m in NAMED if m.__module__ == joints.__name__},
    **{m: (getattr(forms_frames, m.__name__),) for m in NAMED if m.__module__ == frames.__name__},
    **{m: (getattr(forms_probe, m.__name__),) for m in NAMED if m.__module__ == probe.__name__},
    frames.payload: (forms_frames.payload, forms_frames.added_payload),
}
"""Further forms of every known effect; drawn as often as its first form."""
MIX = ("null",) * 4 + ("single",) * 10 + ("pair",) * 3 + ("outside",) * 3  # of every twenty

FIRST_OF = {other: first for first, others in FORMS.items() for other in others}
GENERATORS = (1, 2, 3, 4)
"""Versions of the generator: a seed gives the same sessions within one.

The first has one form of every effect and the second several; the third has sessions on spheres alone, the
fourth with a tracker.
"""
ON_CUBE = {
    probe.plane_form, probe.artefact, forms_probe.plane_form, forms_probe.artefact,
    outside.dent, outside_more.shoved_target,
}  # fmt: skip
ON_SURFACE = ON_CUBE | {
    probe.lobing, probe.latency, forms_probe.lobing, forms_probe.latency,
    outside.warm_trigger, outside.snag, outside_more.hasty_trigger,
}  # fmt: skip
"""What needs a surface, a trigger, or an arm that moves while it is measured: a tracker has none of these."""
ALONE = 0.25
"""Share of sessions on spheres alone, of those whose effects do not need the cube."""
TRACKED = 0.25
"""Share of sessions with a tracker, of those whose effects need no surface: a fifth of all."""


def stage(seed: int, number: int, generator: int, makers: Sequence[Maker]) -> str:
    """Return what calibrates in a session: the cube, spheres alone, or poses that a tracker reads."""
    tracked = generator > 3 and np.random.default_rng([seed, 6, number]).random() < TRACKED
    if tracked and not ON_SURFACE & set(makers):
        return TRACKER
    alone = generator > 2 and np.random.default_rng([seed, 5, number]).random() < ALONE
    return SPHERES if alone and not ON_CUBE & set(makers) else CUBE


def causes(generator: int, reserved: bool) -> tuple[Maker, ...]:
    """Return the causes not in the list of known effects that may be drawn."""
    more = outside_more.MORE if generator > 1 else ()
    return outside.OUTSIDE + more + (outside_more.RESERVED if reserved else ())


def formed(seed: int, number: int, makers: Sequence[Maker]) -> list[Maker]:
    """Return makers with a form of each drawn: the first, or one of the others, with equal probability."""
    rng = np.random.default_rng([seed, 4, number])
    out = []
    for maker in makers:
        others = FORMS.get(maker, ())
        first, which = rng.random() < 0.5, rng.random()
        out.append(maker if first or not others else others[int(which * len(others))])
    return out


def recipe(
    seed: int, number: int, generator: int = GENERATORS[-1], *, reserved: bool = False
) -> tuple[str, list[Maker]]:
    """Return the kind of a world and what makes its effects; names and kinds go round evenly.

    Parameters
    ----------
    seed, number : int
        As of `build.build`.
    generator : int
        One of `GENERATORS`.
    reserved : bool
        Also draw the reserved causes not in the list of known effects.
    """
    kind, makers = _recipe(seed, number, causes(generator, reserved))
    return kind, makers if generator == 1 else formed(seed, number, makers)


def _recipe(seed: int, number: int, strange: Sequence[Maker]) -> tuple[str, list[Maker]]:
    block, slot = divmod(number, len(MIX))
    order = np.random.default_rng([seed, 1, block]).permutation(len(MIX))
    kind = MIX[order[slot]]
    rank = sorted(k for k in range(len(MIX)) if MIX[order[k]] == kind).index(slot) + MIX.count(kind) * block
    if kind == "null":
        return kind, []
    if kind == "pair":
        rng = np.random.default_rng([seed, 2, number])
        first, second = rng.choice(
            [k for k, m in enumerate(NAMED) if m is not joints.compliance], 2, replace=False
        )
        return kind, [NAMED[first], NAMED[second]]
    pool = NAMED if kind == "single" else strange
    again, place = divmod(rank, len(pool))
    return kind, [pool[np.random.default_rng([seed, 3, again, len(pool)]).permutation(len(pool))[place]]]


def wishes(rng: np.random.Generator, makers: Sequence[Maker], what: str) -> dict:
    """Return what a session needs for its effects to be visible at all.

    Without a surface, only stated velocities tell the direction of motion: backlash needs them.
    """
    out: dict = {}
    named = {FIRST_OF.get(maker, maker) for maker in makers}
    if probe.latency in named:
        out |= {"speeds": float(rng.choice([1.6, 2.5])), "spin_degps": float(rng.uniform(1, 3))}
    if (
        frames.payload in named or joints.hardening in named or frames.bending in named
    ) and rng.random() < 0.5:
        out["payload"] = str(rng.choice(["half", "blocks"]))
    if joints.backlash in named and rng.random() < 0.4:
        out["reverse"] = float(rng.uniform(0.02, 0.06))
    if joints.backlash in named and what == TRACKER:
        out["velocity"] = True
    if forms_frames.added_payload in makers:
        out["payload"] = str(rng.choice(["half", "blocks"]))
    if outside_more.hasty_trigger in makers:
        out["speeds"] = 2.5
    return out
