"""Measurements of one pose that share an error: three reflectors are not three independent measurements."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.transforms import rpy_matrix
from bayescal.gap.examine import examine
from bayescal.gap.linear.evidence import Bank, shared_variance, weigh_sets, worth
from bayescal.gap.linear.problem import Problem
from bayescal.gap.linear.state import fit_state
from bayescal.model.scene import Scene

NOISE, POSES = 10e-6, 20


def reflectors(tracker, shared: float, seed: int, wave: float = 0.0):
    """Three reflectors on the flange at every stop of a nominal arm, and an error of each stop."""
    one = tracker(seed=seed, count=POSES, noise=NOISE).dataset
    rng = np.random.default_rng(seed)
    own = one.tools[0]
    offsets = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.01]])
    tools = tuple(
        replace(own, name=f"reflector {k}", centre=own.centre + off) for k, off in enumerate(offsets)
    )
    at = np.repeat(np.arange(POSES), 3)
    table = {
        name: np.asarray(values)[at]
        for name, values in vars(one.measurements).items()
        if isinstance(values, np.ndarray)
    }
    table |= {"ids": tuple(f"r{k}" for k in range(len(at))), "line": np.arange(2, len(at) + 2)}
    m = replace(one.measurements, **table)
    m = replace(m, tool=np.tile(np.arange(3), POSES))
    m = replace(m, velocity=None, time=None, temperature=None, torque=None)  # fewer candidates
    robot = replace(one.robot, reductions=np.full(6, 100.0))
    dataset = replace(one, robot=robot, tools=tools, measurements=m)
    moved = m.readings + wave * np.sin(2 * m.readings) * (np.arange(6) == 0)
    true = replace(dataset, measurements=replace(m, readings=moved))
    points = Scene(true).points + shared * rng.standard_normal((POSES, 3))[at]
    frame = dataset.targets[0].values
    read = (points - frame["xyz"]) @ rpy_matrix(np.asarray(frame["rpy"]))
    return replace(dataset, measurements=replace(m, xyz=read + NOISE * rng.standard_normal(read.shape)))


@pytest.mark.parametrize("shared", [0.0, 60e-6])
def test_three_reflectors_at_a_few_stops_do_not_make_sure_names(shared, tracker):
    """The error is one of the stops; for three independent measurements it would be several sure names."""
    scene = Scene(reflectors(tracker, shared, 2))
    found = examine(scene, ("geometry",), True, 1.0).decision
    assert found.kind == "null"
    assert all(p < 0.5 for name, p in found.probability.items() if name != "null")


def test_an_effect_that_the_reflectors_of_a_stop_show_alike_is_no_shared_error(tracker):
    """Twice a turn of J1: before it is named, all reflectors of a stop are off by the same."""
    found = examine(Scene(reflectors(tracker, 0.0, 2, wave=4e-4)), ("geometry",), True, 1.0)
    assert (found.decision.kind, found.decision.hypothesis.names) == ("named", ("second-harmonic",))
    assert found.problem.worth is None


def made_up(shared: float, seed: int, poses: int = 60, count: int = 3):
    """Points of a made-up problem of five parameters, with the error of each pose."""
    rng = np.random.default_rng(seed)
    rows = 3 * count * poses
    contact = np.arange(rows) // 3
    gradient = 1e5 * np.tile(np.eye(3), (count * poses, 1))
    r = rng.standard_normal(rows) + shared * rng.standard_normal((poses, 3)).repeat(count, axis=0).ravel()
    jacobian = 5 * rng.standard_normal((rows, 5))
    p = Problem(
        r, jacobian, np.zeros((rows, 0)), np.zeros(5), contact, np.arange(count * poses), np.ones(rows)
    )
    return p, gradient, contact // count


def test_the_shared_variance_is_that_of_the_simulation():
    found = []
    for seed in range(8):
        p, gradient, pose = made_up(2.0, seed)
        found.append(shared_variance(fit_state(p, (), (), robust=False), gradient, pose))
    assert np.mean(found) == pytest.approx(4.0, rel=0.15)
    assert not any(
        shared_variance(fit_state(p, (), (), robust=False), gradient, pose)
        for p, gradient, pose in (made_up(0.0, seed) for seed in range(8))
    )
    p, gradient, pose = made_up(2.0, 0, count=1)  # nothing repeats
    assert shared_variance(fit_state(p, (), (), robust=False), gradient, pose) == 0.0


def test_what_a_measurement_is_worth():
    """Three points of one pose: as a mean of three with a shared variance. Other directions share nothing."""
    p, gradient, pose = made_up(2.0, 0, poses=2)
    assert worth(4.0, p.contact, p.lengths, gradient, pose) == pytest.approx(np.full(18, 5 / 13))
    assert worth(0.0, p.contact, p.lengths, gradient, pose) == pytest.approx(np.ones(18))
    contact = np.arange(6)
    faces = np.eye(3)[[0, 1, 2, 0, 0, 0]]
    found = worth(4.0, contact, 5, faces[:5], np.array([0, 0, 0, 1, 1]))
    assert found == pytest.approx([1.0, 1.0, 1.0, 5 / 9, 5 / 9, 1.0])  # the last is an orientation


def test_evidence_of_rows_that_are_worth_half_is_that_of_half_as_many():
    """The same data twice, each worth one half: as the data once."""
    p = made_up(0.0, 0)[0]
    pool = 3 * np.random.default_rng(9).standard_normal((len(p.residual), 2))
    once = replace(p, pool=pool)
    contacts = int(p.contact.max()) + 1
    twice = replace(
        once, residual=np.tile(p.residual, 2), jacobian=np.tile(p.jacobian, (2, 1)),
        pool=np.tile(pool, (2, 1)),
        contact=np.concatenate([p.contact, p.contact + contacts]), rows=np.arange(2 * contacts),
        sigma=np.ones(2 * len(p.residual)), worth=np.full(2 * len(p.residual), 0.5),
    )  # fmt: skip
    sets = [np.array([0]), np.array([0, 1])]
    for columns in ((), (1,)):
        a, b = (fit_state(q, columns, np.ones(len(columns)), robust=False) for q in (once, twice))
        assert a.log_evidence == pytest.approx(b.log_evidence)
        bayes = [
            weigh_sets(s, Bank(s.problem.pool, tuple(sets), s.problem.count, s.problem.worth)) for s in (a, b)
        ]
        assert bayes[0] == pytest.approx(bayes[1])
    robust = fit_state(twice, (), ())
    assert robust.gross == 0
    assert robust.log_evidence == pytest.approx(fit_state(once, (), ()).log_evidence)
