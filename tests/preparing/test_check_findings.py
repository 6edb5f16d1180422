"""Every odd or missing thing that is put into a good session is found, and nothing else."""

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from cases import ROOT, cases, refused
from typer.testing import CliRunner

import bayescal as bc
from bayescal.dataset import read_dataset
from bayescal.dataset.consistency import copies
from bayescal.dataset.join import joined
from bayescal.dataset.read import read_parts
from bayescal.dataset.schema import NoiseEntry
from bayescal.preparing.check import check, check_record, odd
from bayescal.preparing.missing import _roles

JOINTS = [f"j{k}_deg" for k in range(1, 7)]


def simulated(folder: Path, spheres: int) -> tuple[str, list[dict]]:
    """Settings and rows of a simulated session without any finding."""
    bc.simulate(contacts=120, later=8, repeats=5, spheres=spheres, placements=1, seed=1).save(folder)
    rows = list(csv.DictReader(io.StringIO((folder / "measurements.csv").read_text())))
    return (folder / "dataset.yaml").read_text(), rows


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("check") / "good", spheres=1)


@pytest.fixture(scope="module")
def with_two_spheres(tmp_path_factory):
    """Also a certified distance, and a sphere that validates where the other does not."""
    return simulated(tmp_path_factory.mktemp("check") / "two", spheres=2)


def found(folder: Path, settings: str, rows: list[dict]) -> list:
    write(folder, settings, rows)
    return list(check(folder).findings)


def write(folder: Path, settings: str, rows: list[dict]) -> None:
    (folder / "dataset.yaml").write_text(settings)
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (folder / "measurements.csv").write_text(text.getvalue())


def changed(rows: list[dict], columns, change, which=lambda row: True) -> list[dict]:
    """Rows with the numbers of some columns changed."""
    return [row | {c: f"{change(float(row[c])):.9g}" for c in columns} if which(row) else row for row in rows]


def without(rows: list[dict], pattern: str) -> list[dict]:
    return [{c: v for c, v in row.items() if not re.fullmatch(pattern, c)} for row in rows]


def some(rows: list[dict], number: int, **cells) -> list[dict]:
    """Rows with one of them changed."""
    return [*rows[:number], rows[number] | cells, *rows[number + 1 :]]


def planes(settings: str, rows: list[dict], *names: str) -> tuple[str, list[dict]]:
    """The session on some targets alone, without certificates of others."""

    def wanted(line: str) -> bool:
        if line.startswith("  - "):
            return set(re.findall(r"(?:cube|ball)\.[^,\]} ]+", line)) <= {*names}
        return not re.match(r"  (cube|ball)\.", line) or line.partition(":")[0].strip() in names

    text = "\n".join(filter(wanted, settings.splitlines())).replace("certificates:\ntemp", "temp")
    return text + "\n", [row for row in rows if row["target"] in names]


def test_a_good_session_has_no_findings(tmp_path, good, with_two_spheres):
    assert found(tmp_path, *good) == []
    assert found(tmp_path, *with_two_spheres) == []


def test_the_example_has_no_findings():
    assert check(ROOT / "data" / "lrmate200ic-cube").findings == ()


