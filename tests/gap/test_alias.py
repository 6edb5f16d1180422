"""Ripples and the raster of the poses: the sampling theorem, and what the candidates make of it."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.effects import EFFECTS
from bayescal.effects.joints import waves
from bayescal.gap.search.candidates import ALIASED, candidates, unaliased
from bayescal.model.scene import Scene


@pytest.fixture
def c(cube):
    scene = Scene(cube(seed=5, count=120).dataset)
    return scene.circumstances(scene.rows("calibrate"))


def at_angles(c, joint, degrees):
    """The session with other angles of a joint, (N,)."""
    q = c.q.copy()
    q[:, joint - 1] = np.radians(degrees)
    return replace(c, q=q)


RASTER = 5.0 * (np.arange(120) % 47)


@pytest.mark.parametrize(
    ("degrees", "order", "seen"),
    [
        (RASTER, 72, False),  # one period from each angle to the next: a constant
        (RASTER, 73, False),  # once per revolution
        (RASTER, 142, False),  # twice
        (RASTER, 100, True),  # 28 times
        (20.0 * (np.arange(120) % 5), 100, False),  # five angles show nothing but a slow function
        (4.0 * np.linspace(0, 1, 120), 20, False),  # a quarter of a period
        (90.0 * np.linspace(0, 1, 120), 20, True),
        (RASTER, 2, True),  # no ripple
    ],
)
def test_angles_on_a_raster_alias_ripples(c, degrees, order, seen):
    moved = at_angles(c, 3, degrees)
    assert unaliased(waves(moved, "gear-mesh", 3, float(order), 5e-5), moved) == [seen, seen]


def test_an_aliased_ripple_is_not_assessed(c):
    """A gear of 73 at a raster of 5 degrees: at joint 3 alone, and at every joint."""
    geared = replace(c, robot=replace(c.robot, reductions=np.full(6, 73.0)))
    one = candidates(at_angles(geared, 3, RASTER), ("geometry",))
    assert one.missing["gear-mesh at joint 3"] == ALIASED
    assert {v.site for v in one.variants["gear-mesh"]} == {"", *(f"joint {j}" for j in (1, 2, 4, 5, 6))}
    for j in range(1, 7):
        geared = at_angles(geared, j, RASTER)
    every = candidates(geared, ("geometry",))
    assert every.missing["gear-mesh"] == ALIASED
    assert "gear-mesh" not in every.variants
    assert {"eccentricity", "second-harmonic"} <= set(every.variants)
    assert len(EFFECTS["gear-mesh"].at(geared)) == 24  # a model may still contain it
