"""The name that a diagnosis prints is the model that it fitted: parameters, priors and numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayescal as bc
from bayescal.effects import parameters_of
from bayescal.effects.location import joint
from bayescal.gap.search.beam import Member
from bayescal.gap.search.candidates import candidates
from bayescal.gap.search.refit import model_name, still_without
from bayescal.model.block import parts_of
from bayescal.model.scene import Scene

BASE = ("geometry", "compliance")


@pytest.mark.parametrize("baseline", [BASE, ("geometry",)])
@pytest.mark.parametrize(("scale", "partial"), [(0.125, False), (1.0, False), (4.0, True)])
def test_every_variant_has_a_name_that_is_its_parameters(cube, baseline, scale, partial):
    """Also where only some of the effect's parameters are assessed."""
    scene = Scene(cube(seed=1, count=48).dataset)
    c = scene.circumstances(scene.rows("calibrate"))
    known = candidates(c, baseline)
    names = set()
    for variant in (v for own in known.variants.values() for v in own):
        listed = replace(variant, partial=partial and not variant.together)
        name = model_name(Member(listed, scale, 0.0), known)
        own = [p for p in parameters_of((name,), c) if p.effect == variant.effect]
        pool = [known.pool[k] for k in variant.columns]
        assert [p.name for p in own] == [p.name for p in pool], name
        assert [p.centre for p in own] == [p.nominal for p in pool], name
        assert [p.sd for p in own] == pytest.approx([scale * p.sd for p in pool]), name
        for p, q in zip(own, pool, strict=True):
            for s, t in zip(p.terms, q.terms, strict=True):
                assert (s.frame, s.axis) == (t.frame, t.axis)
                assert np.array_equal(s.driver, t.driver), name
        names.add(name)
    assert len(names) == sum(map(len, known.variants.values()))


@pytest.fixture(scope="module")
def lagging():
    return bc.simulate(
        effects="geometry,compliance,backlash at joint 3", contacts=120, later=30, repeats=0, spheres=2,
        placements=2, seed=5, error_scale=2.0,
    )  # fmt: skip


def test_fit_with_the_printed_model_is_the_refit(lagging):
    gap = bc.diagnose(lagging)
    assert gap.record["verdict"] == "named"
    (named,) = gap.record["named"]
    assert (named["effect"], named["site"]) == ("backlash", "joint 3")
    fit = bc.fit(lagging, gap.record["refit"]["model"], samples=0)
    (told,) = gap.record["amplitudes"]
    row, wide = fit.parameters.loc["backlash J3"], fit.data.stated
    k = wide.plain.model.names.index("backlash J3")
    u = wide.sd[k] * wide.plain.model.sd[k]
    assert row.u == pytest.approx(np.degrees(u), rel=0.15)  # of draws, and their kurtosis
    assert (told["unit"], row.unit) == ("deg", "deg")
    assert told["value"] == pytest.approx(abs(row.estimate), rel=1e-9)
    assert told["u"] == pytest.approx(np.degrees(u), rel=1e-9)
    truth = next(p for p in lagging.truth["parameters"] if p["name"] == "backlash J3")
    assert abs(told["value"] - abs(truth["value_deg"])) < 4 * told["u"]


def test_a_part_that_was_left_out_is_back(lagging):
    """The model that is printed is without the parts that are not named."""
    words = "geometry at joint 4, compliance at joint 5"
    gap = bc.diagnose(lagging, without=words)
    named = {n["model"] for n in gap.record["named"]}
    assert "geometry at joint 4" in named
    assert {*gap.record["refit"]["without"]} == {"geometry at joint 4", "compliance at joint 5"} - named
    fit = bc.fit(lagging, samples=0, **gap.record["refit"])
    told = {a["parameters"][0]: a for a in gap.record["amplitudes"]}
    assert "a4" in told
    for name in {"theta4", "d4", "a4", "alpha4"} & told.keys():
        a, row = told[name], fit.parameters.loc[name]
        factor = 1e3 if a["unit"] == "um" else 1.0
        assert a["value"] == pytest.approx(factor * (row.estimate - row.nominal), rel=1e-6)


def test_parts_that_are_not_named_stay_nominal():
    member = SimpleNamespace(effect="geometry", variant=SimpleNamespace(sites=(joint(4),)))
    parts = parts_of(("geometry at joint 4", "geometry at link 3", "compliance at joint 4"), BASE)
    assert still_without(parts, [member]) == parts[1:]
