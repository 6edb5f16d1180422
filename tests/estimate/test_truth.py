"""Estimates of arms whose errors are known: right, as uncertain as they say, robust."""

import json
from dataclasses import replace
from types import SimpleNamespace

import foreign
import numpy as np
import pytest
from scipy.stats import chi2
from sessions import with_columns

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.arm.motion import Motion, Term
from bayescal.dataset import Noise, Target, read_dataset
from bayescal.estimate import STATED_WORTH, estimate, solve, unit_weights
from bayescal.model import Scene, build

BOTH = ("geometry", "compliance")
SURE = 1e-4  # probability of a false alarm, where a seed had not been chosen


def truth_of(model, arm) -> np.ndarray:
    """True z of the arm's parameters; what the true arm does not have wrong is as drawn."""
    return np.array([(arm.values.get(p.name, p.nominal) - p.centre) / p.sd for p in model.parameters])


def off(found, arm) -> np.ndarray:
    return found.z[: len(found.model.parameters)] - truth_of(found.model, arm)


def distance2(found, arm) -> float:
    """Squared distance of truth and estimate, by the estimate's own covariance: chi2 of P."""
    d = off(found, arm)
    return float(d @ np.linalg.solve(found.covariance[: len(d), : len(d)], d))


def fit(dataset, effects=BOTH, **options):
    return estimate(build(Scene(dataset), effects), **options)


def check_pulls(found, arm) -> None:
    pull = off(found, arm) / found.sd[: len(found.model.parameters)]
    assert np.max(np.abs(pull)) < 4.5, dict(zip(found.model.names, pull, strict=False))


def check_covariance(pairs) -> None:
    """No parameter of these estimates (found, arm) far from the truth, and all as far as they say."""
    for pair in pairs:
        check_pulls(*pair)
    total, count = sum(distance2(*pair) for pair in pairs), sum(len(f.model.parameters) for f, _ in pairs)
    low, high = chi2.ppf([SURE, 1 - SURE], count)
    assert low < total < 1.1 * high  # a tenth for the noise scale that is estimated too


def test_cubes(cube):
    """Eight arms."""
    sessions = [cube(seed=seed) for seed in range(8)]
    fits = [fit(session.dataset) for session in sessions]
    for found in fits:
        # something was learnt: all but d2 and d3, a tenth of the prior or better
        told = [k for k, p in enumerate(found.model.parameters) if p.name not in ("d2", "d3")]
        assert np.max(found.sd[told]) < 0.15
        assert found.dof["contact"] == pytest.approx(120 - 38, abs=6)
    check_covariance([(f, s.arm) for f, s in zip(fits, sessions, strict=True)])
    assert sum(len(f.rejected) for f in fits) <= 2  # of 960 clean contacts
    scales = [f.weights.scale["contact"] for f in fits]
    assert np.mean(scales) == pytest.approx(1.0, abs=4 * 0.08 / np.sqrt(8))


def test_targets_are_found_too(cube):
    session = cube(seed=3)
    found = fit(session.dataset)
    for block in found.model.blocks:
        own = found.model.slices[block.target]
        told = block.kind.describe(block.state(found.z[own]))
        normal, offset = session.planes[block.target]
        middle = block.kind.pivot
        sd = found.sd[own] * block.kind.sd
        assert abs(told["normal"] @ middle - told["offset"] - (normal @ middle - offset)) < 4.5 * sd[2]
        assert np.max(np.abs(told["normal"] - normal)) < 4.5 * sd[:2].max()


def wrong_by(session, model) -> dict[str, float]:
    """How wrong the papers of a cube are, by the names of the model's parameters."""
    normal = {name: n for name, (n, _) in session.planes.items()}
    a, b = (model.block_of[f"cube.{side}"].kind for side in ("+y", "-y"))
    both, middle = normal["cube.+y"] + normal["cube.-y"], 0.5 * (a.pivot + b.pivot)
    apart = session.planes["cube.+y"][1] + session.planes["cube.-y"][1] - both @ middle
    out = {"cube.+y cube.-y distance": apart - session.dataset.certificates[0].distance}
    out |= {f"cube.+y cube.-y parallel {k}": float(t @ both) for k, t in enumerate(a.tangents, start=1)}
    for pair in (c.targets for c in session.dataset.certificates[1:]):
        out[f"{' '.join(pair)} square"] = float(normal[pair[0]] @ normal[pair[1]])
    return {f"artefact {name}": value for name, value in out.items()}


