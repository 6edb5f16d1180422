"""Lines, tables and files of records that are made up: each number is there, from where it should be."""

import csv
import re
from types import SimpleNamespace

import numpy as np
import pytest
from influences import check_written, unseen

from bayescal.reporting import check, comparison, fleet, motion, watch
from bayescal.reporting.gap import table_of_contacts
from bayescal.reporting.origin import hand_eye_lines
from bayescal.reporting.page import Run, build
from bayescal.watching.update import Contact


def run(name, errors, values, **expected):
    """A run of `fit`: errors of distances, µm, and estimates with u."""
    usual = {"effect": "geometry", "unit": "mm"}
    parameters = [{"name": key, "estimate": value, "sd": sd, **usual} for key, (value, sd) in values.items()]
    record = {
        "dataset": {"name": name, "sha256": name}, "robot": "arm", "parameters": parameters,
        "predicted_distance": {"over": "centres", **expected},
        "validation": {"distances": [{"calibrated_error_um": error} for error in errors]},
    }  # fmt: skip
    return Run("fit", record, name)


def test_runs_side_by_side_have_their_own_numbers():
    said = {"count": 3, "predicted_rms_um": 21.0, "expanded_U_um": 42.0, "measured_rms_um": 17.0}
    values = {"a2": (300.5, 0.03), "d4": (80.25, 0.01)}, {"a2": (300.8, 0.04), "d4": (80.0, 0.5)}
    runs = run("one", (12.0, -31.0, 5.0), values[0], **said), run("two", (-7.0, 9.0), values[1], **said)
    (table,) = build.distances(runs).context["blocks"]
    cells = {c.heading: [c.cell(item) for item in table.items] for c in table.columns}
    assert [float(x) for x in cells["maximum (µm)"]] == [31.0, 9.0]
    for heading, key in (("U = k u (µm)", "expanded_U_um"), ("expected RMS (µm)", "predicted_rms_um")):
        assert [float(x) for x in cells[heading]] == [said[key]] * 2
    (table,) = build.parameters(runs).context["blocks"]
    for row in table.rows:
        (first, u_first), (second, u_second) = (of[row[0].split()[0]] for of in values)
        *_, difference, ratio = row
        u = np.sqrt(u_first**2 + u_second**2)
        value, _, inside = difference.partition("(")
        assert float(value) == pytest.approx(second - first, abs=0.51 * u)
        decimals = len(value.partition(".")[2])
        size = inside.rstrip(")")
        stated = float(size) if "." in size else float(size) * 10.0**-decimals
        assert stated == pytest.approx(u, rel=0.05)
        assert float(ratio.text) == pytest.approx(abs(second - first) / u, abs=0.051)


def test_every_number_of_a_contact_is_said_while_it_is_watched():
    odd = Contact(11, "c11", "cube.+x", "calibrate", 31e-6, 4e-6, 2e-9, 55e-6)
    assert odd.odd
    assert not unseen(lambda contact: watch.line(contact), odd, "")


def test_compared_methods_have_the_errors_of_their_headings():
    sizes = {
        "contacts": {"rms": 11e-6}, "distance_errors": {"rms": 12e-6, "maximum": 13e-6},
        "point_lengths": {"rms": 14e-6, "mean": 15e-6, "maximum": 16e-6},
    }  # fmt: skip

    def record(given):
        errors = {key: SimpleNamespace(**of) for key, of in given["validation"].items()}
        result = SimpleNamespace(distance_sd=given["distance_sd"], validation=SimpleNamespace(**errors))
        return {key: 1e6 * value(result) for key, (_, value) in comparison.COLUMNS.items()}

    names = {"contacts": "planes", "distance_errors": "distances", "point_lengths": "points"}
    short = {size: size.replace("maximum", "max") for of in sizes for size in sizes[of]}
    called = {f"{of}.{size}": f"{names[of]}_{short[size]}" for of in sizes for size in sizes[of]}
    given = {"validation": sizes, "distance_sd": 17e-6}
    check_written(record, given, but="", called=called, units={"": lambda x: 1e6 * x})