AGAIN, HELD = {"id": "again", "time_s": "1e6"}, {"role": "validate"}
CELLS = {
    "radians": (lambda r: changed(r, JOINTS, np.radians), {"units"}, "look like radians"),
    "a joint in radians": (lambda r: changed(r, ["j2_deg"], np.radians), {"units"}, "`j2_deg` look like"),
    "sign": (lambda r: changed(r, ["j3_deg"], lambda v: -v), {"convention"}, "J3 has the opposite sign"),
    "zero of J2": (lambda r: changed(r, ["j2_deg"], lambda v: v + 90), {"convention"}, "zero of J2 differs"),
    "zero of J5": (lambda r: changed(r, ["j5_deg"], lambda v: v - 90), {"convention"}, "zero of J5 differs"),
    "coupling": (lambda r: coupled(r), {"convention"}, "J3 is coupled to J2"),
    "exchanged columns": (lambda r: swapped(r), {"convention"}, "`j4_deg` and `j6_deg` are interchanged"),
    "beyond a limit": (lambda r: some(r, 7, j1_deg="200"), {"limits"}, "J1 is at 200 deg"),
    "impossible row": (lambda r: turned(r, 7), {"impossible_row"}, "impossible contact"),
    "copy of a row": (lambda r: [*r, r[20] | AGAIN], {"doubled_row"}, "row `again` has"),
    "few digits": (lambda r: changed(r, JOINTS, lambda v: np.round(v, 2)), {"rounded_readings"},
                   "steps of up to 0.01 deg"),
    "clock": (lambda r: some(r, 30, time_s="0"), {"clock"}, "goes back by"),
    "no validation": (lambda r: [row for row in r if row["role"] != "validate"],
                      {"no_validation", "unused_target"}, "no row has the role `validate`"),
    "no repeats": (lambda r: without(r, "repeat"), {"no_repeats"}, "no contact is repeated"),
    "no velocities": (lambda r: without(r, "j._degps"), {"no_velocities"}, "no joint velocities"),
    "few rows": (
        lambda r: [row for k, row in enumerate(r) if row["role"] == "validate" or row["repeat"] or k % 2],
        {"few_rows"}, "values to fit"),
    "nothing to fit": (lambda r: [row | HELD for row in r], {"too_few"}, "no row has the role `calibrate`"),
}  # fmt: skip
"""A change of the rows, the codes of its findings, words of one of them."""


def swapped(rows: list[dict]) -> list[dict]:
    return [row | {"j4_deg": row["j6_deg"], "j6_deg": row["j4_deg"]} for row in rows]


def coupled(rows: list[dict]) -> list[dict]:
    """Readings of J3 against the floor as those of an axis that is not coupled."""
    return [row | {"j3_deg": f"{float(row['j3_deg']) + float(row['j2_deg']):.9g}"} for row in rows]


def turned(rows: list[dict], number: int) -> list[dict]:
    """A row in which a joint stands elsewhere."""
    return some(rows, number, j1_deg=f"{float(rows[number]['j1_deg']) + 15:.6f}")


@pytest.mark.parametrize("name", CELLS)
def test_rows(tmp_path, good, name):
    change, codes, words = CELLS[name]
    findings = found(tmp_path, good[0], change(good[1]))
    assert {f.code for f in findings} == codes, findings
    assert any(re.search(re.escape(words), f.what) for f in findings)
    assert all(f.remedy and f.where.startswith(("measurements.csv", "dataset.yaml")) for f in findings)


def test_few_contacts_of_one_of_two_spheres(tmp_path, with_two_spheres):
    settings, rows = with_two_spheres
    few = [row for row in rows if row["target"] == "ball.A@1"][:3]
    (finding,) = found(tmp_path, settings, [row for row in rows if row["target"] != "ball.A@1" or row in few])
    assert finding.code == "few_on_sphere"
    assert "fewer than 4 contacts to validate `ball.A@1`" in finding.what


def test_as_many_contacts_as_a_finding_asks_for_locate_a_sphere(tmp_path, good):
    """What is advised, and no more, ends the finding."""
    on_it = [row["id"] for row in good[1] if row["target"] == "ball.A@1"]

    def said(count: int) -> list[str]:
        write(tmp_path, good[0], [row for row in good[1] if row["id"] not in on_it[count:]])
        return [f.remedy for f in _roles(read_parts(tmp_path)[0]) if f.code == "few_on_sphere"]

    (remedy,) = said(3)
    asked = int(re.search(r"measure (\d+) or more", remedy)[1])
    assert asked > 3
    assert said(asked) == []


KEYS = cases("check_findings")
"""What is replaced in dataset.yaml, by what, the codes of the findings, words of one of them."""


@pytest.mark.parametrize("name", KEYS)
def test_settings(tmp_path, good, name):
    old, new, codes, words = KEYS[name]
    settings = re.sub(old, new, good[0])
    assert settings != good[0]
    findings = found(tmp_path, settings, good[1])
    assert {f.code for f in findings} == set(codes), findings
    assert any(words in f.what for f in findings)