@pytest.mark.parametrize("lean", [(2.2e-4, 0.0), (0.0, -2.2e-4)], ids=["about x", "about z"])
def test_a_wrong_paper_is_told(cube, lean):
    """A face 50 um out of parallel over the cube's side: its paper takes that, not the arm."""
    pairs = []
    for seed in range(3):
        session = cube(seed=seed, lean=lean)
        found = fit(session.dataset, (*BOTH, "artefact"))
        wrong = wrong_by(session, found.model)
        pairs.append((found, SimpleNamespace(values=session.arm.values | wrong)))
        k = found.model.names.index(max(wrong, key=lambda name: abs(wrong[name])))
        assert abs(found.z[k]) > 4 * found.sd[k]
    check_covariance(pairs)


def test_trackers(tracker):
    pairs = []
    for seed in range(6):
        session = tracker(seed=seed)
        found = fit(session.dataset)
        pairs.append((found, session.arm))
        assert found.weights.scale["point"] == pytest.approx(1, abs=4 / np.sqrt(2 * 270))
        assert not len(found.rejected)
        frame = found.model.blocks[0].kind
        told = frame.describe(frame.sd * found.z[found.model.slices["tracker"]])["frame"]
        np.testing.assert_allclose(told, session.frame, atol=1e-3)
        assert np.max(np.abs(told - frame.frame)) > 2e-3
    check_covariance(pairs)


@pytest.mark.parametrize("stated", [2.5e-6, 20e-6])
def test_noise_is_measured(cube, stated):
    """The fit finds the noise that was there; what was stated counts as some contacts more of that size."""
    honest, session = cube(seed=4, count=300), cube(seed=4, count=300, stated=stated)
    found, known = fit(session.dataset), fit(honest.dataset)
    dof = found.dof["contact"]
    expected = np.sqrt((STATED_WORTH * stated**2 + dof * 5e-6**2) / (STATED_WORTH + dof))
    noise = stated * found.weights.scale["contact"]
    assert noise == pytest.approx(expected, rel=4 / np.sqrt(2 * dof))
    told = known.sd < 0.1
    widened = noise / (5e-6 * known.weights.scale["contact"])
    ratio = found.sd[told] / known.sd[told]  # less than the noise where certificates say the most
    assert np.median(ratio) == pytest.approx(widened, rel=0.1)
    assert np.all(np.abs(np.log(ratio)) < 1.1 * np.abs(np.log(widened)))
    check_pulls(found, session.arm)


@pytest.mark.parametrize("seed", [5, 6])
def test_outliers_are_left_out(cube, seed):
    """Contacts 8 to 100 times the noise off are listed, and the rest says what it said without them."""
    clean, spoilt = cube(seed=seed, count=300), cube(seed=seed, count=300, outliers=6)
    same = (np.delete(s.dataset.measurements.readings, spoilt.outliers, 0) for s in (clean, spoilt))
    np.testing.assert_allclose(*same)
    found, expected = fit(spoilt.dataset), fit(clean.dataset)
    assert found.rejected.tolist() == spoilt.outliers.tolist()
    assert np.max(np.abs(found.z - expected.z) / expected.sd) < 0.5
    check_pulls(found, spoilt.arm)
    role = np.where(np.isin(np.arange(300), spoilt.outliers), "validate", "calibrate")
    # pivots follow the fitted measurements: the arm's part is what compares
    alone = fit(replace(spoilt.dataset, measurements=replace(spoilt.dataset.measurements, role=role)))
    count = len(found.model.parameters)
    assert np.max(np.abs(found.z - alone.z)[:count] / alone.sd[:count]) < 0.01
    fooled = fit(spoilt.dataset, robust=False)
    assert not len(fooled.rejected)
    assert np.max(np.abs(fooled.z - expected.z) / expected.sd) > 3


def test_outliers_of_an_instrument(tracker):
    dataset = tracker(seed=1).dataset
    xyz = dataset.measurements.xyz.copy()
    xyz[[7, 50], [0, 2]] += 1e-3
    found = fit(with_columns(dataset, xyz=xyz))
    assert found.rejected.tolist() == [7, 50]
    assert np.max(np.abs(found.z - fit(dataset).z) / found.sd) < 0.5


def known_planes(session):
    targets = []
    for t in session.dataset.targets:
        normal, offset = session.planes[t.name]
        targets.append(replace(t, values={"normal": normal, "offset": offset}, u=0.0, u_angle=0.0))
    return replace(session.dataset, targets=tuple(targets), certificates=())


