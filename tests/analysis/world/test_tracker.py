"""Sessions with a laser tracker: points of an independent arm, and truths that a brute-force fit confirms."""

import csv
import hashlib
import io
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from analysis.world import (  # fmt: skip
    arm,
    forms_frames,
    forms_joints,
    frames,
    joints,
    scene,
    session,
    tracker,
    validation,
    visible,
)
from analysis.world import build as world
from analysis.world.build import make
from analysis.world.further import Wanted, further
from analysis.world.mix import FORMS, NAMED, ON_SURFACE, recipe, stage
from analysis.world.outside import OUTSIDE
from analysis.world.outside_more import MORE, RESERVED
from analysis.world.scene import NAMES
from analysis.world.touch import Moved
from analysis.world.write import dataset_text, measurements_text, robot_text
from bayescal.dataset import read_dataset
from bayescal.estimate import estimate, settled
from bayescal.model import build as model_of
from bayescal.model.scene import Scene

SEED = 101
STORED = {
    "dataset": "00f2af5fef55f7fd", "measurements": "5e50e06bcf42ddfd",
    "effects": ["step"], "lambda": 164.0449188,
}  # fmt: skip
"""Session 21 of the fourth generator; see the test."""
SIGMA = 2e-5
AXIS = np.array([0.0, 0.0, 1.0])


def numbers(kind, generator=4, count=200):
    """Sessions of a kind with a tracker."""
    drawn = ((k, *recipe(SEED, k, generator)) for k in range(count))
    return [k for k, what, makers in drawn if what == kind and stage(SEED, k, generator, makers) == "tracker"]


def bench(stiff, wishes=None):
    """A true arm before a tracker; no weight deflects it if it is stiff."""
    rng = np.random.default_rng(4)
    body = arm.Arm(arm.draw(rng))
    plan = session.plan(rng, scene.draw(rng), wishes or {}, session.TRACKER)
    give = np.zeros(6) if stiff else body.shape.give
    return tracker.Tracked(body, scene.draw(rng), plan, give, tracker.draw(rng))


@pytest.fixture(scope="module")
def stiff():
    return bench(stiff=True)


@pytest.fixture(scope="module")
def loaded():
    return bench(stiff=False, wishes={"payload": "half"})


def values(made):
    """All lengths and angles of a stiff arm and its instrument, by name."""
    s = made.arm.shape
    return {name: np.array(getattr(s, name)) for name in ("a", "alpha", "d", "zero", "beta3", "tool")} | {
        "at": np.zeros(3), "turned": np.zeros(3)
    }  # fmt: skip


def read(made, v):
    """What the instrument reads (3 n,), by Craig's convention; it may have moved and turned."""
    origin = made.instrument.origin + v["at"]
    axes = Rotation.from_rotvec(v["turned"]).as_matrix() @ made.instrument.turn
    turn, point = np.eye(3), np.zeros(3)
    for i, theta in enumerate((made.session.start @ arm.LINK_FROM_READING.T).T):
        point = point + turn @ Rotation.from_euler("x", v["alpha"][i]).as_matrix()[:, 0] * v["a"][i]
        beta = v["beta3"] if i == 2 else 0.0
        before = Rotation.from_euler("XY", [v["alpha"][i], beta]).as_matrix()
        turn = turn @ before @ Rotation.from_rotvec(np.outer(v["zero"][i] + theta, AXIS)).as_matrix()
        point = point + turn[:, :, 2] * v["d"][i]
    return ((point + turn @ v["tool"] - origin) @ axes).ravel()


def columns(made):
    """Central differences of `read` by every value (3 n, 34)."""
    base, out = values(made), []
    for name, value in base.items():
        for k in range(value.size):
            step = 1e-6 * np.eye(value.size)[k].reshape(value.shape)
            up, down = (read(made, base | {name: v}) for v in (value + step, value - step))
            out.append((up - down) / 2e-6)
    return np.stack(out, axis=1)


