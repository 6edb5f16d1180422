"""Gross mistakes of stated values are named, good sessions have none, and what cannot be seen is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayescal as bc
from bayescal.assess.mistakes import DIFFERENT, hidden, judged, mistaken
from bayescal.dataset import Certificate, Dataset, read_dataset

SHARED = Path(__file__).parents[3] / "shared" / "data"
SESSIONS = [SHARED / name for name in ("real/motoman-planes", "real/panda-ball-socket-4", "worlds-dev/004")]


@pytest.fixture(scope="module")
def good() -> Dataset:
    return bc.simulate(contacts=100, later=8, repeats=5, spheres=2, placements=1, seed=1).dataset


def of_tools(dataset: Dataset, field: str, factor: float) -> Dataset:
    tools = (replace(t, **{field: factor * getattr(t, field)}) for t in dataset.tools)
    return replace(dataset, tools=tuple(tools))


def of_diameters(dataset: Dataset, factor: float, name: str = "") -> Dataset:
    targets = (
        replace(t, values=t.values | {"diameter": factor * t.values["diameter"]})
        if "diameter" in t.values and t.name.startswith(name)
        else t
        for t in dataset.targets
    )
    return replace(dataset, targets=tuple(targets))


def of_lengths(dataset: Dataset, factor: float) -> Dataset:
    longer = (
        c if c.distance is None else replace(c, distance=factor * c.distance) for c in dataset.certificates
    )
    return replace(dataset, certificates=tuple(longer))


LOOKS = "looks like it is"
MISTAKES = {
    "ball diameter": (of_tools, ("ball_radius", 2.0), f"`ball_radius_mm` of `ball` {LOOKS} a diameter"),
    "ball in m": (of_tools, ("ball_radius", 1e-3), f"`ball_radius_mm` of `ball` {LOOKS} in m"),
    "sphere radius": (of_diameters, (0.5,), f"all spheres and cylinders {LOOKS} a radius"),
    "one sphere": (of_diameters, (0.5, "ball.B"), f"`diameter_mm` of `ball.B` {LOOKS} a radius"),
    "twice the diameter": (of_diameters, (2.0,), f"{LOOKS} twice the diameter"),
    "sphere in m": (of_diameters, (1e-3,), f"spheres and cylinders {LOOKS} in m"),
    "mass centre": (of_tools, ("centre_of_mass", 25.4), f"`ball` {LOOKS} multiplied by 25.4 once too often"),
    "mass centre in inches": (of_tools, ("centre_of_mass", 1 / 25.4), f"`ball` {LOOKS} in inches"),
    "certificates": (of_lengths, (1.01,), "all certified lengths look too long by a factor of 1.0"),
    "short certificates": (of_lengths, (0.99,), "all certified lengths look too short by a factor of 1.0"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(good, name):
    change, arguments, words = MISTAKES[name]
    (found,) = mistaken(judged(change(good, *arguments)))
    assert words in found.what
    assert found.remedy


def test_a_good_session_has_none_and_says_what_it_cannot_show(good):
    found = judged(good)
    assert not list(mistaken(found))
    assert abs(found.scale[0]) < 4 * found.scale[1]
    assert list(hidden(found)) == [f"a common error of all certified lengths below {100 * DIFFERENT:.1g} %"]


def test_without_gravity_a_mass_centre_is_not_shown(good):
    found = judged(replace(good, gravity=np.zeros(3)))
    assert found.unknown == ("`centre_of_mass_mm` of `ball`",)
    assert "`centre_of_mass_mm` of `ball`" in next(hidden(found))


def test_without_certified_lengths_there_is_no_factor(good):
    bare = tuple(c for c in good.certificates if c.distance is None)
    assert judged(replace(good, certificates=bare)).scale is None
    apart = (*bare, Certificate("distance", ("ball.A@1", "ball.B@1"), distance=0.3, u_distance=1e-6))
    assert judged(replace(good, certificates=apart)).scale is not None


@pytest.mark.parametrize("folder", SESSIONS, ids=lambda p: p.name)
def test_no_false_alarm(folder):
    if not folder.is_dir():
        pytest.skip("the shared datasets are not here")
    found = judged(read_dataset(folder))
    assert found is not None
    assert not list(mistaken(found))


def test_a_fit_that_fails_names_it(good):
    result = bc.fit(of_tools(good, "ball_radius", 2.0), samples=0)
    assert result.data.findings[0].code == "gross_mistake"
