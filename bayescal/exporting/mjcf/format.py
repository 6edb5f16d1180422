"""MJCF as a format of an export."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bayescal.effects import Parameter
from bayescal.effects.tool import TOOL
from bayescal.exporting.fitted import FittedArm
from bayescal.exporting.geometry import carries
from bayescal.exporting.mjcf.content import STATE, UNHELD, Content
from bayescal.exporting.mjcf.elastic import springless, sprung
from bayescal.exporting.mjcf.mechanism import loads, names
from bayescal.exporting.mjcf.new_file import mjcf
from bayescal.exporting.mjcf.readings import Joints
from bayescal.exporting.mjcf.script import beside
from bayescal.exporting.written import Format, Item, Options, Written, item

PLACES = {
    "torque": ("joint {name}_flex, tendons {name}_flex_...", "stiffness"),
    "bending moment": ("joints {name}_tilt_... and {name}_bend_...", "stiffness"),
    "base moment": ("joints stand_...", "stiffness, pos"),
    "mass": ("bodies tool and payload", "mass, pos"),
    "direction": ("tendon {name}_gear", "springlength"),
    "angle": ("tendon {name}_gear", "coef"),
}
"""Element and attribute of a parameter, by the kind of its driver."""
WEIGHED = ("torque", "bending moment", "base moment", "mass")
"""Drivers that need the masses of the links."""


def write(arm: FittedArm, options: Options) -> Written:
    """The MJCF file of an arm."""
    script, whole, arm = options.readings == "script", arm, sprung(arm)
    if options.into:
        from bayescal.exporting.mjcf.into.patch import patched

        own = patched(arm, options)
        text, details, notes, placed, bodies = own.text, own.details, own.notes, own.placed, own.bodies
        joints = Joints(tuple(details["joints"].values()), np.array(details["signs"]))
    else:
        text, details, notes, placed = mjcf(arm, options.state, script), {}, [], None
        bodies = names(arm.dataset.robot.n)
        joints = Joints.of(arm.dataset.robot.joint_names)
    renamed = details.get("renamed", {})
    more = beside(Content(arm, options.state), joints, not options.into, renamed) if script else {}
    for load in loads(Content(arm, options.state)):
        if load.factor != 1.0:
            told = f"a further mass acts {load.factor:.6g} times: set the body payload so (tool {load.name})"
            notes = [*notes, told]
    details = {**details, "readings": options.readings}
    items = tuple(_items(whole, joints.names, bodies))
    return Written(text, items, more, notes, details, placed)


def holds(arm: FittedArm, k: int) -> bool:
    """Whether an MJCF file can hold a parameter."""
    p = arm.model.parameters[k]
    if p.driver.kind in STATE:
        return all(term.frame >= 0 for term in p.terms)
    weighed = p.driver.kind not in WEIGHED or arm.model.scene.moments is not None
    return p.driver.kind in PLACES and p.driver.form not in UNHELD and weighed and not springless(arm)[k]


def _items(arm: FittedArm, joints: Sequence[str], bodies: Sequence[str]) -> Iterator[Item]:
    """Parameters in a file with these names of its joints, and of the bodies of base, links and flange."""
    for k, p in enumerate(arm.model.parameters):
        if holds(arm, k):
            yield item(arm, k, *_place(p, joints, bodies))


def _place(p: Parameter, joints: Sequence[str], bodies: Sequence[str]) -> tuple[str, str]:
    if p.effect == TOOL.name:
        return f"site {p.name.rpartition(' ')[0]}", "pos"
    if p.driver.kind in PLACES:
        element, attribute = PLACES[p.driver.kind]
        return element.format(name=joints[p.site.number - 1] if p.site.number else "..."), attribute
    term = p.terms[0]
    return f"body {bodies[0 if term.frame == 0 else carries(term) + 1]}", "pos, quat"


MJCF = Format(
    "mjcf",
    ".xml",
    "MuJoCo: geometry, springs of joints, bearings and stand, errors of the readings, lost motion",
    write,
    holds,
    "MuJoCo has no such element",
    readings=("plain", "script"),
    into=True,
)
"""The whole arm, for MuJoCo 4."""
