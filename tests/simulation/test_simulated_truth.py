"""A simulated session against an arm written anew: contacts hold, noise is noise, papers are right."""

import numpy as np
import pytest
from cases import robot_file
from scipy.stats import kstest
from sessions import LITTLE, little

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.errors import BayescalError
from bayescal.model import Scene, build
from bayescal.probing.scene import LARGE, Cube, Scenery
from bayescal.robots import load_robot
from bayescal.simulation import Options, Simulation, simulate
from bayescal.simulation.record import distance_certificates, key_of, noise, true_targets
from factors.kind import tangents

KEYS = {"theta": ("rz", 1), "d": ("tz", 1), "alpha": ("rx", 1), "a": ("tx", 1), "beta": ("ry", 1)}
COMPONENT = {"rz": 0, "tz": 1, "rx": 2, "tx": 3, "ry": 4}
SI = {"mm": 1e-3, "deg": np.pi / 180, "urad_per_nm": 1e-6}


def gaps(s: Simulation, readings: np.ndarray) -> np.ndarray:
    """How far the true ball is off the true surfaces (N,), m, by the numbers of truth.json alone.

    The weights pull on the arm where its errors and its sag have put it.
    """
    d, m = s.dataset, s.dataset.measurements
    robot, tool = d.robot, d.tools[0]
    chain = chain_of(robot)
    q = link_angles(robot, readings)
    delta = np.zeros((len(q), robot.n + 2, 6))
    load = np.full(len(q), tool.mass) + (0.0 if m.payload is None else m.payload)
    compliance = np.zeros(robot.n)
    for p in s.truth["parameters"]:
        unit = next(u for u in SI if f"value_{u}" in p)
        off = (p[f"value_{unit}"] - p[f"nominal_{unit}"]) * SI[unit]
        if p["effect"] == "geometry":
            kind = p["name"].rstrip("0123456789")
            delta[:, int(p["name"][len(kind) :]), COMPONENT[KEYS[kind][0]]] += off
        elif p["effect"] == "compliance":
            compliance[robot.joint_names.index(p["name"].split()[1])] = off
        else:
            delta[:, -1, [3, 5, 1]["xyz".index(p["name"][-1])]] += off
    stiff, com = delta.copy(), np.tile(tool.centre_of_mass, (len(q), 1))
    for _ in range(10 if compliance.any() else 0):
        stance = Stance(delta, delta - stiff)
        torque = gravity_loads(robot, chain, q, d.gravity, load, com, stance).moments[:, 1:, 2]
        delta[:, 1:-1, 0] = stiff[:, 1:-1, 0] + compliance * torque
    ball = points(chain, q, tool.centre, delta)
    out = np.empty(len(q))
    for k, t in enumerate(s.truth["targets"]):
        at = m.target == k
        if t["kind"] == "plane":
            out[at] = ball[at] @ np.array(t["normal"]) - 1e-3 * t["offset_mm"] - tool.ball_radius
        else:
            away = np.linalg.norm(ball[at] - 1e-3 * np.array(t["centre_mm"]), axis=1)
            out[at] = away - 0.5e-3 * t["diameter_mm"] - tool.ball_radius
    return out


@pytest.mark.parametrize("options", [{"noise": 0.0}, {}, {"outliers": 0.05}, {"payload": 2.0}])
def test_contacts_hold(options):
    s = little(**options)
    assert np.abs(gaps(s, s.exact.measurements.readings) - s.shift).max() < 2e-12
    assert np.abs(gaps(s, s.dataset.measurements.readings) - s.shift).max() < 3e-9  # readings end at 1e-7 deg


@pytest.mark.parametrize(
    ("name", "effects"), [("standard", ("geometry", "compliance")), ("seven", ("geometry",))]
)
def test_contacts_hold_for_any_robot(name, effects, tmp_path):
    options = Options(robot=robot_file(name), effects=effects, **LITTLE)
    s = simulate(options)
    assert len(s.dataset.measurements.ids) == 60 + 30 + 12
    assert np.abs(gaps(s, s.exact.measurements.readings) - s.shift).max() < 2e-12
    robot, _ = load_robot(options.robot)
    signs = np.sign(np.diag(robot.link_from_reading))
    angles = s.dataset.measurements.readings @ robot.link_from_reading.T * signs
    assert np.all((angles > robot.limits[:, 0]) & (angles < robot.limits[:, 1]))


