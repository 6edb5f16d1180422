"""The diagnosis end to end: simulated sessions, worlds of another author, and whatever a session may lack."""

import json
import shlex
from dataclasses import replace

import foreign
import numpy as np
import pytest
from cases import cases, refused, terminal_text
from sessions import circumstances, geared, of_targets, plain, rough, simulated, with_columns, with_rows

import bayescal as bc
from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.join import joined
from bayescal.effects import parameters_of
from bayescal.effects.common import ELSEWHERE
from bayescal.effects.location import BASE, Site, joint, link
from bayescal.estimate import calibrated, estimate, settled
from bayescal.fitted.file import open_run
from bayescal.fitted.gate import NOTHING
from bayescal.gap.diagnose import diagnose, explain
from bayescal.gap.examine import examine
from bayescal.gap.result import VERDICTS
from bayescal.gap.search.candidates import candidates
from bayescal.model import build
from bayescal.model.options import USUAL as USUAL_FIT
from bayescal.model.options import FitOptions, Part, kept, parts_of
from bayescal.model.scene import Scene
from bayescal.reporting.gap.record import gap_record
from bayescal.reporting.gap.summary import gap_summary
from bayescal.simulation import Options, simulate

USUAL = ("geometry", "compliance")
LITTLE = {"contacts": 90, "later": 16, "repeats": 6, "spheres": 2, "placements": 2}
LOUD = LITTLE | {"seed": 3, "effects": (*USUAL, "backlash")}
KEYS = {
    "schema", "baseline", "gap", "verdict", "effects", "credible_set90", "probability", "where",
    "where_marginal", "shrinkage", "ladder", "next", "blind_spots",
}  # fmt: skip
"""Of gap.json, by the output contract."""
MASSIVE = {"hardening", "bending", "base-compliance", "payload", "hysteresis"}
"""Effects of gravity: no session shows them of a robot whose links have no masses."""


@pytest.fixture(scope="module")
def quiet():
    return geared(simulate(Options(**LITTLE, seed=4)).dataset)


@pytest.fixture(scope="module")
def loud():
    """A session with play, by the simulator that shares this vocabulary."""
    return geared(simulated(**LOUD).dataset)


def first(dataset, count):
    """The first contacts of a session that calibrate, and all later ones."""
    calibrating = dataset.measurements.role == "calibrate"
    return with_rows(dataset, np.flatnonzero(~calibrating | (np.cumsum(calibrating) <= count)))


def verdict_on(dataset, options=USUAL_FIT):
    """What a diagnosis concludes, without its other results."""
    return explain(Scene(dataset, oriented=True), USUAL, options).verdict


def printed(gap):
    return terminal_text(gap_summary(gap, gap_record(gap)), 110)


def sane(gap):
    """What holds of every diagnosis; its gap.json as written."""
    record = json.loads(json.dumps(gap_record(gap), allow_nan=False))
    assert record.keys() >= KEYS
    assert record["verdict"] in VERDICTS
    stated = [*record["probability"].values(), *(h["probability"] for h in record["hypotheses"])]
    assert all(0.001 - 1e-12 <= p <= 0.999 for p in (*stated, *(n["probability"] for n in record["named"])))
    assert record["credible_set90"]
    assert record["gap"]["noise_um"] > 0
    assert record["gap"]["heldout_rms_um"] > 0
    assert bool(record["named"]) == (record["verdict"] in ("named", "named+unexplained")) or (
        record["verdict"] == "ambiguous"
    )
    assert not set(record["missing"]) & set(record["effects"])
    for place in record["where"]:
        assert place["site"]
        assert 0.0 <= place["p_value"] <= place["family_p_value"] <= 1.0
    text = printed(gap)
    assert "nan" not in text.split()
    assert "e+" not in text
    return record


def test_nothing_there_is_said(quiet):
    gap = diagnose(quiet)
    record = sane(gap)
    assert gap.verdict.kind == "null"
    assert not gap.verdict.named
    assert not gap.shrinkage
    assert record["effects"] == []
    assert "null" in record["credible_set90"]
    assert record["shrinkage"] == {"planes": None, "distances": None}
    assert gap.where  # the largest place there is, for what it is worth
    assert all(w.family_p_value > 0.01 for w in gap.where)
    levels = [("nominal",), ("joint",), ("geometry",), ("geometry", "compliance")]
    assert [s.model for s in gap.levels] == levels
    assert "explains these data" in printed(gap)


