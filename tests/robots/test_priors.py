"""Priors of parameters in a robot file: read, written, used in place of the usual ones."""

from dataclasses import replace

import pytest
from sessions import circumstances, cube

from bayescal.arm.chain import Prior
from bayescal.effects import parameters_of
from bayescal.errors import BayescalError
from bayescal.model.options import FitOptions
from bayescal.robots import load_robot, robot_to_yaml

PRIORS = (Prior("theta2", "rad", -1e-3, 4e-4), Prior("a2", "m", 2e-4, 1e-4))
PRIORS += (Prior("compliance J3", "rad/(N m)", 2.5e-4, 5e-5),)


def with_priors(*priors: Prior):
    dataset = cube(seed=1).dataset
    return circumstances(replace(dataset, robot=replace(dataset.robot, priors=priors)))


def test_round_trip(tmp_path):
    robot = replace(load_robot("fanuc-lrmate200ic")[0], priors=PRIORS)
    (tmp_path / "robot.yaml").write_text(robot_to_yaml(robot))
    again = load_robot("robot.yaml", tmp_path)[0].priors
    assert [(p.name, p.unit) for p in again] == [(p.name, p.unit) for p in PRIORS]
    for a, b in zip(again, PRIORS, strict=True):
        assert (a.deviation, a.sd) == pytest.approx((b.deviation, b.sd), rel=1e-5)


def test_they_replace_the_usual_ones():
    model = ("geometry", "compliance")
    plain = {p.name: p for p in parameters_of(model, with_priors())}
    for name, p in {p.name: p for p in parameters_of(model, with_priors(*PRIORS))}.items():
        stated = next((s for s in PRIORS if s.name == name), None)
        if stated is None:
            assert p.same(plain[name])
            continue
        assert (p.centre - p.nominal, p.sd) == pytest.approx((stated.deviation, stated.sd))
        usual = FitOptions(doubted=(name,)).wider(p)
        assert (usual.centre, usual.sd) == (plain[name].centre, plain[name].sd)
    factor = {p.name: p for p in parameters_of(("geometry x2",), with_priors(*PRIORS))}
    assert factor["a2"].sd == pytest.approx(2e-4)  # of the prior of the file


def test_a_prior_in_another_unit_is_refused():
    with pytest.raises(BayescalError, match="prior of theta2 is in m, the parameter in rad"):
        parameters_of(("geometry",), with_priors(Prior("theta2", "m", 0.0, 1e-3)))
