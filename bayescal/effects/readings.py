"""Errors of joints by their position: scale, what repeats with a turn or a tooth, linked joints, carriages.

Errors of a carriage (prismatic joint) are smooth functions of its position, `common.along_travel`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects import common
from bayescal.effects.location import WAVE, Driver, Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Scan

ENCODER_SCALE_SD = 1e-4  # rad per rad


def _encoder_scale(c: Circumstances, side: str) -> list[Parameter]:
    return common.at_gears(c, "encoder-scale", c.readings, side, ("1", ENCODER_SCALE_SD), "angle")


ENCODER_SCALE = Effect(
    "encoder-scale",
    "joint k turns by more or less than its reading says",
    lambda c: _encoder_scale(c, common.side_of(c.robot)),
    sizes={"1": Size("relative error of the reading")},
    phrase=("every joint", "has an encoder scale error"),
    remedy=(
        "Check the gear ratio and the encoder resolution in the controller, and the teeth and tension "
        "of a timing belt. An absolute encoder with a true scale error must be replaced."
    ),
    confusable_with=("eccentricity", "second-harmonic", "positioning"),
    forms=common.sides(_encoder_scale),
    in_robot_file=True,
    simulated_within=5e-8,
)
r"""Encoder scale: a joint turns by slightly more or less than its reading.

Formula: $`\rho_{z,k} = s_k q_k`$; of a prismatic joint $`\delta_{z,k} = s_k q_k`$.

Driver: the angle that the encoder measures (`common.side_of`), rad. For coupled axes this is the angle
between the two links, unless the robot file states that a linkage couples them. The other side is a separate
form, which a diagnosis compares: ``encoder-scale@reading`` acts with the displayed reading on all links that
it moves, ``encoder-scale@link`` acts between the links. Prior: 1e-4, so that the error at one radian equals
the prior of the first harmonics. Assumed: absolute encoders and integer gear ratios have no scale error, but
a periodic error with less than one period per revolution looks like one. The same of a linear scale or a
rack: 0.1 mm/m (assumed).
"""


ECCENTRICITY_SD = 1e-4  # rad
THIRD = 0.3  # of it


def _eccentricity(c: Circumstances) -> list[Parameter]:
    return common.waves(c, "eccentricity", np.array([[1]]), ECCENTRICITY_SD)


def _with_third(c: Circumstances) -> list[Parameter]:
    return [
        *_eccentricity(c),
        *common.waves(c, "eccentricity third order", np.array([[3]]), THIRD * ECCENTRICITY_SD),
    ]


ECCENTRICITY = Effect(
    "eccentricity",
    "error once per revolution of joint k",
    _eccentricity,
    sizes={"rad": WAVE},
    phrase=("every joint", "has an error once per revolution"),
    remedy=(
        "Check the reduction of the joint and the seat of its output gear, and whether the encoder is "
        "centred on its shaft. If neither can be adjusted, compensate with the calibrated model."
    ),
    confusable_with=("second-harmonic", "encoder-scale"),
    forms=(Form("third-order", "with a part of the third order", _with_third),),
    simulated_within=5e-8,
)
r"""Eccentricity: a joint has an error once per revolution, from an off-centre gear or encoder scale.

Formula: $`\rho_{z,k} = a_k \sin q_k + b_k \cos q_k`$; ``eccentricity@third-order`` adds
$`c_k \sin 3 q_k + d_k \cos 3 q_k`$, as of a scale whose marks are not exactly sinusoidal.

Driver: sine and cosine of the link-relative angle. Prior: 0.1 mrad each, from amplitudes of 0.05 to
0.25 mrad (an ABB IRB 120 measured with a laser tracker; gravity masks those of the shoulder and the elbow);
0.3 of it for the third order (assumed).
"""


SECOND_HARMONIC_SD = 7e-5  # rad


SECOND_HARMONIC = Effect(
    "second-harmonic",
    "error twice per revolution of joint k",
    lambda c: common.waves(c, "second-harmonic", np.array([[2]]), SECOND_HARMONIC_SD),
    sizes={"rad": WAVE},
    phrase=("every joint", "has an error twice per revolution"),
    remedy=(
        "Check the reduction: an oval wave generator or flexspline that is clamped out of round, and "
        "two bolts of a flange that are tighter than the others. Check the tilt of the encoder disc. "
        "Otherwise compensate with the model."
    ),
    confusable_with=("eccentricity", "encoder-scale"),
    simulated_within=5e-8,
)
r"""Second harmonic: a joint has an error twice per revolution, from an oval gear or a tilted encoder scale.

Formula: $`\rho_{z,k} = a_k \sin 2 q_k + b_k \cos 2 q_k`$.

