"""U of a change: a mixture over variances of model errors and over sets, and the stated masses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayescal as bc
from bayescal.changes import search as posterior
from bayescal.changes.linear import LEAST, Errors
from bayescal.changes.search import FREE, Member, Search, Weighed
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.gravity import masses
from bayescal.model.scene import Scene


def evidence(x, g, y, variance):
    """Changes (N, 2) beside a family (N, 3) of a variance, of measurements (N,) of unit noise: two items."""
    precision = np.linalg.inv(np.eye(len(y)) + variance * g @ g.T)
    family = Errors(x.T @ precision @ g, g.T @ precision @ g, g.T @ precision @ y, variance)
    joint = SimpleNamespace(items=[SimpleNamespace(parameters=(None,)) for _ in range(2)], sessions=(0, 1))
    places = (np.array([[0]]), np.array([[1]]))
    parts = {"information": x.T @ precision @ x, "score": x.T @ precision @ y, "errors": (family,)}
    return SimpleNamespace(joint=joint, columns=(0, 1), places=places, **parts)


@pytest.mark.parametrize("variance", [1e-12, 0.05, 4.0])
def test_the_covariance_is_that_of_a_mixture_over_variances(variance):
    rng = np.random.default_rng(3)
    x, g = rng.standard_normal((20, 2)), 3.0 * rng.standard_normal((20, 3))
    y = x @ [3.0, 0.0] + g @ [0.3, -0.2, 0.1] + rng.standard_normal(20)
    members = [Member(0, (1,))]
    _, mean, covariance = posterior.posterior(evidence(x, g, y, variance), members)

    def given(s):
        """Log evidence, mean and variance of the change, by brute force."""
        wide = np.eye(20) + s * g @ g.T
        p = np.linalg.inv(wide)
        a = x[:, 0] @ p @ x[:, 0] + FREE**-2
        found = x[:, 0] @ p @ y / a
        whole = wide + FREE**2 * np.outer(x[:, 0], x[:, 0])
        return -0.5 * (y @ np.linalg.solve(whole, y) + np.linalg.slogdet(whole)[1]), found, 1.0 / a

    sizes = np.geomspace(LEAST, max(1.0, variance), posterior.VALUES)
    logs, means, variances = np.array([given(s) for s in sizes]).T
    weight = np.exp(logs - logs.max()) / np.sum(np.exp(logs - logs.max()))
    _, at_it, least = given(variance)
    assert mean[0] == pytest.approx(at_it, rel=1e-6)
    added = max(weight @ (variances - least), 0.0)
    assert covariance[0, 0] == pytest.approx(least + added + weight @ (means - at_it) ** 2, rel=1e-6)


def test_another_set_of_the_same_change_counts_by_its_probability():
    rng = np.random.default_rng(4)
    x = rng.standard_normal((20, 2)) @ [[1.0, 0.8], [0.0, 0.6]]
    e = evidence(x, np.zeros((20, 1)), x @ [2.0, 1.0] + rng.standard_normal(20), 1e-12)
    m, other = Member(0, (1,)), Member(1, (1,))
    one, two = Weighed((m,), (1.0,), 0.0, 0.6), Weighed((other, m), (0.3, 1.0), 0.0, 0.2)
    g, s = e.information, e.score
    wide = np.linalg.inv(g + np.diag([FREE**-2, 0.3**-2]))
    shift = (wide @ s)[0] - s[0] / (g[0, 0] + FREE**-2)
    expected = 0.25 * (wide[0, 0] - 1.0 / (g[0, 0] + FREE**-2) + shift**2)
    assert posterior.by_sets(Search(e, (one, two)), m) == pytest.approx([expected])
    assert posterior.by_sets(Search(e, (one,)), m) == pytest.approx([0.0])


def test_the_change_of_a_spring_has_the_uncertainty_of_the_torque(monkeypatch):
    d = bc.simulate(contacts=40, seed=1, spheres=0, repeats=0).dataset
    scene = Scene(d, oriented=True)
    c = scene.circumstances(scene.rows("calibrate"))
    elbow, twist = COMPLIANCE.at(c)[1], SimpleNamespace(driver=SimpleNamespace(kind="angle"), unit="rad")
    joint = SimpleNamespace(circumstances=c)
    assert posterior.by_masses(joint, twist) == 0.0
    assert 0.005 < posterior.by_masses(joint, elbow) < 0.15
    monkeypatch.setattr(posterior, "masses", lambda c: [p for p in masses(c) if p.name == "mass of link 3"])
    heavy = replace(d, robot=replace(d.robot, masses=d.robot.masses * (1.0 + 0.05 * (np.arange(6) == 2))))
    more = COMPLIANCE.at(Scene(heavy, oriented=True).circumstances(scene.rows("calibrate")))[1]
    torque, changed = (np.asarray(p.terms[0].driver)[c.fitted] for p in (elbow, more))
    slope = np.polyfit(torque, changed - torque, 1)[0]
    assert posterior.by_masses(joint, elbow) == pytest.approx(abs(slope), rel=0.02)
