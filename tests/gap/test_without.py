"""Parts left out of a model: what they hold, what is refused, and that the diagnosis names them."""

import json

import numpy as np
import pytest

from bayescal.cli import main
from bayescal.dataset import write_dataset
from bayescal.effects.location import joint, link
from bayescal.errors import BayescalError
from bayescal.gap.diagnose import diagnose
from bayescal.gap.search.candidates import candidates
from bayescal.model import build
from bayescal.model.block import Part, kept, parts_of
from bayescal.model.scene import Scene
from bayescal.reporting.gap.record import gap_record
from bayescal.simulation import Options, simulate

BASE = ("geometry", "compliance")
LITTLE = {"contacts": 120, "later": 40, "repeats": 0, "spheres": 2, "placements": 2}


@pytest.fixture(scope="module")
def dataset():
    return simulate(Options(**LITTLE, seed=4)).dataset


@pytest.fixture(scope="module")
def scene(dataset):
    return Scene(dataset)


def names(model, effect="geometry"):
    return {p.name for p in model.parameters if p.effect == effect}


@pytest.mark.parametrize(
    ("words", "gone"),
    [
        ("geometry at joint 4", {"theta4", "d4", "a4", "alpha4"}),
        ("geometry at link 4", {"a4", "alpha4"}),
        ("geometry at joint 2", {"theta2", "d2", "a2", "alpha2", "beta2"}),
        ("geometry at joint 1", {"a1", "alpha1"}),
    ],
)
def test_a_joint_has_its_link_with_it(words, gone, scene):
    whole, bare = build(scene, BASE), build(scene, BASE, without=[Part.of(words)])
    assert names(whole) - names(bare) == gone
    assert names(whole, "compliance") == names(bare, "compliance")
    assert names(build(scene, BASE[1:], without=[Part.of(words)]), "compliance")


def test_parts_are_candidates_each_and_together(scene):
    c = scene.circumstances(scene.rows("calibrate"))
    plain = candidates(c, BASE)
    assert candidates(c, BASE, ()).variants.keys() == plain.variants.keys()
    one = candidates(c, BASE, [Part.of("geometry at joint 4")])
    assert set(one.variants) - set(plain.variants) == {"geometry"}
    (variant,) = one.variants["geometry"]
    assert {one.pool[k].name for k in variant.columns} == {"theta4", "d4", "a4", "alpha4"}
    assert (variant.site, variant.log_prior) == ("joint 4", 0.0)
    two = candidates(c, BASE, parts_of(("geometry at joint 4", "geometry at link 3"), BASE))
    every, *alone = two.variants["geometry"]
    assert every.site == "joint 4 and link 3"
    assert [v.site for v in alone] == ["joint 4", "link 3"]
    assert sorted(every.columns) == sorted(np.concatenate([v.columns for v in alone]))
    assert sum(np.exp(v.log_prior) for v in two.variants["geometry"]) == pytest.approx(1.0)
    assert [p.name for p in two.pool[: len(plain.pool)]] == [p.name for p in plain.pool]


def test_a_part_keeps_the_setting_of_its_effect(scene):
    c = scene.circumstances(scene.rows("calibrate"))
    known = candidates(c, (*BASE, "gear-mesh@50"), [Part.of("gear-mesh at joint 3")])
    (variant,) = known.variants["gear-mesh"]
    assert (variant.setting, variant.site) == (50.0, "joint 3")
    drivers = [f"angle 3, {turns} times a turn" for turns in (50, 100)]
    assert [(str(site), str(driver)) for site, driver in variant.places] == [("joint 3", d) for d in drivers]


def test_what_was_taken_out_is_named_and_shrinks_as_foreseen(dataset):
    gap = diagnose(dataset, without=("geometry at joint 4",))
    record = json.loads(json.dumps(gap_record(gap), allow_nan=False))
    assert record["without"] == ["geometry at joint 4"]
    assert record["baseline"] == list(BASE)
    assert record["verdict"] == "named"
    assert [(n["effect"], n["site"]) for n in record["named"]] == [("geometry", "joint 4")]
    assert record["probability"]["geometry"] > 0.99
    for s in gap.shrinkage:
        assert s.claimed
        assert s.before > 10 * s.after
        assert s.before == pytest.approx(s.predicted_before, rel=0.15)
        assert s.after < 1.6 * s.predicted


def test_one_stiffness_is_named_at_its_joint(dataset):
    gap = diagnose(dataset, without=("compliance at joint 5",))
    assert [(n.effect, n.site) for n in gap.verdict.named] == [("compliance", "joint 5")]
    assert gap.levels[-1].validation_rms < 0.2 * gap.levels[-2].validation_rms


def test_nothing_wrong_there_is_not_named():
    """An arm whose geometry is as drawn: a joint goes back to the drawing, and nobody misses it."""
    drawn = simulate(Options(**LITTLE, seed=4, effects=("compliance",))).dataset
    gap = diagnose(drawn, without=("geometry at joint 4",))
    assert gap.verdict.kind == "null"
    assert gap.verdict.probability["geometry"] < 0.1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("geometry", "`geometry` is not an effect at a site"),
        ("bending at link 2", "bending is not in the model; the model has: geometry, compliance"),
        ("geometry at joint 6", "geometry has no parameters at `joint 6`; its sites are: joint 1, link 1"),
        ("compliance at link 2", "compliance has no parameters at `link 2`; its sites are: joint 2"),
    ],
)
def test_refusals_are_one_line(words, told, dataset, tmp_path, monkeypatch, capsys):
    write_dataset(dataset, tmp_path / "session")
    arguments = [str(tmp_path / "session"), "--without", words, "--out", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", ["bayescal", "gap", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 1
    errors = capsys.readouterr().err.replace("\r", "\n")
    lines = [line for line in errors.splitlines() if "bayescal:" in line]
    assert len(lines) == 1
    assert told in lines[0]
    assert not (tmp_path / "out").exists()


def test_every_parameter_may_be_named(scene):
    """As it is printed: the model lacks this one alone, and it is written and read as its name."""
    own = build(scene, BASE).parameters
    for p in own:
        (part,) = parts_of((p.name,), BASE, own)
        assert {q.name for q in own} - {q.name for q in kept(own, (part,))} == {p.name}
        assert (str(part), part.effect, part.site) == (p.name, p.effect, p.site)
        (again,) = parts_of((str(part),), BASE)
        assert kept(own, (again,)) == kept(own, (part,))
    with pytest.raises(BayescalError, match="`compliance J9` is not an effect at a site, and no parameter"):
        parts_of(("compliance J9",), BASE, own)


def test_what_is_kept_and_what_is_refused(scene):
    own = build(scene, BASE).parameters
    assert kept(own, ()) == own
    assert kept(own, [Part("bending", link(2))]) == own  # no such effect here: nothing to take
    with pytest.raises(BayescalError, match="no parameters at `wrist`"):
        kept(own, [Part.of("geometry at wrist")])
    assert parts_of(("geometry  at  joint 4", "geometry at joint 4"), BASE) == (Part("geometry", joint(4)),)
