"""Errors of contacts with a surface: of the probe, of certified values, of the form of faces."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.polynomial.legendre import legvander2d

from bayescal.arm.motion import CERTIFICATE, CONTACT, Term
from bayescal.effects import location
from bayescal.effects.common import NO_PLANE, without_surface
from bayescal.effects.location import PROBE, WAVE, Driver, Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Face, Form, Parameter, Where

BALL_RADIUS_SD = 10e-6  # m


def _ball_radius(c: Circumstances) -> list[Parameter]:
    out = []
    for k in c.fitted_tools:
        used = c.touching & (c.tool == k)
        if np.any(used):
            larger = (Term(CONTACT, "normal", -used.astype(float)),)
            name = f"ball-radius {c.tool_names[k]}"
            out.append(Parameter(name, "m", larger, BALL_RADIUS_SD, c.tool_radii[k] or 0.0, site=PROBE))
    return out


BALL_RADIUS = Effect(
    "ball-radius",
    "effective stylus-ball radius differs from its stated value",
    _ball_radius,
    without_surface,
    sizes={"m": Size("deviation of the radius")},
    phrase=("the probe", "has a stylus-ball radius that differs from its stated value"),
    remedy=(
        "Replace a worn stylus or clean its ball, and check the diameter that was entered. Qualify "
        "the probe on a reference sphere with the trigger speed of the task."
    ),
)
r"""Ball radius: a stylus ball larger or smaller than stated, or a pre-travel equal in all directions.

Formula: $`\delta_n = -x`$; the displacement of the ball along the direction of contact.

Driver: minus one at every contact with a surface, because a larger ball touches further out. Prior: 10 µm,
from a pre-travel of 5 to 20 µm. The two causes are not distinguishable by construction. Neither is
distinguishable from the offsets of planes without a stated position. Only a certified length between
opposite faces, or a certified diameter, makes the effect identifiable. There an error b looks like a scale
error of 2 b divided by the length. Without such a certificate the effect is not identifiable.
"""


LOBING_SD = 5e-6  # m
LOBES = 3
HERE: Where = {"site": PROBE, "driver": Driver("contact direction")}


def _lobing(c: Circumstances) -> list[Parameter]:
    x, y, _ = np.where(c.touching[:, None], c.approach, 0.0).T
    across, azimuth = np.hypot(x, y), LOBES * np.arctan2(y, x)
    waves = (("sin", across * np.sin(azimuth)), ("cos", across * np.cos(azimuth)))
    return [
        Parameter(f"lobing {wave}", "m", (Term(CONTACT, "normal", driver),), LOBING_SD, **HERE)
        for wave, driver in waves
        if driver.any()
    ]


LOBING = Effect(
    "lobing",
    "three-lobe pre-travel variation of the probe",
    _lobing,
    without_surface,
    sizes={"m": WAVE},
    phrase=("the probe", "has three-lobe pre-travel variation"),
    remedy=(
        "Calibrate the probe in the directions of use, reduce its trigger force or the stylus length, "
        "or use a strain-gauge probe. Check that the stylus is tight."
    ),
)
r"""Lobing: the pre-travel of a touch-trigger probe on three supports varies with the direction of contact.

Formula: $`\delta_n = \sin\beta \, (a \sin 3\varphi + b \cos 3\varphi)`$;
φ is the azimuth of the contact about the stylus, β its angle to the stylus.

Driver: sine and cosine of three times the azimuth of the contact's direction about the stylus, times the
component of that direction transverse to the stylus: a contact along the stylus has no azimuth. The stylus
is assumed to be parallel to the flange's z axis. Prior: 5 µm each, from a pre-travel of 5 to 20 µm with three
lobes. The first harmonic is omitted: it is not distinguishable from the tool's x and y.
"""


TIMES = {"rad": 10.0, "m": 3.0}  # the stated uncertainty


def _artefact(c: Circumstances) -> list[Parameter]:
    out = []
    for value in c.certified_values:
        terms = tuple(Term(CERTIFICATE, str(number), value.rows) for number in value.certificates)
        name, sd = f"artefact {value.name}", TIMES[value.unit] * value.u
        out.append(
            Parameter(name, value.unit, terms, sd, site=location.ARTEFACT, driver=Driver("certificate"))
        )
    return out


ARTEFACT = Effect(
    "artefact",
    "a certified value is in error",
    _artefact,
    lambda c: "" if c.certified_values else "no certificate ties fitted targets",
    sizes={"m": Size("true less certified value"), "rad": Size("true less certified value")},
    phrase=("the artefact", "has a certified value in error"),
    remedy=(
        "Check that the certificate belongs to this artefact and its values are entered correctly. "
        "Then have the artefact measured again; check its temperature and its clamps."
    ),
    in_robot_file=True,
)
r"""Artefact: a certified value of parallelism, squareness or distance is in error.