def test_known_targets(cube):
    """Known planes have no state, and the base's place is told from them."""
    session = cube(seed=8, count=200)
    found = fit(known_planes(session))
    assert found.model.size == len(found.model.parameters)
    assert {b.size for b in found.model.blocks} == {0}
    check_covariance([(found, session.arm)])
    base = [k for k, name in enumerate(found.model.names) if name.startswith("base")]
    assert len(base) == 6
    assert np.max(found.sd[base]) < 0.02
    # known tool
    tool = replace(session.dataset.tools[0], centre=session.arm.tool, u=0.0)
    found = fit(replace(session.dataset, tools=(tool,)))
    assert not [name for name in found.model.names if name.startswith("ball")]
    assert "theta6" in found.model.names
    check_pulls(found, session.arm)


@pytest.mark.parametrize("count", [4, 20])
def test_few_contacts(cube, count):
    """Fewer contacts than parameters: the priors carry what the contacts do not."""
    session = cube(seed=9, count=count)
    found = fit(session.dataset)
    assert found.model.size == 39
    assert np.all(found.sd < 1 + 1e-9)
    assert np.all(np.isfinite(found.z))
    assert found.weights.scale["contact"] == pytest.approx(1, abs=0.5)
    check_pulls(found, session.arm)


def test_arm_as_drawn(cube):
    """No effects: tool and targets only, and the noise says what is missing."""
    session = cube(seed=1)
    found = fit(session.dataset, ())
    assert found.model.names[:3] == ("ball x", "ball y", "ball z")
    assert found.weights.scale["contact"] > 20
    assert fit(session.dataset, ("geometry",)).weights.scale["contact"] > 3


def test_noisy_readings(cube):
    """Noise of the readings, ten times that of a contact, is accounted for contact by contact."""
    pairs = []
    for seed in range(3):
        session = cube(seed=seed, noise=2e-6, joint=5e-5)
        pairs.append((fit(session.dataset), session.arm))
        assert pairs[-1][0].weights.scale["contact"] == pytest.approx(1, abs=4 * 0.08)
    check_covariance(pairs)


def with_readings(model, target: int, readings: np.ndarray):
    """Residuals (R,) of one target as a function of the readings, the target's kind held."""
    dataset, held = model.scene.dataset, model.blocks[target]
    scene = Scene(with_columns(dataset, readings=readings))
    return replace(build(scene, model.effects).blocks[target], kind=held.kind)


def sphere_session(tracker):
    """Rows that touch a sphere wherever the drawing says that the ball is: slopes, not contacts, matter."""
    dataset = tracker(seed=1).dataset
    target = Target("ball.A", "sphere", {"centre": np.array([0.45, 0.0, 0.3]), "diameter": 50.8e-3})
    return replace(dataset, targets=(target,), noise=Noise(contact=5e-6, joint=2e-5))


READINGS_NOISE = {
    "plane": lambda cube, tracker: cube(seed=1, joint=2e-5).dataset,
    "sphere": lambda cube, tracker: sphere_session(tracker),
    "instrument": lambda cube, tracker: replace(tracker(seed=1).dataset, noise=Noise(point=1e-5, joint=2e-5)),
}


@pytest.mark.parametrize("name", READINGS_NOISE)
def test_readings_noise(name, cube, tracker):
    """Slopes by the readings, at an arm well off its drawing, and the variance that they make."""
    dataset = READINGS_NOISE[name](cube, tracker)
    model = build(Scene(dataset), BOTH)
    z = np.random.default_rng(0).standard_normal(model.size)
    z[len(model.parameters) :] *= 0.02
    values, h = model.deviations(z[: len(model.parameters)]), 1e-6
    for k, block in enumerate(model.blocks):
        own = z[model.slices[block.target]]

        def moved(step, k=k, own=own):
            return with_readings(model, k, dataset.measurements.readings + step).residual(values, own).ravel()

        slope = np.stack([(moved(step) - moved(-step)) / (2 * h) for step in h * np.eye(6)], axis=1)
        found = block.by_readings(values, own, dataset.robot.link_from_reading)
        # a hundredth: of the torques that change with the readings, and no more
        np.testing.assert_allclose(found, slope, atol=0.01 * np.max(np.abs(slope)))
        stated = dataset.noise.point if name == "instrument" else dataset.noise.contact
        expected = np.sqrt(stated**2 + dataset.noise.joint**2 * np.sum(slope**2, axis=1))
        np.testing.assert_allclose(unit_weights(model, z).sigma[block.target], expected, rtol=0.02)


