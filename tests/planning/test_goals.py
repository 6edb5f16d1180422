"""Slopes of distances against differences: spheres located anew, and TCP positions moved."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_pools import MODEL, linear, pool, pool_of

from bayescal.dataset import Certificate, Noise
from bayescal.dataset.types import Box
from bayescal.errors import BayescalError
from bayescal.model import ARM
from bayescal.planning.goals import CERTIFIED, POSES, REGION, VOLUME, _at, certified, goals
from bayescal.planning.pool import linearised
from bayescal.predict.targets import certified_diameters, located_target


def centres(found, names, z) -> dict[str, np.ndarray]:
    """Centres of spheres located anew for an arm z."""
    scene = found.model.scene
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    known = certified_diameters(scene)
    at = replace(found.estimate, z=z)
    rows = scene.rows("validate")
    return {
        n: located_target(at, at.model.block(index[n], scene.rows_of(index[n], rows)), known[n]).centre
        for n in names
    }


def test_certified_distances_follow_from_the_contacts_on_the_spheres():
    # with noise of 1 mm no contact is an outlier of an arm with errors
    d = replace(pool().session, noise=Noise(contact=1e-3))
    found = linearised(pool_of(d), MODEL)
    names = [t.name for t in d.targets if t.kind == "sphere"]
    goal = certified(found)
    assert goal.slopes.shape == (3, found.model.size)
    pairs = [c.targets for c in d.certificates if c.kind == "distance"]

    def lengths(z: np.ndarray) -> np.ndarray:
        at = centres(found, names, z)
        return np.array([np.linalg.norm(at[a] - at[b]) for a, b in pairs])

    rng = np.random.default_rng(0)
    for _ in range(3):
        z = np.zeros(found.model.size)
        z[found.model.slices[ARM]] = 0.01 * rng.standard_normal(len(found.model.parameters))
        moved = lengths(found.z + z) - lengths(found.z)
        assert goal.slopes @ z == pytest.approx(moved, rel=0.02, abs=0.02 * np.max(np.abs(moved)))
    goal = certified(linear())
    assert np.all(goal.certificate == 1e-12)
    # 11 contacts of 5 µm on a sphere: some 2 to 4 µm a coordinate, of two centres
    assert np.all((np.sqrt(goal.probing) > 2e-6) & (np.sqrt(goal.probing) < 8e-6))


def test_distances_of_the_region_follow_from_the_tool_points():
    found = linear()
    goal = goals(pool(), found)[1]
    assert goal.over == REGION
    rows = pool().candidates[np.linspace(0, 599, 40).astype(int)]
    model = _at(found.model, pool().session.measurements.readings[rows])
    motion = model.motion(len(model.scene.q) - 40 + np.arange(40))
    rng = np.random.default_rng(0)
    z = 0.01 * rng.standard_normal(len(model.parameters))
    here = found.z[found.model.slices[ARM]]
    a, b = (motion.points(model.deviations(w)) for w in (here, here + z))
    assert len(goal.slopes) > 600
    pairs = np.stack(np.triu_indices(40, 1), axis=1)
    before, after = (np.linalg.norm(p[:, pairs[:, 0]] - p[:, pairs[:, 1]], axis=0) for p in (a, b))
    far = before > 0.2 * before.max()
    moved = (after - before)[far]
    assert np.allclose(goal.slopes[:, found.model.slices[ARM]] @ z, moved, atol=0.01 * np.abs(moved).max())


def test_fitted_spheres_are_no_goal_where_the_fit_uses_the_distance():
    d = pool().session
    m = d.measurements
    fitted = replace(d, measurements=replace(m, role=np.full(len(m.role), "calibrate")))
    found = linearised(pool_of(fitted), MODEL)
    assert certified(found) is None
    assert [g.over for g in goals(pool_of(fitted), found)] == [REGION]


def test_mixed_ends_and_certificates_without_rows():
    d = pool().session
    m = d.measurements
    first = next(k for k, t in enumerate(d.targets) if t.kind == "sphere")
    half = replace(d, measurements=replace(m, role=np.where(m.target == first, "calibrate", m.role)))
    found = linearised(pool_of(half), MODEL)
    goal = certified(found)
    assert len(goal.slopes) == 3
    own = found.model.slices[d.targets[first].name]
    assert np.sum(np.any(goal.slopes[:, own] != 0, axis=1)) == 2
    bare = replace(d, measurements=replace(m, role=np.where(m.role == "validate", "locate", m.role)))
    assert certified(linearised(pool_of(bare), MODEL)) is None  # spheres are located by their validation data


def test_volume_of_interest():
    p = pool()
    box = Box(np.array([0.45, 0.0, 0.45]), np.array([0.2, 0.3, 0.2]))
    inside = replace(p, setup=replace(p.setup, volume=box))
    goal = goals(inside, linear())[1]
    assert goal.over == VOLUME
    assert len(goal.slopes) > 400
    assert goal.note == ""
    assert goals(inside, linear())[1].slopes == pytest.approx(goal.slopes)
    partly = replace(
        p, setup=replace(p.setup, volume=Box(np.array([0.9, 0.0, 0.4]), np.array([0.5, 0.5, 0.5])))
    )
    assert "% of the volume" in goals(partly, linear())[1].note
    away = replace(p, setup=replace(p.setup, volume=Box(np.array([5.0, 0, 0]), box.size)))
    with pytest.raises(BayescalError, match="out of reach"):
        goals(away, linear())


def test_given_poses():
    p, readings = pool(), pool().session.measurements.readings
    asked = replace(p, setup=replace(p.setup, poses=readings[[0, 200, 400]]))
    found = goals(asked, linear())
    assert [g.over for g in found] == [CERTIFIED, REGION, POSES]
    assert len(found[2].slopes) == 3
    with pytest.raises(BayescalError, match="two positions"):
        goals(replace(p, setup=replace(p.setup, poses=readings[[0, 0]])), linear())


def test_a_certificate_of_uncertain_value_counts():
    d = pool().session
    wide = tuple(
        replace(c, u_distance=1e-5) if isinstance(c, Certificate) and c.kind == "distance" else c
        for c in d.certificates
    )
    goal = certified(linearised(pool_of(replace(d, certificates=wide)), MODEL))
    assert np.sqrt(goal.known) > 1e-5