def test_the_roles_of_a_log_are_counted():
    kinds = {"kind": "", "duration_s": 12.0}
    kept = [("calibrate", "m0", 0.0)] * 2 + [("calibrate", "m2", 1.5), ("validate", "m3", 0.0)]
    keys = ("role", "same_as", "payload_kg")
    motions = [{"id": f"m{k}", **dict(zip(keys, row, strict=True)), **kinds} for k, row in enumerate(kept)]
    record = {
        "torque": {"kind": "motor", "signed": True}, "columns": ["q"], "motions": motions, "rows": 1234,
        "stamps": {"jitter": 0.013, "step_ms": 2.5, "longest_ms": 7.5}, "temperature_range_K": 3.5,
        "assumed": [], "assessed": [], "not_assessed": {},
    }  # fmt: skip
    of = SimpleNamespace(findings=())
    said = {heading: text for heading, text, _ in check._log_lines(of, record)}
    counted = {role: list(map(int, re.findall(r"\d+", said[role]))) for role in ("calibrate", "validate")}
    assert counted == {"calibrate": [3, 36, 1, 1], "validate": [1, 12, 0, 0]}  # motions, s, repeats, loaded
    numbers = {key: record[key] for key in ("rows", "stamps", "temperature_range_K")}
    assert not unseen(lambda numbers: check._log_lines(of, record | numbers), numbers, "")


def test_the_place_of_a_camera_is_said_with_both_uncertainties():
    """The largest of each."""
    place = {
        "parent": "flange", "child": "camera", "translation_mm": [1.0, 2.0, 3.0],
        "quaternion_xyzw": [0.1, 0.2, 0.3, 0.9], "u_translation_mm": [0.1, 0.4, 0.2],
        "u_rotation_deg": [0.011, 0.012, 0.033],
    }  # fmt: skip
    ((_, said, _),) = hand_eye_lines({"hand_eye": [{"on_flange": place}]})
    assert said.endswith("u 0.4 mm, 0.033 deg")


@pytest.mark.parametrize("bare", [0, 1])
def test_contacts_of_an_advice_come_back_from_their_file(bare):
    """Of which some state neither load nor motion."""
    contacts = [
        {"id": f"next-1-00{k}", "target": "cube.+x", "tool": "ball", "j_deg": [1.0 + k, -2.5, 3.25],
         "j_degps": [0.5, -0.25, 1.0 + k], "payload_kg": 2.5 - k, "repeat_of": "c7" * k}
        for k in range(2)
    ]  # fmt: skip
    contacts[bare] |= {"j_degps": None, "payload_kg": None}
    for row, contact in zip(csv.DictReader(table_of_contacts(contacts).splitlines()), contacts, strict=True):
        for key in ("id", "target", "tool", "repeat_of"):
            assert row[key] == contact[key]
        assert [float(row[f"j{j}_deg"]) for j in (1, 2, 3)] == contact["j_deg"]
        speed = [row[f"j{j}_degps"] for j in (1, 2, 3)]
        assert (list(map(float, speed)) if any(speed) else None) == contact["j_degps"]
        assert (float(row["payload_kg"]) if row["payload_kg"] else None) == contact["payload_kg"]


def test_the_band_of_residuals_is_twice_the_expected_one(monkeypatch):
    """As the legend says."""
    drawn = []
    monkeypatch.setattr(
        motion.svg, "scatter", lambda dots, labels, band, *_: drawn.append((dots, band)) or ""
    )
    floor, rest = [0.25, 0.5], [0.1, -0.2, 0.3]
    record = {
        "withheld": {"motion": "m3", "time_s": [1.0, 2.0, 3.0], "before_Nm": [rest] * 2},
        "unit": "Nm", "named": [], "joints": ["J1", "J2"], "noise": {"floor_Nm": floor},
    }  # fmt: skip
    figures, legend = motion._course(record)
    assert "Grey band: twice the expected residual" in legend.text
    assert [band for _, band in drawn] == [2.0 * x for x in floor]
    assert len(figures.drawings) == 2


def test_an_arm_of_a_fleet_has_the_uncertainty_of_its_last_session():
    values = ((50.0, 20.0), (40.0, 10.0))
    sizes = [{"expanded_U_um": expanded, "measured_rms_um": rms} for expanded, rms in values]
    about = {"arm": "a", "robot": "ur5e", "effects": []}
    sessions = [{"session": f"s{k}", "fit": of, **about} for k, of in enumerate(sizes)]
    model = SimpleNamespace(arms=("a",), robot="ur5e", unlike=(), changed=(), gains={"a": 3.0})
    (arm,) = fleet._arms(sessions, (model,))
    assert {key: arm[key] for key in sizes[1]} == sizes[1]
    assert arm["sessions"] == ["s0", "s1"]
