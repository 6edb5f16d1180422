"""Sites and drivers: their words in files, their text, what counts as one coordinate, and its values."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.effects import EFFECTS, location, parameters_of
from bayescal.effects.location import (
    ARM,
    BASE,
    CONSTANT,
    KINDS,
    PLAIN,
    PROBE,
    Driver,
    Site,
    face,
    joint,
    link,
)
from bayescal.gap.search.cells import cells
from bayescal.gap.search.unknown import Pool
from bayescal.model.block import Part
from bayescal.model.scene import Scene

DRIVERS = [
    (CONSTANT, "1", "constant"),
    (Driver("angle", 4), "angle 4", "angle of J4"),
    (Driver("angle", 4, 1.0), "angle 4, once a turn", "angle of J4, once per revolution"),
    (Driver("angle", 4, 2.0), "angle 4, twice a turn", "angle of J4, twice per revolution"),
    (Driver("angle", 4, 77.0), "angle 4, 77 times a turn", "angle of J4, 77 times per revolution"),
    (Driver("angle", 4, form="one place"), "angle 4, one place", "angle of J4, local"),
    (Driver("angle", 4, form="beyond"), "angle 4, beyond one place", "angle of J4 beyond a threshold"),
    (Driver("torque", 4), "torque 4", "gravity torque of J4"),
    (Driver("torque", 4, form="sign"), "sign of torque 4", "sign of the gravity torque of J4"),
    (Driver("torque", 4, form="past"), "past torque 4", "earlier gravity torque of J4"),
    (
        Driver("torque", 4, form="own angle"),
        "torque 4, by its angle",
        "gravity torque of J4 times a function of its angle",
    ),
    (
        Driver("torque", 4, form="other angle"),
        "torque 4, by another angle",
        "gravity torque of J4 times a function of another angle",
    ),
    (
        Driver("torque", 4, form="and angle"),
        "torque 4, and its angle",
        "gravity torque of J4 and angle together",
    ),
    (
        Driver("angle", 4, form="waves"),
        "angle 4, 3 to 20 waves a turn",
        "angle of J4, 3 to 20 periods per revolution",
    ),
    (Driver("two angles"), "two angles", "angles of two joints"),
    (Driver("travel", 4), "travel 4", "earlier travel of J4"),
    (Driver("reading", 4), "reading 4", "each new reading of J4"),
    (Driver("base moment", form="sign"), "sign of base moment", "sign of the gravity moment on the base"),
    (Driver("torque"), "torque", "gravity torque"),
    (Driver("direction", 4), "approach 4", "direction of motion of J4"),
    (Driver("joint speed", 4), "speed 4", "speed of J4"),
    (Driver("contact speed"), "speed", "speed of contact"),
    (Driver("contact direction"), "direction of contact", "contact direction"),
    (Driver("time"), "time", "time"),
    (Driver("time", form="to and fro"), "time, to and fro", "time, oscillating"),
    (Driver("temperature"), "temperature", "temperature"),
    (Driver("event"), "moment", "row of the event"),
    (Driver("base moment"), "base moment", "gravity moment on the base"),
    (Driver("bending moment"), "bending moment", "bending moment of the link"),
    (Driver("face"), "place on the face", "position on the face"),
    (Driver("face", form="one spot"), "place on the face, one spot", "position on the face, local"),
    (Driver("workspace"), "place in the workspace", "position in the workspace"),
    (Driver("mass"), "mass", "payload mass"),
    (Driver("certificate"), "certificate", "certified value"),
    (Driver("humidity"), "humidity", "humidity"),  # a user's own
]


@pytest.fixture
def circumstances(cube):
    scene = Scene(cube(seed=1).dataset)
    return scene.circumstances(scene.rows("calibrate"))


@pytest.mark.parametrize(("driver", "words", "text"), DRIVERS)
def test_words_of_files_and_text_for_people(driver, words, text):
    assert (str(driver), driver.text) == (words, text)


def test_sites_are_read_as_they_are_written():
    for site in (*map(Site, PLAIN), joint(4), link(11), face("cube.+y"), face("joint"), face("joint x")):
        assert Site.read(str(site)) == site
    assert [site.text for site in (joint(4), BASE, face("cube.+y"))] == ["joint 4", "the base", "cube.+y"]
    assert link(2).also == (joint(2), link(2))


@pytest.mark.parametrize(
    ("driver", "course"),
    [
        (Driver("angle", 4, 2.0), Driver("angle", 4)),
        (Driver("torque", 4, form="sign"), Driver("torque", 4)),
        (Driver("torque", 4, form="past"), Driver("torque", 4, form="past")),
        (Driver("time", form="to and fro"), Driver("time")),
        (Driver("contact speed"), Driver("contact speed")),
    ],
)
def test_forms_of_one_coordinate(driver, course):
    assert driver.course == course


def test_coordinates_are_those_of_the_session(circumstances):
    c = circumstances
    row = np.arange(1.0, len(c.q) + 1)
    for driver, site, label, values in (
        (Driver("angle", 4, 2.0), joint(4), "reading of joint 4 (deg)", np.degrees(c.readings[:, 3])),
        (Driver("direction", 2), joint(2), "speed of joint 2 (deg/s)", np.degrees(c.velocity[:, 1])),
        (Driver("torque", 3, form="sign"), joint(3), "gravity torque on joint 3 (N m)", c.moments[:, 3, 2]),
        (Driver("torque", 3, form="past"), joint(3), "", row),
        (Driver("torque"), ARM, "", row),  # it was called that of joint 0
        (Driver("contact speed"), PROBE, "speed of contact (mm/s)", 1e3 * c.speed),
        (Driver("face", form="one spot"), face(c.faces[1].name), "place along the face (-1 to 1)",
         c.faces[1].place[:, 0]),
        (Driver("humidity"), ARM, "", row),
    ):  # fmt: skip
        found = driver.coordinate(site, c)
        assert found.label == label
        np.testing.assert_array_equal(found.values, values)


def test_effects_and_cells_are_told_in_known_kinds(circumstances):
    """A misspelt kind would have neither text nor a coordinate."""
    lacking = {name for name, effect in EFFECTS.items() if effect.missing(circumstances)}
    places = [(p.site, p.driver) for p in parameters_of(tuple(set(EFFECTS) - lacking), circumstances)]
    places += [(cell.site, cell.driver) for cell in cells(circumstances)]
    for site, driver in places:
        assert driver.kind in KINDS
        assert site.kind in (*PLAIN, *location.NUMBERED, "face")


def test_a_face_that_is_called_like_a_joint_is_a_face(circumstances):
    """Cells are weighed by the kind of their site, whatever the user's targets are called."""
    of = [cell for cell in cells(circumstances) if cell.site.kind in ("joint", "face")]
    renamed = [
        type(cell)(face(f"joint {cell.site.name}"), cell.driver, cell.sets, cell.known)
        if cell.site.kind == "face" else cell
        for cell in of
    ]  # fmt: skip
    weights = [Pool.of(some, np.zeros((3, 0)), 3).log_prior for some in (of, renamed)]
    np.testing.assert_array_equal(*weights)


def test_a_part_at_a_face_is_that_of_the_face(circumstances):
    name = circumstances.faces[0].name
    own = parameters_of(("plane-form",), circumstances)
    part = Part.of(f"plane-form at {name}")
    assert {str(p.site) for p in own if part.holds(p)} == {name}
