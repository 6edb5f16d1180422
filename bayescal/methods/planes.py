"""Plane equations with planes known: contacts lie on faces whose places are stated (Besnard; Hage).

The faces were measured beforehand to one another; where the arm stands before them is unknown: six
numbers of the base, found with the arm. Nothing else of a face is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bayescal.effects import parameters_of
from bayescal.methods.method import Method, Solution, where_it_stands
from bayescal.methods.solving import System, levenberg, part
from bayescal.model import Block, Model, build, with_parameters
from bayescal.model.model import KNOWN_PLACE
from bayescal.model.scene import Scene
from factors.plane import Plane

FEWEST = 3


def is_plane(block: Block) -> bool:
    """Whether a block touches a face."""
    return isinstance(block.kind, Plane)


def bound(pairs: Iterable[tuple[str, ...]], names: set[str]) -> bool:
    """Whether pairs of names join all names."""
    reached, more = set(sorted(names)[:1]), True
    links = [set(pair) for pair in pairs if len(pair) == 2]
    while more:
        grown = reached.union(*(link for link in links if link & reached))
        more, reached = grown != reached, grown
    return names <= reached


def missing(model: Model) -> str:
    """What a session lacks for known planes."""
    faces = part(model, is_plane)
    names = {block.target for block in faces.blocks}
    if len(names) < FEWEST:
        return f"{len(names) or 'no'} planes are probed; at least {FEWEST} are needed"
    stated = {t.name for t in model.scene.dataset.targets if t.u is not None and t.u <= KNOWN_PLACE}
    if names <= stated or bound([constraint.targets for constraint in faces.constraints], names):
        return ""
    return "the relative positions of the planes are not stated (u_mm, or certificates between them)"


@where_it_stands
def solve(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """Fit the arm and its base to the planes as stated; where nothing ties the base, the planes moved."""
    circumstances = replace(scene.circumstances(scene.rows("calibrate")), tied_base=True)
    model = with_parameters(scene, effects, parameters_of(effects, circumstances))
    found = levenberg(System(part(model, is_plane), known=True))
    plain = build(scene, effects)
    own = {p.name: value for p, value in zip(model.parameters, found.values, strict=True)}
    names = [p.name for p in plain.parameters]
    held = tuple(name for name in found.held if name in names)
    return Solution(plain, np.array([own[name] for name in names]), held, found.condition)


PLANES = Method(
    "known planes",
    "Besnard et al.; Hage et al.",
    "contacts lie on faces at stated positions; non-linear least squares of the arm and its base",
    missing,
    solve,
)
