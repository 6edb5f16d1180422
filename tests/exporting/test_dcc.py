"""Digital Calibration Certificates: valid, with the numbers of the budgets, and with nothing invented."""

import os
from pathlib import Path
from xml.etree import ElementTree

import foreign
import pytest
from cases import DATA, cases, file_text, without_draws

import bayescal as bc
from bayescal.assess.budget import budget
from bayescal.assess.conformance import iso9283
from bayescal.assess.measurand import distance, parameter
from bayescal.exporting.dcc import DCC, SI, dcc, in_digits, read_entries

OURS = DATA / "dcc" / "dcc.xsd"
OFFICIAL = Path(os.environ.get("BAYESCAL_DCC_XSD", foreign.SHARED / "dcc" / "dcc.xsd"))
ENTRIES = file_text("certificate.yaml")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "fit"
    session = bc.simulate(contacts=45, later=4, repeats=2, spheres=2, placements=1, seed=1)
    with without_draws():
        bc.fit(session, samples=0).save(folder, pictures=False)
    return folder


@pytest.fixture
def entries(tmp_path):
    path = tmp_path / "certificate.yaml"
    path.write_text(ENTRIES)
    return path


def test_valid_and_equal_to_the_budgets(run, entries, tmp_path, error_of, output_of):
    out = tmp_path / "arm.xml"
    arguments = ("export", run, "--to", "dcc", "--certificate", entries, "--out", out)
    assert "valid by" in output_of(*arguments, "--schema", OURS)
    root = ElementTree.parse(out).getroot()
    assert "Laboratory <of> lengths & angles" in [e.text for e in root.iter(f"{{{DCC}}}content")]
    found = {q.find(f"{{{DCC}}}name/{{{DCC}}}content").text: q for q in root.iter(f"{{{DCC}}}quantity")}
    compliance = r"\radian\newton\tothe{-1}\metre\tothe{-1}"
    basis = bc.budget(run).basis
    for asked, name, unit in (
        (distance(basis, ("ball.A@1", "ball.B@1")), "error of the distance ball.A@1 - ball.B@1", r"\metre"),
        (parameter(basis, "a2"), "parameter a2", r"\metre"),
        (parameter(basis, "compliance J3"), "parameter compliance J3", compliance),
    ):
        of, own = budget(basis, asked), found[name]
        value, u = in_digits(of.measurand.value, of.expanded)
        assert own.findtext(f".//{{{SI}}}value") == value
        assert own.findtext(f".//{{{SI}}}unit") == unit
        assert own.findtext(f".//{{{SI}}}valueExpandedMU") == u
        assert float(own.findtext(f".//{{{SI}}}coverageFactor")) == pytest.approx(of.k, abs=0.005)
    for f in iso9283(basis).figures:
        for what, value, u in (("mean", f.mean, f.u), ("maximum", f.maximum, f.u_max)):
            own = found[f"{f.symbol}: {f.words}, {what} of {f.count}"]
            stated = tuple(own.findtext(f".//{{{SI}}}{name}") for name in ("value", "valueExpandedMU"))
            assert stated == (in_digits(value, 2 * u) if u is not None else (f"{value:.3g}", None))
    assert any(name.startswith("AD") for name in found)
    assert "certificates are not replaced" in error_of(*arguments)


def test_administrative_entries_stand_where_the_schema_has_them(run, entries):
    entries.write_text(f"{ENTRIES}issued: 2026-12-24\nlaboratory_code: L-7\n")
    root = ElementTree.fromstring(dcc(read_entries(entries), bc.budget(run).basis))
    administrative = root.find(f"{{{DCC}}}administrativeData")

    def told(part):
        """Texts of an element and of all in it, by their tags; that of a name is in its content."""
        found = {e.tag.removeprefix(f"{{{DCC}}}"): (e.text or "").strip() for e in part.iter()}
        return {tag: text for tag, text in found.items() if text}

    core = {
        "countryCodeISO3166_1": "CA", "usedLangCodeISO639_1": "en", "mandatoryLangCodeISO639_1": "en",
        "uniqueIdentifier": "2026-0042", "beginPerformanceDate": "2026-11-20",
        "endPerformanceDate": "2026-11-21", "performanceLocation": "laboratory", "issueDate": "2026-12-24",
    }  # fmt: skip
    assert told(administrative.find(f"{{{DCC}}}coreData")) == core
    item = administrative.find(f".//{{{DCC}}}item")
    assert told(item.find(f"{{{DCC}}}manufacturer")) == {"content": "FANUC"}
    assert item.findtext(f"{{{DCC}}}model") == "LR Mate 200iC"
    assert item.findtext(f".//{{{DCC}}}identification/{{{DCC}}}value") == "E12345"
    laboratory = {
        "content": "Laboratory <of> lengths & angles", "city": "Montreal", "countryCode": "CA",
        "postCode": "H3C 1K3", "calibrationLaboratoryCode": "L-7",
    }  # fmt: skip
    assert told(administrative.find(f"{{{DCC}}}calibrationLaboratory")) == laboratory
    customer = {"content": "A customer", "city": "Quebec", "countryCode": "CA", "eMail": "a@b.ca"}
    assert told(administrative.find(f"{{{DCC}}}customer")) == customer
    head = {"content": "A. Person", "role": "head", "mainSigner": "true"}
    assert told(administrative.find(f"{{{DCC}}}respPersons")) == head


@foreign.needs(OFFICIAL)
def test_valid_by_the_official_schema(run, entries, tmp_path, output_of):
    arguments = ("export", run, "--to", "dcc", "--certificate", entries, "--out", tmp_path / "arm.xml")
    output_of(*arguments, "--schema", OFFICIAL)


@pytest.mark.parametrize(("change", "message"), cases("certificate_refusals"))
def test_what_is_missing_is_refused(run, entries, tmp_path, error_of, change, message):
    assert change[0] in ENTRIES
    entries.write_text(ENTRIES.replace(*change))
    out = tmp_path / "arm.xml"
    assert message in error_of("export", run, "--to", "dcc", "--certificate", entries, "--out", out)
    assert not out.exists()


def test_other_refusals(run, entries, tmp_path, error_of):
    assert "--certificate" in error_of("export", run, "--to", "dcc")
    errors = error_of("export", run, "--to", "urdf", "--certificate", entries)
    assert "urdf has no administrative data" in errors
    changed = tmp_path / "dcc.xsd"
    changed.write_text(OURS.read_text().replace('fixed="3.3.0"', 'fixed="3.4.0"'))
    (tmp_path / "SI_Format.xsd").write_text(OURS.with_name("SI_Format.xsd").read_text())
    arguments = ("--certificate", entries, "--schema", changed, "--out", tmp_path / "a.xml")
    assert "not valid" in error_of("export", run, "--to", "dcc", *arguments)
    assert not (tmp_path / "a.xml").exists()


@pytest.mark.parametrize(("value", "u", "shown"), [
    (0.3000550788, 1.63e-5, ("0.300055", "0.000016")), (1.23e-3, 9.96e-5, ("0.00123", "0.00010")),
    (12.3, 345.0, ("12", "345")), (-1e-7, 2e-5, ("0.000000", "0.000020")),
])  # fmt: skip
def test_digits(value, u, shown):
    assert in_digits(value, u) == shown
