r"""Lobing: the pre-travel of a touch-trigger probe on three supports varies with the direction of contact.

Formula: $`\delta_n = \sin\beta \, (a \sin 3\varphi + b \cos 3\varphi)`$;
φ is the azimuth of the contact about the stylus, β its angle to the stylus.

Driver: sine and cosine of three times the azimuth of the contact's direction about the stylus, times the
component of that direction transverse to the stylus: a contact along the stylus has no azimuth. The stylus
is assumed to be parallel to the flange's z axis. Prior: 5 µm each, from a pre-travel of 5 to 20 µm with three
lobes. The first harmonic is omitted: it is not distinguishable from the tool's x and y.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.common import without_surface
from bayescal.effects.location import PROBE, Driver
from bayescal.effects.sizes import WAVE
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Where

SD = 5e-6  # m
LOBES = 3
HERE: Where = {"site": PROBE, "driver": Driver("contact direction")}


def _parameters(c: Circumstances) -> list[Parameter]:
    x, y, _ = np.where(c.touching[:, None], c.approach, 0.0).T
    across, azimuth = np.hypot(x, y), LOBES * np.arctan2(y, x)
    waves = (("sin", across * np.sin(azimuth)), ("cos", across * np.cos(azimuth)))
    return [
        Parameter(f"lobing {wave}", "m", (Term(CONTACT, "normal", driver),), SD, **HERE)
        for wave, driver in waves
        if driver.any()
    ]


LOBING = Effect(
    "lobing",
    "three-lobe pre-travel variation of the probe",
    _parameters,
    without_surface,
    sizes={"m": WAVE},
    phrase=("the probe", "has three-lobe pre-travel variation"),
    remedy=(
        "Calibrate the probe in the directions of use, reduce its trigger force or the stylus length, "
        "or use a strain-gauge probe. Check that the stylus is tight."
    ),
)
