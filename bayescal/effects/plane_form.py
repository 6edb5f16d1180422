r"""Plane form: form error of faces, as Legendre polynomials of the position on the face.

Formula: $`\delta_n = -\sum_{2 \le i+j \le 4} x_{ij} \, P_i(s) \, P_j(t)`$;
P are Legendre polynomials, s and t positions on the face from -1 to 1.

Degrees 2 to 4. The RMS of each degree is half that of the degree before, because form errors are mainly of
long wavelength. Prior scale: the certificate's u_form, else 3 µm (assumed: 2 to 3 µm are typical of granite
surface plates in a workshop). `fit` estimates the scale if the contacts show a larger form error.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander2d

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import location
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Face, Parameter, Where

GRANITE = 3e-6  # m, root mean square
DEGREES = (2, 3, 4)


def shapes(face: Face) -> list[tuple[str, float, np.ndarray]]:
    """Name, share of the form's root mean square, and values (N,) of every shape of a face."""
    weight = np.array([0.5 ** (degree - 2) for degree in DEGREES])
    weight /= np.sqrt(np.sum(weight**2))
    top = DEGREES[-1]
    every = legvander2d(face.place[:, 0], face.place[:, 1], [top, top]).reshape(-1, top + 1, top + 1)
    out = []
    for degree, share in zip(DEGREES, weight, strict=True):
        for i in range(degree, -1, -1):
            j = degree - i
            # unit root mean square over the square from -1 to 1
            values = every[:, i, j] * np.sqrt((2 * i + 1) * (2 * j + 1)) * face.rows
            out.append((f"{face.name} form {'u' * i}{'v' * j}", share / np.sqrt(degree + 1), values))
    return out


def _parameters(c: Circumstances) -> list[Parameter]:
    out = []
    for face in c.faces:
        scale = GRANITE if face.u_form is None else face.u_form
        where: Where = {"site": location.face(face.name), "driver": Driver("face")}
        for name, share, values in shapes(face):
            # the ball touches a raised area earlier: the residual of the arm is larger by its height
            term = (Term(CONTACT, "normal", -values),)
            out.append(Parameter(name, "m", term, scale * share, **where))
    return out


def _missing(c: Circumstances) -> str:
    return "" if c.faces else "no plane is fitted"


PLANE_FORM = Effect(
    "plane-form",
    "a face is not flat",
    _parameters,
    _missing,
    sizes={"m": Size("RMS form deviation", length)},
    phrase=("every face", "has a form error"),
    remedy=(
        "Clean the faces and check them for damage. Have the form of the faces measured, and state it "
        "in the certificate, or use a flatter artefact."
    ),
)
