"""Centres of targets as quantities: of fitted targets, and of those located from rows of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayescal.assess.budget.inputs import CERTIFICATE, PROBING, Basis, Input, Own, reading_shares
from bayescal.errors import BayescalError
from bayescal.estimate import STATED_WORTH
from bayescal.model import ARM
from bayescal.predict.rows import certified_diameters
from bayescal.predict.targets import LocatedTarget, centre_of


@dataclass(frozen=True)
class Centre:
    """A centre (3,), m, in F0: its slopes (3, D') by the unknowns of a fit, and errors of its own."""

    at: np.ndarray
    by_z: np.ndarray
    own: tuple[Own, ...]


def centre(basis: Basis, name: str) -> Centre:
    """The centre of a target that was fitted or is located from validation measurements.

    Raises
    ------
    BayescalError
        If the session has no such target, or it has no centre, or no rows.
    """
    wide = basis.stated.wide
    model, scene = wide.model, wide.model.scene
    centred = [t.name for t in scene.dataset.targets if scene.declared_of(t.name).centred]
    if name not in centred:
        there = f"those with a centre: {', '.join(centred)}" if centred else "this session has none"
        raise BayescalError(f"there is no target `{name}` with a centre", "--distance", there)
    if name in model.block_of:
        block, z = model.block_of[name], wide.z[model.slices[name]]
        by_z = np.zeros((3, model.size))
        by_z[:, model.slices[name]] = block.by_z(_slopes_of_centre(block.kind.sd))
        return Centre(centre_of(block, block.state(z)), by_z, ())
    known = basis.prepared.located
    if name not in known:
        what = f"{name} has no measurements that are fitted or validate"
        raise BayescalError(what, "--distance", "name targets that were measured")
    t = known[name]
    by_z = np.zeros((3, model.size))
    by_z[:, model.slices[ARM]] = t.to_state[:3] @ t.by_arm
    return Centre(t.centre, by_z, tuple(own_errors(basis, t, t.to_state[:3])))


def _slopes_of_centre(sd: np.ndarray) -> np.ndarray:
    """Slopes (3, kind size) of a centre by the state of its target: the first three components."""
    return np.eye(3, len(sd))


def own_errors(basis: Basis, t: LocatedTarget, by: np.ndarray) -> Iterator[Own]:
    """Errors of locating a target, for quantities with slopes `by` (K, m) by its unknowns."""
    wide, name = basis.stated.wide, t.block.target
    scene = wide.model.scene
    fitted = t.block.group in wide.weights.scale
    factor = float(np.sqrt(basis.stated.white)) if fitted else 1.0
    dof = wide.dof[t.block.group] + STATED_WORTH if fitted else np.inf
    share = np.tile(reading_shares(wide, t.block, t.z), t.block.kind.rows)
    by_noise, evaluation = factor * by @ t.by_noise, "A" if fitted else "B"
    u = factor * float(np.sqrt(np.mean(t.noise**2 * (1.0 - share))))
    count = len(t.block.rows)
    what = f"location of {name} ({count} measurements)"
    probed = Input(
        PROBING, what, evaluation, "m", 0.0, u, dof, "location of the measured targets", t.block.group
    )
    yield probed, by_noise * np.sqrt(1.0 - share)
    if np.any(share):
        u = factor * scene.dataset.noise.joint * (wide.weights.scale[t.block.group] if fitted else 1.0)
        what, common = f"joint readings at {name}", "joint readings at the measured targets"
        yield (
            Input(PROBING, what, evaluation, "rad", 0.0, u, dof, common, t.block.group),
            by_noise * np.sqrt(share),
        )
    yield from _priors(t, by, name in certified_diameters(scene))
    if basis.excess:
        of_rows = scene.declared_of(name).of_instrument
        yield basis.unexplained(), basis.excess * by @ (t.gain if of_rows else t.by_shift)


def _priors(t: LocatedTarget, by: np.ndarray, certified: bool) -> Iterator[Own]:
    """What was stated of a target: its certified diameter, its position, the centre of its tool."""
    name, parts = t.block.target, t.block.kind.parts
    for k, at in enumerate(t.block.free):
        part, unit = parts[at]
        prior = Input(
            PROBING, f"stated {part} of {name}", "B", unit, 0.0, float(t.block.sd[k]),
            common="stated positions of the measured targets",
        )  # fmt: skip
        if part == "diameter":
            nominal = float(t.block.kind.describe(np.zeros(len(parts)))["diameter"])
            what = f"{'certificate' if certified else 'stated'}: diameter {name}"
            prior = replace(
                prior, group=CERTIFICATE, name=what, value=nominal, common="diameters of the measured targets"
            )
        yield prior, by @ t.by_prior[:, [k]]
    for k in range(len(t.block.free), len(t.by_prior)):
        what = f"stated tool of {name}, {'xyz'[k - len(t.block.free)]}"
        yield Input(PROBING, what, "B", "m", 0.0, t.tool_sd, common="stated tools"), by @ t.by_prior[:, [k]]
