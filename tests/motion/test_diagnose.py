"""Diagnoses of made logs: what was added is found, at its place, with its size."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from cases import refused, terminal_text
from influences import check_written
from motion.made import RATE, SECONDS, beyond_nominal, nominal, path, read_commands, truth, write

import bayescal as bc
from bayescal.errors import BayescalError
from bayescal.gap.result import VERDICTS
from bayescal.logs import read_log
from bayescal.logs.types import inertial
from bayescal.motion.diagnose import diagnose
from bayescal.reporting.motion import beyond_stated, motion_summary
from bayescal.reporting.motion import record as of_log
from bayescal.reporting.page import Run
from bayescal.reporting.page.build import run_page
from bayescal.robots.schema import SIX

BUMP = 0.4


def delay(q, dq, ddq, tau, t, load):
    return -0.006 * np.gradient(tau, 1.0 / RATE, axis=0)


def payload(q, dq, ddq, tau, t, load):
    gravity = 0.15 * 0.2 * 9.81  # 0.2 kg at 0.15 m of the last axis, in the plane of the arm
    outer = bool(load) * gravity * np.cos(q[:, 1] + q[:, 2])
    inner = outer + bool(load) * 0.3 * 0.2 * 9.81 * np.cos(q[:, 1])
    return np.column_stack([0.0 * outer, inner, outer])


MASS, CENTRE = 1.5, np.array([0.2, 0.03, 0.05])


def gripper(q, dq, ddq, tau, t, load):
    """A mass at the last link that no motion states."""
    m = nominal()
    total = inertial(m.mass[2], m.centre[2], m.inertia[2]) + inertial(MASS, CENTRE, 1e-4 * np.eye(3))
    centre = total[1:4] / total[0]
    about = total[4 + SIX] - inertial(total[0], centre, np.zeros((3, 3)))[4 + SIX]
    parts = {"mass": total[0], "centre": centre, "inertia": about}
    whole = replace(m, **{key: np.concatenate([getattr(m, key)[:2], [x]]) for key, x in parts.items()})
    return beyond_nominal(whole, q, dq, ddq)


def constants(q, dq, ddq, tau, t, load):
    return [0.03, -0.02, 0.04] * tau


def bump(q, dq, ddq, tau, t, load):
    return [0.0, 0.0, BUMP] * np.exp(-0.5 * ((q - 0.1) / 0.15) ** 2)


@pytest.fixture
def of_the_list(monkeypatch):
    """Causes that are in no list are not searched, which is half the time of a diagnosis: `gaps` has them."""
    monkeypatch.setattr(
        "bayescal.motion.diagnose.beside", lambda pool, noise, search, hypotheses: (pool, hypotheses)
    )


@pytest.fixture(scope="module")
def gaps(tmp_path_factory, null_log, rubbing):
    folder = tmp_path_factory.mktemp("gaps")
    made = {f.__name__: write(folder / f.__name__, f) for f in (delay, payload, gripper, constants, bump)}
    found = {name: bc.diagnose(path, without=[]) for name, path in {"null": null_log, **made}.items()}
    return found | {"load_friction": rubbing}


def test_of_a_null_log_nothing_is_named(gaps):
    gap = gaps["null"]
    assert gap.verdict == "null"
    assert gap.effects == ()
    assert re.fullmatch(r"No effect above noise \(.* above 0\.\d\d?\)\.", gap.record["words"][0])
    assert max(p for n, p in gap.probability.items() if n != "null") < 0.5
    assert gap.shrinkage.before_rms_Nm.to_list() == gap.shrinkage.after_rms_Nm.to_list()


def test_the_shift_of_torques_is_that_of_the_baseline(gaps, null_estimate):
    shift = null_estimate.model.shift[0]
    assert shift != 0.0
    gap, found = gaps["null"].data, gaps["null"].record["torque_shift_ms"]
    assert found == pytest.approx(1e3 * shift, rel=0.05)
    part, *others = gap.estimate.parts
    stated = replace(part, log=replace(part.log, alignment=part.log.alignment + 0.25))
    late = replace(gap, estimate=replace(gap.estimate, parts=(stated, *others)))
    assert of_log.motion_record(late)["torque_shift_ms"] == pytest.approx(found + 250.0)


def test_the_alignment_that_check_advises_makes_a_late_log_a_null_log(tmp_path, of_the_list):
    """Torques that are 10 ms later than positions: `check`, `fit` and `gap` give it one sign."""
    folder = write(tmp_path / "late", late=0.01)
    (finding,) = [f for f in bc.check(folder).data.findings if f.code == "delay"]
    assert "later than positions" in finding.what
    advised = float(finding.remedy.split("`alignment_ms: ")[1].split("`")[0])
    file = folder / "dataset.yaml"
    file.write_text(file.read_text() + f"clock: {{alignment_ms: {advised}}}\n")
    assert "delay" not in [f.code for f in bc.check(folder).data.findings]
    assert "delay" not in bc.diagnose(folder, without=[]).effects
    file.write_text(file.read_text().replace(f"{advised}", "-10"))
    (finding,) = [f for f in bc.check(folder).data.findings if f.code == "delay"]
    assert "stated is -10 ms" in finding.what


@pytest.mark.parametrize("stated", [0.0, -8.0])
def test_a_delay_of_one_joint_is_at_that_joint(tmp_path, of_the_list, stated):
    """Where the stated clock is wrong too, each joint has its own; what remains is no larger than before."""
    folder = write(tmp_path / "late", late=(0.0, 0.008, 0.0))
    file = folder / "dataset.yaml"
    file.write_text(file.read_text() + f"clock: {{alignment_ms: {stated}}}\n")
    gap = bc.diagnose(folder, without=[])
    assert gap.effects == ("delay",)
    a = gap.amplitudes.iloc[0]
    if stated:
        assert a.site == "log"
        sizes = [p["value"] for p in gap.record["amplitudes"][0]["components"].values()]
        assert sizes == pytest.approx([0.008, 0.016, 0.008], abs=1e-3)
        assert "joint 2 1" in gap.record["words"][0]
    else:
        assert (a.site, a.value) == ("joint 2", pytest.approx(0.008, abs=2e-4))
    assert (gap.shrinkage.after_rms_Nm < 1.02 * gap.shrinkage.before_rms_Nm).all()


def test_the_size_of_an_elasticity_is_as_uncertain_as_the_torque_of_the_gear(tmp_path, of_the_list):
    """Second encoders tell the deflection to 1e-4; masses that are 8 % off leave the torque less sure."""
    folder = write(tmp_path / "links")
    torque, arm = truth(np.random.default_rng(1000)), nominal()
    table = pd.read_csv(folder / "motion.csv.gz")
    noise = np.random.default_rng(3).normal(0.0, 1e-4, (len(table), 3))
    for k, rows in table.groupby("motion").groups.items():
        _, q, dq, ddq = path(0 if k < 3 else k - 1)
        of_motor = arm.armature * ddq + arm.coulomb * np.tanh(dq / 0.03) + arm.viscous * dq
        carried = torque(q, dq, ddq, table["payload_kg"][rows[0]]) - of_motor
        links = np.rad2deg(q - [0.0, 1e-5, 0.0] * carried) + noise[rows]
        table.loc[rows, [f"link{j}_deg" for j in (1, 2, 3)]] = links
    table.to_csv(folder / "motion.csv.gz", index=False)
    gap = bc.diagnose(folder, without=[])
    assert gap.effects == ("elasticity",)
    a = gap.amplitudes.iloc[0]
    assert a.site == "joint 2"
    assert a.value == pytest.approx(1e-5, abs=2.5 * a.u)
    assert 0.002 < a.u / a.value < 0.04


def heavier(q, dq, ddq, tau, t, load):
    """Torques by a centre of mass of the last link that is 250 mm farther out, of MuJoCo."""
    farther = nominal().centre + np.outer([0.0, 0.0, 1.0], [0.25, 0.0, 0.0])
    return beyond_nominal(replace(nominal(), centre=farther), q, dq, ddq)


def test_an_error_of_a_body_is_said_by_its_most_significant_parameter(tmp_path, of_the_list):
    """Mass, centre and inertia have several units: their vector has no length."""
    gap = bc.diagnose(write(tmp_path / "heavier", heavier), without=[])
    (a,) = gap.record["amplitudes"]
    # what the last link carries has the same torques, and both have a probability
    assert (a["site"], a["setting"], a["unit"]) == ("tool", "as of the last link", "m")
    assert min(gap.probability["inertia"], gap.probability["payload"]) > 0.3
    assert a["value"] == a["components"]["centre x"]["value"] == pytest.approx(0.25, abs=0.1)
    assert a["text"].startswith("centre x ")
    assert {part["unit"] for part in a["components"].values()} == {"kg", "m", "kg m2"}


def brake(q, dq, ddq, tau, t, load):
    """Drag of joint B from 3 to 6 s of three motions."""
    motion, since = np.divmod(t, SECONDS + 1.0)
    on = np.isin(motion, (2, 5, 7)) & (since > 3.0) & (since < 6.0)
    return on[:, None] * [0.0, 1.0, 0.0] * np.tanh(dq / 0.03)


def test_a_drag_that_comes_and_goes_varies_with_time_and_direction(tmp_path):
    """It was a function of direction and of the angle of another joint."""
    gap = bc.diagnose(write(tmp_path / "brake", brake), without=[])
    assert gap.verdict in ("unknown", "named+unexplained")
    assert "direction times time within a motion at joint 2" in " ".join(gap.record["words"])


def test_residuals_far_beyond_the_stated_noise_are_stated(gaps):
    """What is expected of a residual has noise, and what the model lacks."""
    record = gaps["null"].record
    assert record["noise"]["stated_Nm"] == pytest.approx([0.08, 0.08, 0.04])
    shown = terminal_text(motion_summary(record))
    assert "expected" in "".join(shown.splitlines()[3:7])
    assert "times the stated noise" not in shown
    low = record | {"noise": record["noise"] | {"stated_Nm": [0.08, 0.02, 0.04]}}
    (text,) = beyond_stated(low)
    assert text == f"B {record['noise']['floor_Nm'][1]:.3g} for 0.02"
    assert "more than 2 times the stated noise: B" in terminal_text(motion_summary(low))
    assert beyond_stated(record | {"noise": record["noise"] | {"stated_Nm": None}}) == []


def test_backlash_is_relevant_where_link_encoders_show_it(tmp_path, of_the_list):
    """It changes no torque."""
    folder = write(tmp_path / "loose")
    rows = pd.read_csv(folder / "motion.csv.gz")
    rng = np.random.default_rng(0)
    for j in (1, 2, 3):
        rows[f"link{j}_deg"] = rows[f"q{j}_deg"] + 3e-3 * rng.standard_normal(len(rows))
    rows["link2_deg"] -= 0.08 * np.tanh(np.gradient(rows["q2_deg"]) * RATE / 2.0)
    rows.to_csv(folder / "motion.csv.gz", index=False)
    gap = bc.diagnose(folder, without=[])
    assert (gap.effects, gap.amplitudes.site[0]) == (("backlash",), "joint 2")
    assert gap.amplitudes.relevant.all()
    assert "not relevant" not in " ".join(gap.record["words"])


def test_what_only_withheld_motions_show_has_its_size_and_no_name(tmp_path):
    gap = bc.diagnose(write(tmp_path / "withheld", payload, loads=(0,) * 6 + (0.8, 0.8)), without=[])
    assert (gap.verdict, gap.effects) == ("unknown", ())
    assert gap.record["where"][0]["rms_Nm"] > 0.2
    assert "would, but fitted motions do not show it" in gap.record["words"][0]


@pytest.mark.parametrize(("effect", "site", "size"), [("delay", "log", 0.006), ("payload", "tool", 0.2)])
def test_an_effect_is_named_with_its_size(gaps, effect, site, size):
    gap = gaps[effect]
    assert (gap.verdict, gap.effects) == ("named", (effect,))
    a = gap.amplitudes.iloc[0]
    assert a.site == site
    assert a.value == pytest.approx(size, abs=max(4 * a.u, 0.2 * size))
    assert gap.probability[effect] > 0.9


def test_a_mass_that_no_motion_states_is_a_payload_of_all(gaps, tmp_path):
    gap = gaps["gripper"]
    # of three joints, the last carries it: what it is of cannot be told
    assert (gap.verdict, gap.effects) == ("named", ("payload",))
    assert gap.probability["payload"] + gap.probability["inertia"] > 0.95
    assert gap.probability["inertia"] > 0.1
    (a,) = gap.record["amplitudes"]
    assert (a["site"], a["driver"]) == ("tool", "mass in every motion")
    assert "tool: mass that no motion states, or error of the last link, " in " ".join(str(gap).split())
    # the arm holds it, and so do the files of simulators
    without, arm = gaps["null"].data.arm.mechanism, gap.data.arm.mechanism
    moment = arm.mass[2] * arm.centre[2] - without.mass[2] * without.centre[2]
    assert moment[:2] == pytest.approx(MASS * CENTRE[:2], abs=0.03)  # the third is along the axis
    gap.save(tmp_path / "run")
    assert "payload" not in str(bc.export(tmp_path / "run", "mjcf"))


def test_a_cause_in_all_joints_has_a_value_in_each(gaps):
    gap = gaps["constants"]
    assert (gap.verdict, gap.effects) == ("named", ("torque-constant",))
    (a,) = gap.record["amplitudes"]
    assert (a["site"], a["setting"]) == ("log", "in all joints")
    for j, value in enumerate([0.03, -0.02, 0.04]):
        c = a["components"][f"joint {j + 1}"]
        assert c["value"] == pytest.approx(value, abs=4.0 * c["u"])
        assert 0.0 < c["u"] < 0.02
    assert "found at all joints: error of the torque constant, joint 1 " in " ".join(str(gap).split())
    assert gap.record["named"][0]["text"].startswith("all joints: error of the torque constant, joint 1 ")


def test_friction_that_grows_with_load_is_found_at_its_joint(gaps):
    gap = gaps["load_friction"]
    assert "load-friction" in gap.effects
    assert gap.where.iloc[0].site == "joint 2"
    s = gap.shrinkage
    assert s.after_rms_Nm.iloc[1] < 0.7 * s.before_rms_Nm.iloc[1]
    torque = gap.record["shrinkage"]["torque"]
    assert torque["removed"] > 0.7
    low, high = torque["removed_interval95"]
    said = f"remove {100 * torque['removed']:.0f} % ({100 * low:.0f} to {min(100 * high, 100):.0f} %) of the"
    assert said in " ".join(str(gap).split())


def test_a_cause_outside_the_list_is_unknown_at_its_place(gaps):
    gap = gaps["bump"]
    assert gap.verdict in ("unknown", "named+unexplained")
    assert gap.where.iloc[0].site == "joint 3"
    assert "angle" in gap.where.iloc[0].driver
    (said,) = re.findall(r"\(([\d.e+]+) mN m RMS in joint 3\)", " ".join(str(gap).split()))
    assert float(said) == pytest.approx(1e3 * gap.where.iloc[0].rms_Nm, rel=0.006)
    assert max((gap.probability[n] for n in gap.effects), default=0.0) <= 0.85
    # the bump draws this inertia to 4.6 prior standard deviations; nothing else is as far
    warned = {name: [w.partition(":")[0] for w in gap.record["warnings"]] for name, gap in gaps.items()}
    assert warned == {name: [] for name in gaps} | {"bump": ["inertia xy of link 3"]}


def test_the_record_follows_the_contract(gaps):
    for gap in gaps.values():
        r = json.loads(json.dumps(gap.record, allow_nan=False))
        assert r["schema"] == "bayescal-gap/1"
        assert r["unit"] == "Nm"
        assert r["verdict"] in VERDICTS
        assert set(r["effects"]) <= set(r["probability"])
        assert {len(r["torque_rms_Nm"][k]) for k in ("before", "after")} == {3}
        assert all({"site", "driver"} <= set(w) for w in r["where"])
        assert all(isinstance(a["relevant"], bool) for a in r["amplitudes"])
        assert {n["effect"] for n in r["not_assessed"]} >= {"elasticity", "backlash"}
        assert len(r["noise"]["lag1"]) == 3
        assert (r["class"] is not None) == (r["verdict"] == "class")


def test_a_run_folder_is_read_back(gaps, tmp_path):
    gap = gaps["delay"]
    files = ("gap.json", "gap.html", "next-motions.csv", "next-motions.yaml", "arm.yaml", "dataset")
    assert gap.save(tmp_path / "run") == files
    with pytest.raises(BayescalError, match="of sessions, and this is the run of a joint log"):
        bc.report([tmp_path / "run"] * 2, tmp_path / "both.html")
    planned = [name for name, _, _ in read_commands(tmp_path / "run" / "next-motions.csv")]
    assert planned == [m["id"] for m in gap.record["next_motions"]]
    assert "poses" in planned
    again = bc.load(tmp_path / "run")
    assert again.record == json.loads(json.dumps(gap.record))
    assert again.amplitudes.equals(gap.amplitudes)
    assert "ms" in str(gap)
    page = (tmp_path / "run" / "gap.html").read_text(encoding="utf-8")
    assert "delay of the torque" in page
    assert "<code>alignment_ms</code>" in page
    for step in ("export", "verify"):
        assert f"bayescal {step} " in page
    assert "Run the motions of next-motions.csv" in page
    # residuals of the withheld motion with most error, as they are drawn; withheld motions are alike
    w, s = gap.record["withheld"], gap.record["shrinkage"]["torque"]
    drawn = re.findall(r'<path class="(dot|check)" d="([^"]*)"', page)
    assert [style for style, _ in drawn] == ["dot", "check"] * 3
    for key in ("before", "after"):
        left = np.array(w[f"{key}_Nm"], float)
        assert left.shape == (3, len(w["time_s"]))
        rms = np.sqrt(np.nanmean(left**2, axis=1))
        assert rms == pytest.approx(s[f"{key}_rms_Nm"], rel=0.15)


def test_a_log_without_signed_torques_is_not_assessed(null_log):
    log = read_log(null_log)
    bare = replace(log, motions=tuple(replace(m, torque=None) for m in log.motions))
    refused("no torques are logged", lambda: diagnose(bare))
    refused("torques have no sign", lambda: diagnose(replace(bare, signed=False)))
    fitted_only = replace(log, motions=log.of_role("calibrate"))
    refused("no motion has the role validate", lambda: diagnose(fitted_only))


def test_options_of_contacts_are_refused(null_log):
    refused("--prior-width", lambda: bc.diagnose(null_log, prior_width=2.0))
    refused("--model", lambda: bc.diagnose(null_log, "geometry"))
    refused("one joint log at a time", lambda: bc.diagnose([null_log, null_log]))
    refused("only `fit` takes it beside a session", lambda: bc.diagnose([null_log, null_log.parent]))
    refused("is that of a joint log", lambda: bc.compare(null_log))


IN_JOINT = {"bump": 3, "load_friction": 2}
"""The joint in whose torque a cause is."""
CALLED = {"nats": "log_evidence", "joint": "of_joint", "gain": "delta_elpd", "expected.rms": "floor"}
UNITS = {r"of_joint": lambda x: x + 1}


@pytest.mark.parametrize("cause", IN_JOINT)
def test_every_number_of_a_diagnosis_is_in_its_record_under_its_name(gaps, cause, monkeypatch):
    """Joints count from 1 in it, as in the words."""
    monkeypatch.setattr(of_log, "software", lambda libraries: {})
    gap, record = gaps[cause].data, gaps[cause].record
    assert record["where"][0]["of_joint"] == IN_JOINT[cause]
    said = re.findall(r"RMS in joint (\d)", " ".join(record["words"]))
    assert set(map(int, said)) <= {place["of_joint"] for place in record["where"]}
    assert said or cause == "load_friction"
    # in the second joint, beside which there is another one
    given = {"where": tuple(replace(place, joint=1) for place in gap.where)}
    given |= {"amplitudes": gap.amplitudes, "shrinkage": gap.shrinkage}
    check_written(
        lambda given: of_log.motion_record(replace(gap, **given)), given, but="", called=CALLED, units=UNITS
    )


def test_mistaken_columns_are_corrected_before_all_else(gaps):
    """Neither further motions nor a simulator is advised."""
    gap = gaps["load_friction"].data
    part, *others = gap.estimate.parts
    part = replace(part, log=replace(part.log, mistaken=("swapped; correct them",)))
    wrong = replace(gap, estimate=replace(gap.estimate, parts=(part, *others)))
    for data in (gap, wrong):
        text = run_page(Run("motion", of_log.motion_record(data), "x"))
        assert (of_log.CORRECT in text) == (data is wrong)
        assert ("bayescal export" in text) == (data is gap)
