"""The factor graph against SciPy on the same whitened problem, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from bayescal.errors import BayescalError
from bayescal.estimate import estimate, linearise, solve, unit_weights
from bayescal.model import build
from bayescal.model.options import FitOptions
from bayescal.model.scene import Scene

BOTH = ("geometry", "compliance")


def known_cube(session, faces=None):
    """The session with its true planes stated as known."""
    targets = []
    for t in session.dataset.targets:
        normal, offset = session.planes[t.name]
        known = replace(t, values={"normal": normal, "offset": offset}, u=0.0, u_angle=0.0)
        targets.append(known if faces is None or t.name in faces else t)
    return replace(session.dataset, targets=tuple(targets))


def half_known(session):
    """Two faces known, one of them except for its tilt."""
    dataset = known_cube(session, ("cube.+y", "cube.+z"))
    first = replace(dataset.targets[0], u=0.0, u_angle=1e-4)
    return replace(dataset, targets=(first, *dataset.targets[1:]))


CASES = {
    "loose cube": lambda cube, tracker: (cube(seed=2).dataset, BOTH),
    "known cube": lambda cube, tracker: (known_cube(cube(seed=2)), BOTH),
    "half known": lambda cube, tracker: (half_known(cube(seed=2)), BOTH),
    "tracker": lambda cube, tracker: (tracker(seed=2).dataset, BOTH),
    "arm as drawn": lambda cube, tracker: (cube(seed=2).dataset, ()),
    "faces with form": lambda cube, tracker: (cube(seed=2).dataset, (*BOTH, "plane-form")),
    "wrong paper": lambda cube, tracker: (cube(seed=2).dataset, (*BOTH, "artefact")),
    "wrong paper of known faces": lambda cube, tracker: (known_cube(cube(seed=2)), ("artefact",)),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_same_optimum_and_covariance_as_scipy(case, cube, tracker, tie_residuals):
    model = build(Scene((made := case(cube, tracker))[0]), made[1])
    weights = unit_weights(model, np.zeros(model.size))
    whole = {b.target: weights.row[b.target] * np.linspace(0.2, 1.5, len(b.rows)) for b in model.blocks}
    weights = replace(weights, row=whole, scale=dict.fromkeys(weights.scale, 1.3))
    z, covariance, _ = solve(model, weights, np.zeros(model.size))

    def residuals(z):
        """By blocks and constraints alone, not by `linearise`, which shares its gradients with the graph."""
        parts = []
        for b in model.blocks:
            r = b.residual(model.deviations(z[model.slices["arm"]]), z[model.slices[b.target]]).ravel()
            row = np.tile(weights.row[b.target], b.kind.rows)
            parts.append(r * np.sqrt(row) / (1.3 * weights.sigma[b.target]))
        return np.concatenate(
            [*parts, *(tie_residuals(model, constraint, z) for constraint in model.constraints), z]
        )

    def jacobian(z):
        return np.vstack([linearise(model, z, weights).jacobian, np.eye(model.size)])

    by = jacobian(z)
    step = 1e-5 * np.eye(model.size)
    slope = np.array([(residuals(z + s) - residuals(z - s)) / 2e-5 for s in step]).T
    np.testing.assert_allclose(by, slope, rtol=1e-6, atol=1e-6 * np.max(np.abs(by)))
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    found = least_squares(residuals, z + 1e-3, jacobian, method="lm", **tight)
    assert np.max(np.abs(z - found.x)) < 1e-6
    np.testing.assert_allclose(covariance(), np.linalg.inv(found.jac.T @ found.jac), atol=1e-6)


def test_far_start_finds_the_same(cube):
    model = build(Scene(cube(seed=2).dataset), BOTH)
    weights = unit_weights(model, np.zeros(model.size))
    near, _, _ = solve(model, weights, np.zeros(model.size))
    far, _, _ = solve(model, weights, np.random.default_rng(0).standard_normal(model.size) * 0.5)
    np.testing.assert_allclose(far, near, atol=1e-6)


def without(dataset, *kinds):
    return replace(dataset, certificates=tuple(c for c in dataset.certificates if c.kind not in kinds))


def test_no_length_is_refused(cube):
    """Wide priors and no certified length: the arm would shrink to a point and report no error."""
    dataset = cube(seed=2).dataset
    with pytest.raises(BayescalError, match="length"):
        estimate(
            build(Scene(without(dataset, "parallel", "perpendicular")), BOTH, FitOptions(prior_width=1000.0))
        )
    with pytest.raises(BayescalError, match="length"):  # squareness is no length
        estimate(build(Scene(without(dataset, "parallel")), BOTH, FitOptions(prior_width=1000.0)))
    with pytest.raises(BayescalError, match="length"):  # nor is a length that may be wrong by centimetres
        estimate(build(Scene(dataset), (*BOTH, "artefact"), FitOptions(prior_width=1000.0)))


def test_a_length_is_enough(cube):
    session = cube(seed=2)
    certified = estimate(build(Scene(session.dataset), BOTH, FitOptions(prior_width=1000.0)))
    assert certified.model.constraints
    narrow = estimate(build(Scene(session.dataset), BOTH))
    told = [k for k, name in enumerate(narrow.model.names[:19]) if name not in ("d2", "d3")]
    physical = certified.model.physical(certified.z)[told] - narrow.model.physical(narrow.z)[told]
    sd = narrow.sd[told] * np.array([narrow.model.parameters[k].sd for k in told])
    assert np.max(np.abs(physical) / sd) < 0.5
    # tolerances alone know the arm's length to half a thousandth, known planes their own distance
    assert estimate(build(Scene(without(session.dataset, "parallel")), BOTH)).z.any()
    known = without(known_cube(session), "parallel", "perpendicular")
    assert estimate(build(Scene(known), BOTH, FitOptions(prior_width=1000.0))).z.any()


def test_an_instrument_knows_lengths(tracker):
    assert estimate(build(Scene(tracker(seed=2).dataset), BOTH, FitOptions(prior_width=1000.0))).z.any()


def off_by(dataset, degrees):
    """The session with a drawing whose fourth joint's zero is wrong."""
    wrong = replace(dataset.robot, offset=dataset.robot.offset + np.radians([0, 0, 0, degrees, 0, 0]))
    return replace(dataset, robot=wrong)


def test_a_zero_far_off_is_found(cube):
    """A degree is nine times what the prior expects, and far more than what the contacts leave open."""
    found = estimate(build(Scene(off_by(cube(seed=2).dataset, 1.0)), BOTH))
    right = estimate(build(Scene(cube(seed=2).dataset), BOTH))
    k = found.model.names.index("theta4")
    moved = found.model.physical(found.z)[k] - right.model.physical(right.z)[k]
    assert moved == pytest.approx(0, abs=2e-4)


def test_a_zero_too_far_off_is_refused(cube):
    """Twenty degrees are no calibration, and the chain's series would not hold."""
    with pytest.raises(BayescalError, match="theta4"):
        estimate(
            build(Scene(off_by(cube(seed=2).dataset, 20.0)), BOTH, FitOptions(prior_width=100.0)),
            robust=False,
        )


def test_nothing_to_fit(cube):
    dataset = cube(seed=2).dataset
    idle = replace(dataset.measurements, role=np.full(len(dataset.measurements.ids), "validate"))
    with pytest.raises(BayescalError, match="calibrate"):
        build(Scene(replace(dataset, measurements=idle)), BOTH)