def test_names_that_differ_in_case(tmp_path, good):
    entry = re.search(r"  cube.\+z: .*\n", good[0])[0]
    settings = good[0].replace(entry, entry + entry.replace("cube.+z", "Cube.+z"))
    own = [k for k, row in enumerate(good[1]) if row["target"] == "cube.+z"][::2]
    rows = [row | {"target": "Cube.+z"} if k in own else row for k, row in enumerate(good[1])]
    (finding,) = found(tmp_path, settings, rows)
    assert finding.code == "similar_names"
    assert finding.where == f"dataset.yaml:{settings[: settings.index('Cube.+z')].count(chr(10)) + 1}"


@pytest.mark.parametrize("faces", [("cube.+z",), ("cube.+y", "cube.-y")])
def test_planes_of_one_direction(tmp_path, good, faces):
    settings, rows = planes(*good, *faces)
    codes = {f.code for f in found(tmp_path, settings, rows)}
    assert "parallel_planes" in codes
    assert codes <= {"parallel_planes", "no_length", "few_rows", "no_repeats", "not_identifiable"}


def test_one_configuration(tmp_path, good):
    """Rows of one contact, repeated: no joint moves, and the flange has one direction."""
    rows = changed(good[1], JOINTS, lambda v: v)
    first = rows[0]
    rng = np.random.default_rng(0)
    near = [
        row | {c: f"{float(first[c]) + rng.normal(0, 0.3):.6f}" for c in JOINTS} | {"target": first["target"]}
        for row in rows if row["role"] == "calibrate"
    ]  # fmt: skip
    findings = found(tmp_path, good[0], near + [r for r in rows if r["role"] == "validate"])
    assert {"not_identifiable", "parallel_planes"} <= {f.code for f in findings}
    (poses, *_) = [f for f in findings if f.code == "not_identifiable"]
    assert "the poses are too much alike" in poses.what
    assert poses.remedy.startswith("measure in poses over most of the range of every joint")


def test_the_diameter_that_contacts_show_is_that_of_the_sphere_without_the_ball(tmp_path, good):
    """Near the true 50.8 mm, by what the nominal arm is off; a ball of radius r takes 2 r from it."""
    wrong, shown = good[0].replace("diameter_mm: 50.8}", "diameter_mm: 120}", 1), []
    for radius in (3, 5.5):
        write(tmp_path, wrong.replace("ball_radius_mm: 3", f"ball_radius_mm: {radius}"), good[1])
        (what,) = (f.what for f in odd(*read_parts(tmp_path)) if f.code == "diameter")
        shown.append(float(what.rpartition(" ")[2]))
    assert shown[0] == pytest.approx(50.8, abs=3.0)
    assert shown[0] - shown[1] == pytest.approx(5.0, abs=0.11)


def test_where_is_the_line_and_the_id(tmp_path, good):
    (finding,) = found(tmp_path, good[0], some(good[1], 30, time_s="0"))
    assert finding.where == f"measurements.csv:32 (`{good[1][30]['id']}`)"


def test_what_cannot_be_read_is_refused(tmp_path, good):
    refused("is given twice", lambda: found(tmp_path, good[0], [*good[1], good[1][0]]))


def test_effects_that_need_a_column(tmp_path, good):
    found(tmp_path, good[0], without(good[1], "j._degps"))
    result = check(tmp_path)
    assert {"backlash", "latency"} <= set(result.not_assessed)
    assert "j1_degps" in result.not_assessed["backlash"]
    assert "eccentricity" in result.assessed
    assert "gear-mesh" in result.assessed  # its ratio is not stated: many are screened


PER_UNIT = {"mm": 1e3, "um": 1e6, "urad": 1e6, "deg": 180 / np.pi}