def test_noise_of_one_face_is_no_effect():
    """It was an error of joint 1 at each new reading, with probability 0.99."""
    more = LITTLE | {"contacts": 130, "later": 24}
    verdict = verdict_on(rough(plain(simulate(Options(**more, seed=4)).dataset), 32e-6))
    assert verdict.kind == "null"
    assert verdict.probability["unknown"] < 0.5
    (words,) = (note for note in verdict.footnotes if "noise differs" in note)
    assert words.startswith("noise differs between targets (cube.+y: 2.")


def test_play_is_named_and_removed(loud, tmp_path, output_of):
    """From the file, of a robot whose gears must be scanned."""
    write_dataset(loud, tmp_path / "session")
    out = tmp_path / "out"
    assert "backlash" in output_of("gap", tmp_path / "session", "--out", out)
    record = json.loads((out / "gap.json").read_text())
    assert record.keys() >= KEYS
    assert (record["schema"], record["verdict"]) == ("bayescal-gap/1", "named")
    assert record["effects"] == ["backlash"]
    assert record["probability"]["backlash"] > 0.9
    assert record["where"][0]["driver"].startswith("approach")
    assert record["where"][0]["family_p_value"] < 1e-4
    assert record["shrinkage"]["planes"]["removed"] > 0.8
    assert record["shrinkage"]["distances"]["removed"] > 0.8
    rungs = record["ladder"]
    assert [r["model"][-1] for r in rungs] == ["nominal", "joint", "geometry", "compliance", "backlash"]
    assert rungs[-1]["heldout_rms_um"] < 0.6 * rungs[-2]["heldout_rms_um"]
    assert rungs[-1]["distance_rms_um"] < 0.6 * rungs[-2]["distance_rms_um"]
    lacking = {name for name, why in record["missing"].items() if why not in ELSEWHERE}
    assert lacking <= {"latency", "ball-radius"}  # at one speed nothing tells them apart
    assert {p.name for p in out.glob("[!.]*")} == {
        "gap.json", "gap.html", "arm.json", "dataset", "gap-where.png", "gap-which.png", "gap-levels.png",
        "gap-residuals.png",
    }  # fmt: skip
    arm = open_run(out)  # with the named effect, which the validation measurements confirm
    assert [e[:8] for e in arm.effects] == ["geometry", "complian", "backlash"]
    assert arm.use == NOTHING
    refit = {p.name: v for p, v in zip(arm.model.parameters, arm.values, strict=True)}
    # a fit with the printed model is the refit, but for the share of the discrepancy that may be no play
    fit = bc.fit(tmp_path / "session", record["refit"]["model"], samples=0)
    wide, own = fit.data.stated, fit.data.stated.plain.model
    sd = dict(zip(own.names, np.degrees(wide.sd[: len(own.sd)] * own.sd), strict=False))
    true = {p["name"]: p.get("value_deg") for p in simulated(**LOUD).truth["parameters"]}
    for a in record["amplitudes"]:
        (name,) = a["parameters"]
        row = fit.parameters.loc[name]
        assert abs(np.degrees(refit[name])) == pytest.approx(a["value"], rel=1e-9)
        assert (a["unit"], row.unit) == ("deg", "deg")
        assert row.u == pytest.approx(sd[name], rel=0.15)  # of draws, and their kurtosis
        assert a["value"] == pytest.approx(abs(row.estimate), abs=0.02 * a["u"])
        assert a["u"] == pytest.approx(sd[name], rel=0.02)
        assert abs(a["value"] - abs(true[name])) < 4 * a["u"]


def test_certified_values_in_error_are_named_and_move_no_contact():
    model = "geometry,compliance,artefact"
    session = bc.simulate(effects=model, contacts=160, later=16, repeats=0, spheres=2, placements=1, seed=1)
    gap = diagnose(geared(session.dataset))
    record = sane(gap)
    assert (record["verdict"], record["effects"]) == ("named", ["artefact"])
    true = {p["name"]: p.get("value_deg") for p in session.truth["parameters"]}
    for a in record["amplitudes"]:
        assert a["value"] == pytest.approx(true[a["parameters"][0]], abs=3 * a["u"])
        assert a["value"] > 4 * a["u"]
    assert gap.where[0].explained_by == "artefact"
    assert not gap.where[0].neighbours


