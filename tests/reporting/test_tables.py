"""Tables of the terminal: at any width every figure is there in full."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from cases import terminal_text as printed

from bayescal.assess.agreement import Agreement, Pair
from bayescal.effects.common import STANDSTILL
from bayescal.effects.location import PROBE, face, joint, link
from bayescal.fitted.gate import NOTHING
from bayescal.gap.result import VALIDATION_POINTS, Verdict
from bayescal.planning.result import Detectable
from bayescal.reporting.check import joint_sheet
from bayescal.reporting.exports import compensation_summary
from bayescal.reporting.figures.where import drawn_curves
from bayescal.reporting.fit import MOST_DISTANCES, VALIDATION, _table, agreement_record, distance_table
from bayescal.reporting.fit.files import _labels
from bayescal.reporting.fleet import parameters
from bayescal.reporting.gap import _detectable, per_vector, phrases
from bayescal.reporting.gap.phrases import headline
from bayescal.reporting.gap.summary import _measured
from bayescal.reporting.motion.fit import replay_sheet
from bayescal.reporting.origin import _signs, entry, plain
from bayescal.reporting.page.common import _largest
from bayescal.reporting.page.svg import HEIGHT, prior_posterior, scatter
from bayescal.reporting.plan_sheets import clearances, further, gain, least_favourable, travel
from bayescal.reporting.plan_sheets import headline as plan_headline
from bayescal.reporting.sheet import Column, Sheet, frame, terminal
from bayescal.reporting.text import FigureTable, parameter_notes, size, with_u
from bayescal.storage.files import json_text

NAMES = ("nominal", "geometry + compliance + eccentricity of joint 3 + second-harmonic of joint 5", "x" * 90)
FIGURES = ("+1234.56", "-0.071(12)", "-1733 .. +1698", "(> 0.99)", "98.7654 %", "17.125")
HEADINGS = ("planes RMS", "distances RMS", "predicted 95 % interval", "probability", "within", "maximum")


def table(names) -> FigureTable:
    out = FigureTable("model level (µm)", *HEADINGS)
    for name in names:
        out.add_row(name, *FIGURES)
    out.caption = "a caption"
    return out


@pytest.mark.parametrize("width", [20, 40, 60, 80, 120, 200])
def test_no_figure_is_cut_off(width):
    text = printed(table(NAMES), width)
    for figure in FIGURES:
        assert text.count(figure) == len(NAMES)
    assert "…" not in text
    assert "..." not in text.replace(" .. ", "")
    assert max(map(len, text.splitlines())) <= width


def test_names_are_whole_when_their_pieces_are_joined():
    assert printed(table(NAMES), 100).count("x") == NAMES[1].count("x") + 90 + "maximum".count("x")


def test_a_table_that_fits_has_one_block_and_no_blank_line():
    lines = printed(table(("nominal", "geometry")), 120).rstrip().splitlines()
    assert all(line.strip() for line in lines)
    assert sum("nominal" in line for line in lines) == 1
    assert lines[-1].strip() == "a caption"


@pytest.mark.parametrize(("value", "u", "text"), [
    (0.02441, 0.00098, "0.02441(98)"),
    (0.02441, 0.000996, "0.0244(10)"),
    (300.0551, 0.0081, "300.0551(81)"),
    (12.34, 1.44, "12.3(1.4)"),
    (5317.0, 238.0, "5320(240)"),
    (-0.5, 0.0, "-0.5"),
])  # fmt: skip
def test_two_digits_of_the_uncertainty(value, u, text):
    assert with_u(value, u) == text


# --- Errors of points are lengths everywhere; figures are in the order of time and show what is significant.


def test_the_length_of_points_is_that_of_their_vectors():
    """Corners in images have two coordinates: their lengths were stated sqrt(3/2) times too large."""
    for count in (2, 3):
        errors = np.random.default_rng(0).standard_normal((count, 40))
        rms = float(np.sqrt(np.mean(errors**2)))
        lengths = np.linalg.norm(errors, axis=0)
        assert per_vector(VALIDATION_POINTS, count) * rms == pytest.approx(np.sqrt(np.mean(lengths**2)))
    assert per_vector("planes", 3) == per_vector("distances", 3) == 1.0


@pytest.mark.parametrize(("fitted", "count"), [((1, 2), 2), ((3,), 3), ((1,), 3)])
def test_the_coordinates_of_points_are_those_of_the_fitted_rows(fitted, count, monkeypatch):
    """Points that validate contacts are those of an instrument."""
    blocks = [SimpleNamespace(kind=SimpleNamespace(rows=rows)) for rows in fitted]
    monkeypatch.setattr(phrases, "length_blocks", lambda model: blocks)
    assert phrases.components(SimpleNamespace(calibrated=SimpleNamespace(model=None))) == count


def test_only_significant_curves_and_an_event_once():
    def drawn(*cells):
        curves = [{"site": s, "driver": d, "x": [0.0] * n, "event": d == "moment"} for s, d, _, n in cells]
        where = [{"site": s, "driver": d, "family_p_value": p} for s, d, p, _ in cells]
        return [c["site"] for c in drawn_curves({"curves": curves, "where": where})]

    first, again = ("base", "moment", 0.0, 5), ("tool", "moment", 0.0, 5)
    angle = ("joint 2", "angle", 1e-4, 5)
    chance, none = ("probe", "moment", 0.5, 5), ("joint 3", "angle", 0.0, 0)
    assert drawn(chance, first, again, none, angle) == ["base", "joint 2"]
    assert drawn(chance) == []


@pytest.mark.parametrize(("rms", "unknown", "words"), [
    (5e-6, 0.2, "explains these data"),
    (9e-6, 0.2, "validation points are larger"),
    (5e-6, 0.7, "noise only has probability 0.25"),
])  # fmt: skip
def test_the_headline_is_that_of_the_table(rms, unknown, words):
    sizes = {"rms": rms, "predicted_rms": 5e-6, "predicted_interval95": (3e-6, 7e-6)}
    measured = SimpleNamespace(what=VALIDATION_POINTS, **sizes)
    gap = SimpleNamespace(
        verdict=Verdict("null", (), {"null": 0.25, "unknown": unknown}, (), (), (), {}, ()),
        where=(),
        undetermined=(),
        arm=None,
        calibrated=None,
        scatter=None,
        masses="",
        magnitude=SimpleNamespace(noise=5e-6, noise_interval95=(4e-6, 6e-6), measured=(measured,)),
        dataset=SimpleNamespace(noise=SimpleNamespace(contact=None, point=5e-6)),
    )
    assert words in headline(gap)[0]


# --- Records as JSON text: that of the standard library, and arrays as lists.

RECORD = {
    "a": [1, 2.5, -1e-300, True, None, 'µ "x"\n'],
    "b": {"c": [], "d": {}, "e": [[1, 2], [], [3.0]], "f": [{"g": 1}, 2, ("h", [None])]},
    "": {1: "one", None: 2, 2.5: [0.1 + 0.2]},
    "text": "a, b",
    "number": np.float64(0.1),
}


@pytest.mark.parametrize("value", [RECORD, [], {}, [1.0], "x", None, [[[0]]]])
def test_text_is_that_of_the_standard_library(value):
    text = json.dumps(value, indent=1, allow_nan=False)
    assert json_text(value, rows=False) == text + "\n"
    assert json.loads(json_text(value)) == json.loads(text)


def test_a_list_of_numbers_is_on_one_line():
    text = '{\n "a": [\n  [ 1, -2.5e-07 ],\n  [\n   "x"\n  ]\n ]\n}\n'
    assert json_text({"a": [[1, -2.5e-7], ["x"]]}) == text


def test_a_number_that_is_not_finite_is_refused():
    with pytest.raises(ValueError):
        json_text({"a": [1.0, float("nan")]})


def test_arrays_become_lists_with_none_for_what_is_not_finite():
    values = np.array([[1.5, np.nan], [np.inf, -2.0]])
    lists = {"v": [[1.5, None], [None, -2.0]], "k": [0, 1], "b": [True], "t": ["a"]}
    assert plain({"v": values, "k": np.arange(2), "b": np.array([True]), "t": np.array(["a"])}) == lists
    assert {type(v) for row in plain(values) for v in row} == {float, type(None)}
    assert type(plain(np.arange(2))[0]) is int


def test_signs_of_motion():
    assert _signs(STANDSTILL * np.array([[2.0, -2.0, 0.0], [0.5, -0.5, 2.0]])) == ["+-0", "00+"]


# --- Numbers as text.


@pytest.mark.parametrize(("value", "unit", "words"), [
    (99.6e-6, "m", "100 µm"),
    (99.4e-6, "m", "99 µm"),
    (0.0123e-6, "m", "0.012 µm"),
    (4567e-6, "m", "4600 µm"),
    (np.inf, "m", "-"),
])  # fmt: skip
def test_size(value: float, unit: str, words: str) -> None:
    """Two significant digits, without an exponent where that is readable."""
    assert size(value, unit) == words


def test_u_of_a_compliance_does_not_contain_that_of_masses():
    assert len(parameter_notes(["geometry"])) == 1
    assert "masses" in parameter_notes(["geometry", "compliance"])[-1]


def test_one_table_for_terminal_and_pandas():
    columns = (Column("name", "n"), Column("value", "x", "{:.1f}".format), Column("of", len, words=True))
    sheet = Sheet(columns, [{"n": "a", "x": 1.25, "y": 0}, {"n": "b", "x": None}], style=lambda item: "dim")
    assert sheet.rows == (("a", "1.2", "3"), ("b", "-", "2"))
    assert (sheet.title, sheet.headings, sheet.words) == ("name", ("value", "of"), (2,))
    assert printed(terminal(sheet), 60).split() == ["name", "value", "of", "a", "1.2", "3", "b", "-", "2"]
    values = frame(sheet, "name")
    assert values.loc["a", "value"] == 1.25
    assert values["of"].tolist() == [3, 2]


def test_the_unit_of_a_key_is_that_of_its_value():
    result = SimpleNamespace(rms=2e-6, ends=(1e-3, 2e-3), free=(1, 2), u=float("nan"), count=3)
    fields = ("rms_um", "lengths_mm=ends", "free", "u_um", "number=count")
    assert entry(result, *fields) == {
        "rms_um": 2.0, "lengths_mm": [1.0, 2.0], "free": [1, 2], "u_um": None, "number": 3
    }  # fmt: skip


def test_a_face_named_as_a_joint_has_no_joint():
    """Labels of the draws are of sites, not of their names."""
    sites = (joint(2), link(1), face("joint 2"))
    scene = SimpleNamespace(dataset=SimpleNamespace(robot=SimpleNamespace(joint_names=("a", "b"))))
    parameters = [SimpleNamespace(site=site, effect="e") for site in sites]
    labels = _labels(SimpleNamespace(scene=scene, parameters=parameters, size=4))
    assert labels["joint"] == ("parameter", ["b", "a", "", ""])
    assert labels["effect"] == ("parameter", ["e", "e", "e", "target"])


def test_what_further_contacts_give_is_the_ratio_of_the_two_u_that_are_said():
    goal = SimpleNamespace(u=10e-6, count=3, over="volume of interest")
    measurements, nothing = SimpleNamespace(target=np.zeros(1, int)), SimpleNamespace(kind="plane")
    session = SimpleNamespace(measurements=measurements, targets=[nothing])
    pool = SimpleNamespace(setup=SimpleNamespace(noise_scale={}))
    plan = SimpleNamespace(expected=[goal], next_u=8e-6, equals_random=np.inf, session=session, pool=pool)
    (now, less), said = further(plan), next(plan_headline(plan))
    numbers = [float(text.split("U = ")[1].split()[0]) for text in (said, now)]
    assert numbers == [20.0, 16.0]
    assert less == f"{100 * (1 - numbers[1] / numbers[0]):.1f} % less"


def test_the_arm_waits_for_what_is_changed_after_the_beginning():
    measurements, targets = SimpleNamespace(target=np.zeros(1, int)), [SimpleNamespace(kind="plane")]
    session = SimpleNamespace(measurements=measurements, targets=targets)
    clearance = np.array([0.05, np.nan, 0.02])
    for changes, said in (
        (("mount ball", "", ""), ""),
        (("mount ball", "", "attach 2 kg", "mount b"), "twice"),
    ):
        about = {"changes": changes, "travel": 100.0, "order": "sweeps"}
        plan = SimpleNamespace(session=session, clearance=clearance, **about)
        assert (f"waits {said} for a change" in travel(plan)) if said else ("waits" not in travel(plan))
        assert "clearance 20.0 mm or more" in travel(plan)


def test_amplitudes_of_a_plan_are_those_of_random_contacts_times_what_is_said():
    """Each effect counts once; of its sites the table has that at which least is seen."""
    sizes = [(joint(1), 1e-5, 2e-5), (joint(2), 4e-5, 8e-5), (joint(3), 2e-5, 4e-5)]
    each = [Detectable("backlash", site, "rad", own, random, 1e-4) for site, own, random in sizes]
    each.append(Detectable("lobing", PROBE, "m", 3e-6, 3e-6, 1e-6))
    plan = SimpleNamespace(detectable=tuple(each))
    assert gain(plan) == pytest.approx(np.sqrt(0.5))
    assert [(d.effect, d.site) for d in least_favourable(plan)] == [("backlash", joint(2)), ("lobing", PROBE)]


def test_the_learnt_sd_of_a_fleet_is_stated_of_the_stated_one():
    entries = [
        {"name": "theta2", "unit": "deg", "stated_deviation": 0.0, "stated_sd": 0.1, "deviation": 0.02,
         "u_deviation": 0.01, "usual_sd": 0.03, "sd": 0.05, "effective_arms": 4.0}
    ]  # fmt: skip
    row = frame(parameters({"parameters": entries}), "parameter").iloc[0]
    assert row["of stated"] == pytest.approx(row["learnt sd"] / row["stated sd"])


def test_targets_without_solution_are_neither_inside_nor_outside():
    def result(reason="", inside=True, size=1.0):
        sizes = {"error": 1e-3 * size, "u": 1e-5 * size, "expanded": 2e-5 * size}
        return SimpleNamespace(reason=reason, inside=inside, **sizes)

    lost = result("out of reach", inside=False, size=np.nan)
    corrected = [result(), result(inside=False, size=4.0), result(), lost]
    targets = [SimpleNamespace(where=f"a.csv:{k}") for k in range(2, 6)]
    done = {"warning": "", "source": "a.csv", "frame": "base", "notes": (), "targets": targets}
    robot = SimpleNamespace(robot=SimpleNamespace(name="arm"))
    arm = SimpleNamespace(dataset=robot, effects=("geometry",), use=NOTHING)
    text = printed(compensation_summary(arm, SimpleNamespace(corrected=corrected, **done)), 150)
    for said in (
        "4 targets", "mean 2.000 mm, maximum 4.000 mm", "u of a point 10 µm (median), 40 µm (maximum)",
        "U 20 µm (median, 95 %)", "1 of 3 targets are outside", "a.csv:5: out of reach",
    ):  # fmt: skip
        assert said in text


def test_a_drawn_parameter_is_where_it_is_beside_its_prior():
    """Zero to 2.5 prior standard deviations on either side, in proportion; the band ends at two."""

    def drawn(estimate):
        text = str(prior_posterior((1.0, 0.5), (0.0, 2.0), estimate))
        low, width = re.search(r'class="band" x="([-\d.]+)" y="2" width="([-\d.]+)"', text).groups()
        return float(re.search(r'cx="([-\d.]+)"', text)[1]), float(low), float(low) + float(width)

    middle, low, high = drawn(1.0)
    assert (low + high) / 2 == pytest.approx(middle, abs=0.1)
    for sds in (-2.5, -2.0, -0.5, 1.0, 2.0, 2.5):
        assert drawn(1.0 + 0.5 * sds)[0] - middle == pytest.approx(sds * (high - middle) / 2.0, abs=0.15)


def test_a_measured_error_is_within_where_it_is_between_the_ends():
    sizes = {"what": "validation contacts", "count": 9, "predicted_rms_um": 5.0}
    sizes |= {"predicted_interval95_um": [3.0, 7.0]}
    every = [sizes | {"rms_um": rms} for rms in (2.9, 3.0, 5.0, 7.0, 7.1)]
    rows = _measured({"gap": {"measured": every}, "lengths": {"components": 3}}).rows
    assert [str(row[-1]) for row in rows] == ["outside", "within", "within", "within", "outside"]


def test_the_largest_residuals_are_those_of_either_sign_and_unknown_ones_are_last():
    residuals = [4.0, None, -30.0, 10.0, -0.5]
    rows = {"id": list("abcde"), "residual_um": residuals, "rejected": [False] * 5, "time_s": None}
    rows |= {key: [""] * 5 for key in ("target", "role", "direction")}
    assert [row[0] for row in _largest(SimpleNamespace(rows=rows, refitted=False)).rows] == list("cdaeb")


def test_errors_of_a_replay_are_below_their_arm_and_unit():
    rng = np.random.default_rng(0)
    names = ("nominal", "model", "effects")
    arms = {name: SimpleNamespace(rms=rng.uniform(size=2), torque=rng.uniform(size=2)) for name in names}
    found = frame(replay_sheet(("a", "b"), arms), "open-loop replay of the commands (RMS)")
    words = {"nominal": "nominal", "model": "fitted", "effects": "with the effects"}
    for name, of in arms.items():
        degrees = found[f"{words[name]}, deg"].astype(float).tolist()
        assert degrees == pytest.approx(np.degrees(of.rms), rel=6e-3)
        assert found[f"{words[name]}, N m"].astype(float).tolist() == pytest.approx(of.torque, rel=6e-2)


def test_estimates_of_sessions_are_below_their_session():
    """In the table as in the record, in the unit of the parameter."""
    rng = np.random.default_rng(1)
    said = {name: (rng.uniform(1.0, 2.0, 2), rng.uniform(0.1, 0.2, 2)) for name in ("first", "second")}
    together = rng.uniform(3.0, 4.0, 2), np.array([0.05, 0.06])
    pair = Pair(("first", "second"), np.array([1.0, -4.0]), 17.0, 2, 0.5)
    compared = Agreement(("a2", "theta2"), ("m", "rad"), together, said, (pair,), {})
    found, record = frame(_table(compared), "parameter by session"), agreement_record(compared)
    for k, factor in enumerate((1e3, 180.0 / np.pi)):
        row, entry_ = found.iloc[k], record["parameters"][k]
        for name, (value, sd) in {**said, "together": together}.items():
            assert row[name] == with_u(factor * value[k], factor * sd[k])
            of = entry_["together"] if name == "together" else entry_["alone"][name]
            assert (of["estimate"], of["sd"]) == pytest.approx((factor * value[k], factor * sd[k]))
        assert row["difference / u"] == f"{abs(pair.apart[k]):.1f}"
    assert record["pairs"][0]["apart_sd"] == {"a2": 1.0, "theta2": -4.0}


def test_of_an_effect_the_most_harmful_place_is_told():
    """Blind spots are in the order of their harm."""

    def spot(effect, site, value):
        sizes = {"smallest_nameable": {"value": value, "unit": "urad"}, "plausible": {"value": 30.0}}
        return {"effect": effect, "site": site, **sizes}

    given = (("backlash", "joint 2", 50.0), ("lobing", "probe", 1e9), ("backlash", "joint 5", 9.0))
    spots = [spot(*values) for values in given]
    assert _detectable({"blind_spots": spots}) == {
        "backlash": "50 µrad, joint 2", "lobing": "not detectable, the probe"
    }  # fmt: skip


def test_the_distances_in_the_terminal_have_the_largest_errors_of_either_sign():
    every = [{"number": k, "calibrated_error_um": (-1) ** k * (k + 1.0)} for k in range(MOST_DISTANCES + 6)]
    assert [d["number"] for d in distance_table(every, False).items] == list(range(6, MOST_DISTANCES + 6))
    assert list(distance_table(every, True).items) == every


def test_no_clearance_is_stated_larger_than_it_is():
    true = np.array([0.01234, 5e-5, 0.1, 0.00999, np.nan])
    text = clearances(SimpleNamespace(clearance=true, purpose=("", "") * 2))
    assert text[-1] == ""
    off = 1e3 * true[:-1] - np.array(text[:-1], float)
    assert np.all((off > -1e-9) & (off < 0.1))
    assert clearances(SimpleNamespace(clearance=np.zeros(0), purpose=("a", "b"))) == ["", ""]


def test_angles_of_tables_have_no_exponent():
    """0.34 deg was printed as 3.4e+02 mdeg."""
    (text,) = (text for kind, _, _, text in VALIDATION if kind == "turns")
    assert [text(np.radians(angle)) for angle in (0.338, 0.0171)] == ["340", "17"]


def test_joints_of_a_log_are_in_the_units_of_their_headings():
    delays = {key: {"value": None, "u": None} for key in ("torque", "velocity", "position_after_command")}
    j = {"name": "J1", "range_deg": [-90.0, 45.0], "fastest_rad_per_s": 1.5, "at_rest": 0.25, "slow_s": 3.0,
         "delay_ms": delays, "tracking_rms_deg": 0.02, "velocity_cutoff_Hz": 40.0,
         "torque_filtered_above_Hz": 60.0}  # fmt: skip
    sheet = joint_sheet({"joints": [j]})
    cells = {c.heading: c.cell(j) for c in sheet.columns}
    assert cells["at rest / %"] == "25"
    assert cells["range / deg"] == "-90 to 45"
    assert cells["fastest / rad/s"] == "1.50"


def test_what_is_off_scale_stands_at_its_end():
    x, y = np.array([1.0, 2.0]), np.array([3.0, -3.0])
    text = str(scatter([("dot", x, y)], ("row", "residual"), None, "residuals", (-2.0, 2.0)))
    up, down = (float(place) for place in re.findall(r'class="beyond" d="[^"]* ([-\d.]+)Z', text))
    assert up < 0.1 * HEIGHT < 0.6 * HEIGHT < down
