"""What is stated of an arm comes back from its run folder: nothing is left at a default."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from export_arms import fake, session_of
from influences import leaves
from sessions import with_columns

from bayescal.dataset.join import joined
from bayescal.effects.location import joint
from bayescal.estimate.bounds import Negative, Rigid
from bayescal.fitted.arm import Origin
from bayescal.fitted.file import read_arm, write_arm
from bayescal.fitted.gate import Use
from bayescal.fitted.unmodelled import Unmodelled
from bayescal.model.options import FitOptions, Part

EFFECTS = ("geometry", "compliance")


@pytest.fixture(scope="module")
def pair():
    """Two sessions of one arm and tool, of which the second is noisier."""
    session = session_of()
    other = with_columns(session, readings=session.measurements.readings + 1e-3)
    rough = replace(other, noise=replace(other.noise, contact=3.0 * session.noise.contact))
    named = ((session, "A"), (rough, "B"))
    return tuple(replace(s, name=n, folder=Path(n), sha256=n.lower()) for s, n in named)


def stated(arm):
    """An arm with all that may be said of one."""
    count = len(arm.values)
    rng = np.random.default_rng(0)
    options = FitOptions((Part("compliance", joint(2)),), False, 1.75, 11, widths={"zeros": 1.5})
    rigid = Rigid((Negative("compliance J3", -1e-6, 2e-6, "rad/(N m)"),), 3e-6, 7e-6)
    use = Use(("priors decide",), ("one scale",), rigid, ("backlash is left out",), "measure")
    unmodelled = Unmodelled(
        1e-7 * rng.standard_normal((count, 5)), {"joints": 1e-10}, {"joints": 7.5},
        rng.standard_normal((2, 2)), 3e-6, 12.5, {"contact": 1.25}, {"contact": (1e-9 * np.eye(count), 33.0)},
    )  # fmt: skip
    ids = arm.dataset.measurements.ids
    return replace(
        arm, rejected=(ids[3], ids[7]), origin=Origin("gap", options), use=use, unmodelled=unmodelled,
        solved=0.5 * arm.covariance,
    )  # fmt: skip


ATTRIBUTES = ("values", "covariance", "effects", "states", "rejected", "origin")
ATTRIBUTES += ("use", "unmodelled", "solved")


@pytest.mark.parametrize(("remounted", "own_noise"), [(True, False), (False, True)])
def test_an_arm_that_was_read_is_that_which_was_written(pair, tmp_path, remounted, own_noise):
    arm = stated(fake(joined(pair, remounted=remounted, own_noise=own_noise), EFFECTS))
    write_arm(arm, tmp_path)
    again = read_arm(tmp_path)
    assert [t.name for t in again.dataset.tools] == [t.name for t in arm.dataset.tools]
    assert [bool(t.noise) for t in again.dataset.targets] == [own_noise] * len(arm.dataset.targets)
    for name in ATTRIBUTES:
        was, now = (dict(leaves(getattr(one, name))) for one in (arm, again))
        assert was.keys() == now.keys(), name
        for path, value in was.items():
            same = (
                np.allclose(now[path], value, rtol=1e-9, atol=0) if is_number(value) else now[path] == value
            )
            assert same, (name, path, now[path], value)


def is_number(value):
    return isinstance(value, float | np.ndarray)