Formula: $`v_\mathrm{true} = v_\mathrm{certified} + x`$; v is an angle or a length of a certificate.

One parameter for each certified value, true minus certified; placements of one artefact (``ball.A@1``,
``ball.A@2``) share that of a length. Prior: ten times the stated uncertainty for an angle (assumed: a wrong
certificate, or the certificate of another artefact, is in error by many times its uncertainty), three times
for a length. The error moves neither the arm nor a contact. It is identifiable only if the contacts determine
the same angle or distance independently. An error of a length is nearly confusable with a scale error of the
arm: a wider prior for it would increase the uncertainty of every distance by more than the correction is
worth.
"""

GRANITE, TABLE = 3e-6, 1e-4  # m, root mean square
DEGREES = (2, 3, 4)
RAISED = (0, 1)
"""Degrees of the mean height and the slopes."""
ODDS = 0.2
"""Of a form that contradicts the certificate (assumed: certified faces are seldom damaged)."""


def shapes(face: Face, further: tuple[int, ...] = ()) -> list[tuple[str, float, np.ndarray]]:
    """Name, share of the form's root mean square, and values (N,) of every shape of a face.

    `further`: degrees besides those of a form error, each with the share of the first of these.
    """
    weight = np.array([0.5 ** (degree - 2) for degree in DEGREES])
    weight /= np.sqrt(np.sum(weight**2))
    weight = np.append(weight, np.full(len(further), weight[0]))
    top = DEGREES[-1]
    every = legvander2d(face.place[:, 0], face.place[:, 1], [top, top]).reshape(-1, top + 1, top + 1)
    out = []
    for degree, share in zip((*DEGREES, *further), weight, strict=True):
        for i in range(degree, -1, -1):
            j = degree - i
            # unit root mean square over the square from -1 to 1
            values = every[:, i, j] * np.sqrt((2 * i + 1) * (2 * j + 1)) * face.rows
            out.append(
                (f"{face.name} form {'u' * i + 'v' * j or 'mean'}", share / np.sqrt(degree + 1), values)
            )
    return out


def _parameters(c: Circumstances, further: tuple[int, ...] = ()) -> list[Parameter]:
    out = []
    for face in c.faces:
        scale = (GRANITE if face.certified else TABLE) if face.u_form is None else face.u_form
        where: Where = {"site": location.face(face.name), "driver": Driver("face")}
        for name, share, values in shapes(face, further):
            # the ball touches a raised area earlier: the residual of the arm is larger by its height
            term = (Term(CONTACT, "normal", -values),)
            out.append(Parameter(name, "m", term, scale * share, **where))
    return out


PLANE_FORM = Effect(
    "plane-form",
    "a face is not flat",
    _parameters,
    lambda c: "" if c.faces else NO_PLANE,
    forms=(Form("raised", "raised or lowered in part", partial(_parameters, further=RAISED), ODDS),),
    sizes={"m": Size("RMS form deviation", length)},
    phrase=("every face", "has a form error"),
    remedy=(
        "Clean the faces and check them for damage. Have the form of the faces measured, and state it "
        "in the certificate, or use a flatter artefact."
    ),
    in_robot_file=True,
)
r"""Plane form: form error of faces, as Legendre polynomials of the position on the face.

Formula: $`\delta_n = -\sum_{2 \le i+j \le 4} x_{ij} \, P_i(s) \, P_j(t)`$;
P are Legendre polynomials, s and t positions on the face from -1 to 1.

Degrees 2 to 4. The RMS of each degree is half that of the degree before, because form errors are mainly of
long wavelength. Prior scale: the certificate's u_form, else 3 µm (assumed: 2 to 3 µm are typical of granite
shop-floor surface plates); of a plane that no certificate names, a table or a wall, 0.1 mm (assumed: ISO
2768-2, class K, allows 0.4 mm from peak to valley over 300 to 1000 mm). `fit` estimates the scale if the
contacts show a larger form error.

A local elevation, such as damage or dirt, also changes the mean height and the slopes of the face, which the
certificates state. The form ``plane-form@raised`` therefore has the degrees 0 and 1 too, with the RMS of
degree 2; without it they would be taken for an error of a certified value.
"""