def test_noise_is_normal_and_as_asked():
    s = little(contacts=400, noise=7e-6)
    assert kstest(gaps(s, s.dataset.measurements.readings) / 7e-6, "norm").pvalue > 1e-3
    assert s.dataset.noise.contact == 7e-6


def test_joint_noise_is_on_the_readings():
    s = little(joint_noise=1e-4)
    off = s.dataset.measurements.readings - s.exact.measurements.readings
    assert np.std(off) == pytest.approx(1e-4, rel=0.15)
    assert s.dataset.noise.joint == 1e-4


def test_outliers_are_as_many_as_asked_and_listed():
    s = little(outliers=0.05)
    clean = little()
    ids = np.array(s.dataset.measurements.ids)
    gross = np.isin(ids, s.truth["outliers"])
    assert gross.sum() == round(0.05 * len(ids))
    extra = np.abs(s.shift - clean.shift)
    assert np.all(extra[~gross] == 0)
    assert np.all((extra[gross] > 29e-6) & (extra[gross] < 1.01e-3))


def test_outliers_are_to_either_side():
    shift, gross = noise(Options(noise=0.0, outliers=0.5, seed=1), 2000)
    assert abs(np.mean(np.sign(shift[gross]))) < 0.1  # 3 standard deviations


def test_faces_are_as_good_as_their_papers_and_a_little_out_of_place():
    cube, faces = Cube(np.array([0.45, 0.0, 0.15]), np.eye(3), LARGE.edge), ("+y", "-y", "-x", "+z")
    scenery = Scenery(cube, faces, np.empty((0, 0, 3)), LARGE.diameter)
    cosines, lengths, misplaced = [], [], []
    for seed in range(200):
        true = true_targets(Options(seed=seed), scenery)
        normals = np.array([t.values["normal"] for t in true])
        out = np.array([t.values["offset"] for t in true]) - normals @ cube.centre
        cosines += [normals[0] @ normals[2], normals[0] @ normals[3], normals[2] @ normals[3]]
        cosines += list((normals[0] + normals[1])[[0, 2]])
        lengths.append(out[0] + out[1] - LARGE.edge)
        misplaced.append(out[3] - LARGE.edge / 2)
    assert np.std(cosines) == pytest.approx(1.2e-5, rel=0.1)
    assert np.std(lengths) == pytest.approx(3e-6, rel=0.2)
    assert np.std(misplaced) == pytest.approx(1e-3, rel=0.2)


def test_certified_distances_are_true_and_the_same_in_every_place():
    s = little(placements=2, contacts=16, repeats=0, later=0)
    true = np.array([[d["certified_mm"], d["true_mm"]] for d in s.truth["distances"]])
    assert len(true) == 6
    assert np.allclose(true[:, 0], true[:, 1], atol=5e-3, rtol=0)
    assert np.allclose(true[:3], true[3:], atol=1e-9)
    assert true[:, 0].max() == pytest.approx(300, abs=1)
    nominal = {t.name: t.values["centre"] for t in s.dataset.targets if t.kind == "sphere"}
    for t in s.truth["targets"][4:]:
        assert np.linalg.norm(np.array(t["centre_mm"]) - 1e3 * nominal[t["name"]]) < 8


def test_an_arm_as_drawn_measures_the_distances_right():
    s = little(error_scale=0.0, noise=0.0)
    assert s.truth["worst_distance_um"]["nominal"] < 3  # papers are right to a micrometre
    assert little().truth["worst_distance_um"]["nominal"] > 100


def test_the_seed_gives_the_arm_whatever_else_is_asked():
    def arm(s: Simulation) -> dict[str, float]:
        key, _ = key_of("m")
        return {p["name"]: p[key] for p in s.truth["parameters"] if key in p}

    assert arm(little()) == arm(little(outliers=0.05)) == arm(little(effects=("geometry",)))
    assert arm(little()) != arm(little(seed=5))


def test_units_of_keys():
    assert key_of("m") == ("value_mm", 1e3)
    assert key_of("rad/(N m)")[0] == "value_urad_per_nm"
    assert key_of("1") == ("value", 1.0)
    assert key_of("rad/s^2")[0] == "value_rad_per_s2"


