"""A user's own effect: registered by a program or by an installed package, then like any other."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from bayescal import effects
from bayescal.effects import EFFECTS, MODELS, Effect, Parameter, Term, confusable, parameters_of, registry
from bayescal.effects.location import Driver, joint
from bayescal.errors import BayescalError
from bayescal.gap.search.candidates import candidates
from bayescal.model import build
from bayescal.model.scene import Scene

OWN = Effect(
    "cable-drag",
    "a cable that pulls the last joint round as the first one turns",
    lambda c: [
        Parameter(
            "cable-drag",
            "rad",
            (Term(6, "rz", np.cos(c.q[:, 0])),),
            1e-4,
            site=joint(6),
            driver=Driver("angle", 1),
        )
    ],
    phrase=("the last joint", "is pulled by its cable"),
    confusable_with=("coupling",),
)


@pytest.fixture
def own():
    effects.register(OWN)
    yield OWN
    effects.unregister(OWN.name)


def circumstances(scene):
    return scene.circumstances(scene.rows("calibrate"))


def test_a_registered_effect_is_in_models_and_diagnoses(own, cube):
    scene = Scene(cube(seed=1).dataset)
    model = build(scene, ("geometry", own.name))
    assert [p.name for p in model.parameters if p.effect == own.name] == ["cable-drag"]
    assert own.name in MODELS
    found = candidates(circumstances(scene), ("geometry", "compliance"))
    assert [v.effect for v in found.variants[own.name]] == [own.name]
    assert confusable("coupling", own.name)
    assert confusable(own.name, "coupling")


def test_an_unregistered_effect_is_gone():
    before = list(EFFECTS)
    effects.register(OWN)
    effects.unregister(OWN.name)
    assert list(EFFECTS) == before
    with pytest.raises(BayescalError, match="`cable-drag` was not registered"):
        effects.unregister(OWN.name)
    with pytest.raises(BayescalError, match="`backlash` was not registered"):
        effects.unregister("backlash")


@pytest.mark.parametrize("name", ["backlash", "joint", "tool", "null", "unknown", "nominal", "cable-drag"])
def test_a_name_that_is_taken_is_refused(own, name):
    with pytest.raises(BayescalError, match=f"the name `{name}` is in use"):
        effects.register(replace(own, name=name))
    assert EFFECTS[own.name] is own


@pytest.mark.parametrize("name", ["", "a,b", "step@3", "Cable", "cable drag", "-x"])
def test_a_name_that_no_option_could_give_is_refused(name):
    with pytest.raises(BayescalError, match="cannot name an effect"):
        effects.register(replace(OWN, name=name))


@pytest.mark.parametrize("field", ["confusable_with", "requires", "part_of"])
def test_a_relation_to_no_effect_is_refused(field):
    with pytest.raises(BayescalError, match=f"{field} of cable-drag names `backlsh`"):
        effects.register(replace(OWN, **{field: ("backlsh",)}))
    assert OWN.name not in EFFECTS


def test_what_is_no_effect_is_refused():
    with pytest.raises(BayescalError, match="str is not an Effect"):
        effects.register("backlash")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unit": "mm"}, "the unit `mm` is unknown"),
        ({"sd": 0.0}, "is not normal"),
        ({"mean": np.nan}, "is not normal"),
        ({"terms": (Term(6, "rz", np.ones(3)),)}, "one value per row"),
        ({"terms": (Term(6, "rz", np.nan),)}, "not finite"),
    ],
)
def test_a_parameter_that_no_model_can_hold_is_refused(cube, change, words):
    spoilt = replace(OWN, parameters=lambda c: [replace(p, **change) for p in OWN.parameters(c)])
    effects.register(spoilt)
    try:
        with pytest.raises(BayescalError, match=f"parameter `cable-drag` of cable-drag: .*{words}"):
            parameters_of((OWN.name,), circumstances(Scene(cube(seed=1).dataset)))
    finally:
        effects.unregister(OWN.name)


def offered(monkeypatch, tmp_path, source, *names):
    """A vocabulary beside which a package with that source offers entry points."""
    module = f"offered_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{module}.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, module, raising=False)
    calls = []

    def found(group):
        calls.append(group)
        return [EntryPoint(name, f"{module}:{name}", group) for name in names]

    monkeypatch.setattr(registry, "entry_points", found)
    return registry.Vocabulary(EFFECTS.values(), ("tool",)), calls


OFFER = """
from bayescal.effects import Effect, EFFECTS
count = len(EFFECTS)  # reading the vocabulary while it is read
DRAG = Effect("drag", "drag", lambda c: [], requires=("sag",))
SAG = Effect("sag", "sag", lambda c: [])
WRONG = 3
TAKEN = Effect("backlash", "mine", lambda c: [])
"""


def test_entry_points_are_read_once_and_at_first_use(monkeypatch, tmp_path):
    table, calls = offered(monkeypatch, tmp_path, OFFER, "DRAG", "SAG")
    assert calls == []
    assert list(table)[-2:] == ["drag", "sag"]
    assert table["drag"].summary == "drag"
    assert calls == ["bayescal.effects"]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("WRONG",), "entry point WRONG = .*: int is not an Effect"),
        (("TAKEN",), "the name `backlash` is in use"),
        (("DRAG",), "requires of drag names `sag`"),
        (("SAG", "ABSENT"), "entry point ABSENT = .*: cannot be loaded: AttributeError"),
    ],
)
def test_an_entry_point_that_offers_no_effect_is_refused_each_time(monkeypatch, tmp_path, names, words):
    table, _ = offered(monkeypatch, tmp_path, OFFER, *names)
    for _ in range(2):
        with pytest.raises(BayescalError, match=words):
            len(table)
