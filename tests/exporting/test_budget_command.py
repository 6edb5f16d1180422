"""`bayescal budget` on run folders: the numbers of the fit, without a new fit."""

import csv
import json
import re
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

import bayescal as bc
from bayescal.assess.budget import budget
from bayescal.assess.measurand import parameter
from bayescal.fitted.arm import of_fit, open_run
from bayescal.fitted.file import restored
from bayescal.fitted.point import lost_motion, point

OPTIONS = {"contacts": 90, "later": 10, "repeats": 5, "spheres": 2, "placements": 1, "seed": 1}
READINGS = np.array([10.0, 20.0, -30.0, 40.0, 50.0, 60.0])


@pytest.fixture(scope="module")
def fitted():
    """Other priors than the default, and an effect that depends on the direction of motion."""
    session = bc.simulate(effects="geometry, compliance, backlash", joint_noise=1e-5, **OPTIONS)
    return bc.fit(session, "geometry, compliance, backlash at joint 2", samples=0, prior_width=1.5)


@pytest.fixture(scope="module")
def run(fitted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "fit"
    fitted.save(folder, pictures=False)
    return folder


def test_what_a_folder_restores_is_the_fit(fitted, run):
    found, fit = restored(open_run(run)), fitted.data.final.estimate
    np.testing.assert_allclose(found.z, fit.z, atol=1e-9)
    assert found.weights.scale == pytest.approx(fit.weights.scale, rel=1e-3)
    np.testing.assert_allclose(found.sd, fit.sd, rtol=1e-3)


@pytest.mark.parametrize(
    "asked",
    [{}, {"parameter": "a2"}, {"distance": ("ball.A@1", "ball.B@1")}, {"point": READINGS}],
    ids=["headline", "parameter", "distance", "point"],
)
def test_a_folder_has_the_budgets_of_its_fit(fitted, run, asked):
    of_folder, of_result = bc.budget(run, **asked), bc.budget(fitted, **asked)
    assert pytest.approx(of_result.U, rel=2e-3) == of_folder.U
    assert list(of_folder.components.index) == list(of_result.components.index)


def test_the_command(fitted, run, command):
    code, text, errors = command("budget", run, "--to", "json")
    assert code == 0, errors
    record, written = json.loads(text), json.loads((run / "budget.json").read_text())
    assert record["measurand"] == written["measurand"] == written["budgets"][0]["measurand"]
    assert record["U_um"] == pytest.approx(written["U_um"], rel=2e-3)
    for name in ("schema", "measurand", "components", "u_um", "U_um", "k", "coverage"):
        assert name in written
    for c in written["components"]:
        assert {
            "name",
            "type",
            "distribution",
            "value",
            "u",
            "unit",
            "sensitivity",
            "contribution_um",
        } <= c.keys()
    total = sum(c["contribution_um"] ** 2 for c in written["components"]) ** 0.5
    assert total == pytest.approx(written["u_um"])
    assert written["U_um"] == pytest.approx(written["k"] * written["u_um"])
    code, text, _ = command("budget", run, "--parameter", "theta4")
    assert "U = k u" not in text
    assert "parameter theta4" in text
    assert max(map(len, text.splitlines())) <= 80
    shares = [int(n) for n in re.findall(r"(\d+) %$", text.partition("smaller components")[0], re.MULTILINE)]
    assert shares == sorted(shares, reverse=True)  # the largest first
    assert len(shares) > 2


def test_csv_has_all_components_and_the_sum(run, command):
    _, text, _ = command("budget", run, "--parameter", "a2", "--to", "csv")
    rows = list(csv.DictReader(StringIO(text)))
    total = next(r for r in rows if r["group"] == "u")
    own = [float(r["contribution"]) for r in rows if r["group"] not in ("u", "U")]
    assert np.sqrt(np.sum(np.square(own))) == pytest.approx(float(total["contribution"]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--parameter", "zz"), "no parameter `zz`"),
        (("--distance", "ball.A@1", "cube.+y"), "no target `cube.+y` with a centre"),
        (("--distance", "ball.A@1", "ball.A@1"), "both ends are ball.A@1"),
        (("--point-deg", "1,2,3"), "3 readings"),
        (("--point-deg", "1,2,x,4,5,6"), "no list of numbers"),
        (("--point-deg", "1,2,nan,4,5,6"), "no finite number"),
        (("--to", "xml"), "no format `xml`"),
        (("--parameter", "a2", "--point-deg", "1,2,3,4,5,6"), "more than one measurand"),
    ],
)
def test_refusals(run, command, arguments, message):
    code, _, errors = command("budget", run, *arguments)
    assert code == 1
    assert message in errors
    assert errors.count("\n") == 1


def test_a_folder_that_was_changed_is_refused(run, tmp_path, command):
    import shutil

    other = tmp_path / "run"
    shutil.copytree(run, other)
    record = json.loads((other / "arm.json").read_text())
    record["covariance_si"] = (1.2 * np.array(record["covariance_si"])).tolist()
    (other / "arm.json").write_text(json.dumps(record))
    code, _, errors = command("budget", other, "--parameter", "a2")
    assert code == 1
    assert "arm.json was changed or removed after the run had written it" in errors
    (other / ".bayescal-files.json").unlink()
    code, _, errors = command("budget", other, "--parameter", "a2")
    assert code == 1
    assert "times that of arm.json" in errors


def test_covariance_of_a_point_is_that_of_the_arm(fitted):
    """Without a discrepancy: by the parameters, as `compensate` states it, and by the lost motion."""
    arm = of_fit(fitted.data)
    basis = fitted.data.basis
    assert not basis.stated.families
    q = np.radians(READINGS)
    m = point(arm, replace(basis, excess=3e-6), q)
    pose = arm.at(q)
    np.testing.assert_allclose(m.position, pose.points[0], atol=1e-12)
    covariance = m.by_z @ basis.stated.wide.covariance @ m.by_z.T
    np.testing.assert_allclose(covariance, pose.covariance[0], rtol=1e-4, atol=1e-16)
    off = lost_motion(arm, lambda q, which, way: arm.at(q, direction=way), q[None], np.zeros((1, 6)), pose)[0]
    assert np.any(off[1])
    assert not np.any(off[2])
    b = budget(replace(basis, excess=3e-6), m)
    total = np.trace(covariance) + np.sum(off**2) + 3 * 3e-6**2
    assert b.u**2 == pytest.approx(total, rel=1e-4)


def test_a_diagnosis_has_budgets_too(tmp_path):
    gap = bc.diagnose(bc.simulate(effects="geometry", **(OPTIONS | {"spheres": 0})), model="geometry")
    gap.save(tmp_path / "gap", pictures=False)
    found = bc.budget(tmp_path / "gap", parameter="a2")
    k = gap.data.arm.model.names.index("a2")
    sd = gap.data.arm.model.sd[k] * gap.data.covariance[k, k] ** 0.5
    assert found.data.u == pytest.approx(sd, rel=0.01)
    assert found.data.u == pytest.approx(budget(found.basis, parameter(found.basis, "a2")).u)