@foreign.needs()
@pytest.mark.parametrize("world", ["010", "022"])
def test_worlds_of_another_author(world):
    truth = json.loads((foreign.WORLDS / "truth" / f"{world}.json").read_text())
    gap = diagnose(first(geared(read_dataset(foreign.WORLDS / world)), 200))
    record = sane(gap)
    kind = {"single": "named", "outside": "unknown"}[truth["kind"]]
    assert gap.verdict.kind == kind
    assert record["effects"] == truth["effects"]
    assert str(gap.where[0].site) == truth["where"][0]["site"]
    assert gap.where[0].family_p_value < 1e-3
    if kind == "named":
        assert gap.where[0].explained_by == truth["effects"][0]
        assert gap.levels[-1].validation_rms < gap.levels[-2].validation_rms


def without_spheres(dataset):
    others = (t.name for t in dataset.targets if t.kind != "sphere")
    return of_targets(with_rows(dataset, np.flatnonzero(~on_spheres(dataset))), *others)


def on_spheres(dataset):
    """Which rows touch a sphere."""
    return np.array([t.kind == "sphere" for t in dataset.targets])[dataset.measurements.target]


def unstated(dataset):
    calibrating = with_rows(dataset, np.flatnonzero(dataset.measurements.role == "calibrate"))
    return replace(with_columns(calibrating, time=None, temperature=None, repeat=None), readings="command")


def massless(dataset):
    robot = replace(dataset.robot, masses=None, centres_of_mass=None, compliance=None)
    return replace(dataset, robot=robot)


def one_plane(dataset):
    return with_rows(dataset, np.flatnonzero((dataset.measurements.target == 0) | on_spheres(dataset)))


def test_without_spheres_validation_measurements_time_temperature_repeats_and_encoders(loud):
    gap = diagnose(unstated(without_spheres(loud)))
    record = sane(gap)
    assert all(gap.verdict.missing.values())
    assert "backlash" in record["effects"]
    assert record["gap"]["heldout"] == "leave-one-out cross-validation"
    assert record["shrinkage"]["distances"] is None
    assert record["gap"]["noise_from"] == "fit"
    assert any("commanded" in note for note in gap.verdict.notes)


def test_without_masses_speeds_and_all_planes_but_one(loud):
    light = massless(with_columns(one_plane(first(loud, 60)), velocity=None))
    refused("compliance cannot be judged", lambda: diagnose(light))
    gap = diagnose(light, ("geometry",))
    sane(gap)
    assert {"backlash", "latency", "artefact", "compliance"} | MASSIVE <= set(gap.verdict.missing)
    assert all(gap.verdict.missing.values())
    assert "mass_kg" in gap.verdict.missing["payload"]


def test_a_model_without_compliance_is_judged_with_it(quiet):
    gap = diagnose(plain(quiet), ("geometry",))
    record = sane(gap)
    assert record["baseline"] == ["geometry"]
    assert record["effects"][:1] == ["compliance"]
    assert gap.levels[-1].validation_rms < 0.2 * gap.levels[1].validation_rms


def test_a_model_that_has_the_effect_and_a_step_has_no_gap(loud):
    gap = diagnose(loud, (*USUAL, "backlash", "step@50"))
    sane(gap)
    assert not {"backlash", "step"} & set(gap.verdict.probability)
    assert gap.verdict.kind == "null"
    assert len(gap.levels) == 6


def test_twenty_contacts(loud):
    twenty = diagnose(first(loud, 20), options=FitOptions(seed=5))
    sane(twenty)
    assert not twenty.verdict.named
    assert any("uncertain" in w for w in twenty.warnings)
    assert "explains these data" not in printed(twenty)


def test_points_of_an_instrument(tracker):
    gap = diagnose(plain(tracker(seed=3, count=60).dataset))
    record = sane(gap)
    assert set(record["shrinkage"]) >= {"planes", "distances"}
    assert "per point (length)" in printed(gap)
    assert {"lobing", "ball-radius", "plane-form"} <= set(gap.verdict.missing)


