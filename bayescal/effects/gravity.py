"""Gravity on an arm: bending of bearings, links and linear axes; added loads, errors of the stated masses.

A site that the model contains deflects by its fitted (or true) compliance: joints, bearings, links and the
base. A joint of unknown compliance has the value of the robot file, or a typical one; any other site whose
compliance is unknown is rigid. Measured torques contain the torque of every mass: then only links and base
deflect by an added one.

Masses of links differ from the robot file by 5 %, their centres of mass a little; the load on the flange is
known to half a percent, its centre of mass to a few millimetres. The compliances absorb most of this: the
stated uncertainty of a fit contains what they are wrong by. The remainder looks like an error that depends on
joint angles, so a diagnosis includes it in every hypothesis, with these priors.
Assumed: masses of links may be in error by up to 15 %, but by a common factor, which the compliances absorb.
Wider priors hide true effects (backlash and harmonics of a wrist lost two thirds of their evidence at 15 %
and 0.5 mm).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm.chain import Chain, frames, link_angles
from bayescal.arm.motion import Term
from bayescal.arm.statics import Loads, centre_of_mass, gravity_in_f0, hinges, placed
from bayescal.arm.transforms import cross
from bayescal.effects import common
from bayescal.effects.compliance import BASE_COMPLIANCE, COMPLIANCE, ELBOW, SHOULDER, SPREAD, of_joints
from bayescal.effects.location import COMPLIANT, FACTOR, TOOL, Driver, Size, length, link
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Where

SHARE = 0.3  # of the joint's compliance about its axis
SHORT = 1e-3  # m: a link of this length counts as without length


def ends(chain: Chain, j: int) -> np.ndarray:
    """Ends of link j (from 1) in its frame, (2, 3), m: before its joint's d, and at the next row's axis."""
    slides = np.broadcast_to(chain.slides, chain.n)[j - 1]  # from its carriage on
    return np.array([[0.0, 0.0, 0.0 if slides else -chain.d[j - 1]], chain.link[j, :3, 3]])


def across(ends: np.ndarray) -> dict[str, np.ndarray]:
    """Unit axes (3,) across a link between two ends (2, 3), m, named by the nearest axis of its frame.

    Ends differ along x and z of the frame alone: one axis is y, the other is in that plane.
    """
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length < SHORT:
        return {}
    other = np.array([-along[2], 0.0, along[0]]) / length
    return {"y": np.array([0.0, 1.0, 0.0]), "xyz"[int(np.argmax(np.abs(other)))]: other}


def _bearing(c: Circumstances, j: int) -> list[Term]:
    assert c.loads is not None
    moment = c.loads.moments[:, j]
    return [Term(j, "rx", moment[:, 0]), Term(j, "ry", moment[:, 1])]


def _hinge(c: Circumstances, j: int, axis: np.ndarray, point: np.ndarray) -> list[Term]:
    """Turns of frame j about an axis (3,) through a point (3,), m, by the moment there; it does not slide."""
    assert c.loads is not None
    moment = (c.loads.moments[:, j] - cross(point, c.loads.weights[:, j])) @ axis
    parts = zip(("rx", "ry", "rz", "tx", "ty", "tz"), (*axis, *np.cross(point, axis)), strict=True)
    return [Term(j, name, part * moment) for name, part in parts if abs(part) > 1e-12]


def _bending(c: Circumstances) -> list[Parameter]:
    upright = float(common.first_axis(c) @ common.vertical(c))
    first_leans = min(abs(upright), np.sqrt(max(1.0 - upright**2, 0.0))) > common.LEANING
    usual = SHARE * of_joints(c.robot, SHOULDER)
    out = []
    for j, (name, of_joint) in enumerate(zip(c.robot.joint_names, usual.tolist(), strict=True), start=1):
        parts = {"bearing": (_bearing(c, j), of_joint)} if j > 1 or first_leans or c.robot.slides[0] else {}
        if j < c.robot.n:
            of_link, two = min(of_joint, SHARE * ELBOW), ends(c.chain, j)
            for axis, way in across(two).items():
                parts[f"link {axis}"] = _hinge(c, j, way, two.mean(axis=0)), of_link
        where: Where = {"site": link(j), "driver": Driver("bending moment")}
        for part, (terms, mean) in parts.items():
            if any(common.carries(np.asarray(term.driver)) for term in terms):
                label, sd = f"bending {name} {part}", SPREAD * mean
                out.append(Parameter(label, "rad/(N m)", tuple(terms), sd, 0.0, mean, positive=True, **where))
    return out


BENDING = Effect(
    "bending",
    "transverse (bending) compliance of link k",
    _bending,
    common.without_masses,
    sizes={"rad/(N m)": COMPLIANT, "1": FACTOR},
    phrase=("every link", "has transverse (bending) compliance"),
    remedy=(
        "Check the bolts of the joint bearing and of the link, and the firm seat of the flanges; a "
        "worn cross-roller bearing tilts. Of the last links: the bracket of the tool or camera bends alike. "
        "If all are tight, keep the effect in the model."
    ),
    confusable_with=("coupling", "axis-bending"),
    requires=("compliance",),
    simulated_within=5e-7,
    linear_spring=True,
)
r"""Bending: transverse compliance of the joint bearings, and bending of the links.