Driver: sine and cosine of twice the link-relative angle. Prior: 0.07 mrad each, from amplitudes of
0.03 to 0.19 mrad (an ABB IRB 120 measured with a laser tracker).
"""


GEAR_MESH_SD, ALONG_SD = 5e-5, 2e-5  # rad; m, of a prismatic joint
RATIOS = np.arange(20.0, 201.0)  # of small arms; in steps of 1, the resolution of a range of two radians


def _meshing(c: Circumstances, reductions: np.ndarray) -> list[Parameter]:
    return common.waves(
        c, "gear-mesh {:g}", np.multiply.outer(reductions, (1.0, 2.0)), GEAR_MESH_SD, ALONG_SD
    )


def _gear_mesh(c: Circumstances) -> list[Parameter]:
    assert c.robot.reductions is not None
    return _meshing(c, c.robot.reductions)


def _gear_mesh_missing(c: Circumstances) -> str:
    lacks = "no reductions in the robot file (or gear-mesh@100 for a ratio of 100)"
    return lacks if c.robot.reductions is None else ""


GEAR_MESH = Effect(
    "gear-mesh",
    "error at the gear-mesh frequency of joint k (n per revolution)",
    _gear_mesh,
    _gear_mesh_missing,
    Scan(
        "motor revolutions per joint revolution",
        "{:g} motor revolutions per joint revolution",
        lambda c: RATIOS if c.robot.reductions is None else np.empty(0),
        lambda c, turns: _meshing(c, np.full(c.robot.n, turns)),
        by_site=True,
    ),
    sizes={"rad": WAVE, "m": WAVE},
    phrase=("every joint", "has an error at its gear-mesh frequency"),
    remedy=(
        "Check the strain-wave or planetary gear for wear, dirt and wrong assembly, and the seat of "
        "its wave generator. Replace the gear if the ripple grows; otherwise avoid accurate points "
        "within a fraction of the mesh period."
    ),
    simulated_within=5e-8,
)
r"""Gear mesh: ripple of the reducer, once and twice per revolution of the motor.

Formula: $`\rho_{z,k} = \sum_{m=1}^{2} a_{m,k} \sin(m N_k q_k) + b_{m,k} \cos(m N_k q_k)`$.

Driver: sine and cosine of N and 2 N times the link-relative angle. N is the number of motor revolutions per
joint revolution; a strain-wave gear meshes twice per motor revolution. Of a prismatic joint it is the number
of revolutions of its motor, pinion or screw per metre (prior 0.02 mm, assumed). Prior: 0.05 mrad each, from
amplitudes of 0.02 to 0.13 mrad at 2 N (an ABB IRB 120 measured with a laser tracker). If the robot file
states no reductions, the ratio is scanned, or given as ``gear-mesh@100``; joints with different ratios as
``gear-mesh@100/50 at joint 1 and joint 5``.
"""


COUPLING_SD = 1e-4  # rad per rad
BENDS = 1.4  # standard deviations of the other reading over the fitted measurements
BEFORE = 2  # joints: gear trains run through a wrist, from J4 to J5 and J6


def _couplings(
    c: Circumstances, drive: Callable[[np.ndarray], np.ndarray], form: str = ""
) -> list[Parameter]:
    """Parameters with a function of the other reading (N,), rad, as driver."""
    robot, names, side = c.robot, c.robot.joint_names, common.side_of(c.robot)

    def terms(j: int, k: int) -> tuple[Term, ...]:
        """An error of joint j by the reading of joint k, in the sense in which j reads."""
        other = drive(c.readings[:, k - 1])
        by = common.motion(robot, j, np.where(np.arange(robot.n) == j - 1, other[:, None], 0.0), side)
        return common.turned(robot, j, by, side)

    return [
        Parameter(
            f"coupling {names[k - 1]} to {names[j - 1]}", "1", terms(j, k), COUPLING_SD,
            **common.site_and_driver(j, Driver("angle", k, form=form)),
        )
        for j in range(1, c.robot.n + 1)
        for k in range(max(1, j - BEFORE), min(c.robot.n, j + 1) + 1)
        if k != j and c.readings[:, k - 1].any() and not c.robot.slides[[j - 1, k - 1]].any()
    ]  # fmt: skip


def _levelling(c: Circumstances) -> list[Parameter]:
    def bent(reading: np.ndarray) -> np.ndarray:
        mine = reading[c.fitted]
        reach = BENDS * float(np.std(mine))
        return reach * np.tanh((reading - np.median(mine)) / reach) if reach > 0 else reading

    return _couplings(c, bent, form="level")


COUPLING = Effect(
    "coupling",
    "joint k turns when a neighbouring joint turns",
    lambda c: _couplings(c, lambda reading: reading),
    sizes={"1": Size("share of the other angle")},
    phrase=("every joint", "has an error proportional to the preceding joint"),
    remedy=(
        "Check the coupling ratio of the wrist in the controller, and the shared gear train or belt. "
        "Check that no cable or hose pulls the joint."
    ),
    confusable_with=("bending",),
    forms=(Form("levels-off", "levelling off away from the middle of the session", _levelling),),
    simulated_within=5e-8,
)
r"""Coupling: motion of a joint turns its neighbours slightly, through a shared gear train.

