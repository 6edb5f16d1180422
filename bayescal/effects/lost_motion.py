"""Errors by the motion before a measurement: lost motion, hysteresis, and readings of another time."""

from __future__ import annotations

from functools import partial

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import common
from bayescal.effects.common import at_gears, side_of, without_surface, without_velocity
from bayescal.effects.compliance import by_torque, loaded
from bayescal.effects.imaging import at_view, late_images
from bayescal.effects.location import CAMERA, LATER, PROBE, Driver, Size, magnitude
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Scan

BACKLASH_SD, ALONG_SD = 8e-5, 3e-5  # rad; m, of a prismatic joint

FRICTIONS = (0.3, 0.6)  # shares of the usual torque (assumed)
CHANGES = 0.03  # share of the usual torque within which the flank changes (assumed)


def _backlash(c: Circumstances, side: str) -> list[Parameter]:
    assert c.velocity is not None
    return common.at_gears(
        c, "backlash", c.velocity, side, ("rad", BACKLASH_SD), "direction", common.sense, ("m", ALONG_SD)
    )


def _held(share: float) -> Form:
    """The form with a friction of a share of the usual torque."""

    def parameters(c: Circumstances) -> list[Parameter]:
        if common.without_torques(c) or c.velocity is None:
            return []
        out, side = [], common.side_of(c.robot)
        for j, name, _, torque in loaded(c):
            speed = common.motion(c.robot, j, c.velocity, side)
            push = share * common.sense(speed) - torque / common.usual(c, torque)
            terms = common.turned(c.robot, j, np.tanh(push / CHANGES), side)
            unit, sd = ("m", ALONG_SD) if c.robot.slides[j - 1] else ("rad", BACKLASH_SD)
            where = common.site_and_driver(j, Driver("flank", j))
            out.append(Parameter(f"backlash {name}", unit, terms, sd, **where))
        return out

    words = f"where gravity torques above {share:.0%} of the usual torque hold the joint on one flank"
    return Form(f"held-{100 * share:.0f}", words, parameters)


BACKLASH = Effect(
    "backlash",
    "lost motion on reversal of joint k, half-width b",
    lambda c: _backlash(c, common.side_of(c.robot)),
    common.without_velocity,
    sizes=dict.fromkeys(("rad", "m"), Size("half-width", magnitude)),
    phrase=("every joint", "has lost motion on reversal"),
    remedy=(
        "Adjust the belt tension or the preload of the gear, and check keys, couplings and worn "
        "teeth. Until then, approach accurate points from one direction."
    ),
    confusable_with=("unsettled",),
    forms=(*common.sides(_backlash), *map(_held, FRICTIONS)),
    directed=True,
    simulated_within=2e-6,
)
r"""Backlash: lost motion in a gear. The link lags its motor by the half-width in either direction of motion.

Formula: $`\rho_{z,k} = b_k \, \frac{\omega_k}{\sqrt{\omega_k^2 + \omega_0^2}}`$;
b is the half-width, ω the speed, ω0 = 0.03 deg/s.

Driver: the sign of the velocity at the gear (`common.side_of`). For coupled axes this is the velocity between
the two links, unless the robot file states that a linkage couples them. The other side is a separate form,
which a diagnosis compares: ``backlash@reading`` acts with the displayed readings on all links that they move,
``backlash@link`` acts between the links. Below 0.03 deg/s (assumed) the sign goes smoothly to zero. A
negative value is a lag, a positive value a lead. Prior: 0.08 mrad, from half-widths of 0.003 to 0.16 mrad
(an ABB IRB 120 measured with a laser tracker; J4 and J6 had the largest); along a prismatic joint 0.03 mm
(assumed: a rack and pinion), and ω is its speed, ω0 = 0.5 mm/s.

A loaded joint does not always follow its motion. Friction of the link presses the teeth against the flank of
the motion, gravity against that of its torque, and the larger one decides: ``backlash@held-30`` has a
friction of 30 % of the joint's usual torque (the 90th percentile over the contacts). With little friction
this is `hysteresis`, with much it is the usual form.
"""


HYSTERESIS_SD = 5e-5  # rad; m of a prismatic joint (assumed)
SHARES = np.array([0.02, 0.06, 0.12])
CHANGE = 0.2  # share of the usual torque within which a late change takes place (tuned)
LAGS = (0.2, 0.6)  # shares of the usual torque over which it is followed (tuned)


def _at(c: Circumstances, share: float) -> list[Parameter]:
    return by_torque(
        c,
        "hysteresis",
        lambda torque, most: np.tanh(torque / (share * most)),
        lambda *_: HYSTERESIS_SD,
        form="sign",
    )


def _hysteresis(c: Circumstances) -> list[Parameter]:
    return _at(c, float(SHARES[1]))


def _late(c: Circumstances, lag: float) -> list[Parameter]:
    def followed(torque: np.ndarray, most: float) -> np.ndarray:
        return common.lagging(c, np.tanh(torque / (CHANGE * most)), torque, lag * most)

    return by_torque(c, "hysteresis", followed, lambda *_: HYSTERESIS_SD, form="late")


