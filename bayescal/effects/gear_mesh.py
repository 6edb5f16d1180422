r"""Gear mesh: ripple of the reducer, once and twice per revolution of the motor.

Formula: $`\rho_{z,k} = \sum_{m=1}^{2} a_{m,k} \sin(m N_k q_k) + b_{m,k} \cos(m N_k q_k)`$.

Driver: sine and cosine of N and 2 N times the link-relative angle. N is the number of motor revolutions per
joint revolution; a strain-wave gear meshes twice per motor revolution. Of a prismatic joint it is the number
of revolutions of its motor, pinion or screw per metre (prior 0.02 mm, assumed). Prior: 0.05 mrad each, from
amplitudes of 0.02 to 0.13 mrad at 2 N (an ABB IRB 120 measured with a laser tracker). If the robot file
states no reductions, the ratio is scanned, or given as ``gear-mesh@100``; joints with different ratios as
``gear-mesh@100/50 at joint 1 and joint 5``.
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.common import waves
from bayescal.effects.sizes import WAVE
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Scan

SD, ALONG_SD = 5e-5, 2e-5  # rad; m, of a prismatic joint
RATIOS = np.arange(20.0, 201.0)  # of small arms; in steps of 1, the resolution of a range of two radians


def _meshing(c: Circumstances, reductions: np.ndarray) -> list[Parameter]:
    return waves(c, "gear-mesh {:g}", np.multiply.outer(reductions, (1.0, 2.0)), SD, ALONG_SD)


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.robot.reductions is not None
    return _meshing(c, c.robot.reductions)


def _missing(c: Circumstances) -> str:
    lacks = "no reductions in the robot file (or gear-mesh@100 for a ratio of 100)"
    return lacks if c.robot.reductions is None else ""


GEAR_MESH = Effect(
    "gear-mesh",
    "error at the gear-mesh frequency of joint k (n per revolution)",
    _parameters,
    _missing,
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