def test_points_are_those_of_an_independent_arm(stiff):
    noise = SIGMA * np.random.default_rng(1).standard_normal(3 * len(stiff.session.time))
    expected = read(stiff, values(stiff))
    np.testing.assert_allclose(stiff.points((), 0 * noise).ravel(), expected, atol=1e-9)
    np.testing.assert_allclose(stiff.points((), noise).ravel(), expected - noise, atol=1e-9)


@pytest.mark.parametrize("maker", [joints.eccentricity, joints.hysteresis, forms_joints.coupling])
def test_lambda_is_what_a_fit_without_the_effect_leaves(maker, stiff):
    """Chi-square of a least-squares fit to the shift alone, with derivatives of the matrix products."""
    act = maker(np.random.default_rng(2), stiff)
    quiet = stiff.session.start
    shift = stiff.gap(quiet, [(act, act.size)]) - stiff.gap(quiet)
    used = np.repeat(stiff.session.phase == 0, 3)
    by = columns(stiff)[used] / SIGMA
    left = shift[used] / SIGMA - by @ np.linalg.lstsq(by, shift[used] / SIGMA, rcond=1e-9)[0]
    found = float(np.sum(visible.fitted(stiff, quiet, stiffness=False).left(shift, SIGMA) ** 2))
    assert found > 10
    assert found == pytest.approx(float(left @ left), rel=1e-4)


@pytest.fixture(scope="module")
def derivatives(loaded, tmp_path_factory):
    """Derivatives by geometry and compliances that the program finds from the files alone (rows, z)."""
    folder, plan = tmp_path_factory.mktemp("loaded"), loaded.session
    noise = SIGMA * np.random.default_rng(1).standard_normal(3 * len(plan.time))
    texts = {"dataset.yaml": dataset_text(loaded, "loaded", SIGMA), "robot.yaml": robot_text()}
    texts["measurements.csv"] = measurements_text(plan, plan.start, plan.velocity, loaded.points((), noise))
    for name, text in texts.items():
        (folder / name).write_text(text)
    fitted = estimate(model_of(Scene(read_dataset(folder)), ("geometry", "compliance")))
    return fitted.linear.jacobian[: 3 * np.sum(plan.phase == 0)]


@pytest.mark.parametrize("maker", [joints.hysteresis, frames.bending, forms_frames.added_payload])
def test_lambda_is_what_a_fit_of_an_elastic_arm_leaves(maker, loaded, derivatives):
    """Rows of the program go by coordinate, then by pose; its derivatives are those of the fitted arm."""
    act = maker(np.random.default_rng(2), loaded)
    quiet = loaded.session.start
    shift = loaded.gap(quiet, [(act, act.size)]) - loaded.gap(quiet)
    found = float(np.sum(visible.fitted(loaded, quiet, stiffness=True).left(shift, SIGMA) ** 2))
    right = shift.reshape(-1, 3)[loaded.session.phase == 0].T.ravel() / SIGMA
    scaled = derivatives / np.linalg.norm(derivatives, axis=0)
    left = right - scaled @ np.linalg.lstsq(scaled, right, rcond=1e-9)[0]
    assert found > 5
    assert found == pytest.approx(float(left @ left), rel=0.02)


def test_place_and_orientation_of_the_tracker_are_not_visible(loaded):
    quiet = loaded.session.start
    model = visible.fitted(loaded, quiet, stiffness=True)
    turn = Rotation.from_rotvec([2e-5, -3e-5, 1e-5]).as_matrix()
    instrument = loaded.instrument
    moved = replace(instrument, origin=instrument.origin + 1e-4, turn=turn @ instrument.turn)
    shift = replace(loaded, instrument=moved).gap(quiet) - loaded.gap(quiet)
    assert np.abs(shift).max() > 1e-4
    assert np.sum(model.left(shift, SIGMA) ** 2) < 0.01
    assert np.abs(shift - model.absorbed(shift, SIGMA, model.used)).max() < 1e-6, "nor in the later poses"