def test_a_paper_is_as_wrong_as_the_truth_says():
    """By so much more than of the same faces without: they are turned and moved, and touched there."""
    s, right = (little(effects=e) for e in (("geometry", "artefact"), ("geometry",)))
    said = {}
    for p in s.truth["parameters"]:
        key = next(k for k in p if k.startswith("value"))
        said[p["name"].removeprefix("artefact ")] = p[key] * SI[key.removeprefix("value_")]
    assert sum(name.startswith("cube") for name in said) == 6

    def told(session: Simulation) -> dict[str, float]:
        true = {t["name"]: t for t in session.truth["targets"] if t["kind"] == "plane"}
        normal = {name: np.array(t["normal"]) for name, t in true.items()}
        pivot = {b.target: b.kind.pivot for b in build(Scene(s.dataset), ()).blocks}
        a, b = "cube.+y", "cube.-y"
        both, middle = normal[a] + normal[b], 0.5 * (pivot[a] + pivot[b])
        apart = 1e-3 * (true[a]["offset_mm"] + true[b]["offset_mm"]) - both @ middle
        turned = tangents(np.array([0.0, 1.0, 0.0])) @ both
        out = {f"{a} {b} distance": apart, f"{a} {b} parallel 1": turned[0], f"{a} {b} parallel 2": turned[1]}
        for pair in ((a, "cube.-x"), (a, "cube.+z"), ("cube.-x", "cube.+z")):
            out[f"{' '.join(pair)} square"] = normal[pair[0]] @ normal[pair[1]]
        return out

    wrong, as_stated = told(s), told(right)
    for name, value in wrong.items():
        assert value - as_stated[name] == pytest.approx(said[name], abs=1e-7 if "distance" in name else 1e-10)
    assert max(abs(said[name]) for name in wrong) > 5e-5
    assert np.abs(s.world.distances(s.world.model(s.exact)) - s.shift).max() < 2e-12
    assert s.truth["targets"][4:] == right.truth["targets"][4:]  # no paper of the spheres is fitted


def test_settings_are_simulated_too(tmp_path):
    s = simulate(Options(effects=("step@20",), **{**LITTLE, "placements": 0}))
    assert s.truth["effects"] == ["step@20"]
    (p, *_) = s.world.model(s.exact).parameters
    np.testing.assert_array_equal(p.terms[0].driver, np.arange(len(s.shift)) >= 19)
    with pytest.raises(BayescalError, match="--effects: geometry has no setting"):
        simulate(Options(effects=("geometry@3",), **LITTLE))


def test_sessions_of_one_arm_have_the_same_cube_and_artefact():
    """They are placed anew: faces at the same angles and distances, spheres at the same certified lengths."""
    cube, faces = Cube(np.array([0.45, 0.0, 0.15]), np.eye(3), LARGE.edge), ("+y", "-y", "-x", "+z")
    places = np.array([[[0.4, 0.1, 0.1], [0.5, 0.1, 0.1], [0.4, 0.3, 0.1]]])
    scenery = Scenery(cube, faces, np.concatenate([places, places + 0.2]), LARGE.diameter)

    def shape(seed, arm):
        options = Options(seed=seed, arm_seed=arm)
        true = true_targets(options, scenery)
        normals = np.array([t.values["normal"] for t in true[:4]])
        offsets = [t.values["offset"] for t in true[:2]]
        centres = np.array([t.values["centre"] for t in true[4:7]])
        stated = [c.distance for c in distance_certificates(options, scenery, true)]
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
        return np.r_[
            (normals @ normals.T).ravel(),
            sum(offsets) + (normals[0] + normals[1]) @ -cube.centre,
            apart.ravel(),
            stated,
            [t.values["diameter"] for t in true[4:7]],
        ], normals

    (one, placed), (two, again), (other, _) = shape(5, 5), shape(6, 5), shape(6, 6)
    assert one[:16] == pytest.approx(two[:16], abs=1e-6)
    assert one[17:] == pytest.approx(two[17:], abs=2e-9)
    assert np.abs(two[17:] - other[17:]).max() > 1e-6
    assert np.abs(placed - again).max() > 1e-5
