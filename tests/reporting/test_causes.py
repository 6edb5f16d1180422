"""Unmodelled locations that show what happens: the sentence, the row and size, and what to inspect."""

from dataclasses import replace

import pytest
from test_gap_report import diagnosis, printed

from bayescal.effects.location import BASE, TOOL, Driver
from bayescal.gap.result import Amplitude, Event, Gap
from bayescal.gap.search.cells import cells
from bayescal.model.scene import Scene
from bayescal.reporting.gap.causes import CAUSES
from bayescal.reporting.gap.record import gap_record


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=7, count=240).dataset


def shifted(dataset, family_p_value: float = 1e-9, *, explained_by: str = "") -> Gap:
    """A gap whose first location is a tool that shifts at the 13th row."""
    gap = diagnosis(dataset, "unknown")
    values = zip("xyz", (10e-6, -4.6e-6, 120e-6), (1.4e-6, 2.1e-6, 3e-6), strict=True)
    moved = tuple(
        Amplitude("unknown", TOOL, Driver("event"), (), f"shift {a}", v, u, "m", None, v > 5e-6)
        for a, v, u in values
    )
    place = replace(
        gap.where[0], site=TOOL, driver=Driver("event"), family_p_value=family_p_value,
        explained_by=explained_by, event=Event(12, (11, 13)), amplitudes=moved,
    )  # fmt: skip
    return replace(gap, where=(place, *gap.where[1:]))


def test_an_unmodelled_location_says_what_happens_and_what_to_inspect(session):
    gap = shifted(session)
    name = session.measurements.ids[12]
    says = (
        f"the tool shifted at row 13 ({name}), rows 12 to 14 at 95 %, by (x, y, z) = "
        "(10.0(1.4), -4.6(2.1), 120.0(3.0)) µm"
    )
    flat = " ".join(printed(gap).split())
    assert f"T{says[1:]}" in flat
    assert "inspect Look at the log at this row: a stylus" in flat
    place = gap_record(gap)["where"][0]
    assert place["words"] == says
    assert place["event"] == {"row": 13, "id": name, "interval95": [12, 14]}
    assert place["amplitudes"][2] == {
        "what": "shift z", "value": pytest.approx(120.0), "u": pytest.approx(3.0), "unit": "um",
        "significant": True,
    }  # fmt: skip
    assert "another tool" in place["remedy"]


@pytest.mark.parametrize("place", [{"family_p_value": 0.2}, {"explained_by": "step"}])
def test_no_cause_of_a_location_that_is_not_significant_or_has_a_name(session, place):
    gap = shifted(session, **place)
    assert "words" not in gap_record(gap)["where"][0]
    assert "shifted at row" not in printed(gap)


def test_a_base_that_rocks_is_told_with_its_half_angle(session):
    gap = diagnosis(session, "unknown")
    driver = Driver("base moment", form="sign")
    what = "half-angle about the horizontal axis at 45 deg from x"
    angle = Amplitude("unknown", BASE, driver, (), what, 4e-4, 1e-5, "rad", None, True)
    where = (replace(gap.where[0], site=BASE, driver=driver, amplitudes=(angle,)), *gap.where[1:])
    flat = " ".join(printed(replace(gap, where=where)).split())
    assert f"The base rocks with the sign of the base moment ({what} 0.02292(57) deg)" in flat
    assert "clearance below the mounting plate" in flat


def test_every_cause_is_of_a_cell_of_a_session(session):
    """No sentence for a location that no diagnosis finds."""
    scene = Scene(session)
    found = {
        (x.site.kind, x.driver.kind, x.driver.form)
        for x in cells(scene.circumstances(scene.rows("calibrate")))
    }
    assert not set(CAUSES) - found
