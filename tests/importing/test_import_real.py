"""Real sessions through logs in other units, where their data are at hand."""

import foreign
import numpy as np
import pytest
from made_up_logs import said, table

from bayescal.dataset import read_dataset
from bayescal.importing import Request, convert, write

EVERY = 4
"""One row in so many, to be quick."""


@foreign.needs()
@pytest.mark.parametrize("name", ["ur5-lasertracker", "ur10-lasertracker"])
def test_a_tracker_and_its_reflector_are_found(name, tmp_path):
    """Neither is said, the arm is as drawn; and a wrong unit is told nevertheless."""
    data = read_dataset(foreign.REAL / name)
    m = data.measurements
    clock = np.arange(len(m.ids)) if m.time is None else m.time
    log = table(data, tmp_path / "log.csv", "rad", "m", ";", ",", clock)
    lines = log.read_text(encoding="utf-8").splitlines()
    log.write_text("\n".join([lines[0], *lines[1::EVERY]]), encoding="utf-8")
    usual = {"log": log, "robot": str(foreign.REAL / name / "robot.yaml"), "noise": "30 um"}
    draft = convert(Request(map=said("rad", "m"), **usual))
    assert draft.wrong == ""
    np.testing.assert_allclose(draft.dataset.tools[0].centre, data.tools[0].centre, atol=4e-3)
    write(draft, tmp_path / "out")
    got = read_dataset(tmp_path / "out").measurements
    np.testing.assert_allclose(got.readings, m.readings[::EVERY], atol=1e-8)
    np.testing.assert_allclose(got.xyz, m.xyz[::EVERY], atol=1e-8)
    assert "57 times too small; in rad" in convert(Request(map=said("deg", "m"), **usual)).wrong
    assert "1000 times too small; in m" in convert(Request(map=said("rad", "mm"), **usual)).wrong