def test_exact_readings_leave_the_stated_noise(cube):
    model = build(Scene(cube(seed=1).dataset), BOTH)
    for sigma in unit_weights(model, np.zeros(model.size)).sigma.values():
        assert np.all(sigma == 5e-6)


def test_linear_at_the_estimate(cube):
    """What is handed on belongs together: covariance, linearisation, weights and noise scale."""
    found = fit(cube(seed=6, count=200, outliers=6).dataset)
    jacobian = found.linear.jacobian
    expected = np.linalg.inv(jacobian.T @ jacobian + np.eye(found.model.size))
    np.testing.assert_allclose(found.covariance, expected, atol=1e-8)
    assert np.max(np.abs(jacobian.T @ found.linear.residual + found.z) * found.sd) < 1e-4
    again, _, _ = solve(found.model, found.weights, found.z)
    np.testing.assert_allclose(again, found.z, atol=1e-5)
    for block in found.model.blocks:
        r = found.residuals(block)
        assert r.shape == (1, len(block.rows))
        expected = found.linear.residual[found.linear.of_block[block.target]]
        np.testing.assert_allclose(r.ravel() * found.weights.whitening(block), expected, atol=1e-8)


def world_arm(dataset, truth: dict):
    """The true arm of a simulated world: its table, with the angle between axes 2 and 3, and its ball."""
    table = truth["robot"]
    beta = np.array([0, 0, table["beta3_mrad"] * 1e-3, 0, 0, 0])
    a, d = (np.array(table[key]) * 1e-3 for key in ("a_mm", "d_mm"))
    offset = dataset.robot.offset + np.array(table["theta_offset_mrad"]) * 1e-3
    robot = replace(dataset.robot, a=a, alpha=np.radians(table["alpha_deg"]), d=d, offset=offset, beta=beta)
    return robot, np.array(table["tool_mm"]) * 1e-3


def in_our_gauge(model, robot, tool) -> tuple[np.ndarray, list[int]]:
    """Z of geometry and tool that, with the base moved at will, put the ball where another table does."""
    readings = np.random.default_rng(0).uniform(-2, 2, (200, 6))
    goal = points(chain_of(robot), link_angles(robot, readings), tool).T
    rigid = [k for k, p in enumerate(model.parameters) if p.effect in ("geometry", "tool")]
    sd = np.array([model.parameters[k].sd for k in rigid] + [1.0] * 6)
    terms = [(at, term) for at, k in enumerate(rigid) for term in model.parameters[k].terms]
    terms += [(len(rigid) + k, Term(0, axis)) for k, axis in enumerate(("tx", "ty", "tz", "rx", "ry", "rz"))]
    drawing = model.scene.dataset.robot
    at_tool = np.tile(model.scene.dataset.tools[0].centre, (200, 1))
    motion = Motion(model.scene.chain, link_angles(drawing, readings), at_tool, terms, len(sd))
    z = np.zeros(len(sd))
    for _ in range(8):
        p = motion.points(z * sd)
        directions = (np.tile(e[:, None], (1, 200)) for e in np.eye(3))
        by = np.concatenate([motion.columns(z * sd, p, e) for e in directions], axis=1)
        jacobian = np.vstack([(by.T * sd) / 1e-7, np.eye(len(sd))])  # the prior settles what points do not
        z -= np.linalg.lstsq(jacobian, np.append((p - goal).ravel() / 1e-7, z), rcond=None)[0]
    assert np.max(np.abs(motion.points(z * sd) - goal)) < 1e-6
    return z[: len(rigid)], rigid


@foreign.needs()
@pytest.mark.parametrize("world", ["000", "001"])
def test_worlds(world):
    """Worlds of a simulator that shares no code with this package; these two hide no effect."""
    folder = foreign.WORLDS
    truth = json.loads((folder / "truth" / f"{world}.json").read_text(encoding="utf-8"))
    assert not truth["effects"]
    dataset = read_dataset(folder / world)
    found = fit(dataset)
    expected, rigid = in_our_gauge(found.model, *world_arm(dataset, truth))
    pull = (found.z[rigid] - expected) / found.sd[rigid]
    assert np.max(np.abs(pull)) < 4.5, dict(zip(np.array(found.model.names)[rigid], pull, strict=True))
    drawn = np.array([found.model.names[k] not in ("d2", "d3") for k in rigid])
    assert np.max(np.abs(expected[drawn]) / found.sd[rigid][drawn]) > 30  # the drawing is far off
