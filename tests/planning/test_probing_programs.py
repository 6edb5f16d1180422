"""Probing programs, run by interpreters of their subsets on a simulated arm: touch, no touch, early touch.

The interpreters and the cell share no code with the package. None of this is a controller.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from made_up_plans import made_up_plan
from probing_cell import cell_of, on_planes
from urscript_interpreter import Program

from bayescal.exporting.plan import FORMATS, Probe

ERROR = {"a": [0, 2e-4, 5e-4, -3e-4, 0, 0], "offset": [0, 1e-3, -8e-4, 5e-4, -6e-4, 0]}
SHIFT = {"cube.+z": 6e-4, "cube.-x": -4e-4, "cube.+y": 3e-4}
SPEED = 5e-3


@pytest.fixture(scope="module")
def plan(cube):
    """A dozen contacts with a change before the sixth."""
    return on_planes(made_up_plan(cube(seed=1, count=90).dataset, count=10, validation=2))


def ran(plan, name="urscript", probe=None, **cell):
    """The interpreted program of a plan."""
    (_, text), *_ = FORMATS[name].files(plan, probe or Probe()).items()
    return Program(text, cell_of(plan, ERROR, SHIFT, **cell)).run()


def records(program):
    """Logged (id, state, readings)."""
    out = []
    for line in program.log:
        name, values = re.fullmatch(r"bayescal, (\S+), rad, (\[.*\])", line).groups()
        state, *q = json.loads(values)
        out.append((name, state, np.array(q)))
    return out


def off_surface(program, rows):
    """Depths, m, of the ball at logged readings inside the surfaces of their rows."""
    cell = program.cell
    off = cell.true.ball(np.array([q for _, _, q in records(program)])) - cell.points[rows]
    return -np.einsum("mi,mi->m", off, cell.normals[rows])


@pytest.mark.parametrize("cycle", [2e-3, 8e-3])
def test_every_contact_is_touched_and_logged_in_the_cycle_of_the_touch(plan, cycle):
    program = ran(plan, cycle=cycle)
    found = records(program)
    assert not program.halted
    assert [(name, state) for name, state, _ in found] == [(f"p{k:03d}", 1) for k in range(1, 13)]
    depth = off_surface(program, np.arange(12))
    assert (depth > 0).all()
    assert (depth <= SPEED * cycle * 1.2).all()  # the true arm is a little faster than the nominal one
    assert program.cell.deepest <= 1.2 * (SPEED * 2 * cycle + SPEED**2 / (2 * 0.5))
    assert [text.partition(":")[2] for text in program.popups[2:]] == [" attach 0.5 kg beyond the tool"]
    ends = np.array([q for kind, q in program.cell.travelled if kind == "joint"])
    assert len(ends) == 1 + 12 + 2 * 11  # where it begins, approaches, raised poses
    np.testing.assert_allclose(ends[0], plan.leave[0][0], atol=1e-6)
