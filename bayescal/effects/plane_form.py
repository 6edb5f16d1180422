"""Form of the faces of artefacts."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.polynomial.legendre import legvander2d

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import location
from bayescal.effects.common import NO_PLANE
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Face, Form, Parameter, Where

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
