"""What reports say of sessions of images: events by image, what is not distinguishable, how many values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import camera_session
from sessions import with_columns

from bayescal.assess.identifiability import Directions, in_words
from bayescal.assess.undetermined import _poses
from bayescal.effects.location import BASE, CONSTANT, PROBE, TOOL, Driver, joint
from bayescal.gap.result import CauseClass, Event
from bayescal.reporting.gap import measured_as
from bayescal.reporting.gap.causes import beside_base, event_record, when
from bayescal.reporting.gap.phrases import _class, _separates


@pytest.mark.parametrize(("mount", "other"), [("flange", "board"), ("fixed", "fixed camera")])
def test_what_is_fixed_is_not_distinguishable_from_the_base(mount, other):
    session = camera_session(mount, images=4)
    assert beside_base(session, ["event", "time"]) == other
    assert beside_base(session, ["event", "base moment"]) == ""
    assert beside_base(session, []) == ""
    second = replace(session.targets[0], name="second")
    target = np.where(np.arange(len(session.measurements.ids)) % 2, 0, 1)
    two = with_columns(replace(session, targets=(*session.targets, second)), target=target)
    assert beside_base(two, ["event"]) == ""


def test_an_event_is_that_of_an_image():
    session = camera_session(images=4)
    event = Event(row=48, interval95=(48, 71))
    assert when(event, session) == "image i2 (row 49)"
    assert when(replace(event, interval95=(40, 71)), session) == "image i2 (row 49; i1 to i2 at 95 %)"
    assert event_record(event, session)["image"] == "i2"


def gap_of(causes, session, *named):
    """A diagnosis that ends in a class of causes."""
    verdict = SimpleNamespace(named=named, causes=causes)
    return SimpleNamespace(dataset=session, verdict=verdict, advice=(), where=())


def test_a_class_names_its_event_and_what_is_not_distinguishable():
    session = camera_session("fixed", images=4)
    causes = CauseClass((BASE,), (Driver("event"),), {"step": 0.6, "thermal-drift": 0.3})
    named = SimpleNamespace(effect="step", events=(Event(row=48, interval95=(48, 71)),))
    text = _class(causes, gap_of(causes, session, named))
    assert "at the base or the fixed camera (these data do not distinguish them)" in text
    assert "from image i2 (row 49) on" in text


def test_a_payload_is_not_said_to_vary():
    causes = CauseClass((TOOL,), (Driver("mass"),), {"payload": 0.6, "hardening": 0.3})
    gap = gap_of(causes, camera_session(images=4))
    assert "varies with gravity of tool and payload" in _class(causes, gap)
    assert _separates(gap) == "measurements at the same poses with another known mass on the flange"


def test_an_advice_that_distinguishes_other_causes_is_none_of_a_class():
    causes = CauseClass(
        (joint(2),), (Driver("angle", 2),), {"second-harmonic": 0.7, "eccentricity": 0.2, "hardening": 0.1}
    )
    gap = gap_of(causes, camera_session(images=4))
    assert _separates(gap) == "measurements with other values of angle of J2"
    others = SimpleNamespace(separates=("second-harmonic", "hardening"), what="a payload")
    its = SimpleNamespace(separates=("eccentricity", "second-harmonic"), what="other angles")
    gap.advice = (others,)
    assert _separates(gap) == "measurements with other values of angle of J2"
    gap.advice = (others, its)
    assert _separates(gap) == "other angles"


def test_a_constant_is_not_said_to_vary():
    causes = CauseClass((PROBE,), (CONSTANT,), {"ball-radius": 0.5, "latency": 0.47})
    gap = gap_of(causes, camera_session(images=4))
    members = "ball-radius (probability 0.50) or latency (probability 0.47)"
    assert _class(causes, gap) == f"Class of causes: an error at the probe: {members}"
    assert _separates(gap) == "measurements at other poses"


@pytest.mark.parametrize(
    ("images", "words"), [(True, "too much alike"), (False, "18 different poses cannot")]
)
def test_an_image_has_six_values(images, words):
    readings = np.random.default_rng(0).uniform(-1, 1, (18, 6))
    rows = np.arange(18)
    robot = SimpleNamespace(joint_names=tuple("abcdef"), n=6)
    scene = SimpleNamespace(in_images=np.full(18, images), dataset=SimpleNamespace(robot=robot))
    model = SimpleNamespace(size=50, scene=scene)
    session = SimpleNamespace(model=model, readings=readings, rows=rows, values_per_row=2.0)
    assert words in _poses(session)


def test_directions_of_images():
    seen = Directions(np.eye(3), np.array([1.0, 0.9, 0.05]), images=True)
    assert in_words(seen) == "all images are taken along about z of the base"
    assert in_words(replace(seen, images=False)) == "hardly a row looks along z of the base"


def test_what_to_take_where_nothing_is_advised():
    assert measured_as({"images": [{"target": "cam"}]}, []) == "image"
    assert measured_as({"images": []}, []) == "contact"
