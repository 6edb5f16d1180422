"""Which worlds there are: kinds in fixed shares, and every effect in its turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.world import frames, joints, outside, probe
from bayescal.world.touch import Act, World

Maker = Callable[[np.random.Generator, World], Act]
NAMED: tuple[Maker, ...] = (
    joints.eccentricity, joints.second_harmonic, joints.gear_mesh, joints.backlash, joints.hysteresis,
    joints.encoder_scale, joints.coupling, joints.hardening, joints.compliance,
    frames.thermal_drift, frames.step, frames.bending, frames.base_compliance, frames.payload,
    probe.lobing, probe.latency, probe.plane_form, probe.artefact,
)  # fmt: skip
MIX = ("null",) * 4 + ("single",) * 10 + ("pair",) * 3 + ("outside",) * 3  # of every twenty


def recipe(seed: int, number: int) -> tuple[str, list[Maker]]:
    """Return the kind of a world and what makes its effects; names and kinds go round evenly."""
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
    pool = NAMED if kind == "single" else outside.OUTSIDE
    again, place = divmod(rank, len(pool))
    return kind, [pool[np.random.default_rng([seed, 3, again, len(pool)]).permutation(len(pool))[place]]]


def wishes(rng: np.random.Generator, makers: Sequence[Maker]) -> dict:
    """Return what a session needs for its effects to be visible at all."""
    out: dict = {}
    if probe.latency in makers:
        out |= {"speeds": float(rng.choice([1.6, 2.5])), "spin_degps": float(rng.uniform(1, 3))}
    if (
        frames.payload in makers or joints.hardening in makers or frames.bending in makers
    ) and rng.random() < 0.5:
        out["payload"] = str(rng.choice(["half", "blocks"]))
    if joints.backlash in makers and rng.random() < 0.4:
        out["reverse"] = float(rng.uniform(0.02, 0.06))
    return out