def test_errors_of_distances_are_those_of_displaced_points(loaded):
    still = loaded.gap(loaded.session.start)
    late = np.repeat(loaded.session.phase == 2, 3)
    move = 1e-6 * np.random.default_rng(5).standard_normal(len(still))
    model = visible.fitted(loaded, loaded.session.start, stiffness=True)
    found = validation.distances(loaded, model, move, still)
    at, after = still[late].reshape(-1, 3), (still + move)[late].reshape(-1, 3)
    i, j = np.triu_indices(len(at), 1)
    expected = np.linalg.norm(after[i] - after[j], axis=1) - np.linalg.norm(at[i] - at[j], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-10)
    assert np.all(validation.certificate_errors(loaded) == 0)


def test_a_fit_finds_the_hidden_arm(tmp_path):
    """A null session: geometry and compliances within what the fit states, all together a chi-square."""
    texts, truth = world.build(SEED, numbers("null")[0])
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    fitted = estimate(model_of(Scene(read_dataset(tmp_path)), ("geometry", "compliance")))
    fitted = estimate(model_of(settled(fitted), ("geometry", "compliance")), start=fitted.z)
    true = {"beta2": truth["robot"]["beta3"]}
    for k in range(6):
        true |= {f"{name}{k}": truth["robot"][name][k] for name in ("a", "alpha")}
        true |= {f"d{k + 1}": truth["robot"]["d"][k], f"theta{k + 1}": truth["robot"]["zero"][k]}
        true[f"compliance J{k + 1}"] = truth["robot"]["give"][k]
    parameters = fitted.model.parameters
    sd = np.sqrt(np.diag(fitted.covariance))[: len(parameters)]
    pull = np.array(
        [(fitted.z[k] - (true[p.name] - p.centre) / p.sd) / sd[k] for k, p in enumerate(parameters)
         if p.name in true]
    )  # fmt: skip
    assert len(pull) >= 22
    assert np.abs(pull).max() < 4
    assert 0.4 < np.mean(pull**2) < 2.0


@pytest.mark.parametrize(
    "maker", [m for m in (*NAMED, *chain.from_iterable(FORMS.values()), *OUTSIDE, *MORE, *RESERVED)
              if m not in ON_SURFACE]
)  # fmt: skip
def test_what_is_drawn_moves_the_reflector_and_needs_no_surface(maker, loaded):
    act = maker(np.random.default_rng(1), loaded)
    quiet = loaded.session.start
    shift = loaded.gap(quiet, [(act, act.size)]) - loaded.gap(quiet)
    assert np.all(np.isfinite(shift))
    assert 1e-6 < np.std(shift) < 2e-3
    moved = Moved.nothing(len(quiet))
    act.move(loaded.seen(quiet, ())[0], act.size, moved)
    assert not any(np.any(x) for x in (moved.travel, moved.height, moved.lag))


def test_what_needs_a_surface_is_never_measured_with_a_tracker():
    drawn = [(k, recipe(SEED, k, reserved=True)[1]) for k in range(400)]
    where = [(stage(SEED, k, 4, makers), makers) for k, makers in drawn]
    assert 50 < sum(what == "tracker" for what, _ in where) < 110
    assert not any(ON_SURFACE & set(makers) for what, makers in where if what == "tracker")
    assert "tracker" not in {stage(SEED, k, 3, makers) for k, makers in drawn}
    others = [(stage(SEED, k, 3, makers), what) for (k, makers), (what, _) in zip(drawn, where, strict=True)]
    assert all(before == now for before, now in others if now != "tracker"), "otherwise as generator 3"


@pytest.mark.parametrize("stated", [True, False])
def test_columns_are_those_that_the_session_states(stated, loaded):
    plan, points = loaded.session, loaded.points((), np.zeros(3 * len(loaded.session.time)))
    text = measurements_text(plan, plan.start, plan.velocity if stated else None, points)
    head, first, *_ = (line.split(",") for line in text.splitlines())
    assert ("j1_degps" in head) == stated
    assert "z_mm" in head
    assert [float(first[head.index(c)]) for c in ("x_mm", "y_mm", "z_mm")] == pytest.approx(1e3 * points[0])


