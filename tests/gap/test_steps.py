"""Steps of the base, of a reflector and of an instrument: alternatives, each with its row."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import Bench

from bayescal.arm.motion import Term
from bayescal.dataset import Target
from bayescal.effects import EFFECTS, Parameter, parameters_of
from bayescal.effects.location import BASE, TOOL
from bayescal.gap.outcome.notes import alike
from bayescal.gap.search.refit import model_name
from bayescal.model.scene import Scene


@pytest.fixture(scope="module")
def bench(tracker):
    return Bench.of(tracker(seed=3, count=120).dataset)


def circumstances(dataset):
    scene = Scene(dataset)
    return scene.circumstances(scene.rows("calibrate"))


def two_instruments(dataset):
    """Every second row is read by another instrument, beside the first."""
    first = dataset.targets[0]
    other = Target("radar", "instrument", {**first.values, "xyz": first.values["xyz"] + [0.0, 0.5, 0.0]})
    m = dataset.measurements
    m = replace(m, target=np.arange(len(m.ids)) % 2)
    return replace(dataset, targets=(first, other), measurements=m)


def shifted(c, frame, rows=1.0, row=60):
    """Columns of a shift of a frame from a row on (from 1), written down without the effect."""
    since = (np.arange(len(c.q)) >= row - 1) * rows
    return [Parameter("truth", "m", (Term(frame, axis, since),), 5e-5) for axis in ("tx", "ty", "tz")]


def found(bench, parameters, strength=250.0):
    columns = bench.slopes.columns(parameters)
    decision, _ = bench.decided(bench.made_up(1, bench.visible(columns, strength, 2)))
    (member,) = decision.members
    return decision.kind, member


@pytest.mark.parametrize("frame", [0, 7])
def test_the_base_or_the_reflector_shifted(bench, tracker, frame):
    """In sessions of a tracker; a shift of the reflector was an unmodelled effect."""
    kind, member = found(bench, shifted(bench.circumstances, frame))
    assert (kind, member.effect) == ("named", "step")
    assert abs(member.variant.setting - 60) <= 3
    assert model_name(member, bench.known).split(" x")[0] == (
        f"step@{member.variant.setting:g}" + (" at tool" if frame else "")
    )
    note = list(alike(Scene(tracker(seed=3, count=120).dataset), [member]))
    assert bool(note) == (frame == 0)
    assert not note or "the instrument" in note[0]


def test_one_of_two_instruments_shifted(tracker):
    bench = Bench.of(two_instruments(tracker(seed=3, count=120).dataset))
    c = bench.circumstances
    kind, member = found(bench, shifted(c, 0, np.arange(len(c.q)) % 2))
    assert (kind, member.effect, member.variant.site) == ("named", "step", "radar")
    names = {p.name for p in parameters_of((model_name(member, bench.known),), c) if p.effect == "step"}
    assert names == {f"step radar {axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")}


def test_without_a_site_a_step_is_of_the_base(bench, cube):
    c = bench.circumstances
    for name, sites in (("step@60", {BASE}), ("step@60 at tool", {TOOL}), ("step", {BASE})):
        assert {p.site for p in parameters_of((name,), c) if p.effect == "step"} == sites
    touching = EFFECTS["step"].at(circumstances(cube(seed=1).dataset), 60.0)
    assert {p.site for p in touching} == {BASE}


def test_each_of_several_reflectors_and_all_of_them(tracker):
    d = tracker(seed=3, count=60).dataset
    tools = (d.tools[0], replace(d.tools[0], name="upper"))
    d = replace(d, tools=tools, measurements=replace(d.measurements, tool=np.arange(60) % 2))
    sites = [str(p.site) for p in EFFECTS["step"].at(circumstances(d), 30.0)]
    name = d.tools[0].name
    assert list(dict.fromkeys(sites)) == ["base", "tool", f"tool of {name}", "tool of upper"]


def test_alternatives_share_a_part_of_the_prior(bench):
    variants = bench.known.variants["step"]
    assert sum(np.exp(v.log_prior) for v in variants) == pytest.approx(1.0)
    own = [v for v in variants if v.setting == variants[0].setting]
    assert [v.site for v in own] == ["", "tool"]
    assert np.exp(own[1].log_prior - own[0].log_prior) == pytest.approx(3 / 7)
