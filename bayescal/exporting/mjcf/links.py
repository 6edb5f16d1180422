"""Bodies, hinges and springs of a mechanism as elements of an MJCF file."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.transforms import rigid
from bayescal.exporting.mjcf.mechanism import Body, Hinge, Load, Mechanism
from bayescal.exporting.mjcf.text import add, number, place

DEFAULT = "bayescal"
DAMPING = 0.02
"""Damping of a spring, s times its stiffness."""
GYRATION = 0.08
"""Radius of gyration of a link, m (assumed: a calibration at standstill does not identify inertias)."""
WEIGHTLESS = 1.0
"""Mass, kg, of a body without a stated mass; gravity does not act on it."""
THIN = 0.02
"""Radius of the capsules that show the links, m."""


def defaults(root: ET.Element) -> None:
    """The default class of all inserted joints: it resets what the defaults of a file may set."""
    top = add(add(root, "default"), "default", **{"class": DEFAULT})
    add(
        top, "joint", type="hinge", limited="false", range="0 0", armature=1e-3, frictionloss=0.0,
        springref=0.0, ref=0.0, stiffness=0.0, damping=0.0, actuatorfrclimited="false", margin=0.0,
    )  # fmt: skip
    add(top, "geom", contype="0", conaffinity="0", group="2", type="capsule", size=THIN, rgba=".7 .7 .75 1")
    add(top, "site", size=0.004, rgba=".9 .2 .1 1")


def bodies(parent: ET.Element, mechanism: Mechanism) -> list[ET.Element]:
    """Append the bodies in series; returns their elements, the last that of the flange."""
    out = []
    ends = [b.pose[:3, 3] for b in mechanism.bodies[1:]] + [mechanism.flange[:3, 3]]
    for body, end in zip(mechanism.bodies, ends, strict=True):
        parent = add(parent, "body", name=body.name, childclass=DEFAULT, **place(body.pose))
        inertial(parent, body)
        for h in body.hinges:
            hinge(parent, h)
        if np.linalg.norm(end) > THIN:
            add(parent, "geom", fromto=[0.0, 0.0, 0.0, *end])
        out.append(parent)
    out.append(add(parent, "body", name="flange", childclass=DEFAULT, **place(mechanism.flange)))
    return out


def inertial(element: ET.Element, body: Body) -> None:
    """Append the mass of a body; one without a mass has inertia, but no weight."""
    if body.mass <= 0:
        element.set("gravcomp", "1")
    mass = body.mass if body.mass > 0 else WEIGHTLESS
    add(element, "inertial", pos=body.centre, mass=mass, diaginertia=[mass * GYRATION**2] * 3)


def hinge(element: ET.Element, h: Hinge) -> None:
    """Append a hinge with its spring."""
    own = add(element, "joint", **{"class": DEFAULT}, name=h.name, axis=h.axis, pos=h.pos)
    if h.spring is not None:
        own.set("stiffness", number(h.spring.stiffness))
        own.set("damping", number(DAMPING * h.spring.slope))
        if h.rest:
            own.set("springref", number(h.rest))


def bands(tendons: ET.Element, mechanism: Mechanism) -> None:
    """Append the dead bands of springs as tendons."""
    for h in (h for b in mechanism.bodies for h in b.hinges if h.spring is not None):
        assert h.spring is not None
        for k, b in enumerate(h.spring.bands, start=1):
            edges = [b.lower, b.upper]
            fixed = add(tendons, "fixed", name=f"{h.name}_{k}", springlength=edges, stiffness=b.stiffness)
            add(fixed, "joint", joint=h.name, coef=1.0)


def tool(flange: ET.Element, load: Load) -> None:
    """Append a tool: its mass, a further mass that a user may set, and its tip."""
    own = add(flange, "body", name="tool", childclass=DEFAULT)
    if load.mass > 0:
        add(own, "inertial", pos=load.centre, mass=load.mass, diaginertia=[load.mass * GYRATION**2] * 3)
    added = add(own, "body", name="payload", **place(rigid(None, load.centre)))
    add(added, "inertial", pos=np.zeros(3), mass=1e-9, diaginertia=[1e-9] * 3)


def tips(flange: ET.Element, loads: tuple[Load, ...]) -> None:
    """Append the tips of all tools as sites."""
    for load in loads:
        add(flange, "site", **{"class": DEFAULT}, name=load.name, pos=load.tip)
