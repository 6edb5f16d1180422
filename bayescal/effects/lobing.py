"""Lobing: a touch-trigger probe on three supports gives way further in some directions than in others.

Driver: sine and cosine of three times the azimuth of the contact's direction about the stylus, which is
taken to lie along the flange's z, times the share of the push that goes across it: a push along the
stylus has no azimuth. Prior: 5 um each, from a pre-travel of 5 to 20 um with three lobes. The first
harmonic is left out: it cannot be told from the tool's own x and y.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.joints import without_surface
from bayescal.effects.location import PROBE, Driver
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
    phrase=("the probe", "has three-lobe pre-travel variation"),
)
