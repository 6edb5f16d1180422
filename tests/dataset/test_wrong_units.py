"""No session is blamed for a unit that is only loosely known, badly placed or shuffled."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.dataset.plausibility import suspicion


def with_rows(dataset, **changed):
    return replace(dataset, measurements=replace(dataset.measurements, **changed))


@pytest.mark.parametrize("factor", [np.pi / 180, 180 / np.pi, 1e-3, 1e3])
def test_the_factor_is_found(tracker, factor):
    data = tracker(count=30).dataset
    field = "xyz" if factor in (1e-3, 1e3) else "readings"
    found = suspicion(with_rows(data, **{field: getattr(data.measurements, field) * factor}))
    assert found is not None
    assert found.factor == pytest.approx(1 / factor)
    assert found.quantities == (("x", "y", "z") if field == "xyz" else tuple(f"j{j}" for j in range(1, 7)))
    assert found.other < 0.01 < 0.1 < found.stated


def test_nothing_is_suspected(cube, tracker):
    for data in (cube(count=60).dataset, tracker(count=30).dataset):
        assert suspicion(data) is None


def test_planes_that_are_nowhere_near(cube):
    """Offsets and normals drawn anew, up to half a metre and 30 deg off: wrong, but not by a unit."""
    rng = np.random.default_rng(5)
    data = cube(count=60).dataset
    for _ in range(40):
        targets = []
        for target in data.targets:
            normal = target.values["normal"] + rng.normal(0, 0.3, 3)
            offset = target.values["offset"] + rng.uniform(-0.5, 0.5)
            targets.append(
                replace(target, values={"normal": normal / np.linalg.norm(normal), "offset": offset})
            )
        assert suspicion(replace(data, targets=tuple(targets))) is None


def test_shuffled_points_and_a_wrong_tool(tracker):
    data = tracker(count=30).dataset
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shuffled = with_rows(data, xyz=rng.permutation(data.measurements.xyz))
        assert suspicion(shuffled) is None
        tool = replace(data.tools[0], centre=data.tools[0].centre + rng.normal(0, 0.2, 3))
        assert suspicion(replace(data, tools=(tool,))) is None


def test_a_number_near_the_largest_is_no_overflow(cube):
    data = cube(count=30).dataset
    readings = data.measurements.readings.copy()
    readings[2, 0] = -1e308
    with np.errstate(over="raise"):
        assert suspicion(with_rows(data, readings=readings)) is None