Formula: $`\rho_{a,k} = c_{a,k} M_{a,k}, \quad a \perp z_k`$; M is the gravity moment at the hinge.

The bearing of each link tilts at its joint under the gravity moment transverse to the axis (components x
and y in the joint's frame, each about its own axis). The link bends as if it had two spring hinges at its
middle, across its length, each with its own compliance: sections are rarely round. A uniform cantilever of
length L and stiffness EI under a moment M and a force F at its far end turns there by M L / EI + F L^2 / (2
EI). That is L / EI times the moment at its middle, and the end sinks as if it turned about the middle, but
for F L^3 / (12 EI). A link extends from before its joint's d to the next row of the table. Its own mass is
beyond the middle. A link without length does not bend. Its torsion is left to the joints.

Prior of a bearing: mean 0.3 of the joint's typical compliance, with a standard deviation of 1.5 times the
mean (assumed; the order of magnitude agrees with an ABB IRB 120, where bending and base tilt reduced the
mean error from 0.099 to 0.081 mm, which is 0.06 mm at half a metre and 30 N m). That of a link is the same,
but not above that of the elbow: a wrist yields in its gears. The first joint's bearing is omitted if its
axis is vertical or horizontal: there its effect equals that of `base-compliance`.
The carriage of a prismatic joint tilts under the moment about itself, with the compliance of a shoulder.
"""


MEAN = 2e-7  # rad/(N m2)

Beam = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Distances p and r (N,), m, from both limits -> per 1 / (E I): turn by a moment, turn by a force, which is
the deflection by a moment, and deflection by a force."""


def cantilever(p: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Beam` that is clamped at p = 0 and ends at the carriage."""
    return p, p**2 / 2, p**3 / 3


def supported(p: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Beam` on supports at p = 0 and r = 0."""
    length = p + r
    return (p**3 + r**3) / (3 * length**2), p * r * (r - p) / (3 * length), p**2 * r**2 / (3 * length)


def _bent(c: Circumstances, beam: Beam, label: str) -> list[Parameter]:
    assert c.loads is not None
    out = []
    for j in (np.flatnonzero(c.robot.slides) + 1).tolist():
        (low, high), sign = c.robot.limits[j - 1], np.sign(c.robot.link_from_reading[j - 1, j - 1])
        place = np.clip(sign * c.q[:, j - 1], low, high)
        turn, both, shift = beam(place - low, high - place)
        where = common.site_and_driver(j, Driver("extended moment"))
        moment, force = c.loads.moments[:, j], c.loads.weights[:, j]
        # a turn about y moves the end of what extends along z along x, one about x against y
        for name, about, along, way in (("x", 1, 0, sign), ("y", 0, 1, -sign)):
            m, f = moment[:, about], way * force[:, along]
            turned, moved = turn * m + both * f, way * (shift * f + both * m)
            if common.carries(turned) or common.carries(moved):
                terms = (Term(j, f"r{'xyz'[about]}", turned), Term(j, f"t{'xyz'[along]}", moved))
                words = f"axis-bending {label}{c.robot.joint_names[j - 1]} {name}"
                p = Parameter(words, "rad/(N m^2)", terms, SPREAD * MEAN, 0.0, MEAN, positive=True, **where)
                out.append(p)
    return out


AXIS_BENDING = Effect(
    "axis-bending",
    "a linear axis bends under its load, by its extension",
    lambda c: _bent(c, cantilever, ""),
    lambda c: common.without_slides(c) or common.without_masses(c),
    sizes={"rad/(N m^2)": COMPLIANT, "1": FACTOR},
    phrase=("the linear axis", "bends under its load"),
    remedy=(
        "Check the clamping of the column or the supports of the rail. If they are firm, keep the effect "
        "in the model, and calibrate at the loads of the task."
    ),
    confusable_with=("bending",),
    requires=("compliance",),
    forms=(Form("beam", "as a beam on supports at its ends", lambda c: _bent(c, supported, "beam ")),),
)
r"""Axis bending: the guide of a prismatic joint bends under its load, the more the farther it is extended.

Formula: $`\rho_a = c_a (M_a L \pm F_b L^2 / 2), \quad \delta_b = c_a (F_b L^3 / 3 \pm M_a L^2 / 2)`$;
c = 1 / (E I), L the extension, M and F the moment and the weight on the carriage, a and b across the axis.

The end of a cantilever of length L, clamped at the lower limit of the joint: a lifting column, or an arm
that is pushed out. In ``axis-bending@beam`` the guide lies on supports at both limits of the joint: a force
F at a distance p from one and r from the other deflects it there by F p^2 r^2 / (3 E I (p + r)), and turns
it by F p r (r - p) / (3 E I (p + r)); moments M turn it by M (p^3 + r^3) / (3 E I (p + r)^2), and deflect it
as the forces turn it. Each of the two directions across the axis has its own stiffness.

Prior: mean 2e-7 rad/(N m2), with a standard deviation of 1.5 times the mean (assumed: a steel tube of 200 x
200 x 6 mm has 1.6e-7).
"""

COMPLIANCES = (COMPLIANCE, BENDING, BASE_COMPLIANCE, AXIS_BENDING)
"""Effects whose parameters are compliances: displacement = value x gravity moment."""


def compliances(parameters: Sequence[Parameter], deviations: np.ndarray) -> Mapping[str, float]:
    """Values (SI) of all compliances among P parameters, by name, at deviations (P,) from nominal."""
    names = {effect.name for effect in COMPLIANCES}
    out: dict[str, float] = {}
    for p, value in zip(parameters, deviations.tolist(), strict=True):
        if p.effect not in names:
            continue
        out |= {member.name: member.nominal + value * member.centre for member in p.stands_for} or {
            p.name: p.nominal + value
        }
    return out


def deflections(c: Circumstances, loads: Loads) -> tuple[Term, ...]:
    """Displacements of all compliant sites by added gravity moments."""
    added, out = replace(c, loads=loads), []
    for effect in COMPLIANCES:
        if effect is COMPLIANCE and c.measured_torques is not None:
            continue
        if effect is not COMPLIANCE and not any(f"{effect.name} " in name for name in c.compliances):
            continue
        makers = (effect.parameters, *(form.parameters for form in effect.forms))
        for p in {p.name: p for make in makers for p in make(added)}.values():
            value = c.compliances.get(p.name, p.centre if effect is COMPLIANCE else 0.0)
            if value:
                out += [replace(term, driver=value * np.asarray(term.driver)) for term in p.terms]
    return tuple(out)


MASS_SHARE = 0.05
"""Standard uncertainty of a link's mass, and of each coordinate of its centre, as a share (assumed)."""
LOAD_SHARE = 0.005
"""Standard uncertainty of the mass of the load on the flange, as a share (assumed: it was weighed)."""
CENTRE_OFF = 2e-4
"""Standard uncertainty of a link's centre of mass beside the share of its coordinate, m (assumed)."""
LOAD_OFF = 4e-3
"""Standard uncertainty of each coordinate of the load's centre of mass, m (tuned: a tool is weighed, but its
centre is computed; with 10 mm small payloads are no longer named)."""


def masses(c: Circumstances) -> list[Parameter]:
    """Relative errors of masses and shifts of centres of mass, of each link and of the load.

    One that loads nothing in these rows has no terms; without any that has, there are none.
    """
    robot = c.robot
    if robot.masses is None or robot.centres_of_mass is None or c.moments is None:
        return []
    delta = None if c.stance is None else c.stance.delta
    pose = frames(c.chain, link_angles(robot, c.readings), delta)
    about = hinges(c.chain, pose, delta)
    gravity = gravity_in_f0(c.chain, pose, c.gravity, c.stance)
    out: list[Parameter] = []

    def add(name: str, share: float, of_body: list[Loads], off: np.ndarray) -> None:
        """Add the mass and the centre of mass of a body, by the loads of `by_mass`; `off` (3,), m."""
        of_mass, *of_centre = of_body
        out.append(Parameter(f"mass of {name}", "1", deflections(c, of_mass), share))
        for axis, loads, sd in zip("xyz", of_centre, off.tolist(), strict=True):
            out.append(Parameter(f"centre of {name} {axis}", "m", deflections(c, loads), sd))

    for i, (mass, centre) in enumerate(zip(robot.masses, robot.centres_of_mass, strict=True), start=1):
        centres = placed(pose[:, i], centre_of_mass(robot, c.chain, i, c.stance))
        turn = (pose[:, i] if robot.convention == "mdh" else pose[:, i] @ c.chain.link[i])[:, :3, :3]
        off = CENTRE_OFF + MASS_SHARE * np.abs(centre)
        weight = np.full(len(centres), mass)[:, None] * gravity
        add(f"link {i}", MASS_SHARE, about.by_mass(i, weight, centres, turn), off)
    add("load", LOAD_SHARE, _loads(c, c.load_mass), np.full(3, LOAD_OFF))
    return out if any(p.terms for p in out) else []


PAYLOAD_SD, MOMENT_SD = 0.3, 0.03  # kg, kg m
SHARE_SD, SHIFT_SD = 0.3, 0.06  # of the mass, m
ADDED = 0.05  # kg, from which on a row carries an added load


def _loads(c: Circumstances, mass: np.ndarray) -> list[Loads]:
    """Loads by a mass (N,), kg, in the centre of the load, and by its shifts along the axes of the flange."""
    delta = None if c.stance is None else c.stance.delta
    pose = frames(c.chain, link_angles(c.robot, c.readings), delta)
    flange, weight = pose[:, -1], mass[:, None] * gravity_in_f0(c.chain, pose, c.gravity, c.stance)
    centre = placed(flange, c.load_centre)
    return hinges(c.chain, pose, delta).by_mass(c.robot.n, weight, centre, flange[:, :3, :3])


def _parameter(c: Circumstances, name: str, unit: str, sd: float, loads: Loads) -> list[Parameter]:
    terms = deflections(c, loads)
    return [Parameter(f"payload {name}", unit, terms, sd, site=TOOL, driver=Driver("mass"))] if terms else []


def _shifted(c: Circumstances, name: str, unit: str, sd: float, loads: Sequence[Loads]) -> list[Parameter]:
    """Parameters of the centre of a mass, by the loads of its shifts."""
    return [
        p
        for axis, by in zip("xyz", loads, strict=True)
        for p in _parameter(c, f"{name} {axis}", unit, sd, by)
    ]


def _payload(c: Circumstances) -> list[Parameter]:
    return _parameter(c, "mass", "kg", PAYLOAD_SD, _loads(c, np.ones(len(c.q)))[0])


def _elsewhere(c: Circumstances) -> list[Parameter]:
    of_mass, *of_shifts = _loads(c, np.ones(len(c.q)))
    return [
        *_parameter(c, "mass", "kg", PAYLOAD_SD, of_mass),
        *_shifted(c, "moment", "kg m", MOMENT_SD, of_shifts),
    ]


def _added(c: Circumstances) -> list[Parameter]:
    """The load beyond the least with the same tool; nothing where the rows to fit carry the same load."""
    mass = common.added_load(c)
    if not np.any(mass[c.fitted] > ADDED):
        return []
    of_mass, *of_shifts = _loads(c, mass)
    share = _parameter(c, "added share", "1", SHARE_SD, of_mass)
    return [*share, *_shifted(c, "added centre", "m", SHIFT_SD, of_shifts)]


def _holder(c: Circumstances) -> list[Parameter]:
    """What holds the added loads; nothing where these are all alike, as `_added` is then."""
    held = common.added_load(c) > ADDED
    added = common.added_load(c)[c.fitted[held[c.fitted]]]
    if not len(added) or np.ptp(added) <= ADDED:
        return []
    of_mass = _parameter(c, "of the holder", "kg", PAYLOAD_SD, _loads(c, held.astype(float))[0])
    return [replace(p, driver=Driver("load")) for p in of_mass]


def _payload_missing(c: Circumstances) -> str:
    measured = "the torques are measured: they contain the payload"
    return common.without_masses(c) if c.measured_torques is None else measured


PAYLOAD = Effect(
    "payload",
    "payload mass or centre of mass differs from what was stated",
    _payload,
    _payload_missing,
    sizes={
        "kg": Size("additional mass"),
        "kg m": Size("first moment", length),
        "1": Size("additional share of the added load"),
        "m": Size("shift of the centre of the added load", length),
    },
    phrase=("the tool", "carries a payload that differs from what was stated"),
    remedy=(
        "Weigh the tool with its cables and bracket, and find its centre of mass. Correct the load in "
        "the controller and in dataset.yaml, and fasten loose loads."
    ),
    requires=("compliance",),
    forms=(
        common.by_session(_payload),
        Form("elsewhere", "a mass that hangs elsewhere than the tool's centre of mass", _elsewhere),
        Form("added", "an added load that hangs elsewhere, or differs in mass", _added),
        Form("holder", "a mass that rows with an added load have in common", _holder),
    ),
    simulated_within=2e-8,
)
r"""Payload: the mass on the flange differs from the stated mass, and deflects every compliant site.

Formula: $`\rho_k = c_k \, m \, \frac{\partial M_k}{\partial m}`$;
at every compliant site k, with its compliance c.

Driver: the gravity moments of one kilogram at the tool's centre of mass times the compliances of all sites
(`deflection`). The value in kilograms is only as accurate as these compliances. Prior: 0.3 kg (assumed: the
mass of a probe, its cable and its bracket is an estimate).

Further forms: in ``payload@elsewhere`` the mass hangs elsewhere than the tool's centre of mass: its first
moment about that centre is free, with a prior of 0.03 kg m (0.3 kg at 0.1 m). In ``payload@added`` the load
that some rows carry beyond the others differs from the stated one: its mass by a share (prior 0.3) and its
centre by a shift (prior 0.06 m; assumed: a load that is clamped by hand hangs some centimetres off). In
``payload@holder`` all rows with such a load have the same further mass: a gripper or an adapter that holds
it. It needs loads of two sizes. Forms with more unknowns pay for them in the evidence.
"""