def test_an_upright_joint_that_is_found_to_lean_two_tools_and_options(loud):
    """A base joint along gravity carries nothing as drawn, but does where the base is found to lean."""
    # placed targets: so the base itself is found
    targets = tuple(replace(t, u=1e-3, u_angle=2e-3) for t in loud.targets)
    dataset = replace(loud, targets=targets, tools=(loud.tools[0], replace(loud.tools[0], name="other")))
    dataset = with_columns(dataset, tool=np.arange(len(loud.measurements.ids)) % 2)
    drawn = estimate(build(Scene(dataset), USUAL))
    assert set(build(settled(drawn), USUAL).names) - set(drawn.model.names) == {"compliance J1"}
    gap = diagnose(dataset, options=FitOptions(robust=False, prior_width=2.0))
    assert (gap.options.robust, gap.options.prior_width) == (False, 2.0)
    assert "backlash" in sane(gap)["effects"]


@pytest.mark.parametrize(("without", "arguments", "words"), cases("gap_refusals"))
def test_refusals_are_one_line_and_leave_nothing(without, arguments, words, loud, tmp_path, command):
    dataset = loud
    if without == "velocity":
        dataset = with_columns(loud, velocity=None)
    elif without == "contacts":
        dataset = with_rows(loud, np.flatnonzero(loud.measurements.role != "calibrate"))
    elif without == "masses":
        dataset = massless(loud)
    write_dataset(dataset, tmp_path / "session")
    arguments = shlex.split(arguments.replace("SESSION", str(tmp_path / "session")))
    if "--out" not in arguments:
        arguments += ["--out", str(tmp_path / "out")]
    before = sorted(tmp_path.rglob("*"))
    code, text, errors = command("gap", tmp_path / "session", *arguments)
    assert (code, text) == (1, "")
    lines = [line for line in errors.replace("\r", "\n").splitlines() if "bayescal:" in line]
    assert len(lines) == 1
    assert words in lines[0]
    assert "Traceback" not in errors
    assert sorted(tmp_path.rglob("*")) == before


@pytest.fixture(scope="module")
def contradicted(loud):
    """Certified distances that are 0.15 mm off, ten times what the refit with play expects."""
    off = [
        replace(c, distance=c.distance + 1.5e-4 * (-1) ** k) if c.kind == "distance" else c
        for k, c in enumerate(loud.certificates)
    ]
    return examine(Scene(replace(loud, certificates=tuple(off)), oriented=True), USUAL, USUAL_FIT)


@pytest.fixture
def concluded(contradicted, monkeypatch):
    """What follows from a search that is made once."""
    monkeypatch.setattr("bayescal.gap.diagnose.examine", lambda *_: contradicted)
    return lambda: diagnose(contradicted.fitted.model.scene.dataset)


def test_validation_that_contradicts_a_refit_leaves_no_plain_name(concluded):
    """Play is not all."""
    gap = concluded()
    record = sane(gap)
    assert gap.verdict.kind == "named+unexplained"
    assert [n.effect for n in gap.verdict.named] == ["backlash"]
    assert any("contradict the refit" in note for note in gap.verdict.footnotes)
    assert record["probability"]["backlash"] == record["named"][0]["probability"] == 0.85


def test_a_certain_name_that_validation_does_not_confirm_claims_nothing(concluded, monkeypatch):
    """Play at P > 0.99 whose refit is worth less than the baseline by the validation data."""
    monkeypatch.setattr("bayescal.gap.search.gate.gain", lambda before, less, more: -12.0)
    gap = concluded()
    record = sane(gap)
    assert [(n["effect"], n["confirmed"]) for n in record["named"]] == [("backlash", False)]
    assert record["shrinkage"]["planes"]["after_rms_um"] < record["shrinkage"]["planes"]["before_rms_um"]
    assert not any(s.claimed for s in gap.shrinkage)
    less = "backlash explains the calibration rows but makes the validation data less probable"
    assert less in str(record["footnotes"])
    assert "do not confirm backlash" in printed(gap)


# --- Effects of one session of several: a base that yields on one floor and not on the other.

ONE_SESSION_LITTLE = {
    "contacts": 50, "later": 16, "repeats": 4, "spheres": 1, "placements": 1, "arm_seed": 1
}  # fmt: skip


