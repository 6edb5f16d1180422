"""Bodies, hinges and springs of a mechanism as elements of an MJCF file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.transforms import rigid
from bayescal.exporting.digits import number, numbers
from bayescal.exporting.mjcf.mechanism import Body, Hinge, Load, Mechanism
from bayescal.exporting.mjcf.text import DEFAULT, add, place

DAMPING = 0.02
"""Damping of a spring, s times its stiffness."""
GYRATION = 0.08
"""Radius of gyration of a link, m (assumed: a calibration at standstill does not identify inertias)."""
WEIGHTLESS = 1.0
"""Mass, kg, of a body without a stated mass; gravity does not act on it."""
NEUTRAL = {
    "joint": {
        "frictionloss": "0", "springref": "0", "ref": "0", "stiffness": "0", "damping": "0", "springyield":
        "0", "actuatorfrclimited": "false", "margin": "0", "group": "3",
    },
    "tendon": {
        "frictionloss": "0", "stiffness": "0", "damping": "0", "springlength": "-1", "springyield": "0",
        "armature": "0", "margin": "0",
    },
    "equality": {"active": "true", "solref": "0.02 1", "solimp": "0.9 0.95 0.001 0.5 2"},
}  # fmt: skip
"""Attributes of added elements that have no effect."""
MOST = 6
"""Largest number of hinges of a body in MuJoCo."""
TIP = {"type": "sphere", "size": "0.004", "rgba": ".9 .2 .1 1", "group": "0"}
"""Attributes of a site at the tip of a tool."""
THIN = 0.02
"""Radius of the capsules that show the links, m."""


def defaults(root: ET.Element, shown: bool = True) -> None:
    """The default class of all added elements: it resets what the defaults of a file may set."""
    top = root.find("default")
    own = add(add(root, "default") if top is None else top, "default", **{"class": DEFAULT})
    add(own, "joint", type="hinge", limited="false", range="0 0", armature=1e-3, **NEUTRAL["joint"])
    add(own, "tendon", limited="false", range="0 0", **NEUTRAL["tendon"])
    add(own, "equality", **NEUTRAL["equality"])
    if shown:
        add(
            own,
            "geom",
            contype="0",
            conaffinity="0",
            group="2",
            type="capsule",
            size=THIN,
            rgba=".7 .7 .75 1",
        )


def bodies(parent: ET.Element, mechanism: Mechanism) -> list[ET.Element]:
    """Append the bodies in series; returns their elements, the last that of the flange."""
    out = []
    ends = [b.pose[:3, 3] for b in mechanism.bodies[1:]] + [mechanism.flange[:3, 3]]
    for body, end in zip(mechanism.bodies, ends, strict=True):
        for part in _parts(body):
            parent = add(parent, "body", name=part.name, childclass=DEFAULT, **place(part.pose))
            inertial(parent, part)
            for h in part.hinges:
                hinge(parent, h)
        if np.linalg.norm(end) > THIN:
            add(parent, "geom", fromto=[0.0, 0.0, 0.0, *end])
        out.append(parent)
    out.append(add(parent, "body", name="flange", childclass=DEFAULT, **place(mechanism.flange)))
    return out


def _parts(body: Body) -> list[Body]:
    """The body; of one with too many hinges, a body without a mass for its first ones and itself."""
    if len(body.hinges) <= MOST:
        return [body]
    first = replace(body, hinges=body.hinges[:-MOST], mass=0.0, centre=np.zeros(3))
    return [first, replace(body, name=f"{body.name}_yielding", pose=np.eye(4), hinges=body.hinges[-MOST:])]


def inertial(element: ET.Element, body: Body) -> None:
    """Append the mass of a body; one without a mass has inertia, but no weight."""
    if body.mass <= 0:
        element.set("gravcomp", "1")
    mass = body.mass if body.mass > 0 else WEIGHTLESS
    add(element, "inertial", pos=body.centre, mass=mass, diaginertia=[mass * GYRATION**2] * 3)


def hinge(element: ET.Element, h: Hinge) -> None:
    """Append a hinge with its spring."""
    own = add(element, "joint", **{"class": DEFAULT}, name=h.name, axis=h.axis, pos=h.pos)
    if h.limits is not None:
        own.attrib.update(limited="true", range=numbers(h.limits))
    if h.spring is not None:
        own.set("stiffness", number(h.spring.stiffness))
        own.set("damping", number(DAMPING * h.spring.slope))
        if h.rest:
            own.set("springref", number(h.rest))


def bands(tendons: ET.Element, mechanism: Mechanism, names: Mapping[str, str] | None = None) -> None:
    """Append the dead bands of springs as tendons; `names` of the hinges in the file, if they differ."""
    for h in (h for b in mechanism.bodies for h in b.hinges if h.spring is not None):
        assert h.spring is not None
        name = h.name if names is None else names[h.name]
        for k, b in enumerate(h.spring.bands, start=1):
            edges = [b.lower, b.upper]
            fixed = add(
                tendons,
                "fixed",
                **{"class": DEFAULT},
                name=f"{name}_{k}",
                springlength=edges,
                stiffness=b.stiffness,
            )
            add(fixed, "joint", joint=name, coef=1.0)


def tool(flange: ET.Element, load: Load) -> None:
    """Append a tool: its mass, a further mass that a user may set, and its tip."""
    own = add(flange, "body", name="tool", childclass=DEFAULT)
    if load.mass > 0:
        add(own, "inertial", pos=load.centre, mass=load.mass, diaginertia=[load.mass * GYRATION**2] * 3)
    added = add(own, "body", name="payload", **place(rigid(None, load.at)))
    add(added, "inertial", pos=np.zeros(3), mass=1e-9, diaginertia=[1e-9] * 3)


def tips(flange: ET.Element, loads: tuple[Load, ...]) -> None:
    """Append the tips of all tools as sites."""
    for load in loads:
        add(flange, "site", name=load.name, pos=load.tip, **TIP)