Formula: $`\rho_{z,k} = x_{kj} \, q_j, \quad j \in \{k-2, k-1, k+1\}`$.

Driver: the reading of one of the two preceding joints, or of the following joint, rad; none of prismatic
joints. It acts as an error of the joint's own encoder (`common.turned`). Prior: 1e-4, as for an encoder
scale (assumed: laser tracker measurements of an ABB IRB 120 showed no coupling at the wrist).

A joint may also be dragged along by friction, less and less away from the middle of the session. In
``coupling@levels-off`` the error is a tanh that bends at 1.4 standard deviations of the other reading
(assumed), with the same slope in its middle. On coupled axes, the other parameters absorb a straight line
but not this.
"""


STRAIGHTNESS_SD = 1e-4  # m
STRAIGHTNESS_AXES = {"x": "tx", "y": "ty"}


STRAIGHTNESS = Effect(
    "straightness",
    "the carriage of a linear axis leaves its straight line",
    lambda c: common.along_travel(c, "straightness", STRAIGHTNESS_AXES, 2, ("m", STRAIGHTNESS_SD)),
    common.without_slides,
    sizes={"m": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "is not straight"),
    remedy=(
        "Align the guide rails against a straight edge or a laser line, and check the bolts and the "
        "joints of rail segments. What remains is compensated with the calibrated model."
    ),
    confusable_with=("angular-motion",),
)
r"""Straightness: the carriage of a prismatic joint leaves its straight line, as a function of its position.

Formula: $`\delta_{a,k} = \sum_{m=2}^{16} x_{a,m} \sqrt{2m+1}\, P_m(u_k), \quad a \in \{x, y\}`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). A straight line is the direction of the
axis, which `geometry` has. Prior: 0.1 mm of the second order along each axis, falling with the order as its
power -2 (assumed: mounted linear guides are straight within 0.02 to 0.1 mm/m). As of ISO 230-1, which
calls these straightness error motions.
"""


ANGULAR_MOTION_SD = 1e-4  # rad
ANGULAR_MOTION_AXES = {"about x": "rx", "about y": "ry", "roll": "rz"}


ANGULAR_MOTION = Effect(
    "angular-motion",
    "the carriage of a linear axis rolls, pitches and yaws",
    lambda c: common.along_travel(c, "angular-motion", ANGULAR_MOTION_AXES, 1, ("rad", ANGULAR_MOTION_SD)),
    common.without_slides,
    sizes={"rad": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "turns its carriage along the travel"),
    remedy=(
        "Check that the guide rails are parallel and of equal height, and the preload of the carriages. What "
        "remains is compensated with the calibrated model."
    ),
    confusable_with=("straightness",),
)
r"""Angular motion: the carriage of a prismatic joint rolls, pitches and yaws, as a function of its position.

Formula: $`\rho_{a,k} = \sum_{m=1}^{16} x_{a,m} \sqrt{2m+1}\, P_m(u_k), \quad a \in \{x, y, z\}`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). A constant angle is one of `geometry`. The
tool is displaced by the angle times its distance from the carriage. Prior: 0.1 mrad of the first order about
each axis, falling with the order as its power -2 (assumed: a straightness of 0.1 mm over a carriage of 0.5
m is 0.2 mrad). As of ISO 230-1, which calls these angular error motions.
"""


POSITIONING_SD = 5e-5  # m


POSITIONING = Effect(
    "positioning",
    "a linear axis stands beside its reading, by its position",
    lambda c: common.along_travel(c, "positioning", {"order": "tz"}, 2, ("m", POSITIONING_SD)),
    common.without_slides,
    sizes={"m": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "has a positioning error by its position"),
    remedy=(
        "Measure the axis with a laser interferometer and load its compensation table, and check the "
        "joints of rack segments."
    ),
    confusable_with=("encoder-scale",),
)
r"""Positioning: a prismatic joint stands beside its reading, as a smooth function of its position.

Formula: $`\delta_{z,k} = \sum_{m=2}^{16} x_m \sqrt{2m+1}\, P_m(u_k)`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). An error in proportion to the position is
`encoder-scale`, one that repeats with the pinion or screw `gear-mesh`. Prior: 0.05 mm of the second order,
falling with the order as its power -2 (assumed: racks are accurate within 0.03 to 0.1 mm/m).
"""