@pytest.fixture(scope="module")
def two():
    """Two sessions of one arm; only the base of the second yields."""
    effects = {"A": USUAL, "B": (*USUAL, "base-compliance")}
    made = [
        simulate(Options(name=name, seed=k, effects=own, **ONE_SESSION_LITTLE)).dataset
        for k, (name, own) in enumerate(effects.items(), 11)
    ]
    return joined([plain(d) for d in made], own_noise=False)


@pytest.fixture(scope="module")
def c(two):
    return circumstances(two)


def test_sites_of_a_session():
    site = BASE.of("cube, floor 2")
    assert (str(site), site.text) == ("base of cube-floor-2", "the base of cube-floor-2")
    assert Site.read(str(site)) == site
    assert site.anywhere == BASE == Site.read("base")
    assert str(Site.read("A:cube.+x")) == "A:cube.+x"


def test_parameters_act_in_their_session(c):
    usual = parameters_of(("base-compliance",), c)
    second = parameters_of(("base-compliance@session at base of B",), c)
    rows = c.sessions[1].rows
    assert len(usual) == len(second)
    for p, q in zip(second, usual, strict=True):
        if q.effect == "base-compliance":
            assert (p.effect, p.name) == (q.effect, f"B:{q.name}")
            for s, t in zip(p.terms, q.terms, strict=True):
                np.testing.assert_array_equal(s.driver, np.where(rows, t.driver, 0.0))


def test_a_single_session_has_no_such_form(two):
    alone = circumstances(two.sessions[0])
    ask = ("base-compliance@session",)
    refused("base-compliance@session has no parameters here", lambda: parameters_of(ask, alone))
    assert {v.setting for v in candidates(alone, USUAL).variants["base-compliance"]} == {None, "turned"}


def test_variants_pay_for_their_freedom(c):
    found = candidates(c, USUAL).variants["base-compliance"]
    own = [v for v in found if v.setting == "session"]
    assert [str(v.site) for v in own] == ["", "base of A", "base of B"]
    assert np.sum(np.exp([v.log_prior for v in found])) == pytest.approx(1.0)
    assert max(v.log_prior for v in own) < max(v.log_prior for v in found if v.setting is None)


def test_the_base_of_the_second_session_is_named(two):
    verdict = verdict_on(two)
    assert verdict.kind == "named"
    (name,) = verdict.named
    assert name.effect == "base-compliance"
    assert list(map(str, name.sites)) == ["base of B"]
    fitted = calibrated(Scene(two), (*USUAL, "base-compliance@session at base of B"))
    assert fitted.weights.scale["contact"] < 1.3


# --- Parts left out of a model: what they hold, what is refused, and that the diagnosis names them.

WITHOUT_LITTLE = {"contacts": 80, "later": 24, "repeats": 0, "spheres": 2, "placements": 2}


@pytest.fixture(scope="module")
def dataset():
    return plain(simulate(Options(**WITHOUT_LITTLE, seed=4)).dataset)


@pytest.fixture(scope="module")
def scene(dataset):
    return Scene(dataset)


def names(model, effect="geometry"):
    return {p.name for p in model.parameters if p.effect == effect}


@pytest.mark.parametrize(
    ("words", "gone"),
    [
        ("geometry at joint 4", {"theta4", "d4", "a4", "alpha4"}),
        ("geometry at link 4", {"a4", "alpha4"}),
        ("geometry at joint 2", {"theta2", "d2", "a2", "alpha2", "beta2"}),
        ("geometry at joint 1", {"a1", "alpha1"}),
    ],
)
def test_a_joint_has_its_link_with_it(words, gone, scene):
    whole, bare = build(scene, USUAL), build(scene, USUAL, FitOptions((Part.of(words),)))
    assert names(whole) - names(bare) == gone
    assert names(whole, "compliance") == names(bare, "compliance")
    assert names(build(scene, USUAL[1:], FitOptions((Part.of(words),))), "compliance")