def test_values_of_the_record_are_in_their_units(tmp_path, with_two_spheres):
    """All that the dataset states of noise and certificates, by the names of their keys."""
    settings, rows = with_two_spheres
    flat = "certificates:\n  - {kind: flat, target: cube.+z, u_form_mm: 0.0025}\n"
    noise = "noise:\n  slide_mm: 0.003\n  orientation_deg: 0.01\n"
    write(tmp_path, settings.replace("certificates:\n", flat).replace("noise:\n", noise), rows)
    data, record = read_dataset(tmp_path), check_record(check(tmp_path))
    kinds = set()
    for entry, stated in zip(record["certificates"], data.certificates, strict=True):
        values = {key.rpartition("_")[::2]: v for key, v in entry.items() if key not in ("kind", "targets")}
        for (stem, unit), value in values.items():
            si = getattr(stated, "u_distance" if stem == "u" else stem)
            assert value == pytest.approx(PER_UNIT[unit] * si), (entry, stem)
        some = [getattr(stated, k) for k in ("distance", "u_distance", "u_angle", "u_form")]
        assert len(values) == sum(v is not None for v in some)
        kinds.add(stated.kind)
    assert kinds == {"flat", "parallel", "perpendicular", "diameter", "distance"}
    assert set(record["noise"]) == set(NoiseEntry.model_fields)
    for key, value in record["noise"].items():
        stem, _, unit = key.rpartition("_")
        si = getattr(data.noise, stem)
        assert value == (None if si is None else pytest.approx(PER_UNIT[unit] * si))


def test_command_line_and_api(tmp_path, good):
    from bayescal.cli import app

    found(tmp_path, good[0], without(good[1], "repeat"))
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "no contact is repeated" in " ".join(done.output.split())
    done = CliRunner().invoke(app, ["check", str(tmp_path), "--to", "json"])
    record = json.loads(done.output)
    assert CliRunner().invoke(app, ["check", str(tmp_path), "--json"]).output == done.output  # earlier name
    assert record["rows"]["calibrate"] == 120
    result = bc.check(tmp_path)
    assert result.record == record
    assert list(result.findings["code"]) == ["no_repeats"]
    assert "1 missing" in repr(result)


@pytest.mark.parametrize(("stated", "column", "words"), [
    ("arm", True, "temperature of the arm"),
    ("", True, "temperatures of arm or air (`temperature_of` does not say which)"),
    ("arm", False, "no temperatures"),
])  # fmt: skip
def test_what_is_known_of_temperatures(tmp_path, good, stated, column, words):
    settings = good[0] if stated else good[0].replace("temperature_of: arm\n", "")
    write(tmp_path, settings, good[1] if column else without(good[1], "temperature_c"))
    assert f"; {words} model" in " ".join(str(bc.check(tmp_path)).split())


def test_a_fit_of_copied_rows_says_so(tmp_path, good):
    """`check` finds copies; who does not run it must read of them all the same."""
    settings, rows = good
    once = [row for row in rows if row["role"] == "calibrate" and not row["repeat"]]
    copied = [row | {"id": f"z{row['id']}"} for row in once]
    found(tmp_path, settings, [*rows, *copied])
    words = [f.text for f in bc.fit(tmp_path, samples=0).data.findings if f.code == "doubled_row"]
    assert len(words) == 1
    assert f"{len(copied)} of {len(rows) + len(copied)} rows have the values of another row" in words[0]
    assert copies(read_dataset(tmp_path)) == words[0]


def test_rows_of_two_sessions_with_the_same_digits_are_copies(tmp_path, good):
    """Another name makes another SHA-256, not another measurement."""
    sessions = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        found(tmp_path / name, good[0].replace("name: ", f"name: {name}-"), good[1])
        sessions.append(read_dataset(tmp_path / name))
    assert copies(sessions[0]) == ""
    assert copies(joined(sessions)).startswith(f"{len(good[1])} of {2 * len(good[1])} rows")


def test_the_exit_code_is_that_of_a_fit(tmp_path, good):
    """1 wherever `fit` would refuse, by a finding `refused by fit`; 0 of other findings is above."""
    from bayescal.cli import app

    write(tmp_path, good[0], changed(good[1], JOINTS, np.radians))
    done = CliRunner().invoke(app, ["check", str(tmp_path), "--to", "json"])
    assert done.exit_code == 1
    assert "refused" in {f["kind"] for f in json.loads(done.output)["findings"]}