def test_a_seed_of_the_fourth_generator_keeps_its_meaning():
    """Files and effect of a session, unchanged by later generators."""
    texts, truth = world.build(SEED, 21, generator=4)
    assert truth["session"]["stage"] == "tracker"
    assert truth["effects"] == STORED["effects"]
    assert truth["lambda"]["value"] == pytest.approx(STORED["lambda"], rel=1e-6)
    for name, file in (("dataset", "dataset.yaml"), ("measurements", "measurements.csv")):
        assert hashlib.sha256(texts[file].encode()).hexdigest()[:16] == STORED[name]


def test_an_outlier_displaces_a_whole_point(loaded):
    wild = [world._wild(np.random.default_rng(seed), loaded.session).reshape(-1, 3) for seed in range(6)]
    hit = [np.any(w != 0, axis=1) for w in wild]
    assert 0 < sum(np.any(h) for h in hit) < 6
    for w, h in zip(wild, hit, strict=True):
        assert np.all(w[h] != 0)
        assert np.all((np.linalg.norm(w[h], axis=1) > 2.9e-5) & (np.linalg.norm(w[h], axis=1) < 1.1e-3))
        assert not np.any(h[loaded.session.phase != 0])


# --- A further round of a simulated session: the same machine, other contacts.


def number_of(effects: set[str], what: str = "cube") -> int:
    """The first session with one of these effects alone."""
    return next(
        k
        for k in range(400)
        if (drawn := recipe(SEED, k))[0] in ("single", "outside")
        and drawn[1][0].__name__ in effects
        and stage(SEED, k, 4, drawn[1]) == what
    )


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def wanted(made, count: int, payload: float = 0.0) -> list[Wanted]:
    """Contacts of the first round once more, from a little off the surface."""
    s = made.world.session
    at = np.flatnonzero((s.phase == 0) & (s.payload == payload))[:count]
    return [Wanted(NAMES[s.target[k]], s.start[k] - 1e-3 * s.way[k], s.velocity[k], payload) for k in at]


@pytest.mark.parametrize("effects", [{"latency"}, {"step"}], ids=min)
def test_the_first_round_stays_and_further_rows_are_measured(effects) -> None:
    made = make(SEED, number_of(effects))
    old, count = rows_of(made.texts["measurements.csv"]), 10
    rows = rows_of(further(made, wanted(made, count, 0.0), np.random.default_rng(0)))
    assert rows[: len(old)] == old
    assert [r["role"] for r in rows[len(old) :]] == ["calibrate"] * count
    assert len({r["id"] for r in rows}) == len(rows)
    assert all(float(a["time_s"]) < float(b["time_s"]) for a, b in pairwise(rows))


def test_the_same_contacts_are_read_again_but_for_noise() -> None:
    """Without effects that depend on time, the readings of a repeated contact differ by the noise."""
    made = make(SEED, number_of({"encoder_scale", "bending", "base_compliance", "coupling"}))
    rows = rows_of(further(made, wanted(made, 12), np.random.default_rng(0)))
    joints = [f"j{k}_deg" for k in range(1, 7)]
    q = np.radians([[float(r[j]) for j in joints] for r in rows])
    s = made.world.session
    at = np.flatnonzero((s.phase == 0) & (s.payload == 0))[:12]
    gap = made.world.gap(np.concatenate([q[: len(s.time)]]), made.acts)
    assert np.max(np.abs(gap - made.noise)) < 1e-7
    again = np.array(q[: len(s.time)])
    again[at] = q[len(s.time) :]
    assert 0 < np.max(np.abs(made.world.gap(again, made.acts)[at])) < 6 * made.sigma


def test_a_payload_hangs_on_the_arm() -> None:
    made = make(SEED, number_of({"bending"}))
    bare = wanted(made, 8)
    loaded = [replace(w, payload=2.0) for w in bare]
    last = (rows_of(further(made, w, np.random.default_rng(0)))[-8:] for w in (bare, loaded))
    q = [np.array([float(r["j2_deg"]) for r in rows]) for rows in last]
    assert np.max(np.abs(q[1] - q[0])) > 1e-4


def test_a_session_that_a_further_round_would_change_is_refused() -> None:
    made = make(SEED, number_of({"shoved_target"}))
    with pytest.raises(RuntimeError, match="would change what shoved-target did"):
        further(made, wanted(made, 5), np.random.default_rng(0))