def test_parts_are_candidates_each_and_together(scene):
    c = circumstances(scene)
    plain = candidates(c, USUAL)
    assert candidates(c, USUAL, ()).variants.keys() == plain.variants.keys()
    one = candidates(c, USUAL, [Part.of("geometry at joint 4")])
    assert set(one.variants) - set(plain.variants) == {"geometry"}
    (variant,) = one.variants["geometry"]
    assert {one.pool[k].name for k in variant.columns} == {"theta4", "d4", "a4", "alpha4"}
    assert (variant.site, variant.log_prior) == ("joint 4", 0.0)
    two = candidates(c, USUAL, parts_of(("geometry at joint 4", "geometry at link 3"), USUAL))
    every, *alone = two.variants["geometry"]
    assert every.site == "joint 4 and link 3"
    assert [v.site for v in alone] == ["joint 4", "link 3"]
    assert sorted(every.columns) == sorted(np.concatenate([v.columns for v in alone]))
    assert sum(np.exp(v.log_prior) for v in two.variants["geometry"]) == pytest.approx(1.0)
    assert [p.name for p in two.pool[: len(plain.pool)]] == [p.name for p in plain.pool]
    # a part keeps the setting of its effect
    known = candidates(c, (*USUAL, "gear-mesh@50"), [Part.of("gear-mesh at joint 3")])
    (variant,) = known.variants["gear-mesh"]
    assert (variant.setting, variant.site) == (50.0, "joint 3")
    drivers = [f"angle 3, {turns} times a turn" for turns in (50, 100)]
    assert [(str(site), str(driver)) for site, driver in variant.places] == [("joint 3", d) for d in drivers]


def test_what_was_taken_out_is_named_at_its_joints_and_shrinks_as_foreseen(dataset):
    without = ["geometry at joint 4", "compliance at joint 5"]
    found = bc.diagnose(dataset, without=", ".join(without))
    gap, record = found.data, json.loads(json.dumps(found.record, allow_nan=False))
    assert record["without"] == without
    assert record["baseline"] == list(USUAL)
    assert record["verdict"] == "named"
    places = sorted((n["effect"], n["site"]) for n in record["named"])
    assert places == [("compliance", "joint 5"), ("geometry", "joint 4")]
    assert min(record["probability"][name] for name in USUAL) > 0.99
    for s in gap.shrinkage:
        assert s.claimed
        assert s.before > 10 * s.after
        assert s.before == pytest.approx(s.predicted_before, rel=0.15)
        assert s.after < 1.6 * s.predicted
    # the model that is printed is the refit: without the parts that are not named
    assert {*record["refit"]["without"]} == {*without} - {n["model"] for n in record["named"]}
    fit = bc.fit(dataset, samples=0, **found.record["refit"])
    told = {a["parameters"][0]: a for a in record["amplitudes"]}
    assert "a4" in told
    for name in {"theta4", "d4", "a4", "alpha4"} & told.keys():
        a, row = told[name], fit.parameters.loc[name]
        factor = 1e3 if a["unit"] == "um" else 1.0
        assert a["value"] == pytest.approx(factor * (row.estimate - row.nominal), abs=0.1 * a["u"])


def test_nothing_wrong_there_is_not_named():
    """An arm whose geometry is as drawn: a joint goes back to the drawing, and nobody misses it."""
    drawn = simulate(Options(**WITHOUT_LITTLE, seed=4, effects=("compliance",))).dataset
    verdict = verdict_on(plain(drawn), FitOptions((Part.of("geometry at joint 4"),)))
    assert verdict.kind == "null"
    assert verdict.probability["geometry"] < 0.1


def test_every_parameter_may_be_named(scene):
    """As it is printed: the model lacks this one alone, and it is written and read as its name."""
    own = build(scene, USUAL).parameters
    for p in own:
        (part,) = parts_of((p.name,), USUAL, own)
        assert {q.name for q in own} - {q.name for q in kept(own, (part,))} == {p.name}
        assert (str(part), part.effect, part.site) == (p.name, p.effect, p.site)
        (again,) = parts_of((str(part),), USUAL)
        assert kept(own, (again,)) == kept(own, (part,))
    no_part = "`compliance J9` is not an effect at a site, and no parameter"
    refused(no_part, lambda: parts_of(("compliance J9",), USUAL, own))
    # what is kept and what is refused
    assert kept(own, ()) == own
    assert kept(own, [Part("bending", link(2))]) == own  # no such effect here: nothing to take
    refused("no parameters at `wrist`", lambda: kept(own, [Part.of("geometry at wrist")]))
    assert parts_of(("geometry  at  joint 4", "geometry at joint 4"), USUAL) == (Part("geometry", joint(4)),)