HYSTERESIS = Effect(
    "hysteresis",
    "torque-reversal hysteresis of joint k",
    _hysteresis,
    common.without_torques,
    Scan(
        "share of the usual torque within which it changes",
        "changing flanks within {:.0%} of the usual torque",
        lambda c: SHARES,
        _at,
    ),
    sizes=dict.fromkeys(("rad", "m"), Size("half-width", magnitude)),
    phrase=("every joint", "has torque-reversal hysteresis"),
    remedy=(
        "Check the preload and wear of the gear, and the belt tension: the load presses the teeth on "
        "either flank. Check the counterbalance spring. Until then, use poses in which the torque "
        "keeps its sign."
    ),
    confusable_with=("hardening",),
    requires=("compliance",),
    forms=tuple(
        Form(
            f"late-{100 * lag:.0f}",
            f"followed late, over {lag:.0%} of the usual torque",
            partial(_late, lag=lag),
        )
        for lag in LAGS
    ),
    simulated_within=5e-7,
)
r"""Hysteresis: gravity torque presses the gear of a joint against one or the other tooth flank.

Formula: $`\rho_{z,k} = w_k \tanh \frac{\tau_k}{s \, T_k}`$;
w is the half-width, T the usual torque, s the share.

Driver: a smooth sign, tanh of the gravity torque divided by a small share of the joint's usual torque (the
90th percentile over the contacts): at small torques the gear is between the flanks. The share is scanned:
``hysteresis@0.02`` changes flanks within 2 %. Prior: 0.05 mrad, within the half-widths of 0.003 to 0.16 mrad
that approaches from two sides show (an ABB IRB 120 measured with a laser tracker; the same distance of the
flanks under gravity is assumed). A change over a larger share of the torque is `hardening`.

``hysteresis@late-20`` and ``hysteresis@late-60`` have a memory: the change over 20 % of the usual torque is
followed late, with a lag that fades over 20 or 60 % of the usual torque (a first-order lag along the path of
the torque from contact to contact, as in Dahl's model of friction). Without a memory this curve is
`hardening`.
"""

LATENCY_SD = 2e-3  # s
CLOCK_SD = 20e-3  # s, of images: exposure, transfer and the clocks of two computers (assumed)


def _latency(c: Circumstances) -> list[Parameter]:
    assert c.speed is not None
    assert c.velocity is not None
    speed = np.where(c.touching, c.speed, 0.0)
    terms = (Term(CONTACT, "normal", speed),)
    parameter = Parameter("latency", "s", terms, LATENCY_SD, site=PROBE, driver=Driver("contact speed"))
    out = [parameter] if speed.any() else []
    for v in c.views:
        turns, site = late_images(c, v), at_view(v, CAMERA)
        clock = Parameter(f"latency {v.name}", "s", turns, CLOCK_SD, site=site, driver=Driver("clock"))
        out += [clock] if turns else []
    return out


LATENCY = Effect(
    "latency",
    "joint readings later than the measurement by t, or older (t < 0)",
    _latency,
    lambda c: (without_surface(c) if not c.views else "") or without_velocity(c),
    sizes={"s": Size(LATER)},
    phrase=("every joint", "has readings of another time than the measurement"),
    remedy=(
        "Measure more slowly or at rest, latch the joint readings by hardware at the trigger, or correct the "
        "delay in the controller. Measurements at two speeds show the delay."
    ),
    confusable_with=("unsettled",),
    directed=True,
    side="clock",
)
r"""Latency: the joints are read a time t after the contact, while the arm moves further.

Formula: $`\delta_n = t \, v_n`$; v is the speed of the ball towards the surface.

Driver: the speed of the ball towards the surface, m/s. Prior: 2 ms, from trigger delays of 1 to 2 ms. A
negative value is of readings that are older than the contact: they lag. If all contacts have the same speed,
latency is not distinguishable from the ball's radius.

Images of an arm that moves: t is the time by which the readings are later than the image.
"""


SHARE, TIME = 0.3, 1e-2  # of the remaining motion; s
AT_REST = 1e-7  # rad: rounding of angles in a file


def remaining(c: Circumstances) -> np.ndarray | None:
    """Commanded angles minus readings (N, n), rad, or None if no joint has a way to go in any row."""
    if c.command is None:
        return None
    way = c.command - c.readings
    return way if np.any(np.abs(way[c.fitted]) > AT_REST) else None


def _unsettled(c: Circumstances) -> list[Parameter]:
    way, side = remaining(c), side_of(c.robot)
    if way is not None:
        return at_gears(c, "unsettled", way, side, ("1", SHARE), "remaining motion")
    assert c.velocity is not None
    return at_gears(c, "unsettled", c.velocity, side, ("s", TIME), "joint speed")


def _unsettled_missing(c: Circumstances) -> str:
    first = ("j1_command_mm", "j1_mmps") if c.robot.slides[0] else ("j1_command_deg", "j1_degps")
    lacks = " ... or ".join(first)
    return "" if c.velocity is not None or remaining(c) is not None else f"no {lacks} ..."


UNSETTLED = Effect(
    "unsettled",
    "settling error of joint k: it is read before standstill",
    _unsettled,
    _unsettled_missing,
    sizes={"1": Size("share of the remaining motion"), "s": Size("time")},
    phrase=("every joint", "has a settling error: it is read before standstill"),
    remedy=(
        "Wait until the arm stands still before the reading (a dwell of a few time constants), "
        "approach more slowly, and check the brake release and the tuning of the joint controller."
    ),
    confusable_with=("backlash", "latency"),
)
r"""Settling error: a joint is read before it stands still, and moves on in its direction of motion.

Formula: $`\rho_{z,k} = x_k \, (q_{\mathrm{command},k} - q_k)`$; or x times the speed.

Driver: the remaining motion at the gear (`common.side_of`), which is the commanded angle minus the reading
(`jN_command_deg`); the value is the share of it that follows after the reading. If there are no commanded
angles, or the readings are these, the driver is the speed of the joint, and the value is a time. Backlash
follows the sign of the speed instead, and `latency` is one time for all joints at a contact. Prior: a share
of 0.3, and 10 ms (assumed: between the delay of a trigger, 1 to 2 ms, and the time constant of a servo, 20 to
50 ms). A negative value is a reading that is ahead of the joint.
"""
