"""Tables of logs: what is around the rows, units in headers, decimal marks, encodings, expressions."""

import numpy as np
import pytest
from cases import cases, file_text

from bayescal.errors import BayescalError
from bayescal.importing.columns import columns_of, missing_in
from bayescal.importing.log import read_log
from bayescal.importing.mapping import read_map


def read(tmp_path, text, map_, decimal="", encoding="utf-8"):
    (tmp_path / "log.csv").write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    said = read_map(map_, 2)
    return columns_of(read_log(tmp_path / "log.csv", missing=missing_in(said)), said, decimal)


LAB = file_text("lab.csv")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_a_report_with_text_around_its_rows(tmp_path, encoding):
    got = read(tmp_path, LAB, "id=Point, j1=A1, x=X, u=u", encoding=encoding)
    assert got.texts["id"].tolist() == ["P1", "P2", "P3"]
    np.testing.assert_allclose(got.numbers["j1"], np.radians([10, 20, 30]), atol=1e-12)
    np.testing.assert_allclose(got.numbers["x"], [1.5e-3, 2.5e-4, 1.2345], atol=1e-12)
    np.testing.assert_allclose(got.numbers["u"], [3e-6, 4e-6, 5e-6], atol=1e-15)
    assert got.line.tolist() == [5, 7, 9]
    notes = "\n".join(got.notes)
    assert "2 lines of log.csv before the header left out: 'Metrology report' (line 1)" in notes
    assert "1 repetitions of the header" in notes
    assert "2 lines of log.csv behind the last row left out: 'Total points: 3' (line 10)" in notes
    assert ("Windows-1252" in notes) == (encoding == "cp1252")


def test_units_in_a_row_below_the_header(tmp_path):
    got = read(tmp_path, "A1\tX\tnote\ndeg\tm\t-\n180\t2\tgood\n", "j1=A1, x=X")
    assert (got.numbers["j1"][0], got.numbers["x"][0]) == (pytest.approx(np.pi), 2.0)
    assert got.unused == ("note",)


def test_a_header_in_a_comment(tmp_path):
    """NumPy's savetxt writes it so."""
    got = read(tmp_path, "# made by a script\n# q1 q2\n1 2\n3 4\n", "j1=q1 rad, j2=q2 rad")
    np.testing.assert_array_equal(got.numbers["j2"], [2, 4])


@pytest.mark.parametrize(
    ("map_", "value"),
    [
        ("j1=a3 + a2 deg", np.radians(12.5)),
        ("j1=-(a3 - a2) / 2 + 1 deg", np.radians(-2.75)),
        ("j1=#1 - #2 deg", np.radians(7.5)),
        ("j1_deg=a3+a2", np.radians(12.5)),
        ("x={J 1} * 2 mm", 0.04),
        ("x=J 1 mm", 0.02),
        ("x_mm=J 1", 0.02),
        ("u=U95 / 2 mm", 1e-5),
        ("payload=2 kg", 2.0),
        ("payload_g=250", 0.25),
        ("length=1e2 + .5 mm", 0.1005),
        ("j1_degps=a2", np.radians(2.5)),
        ("temperature_c=a3", 10.0),
    ],
)
def test_expressions(tmp_path, map_, value):
    got = read(tmp_path, "a3,a2,J 1,U95\n10,2.5,20,0.02\n", map_)
    assert next(iter(got.numbers.values())) == pytest.approx([value], abs=1e-12)


def test_texts_of_several_columns(tmp_path):
    got = read(tmp_path, "Group,Target\nA,1\nA,2\n", "id='{Group}.{Target}', target='leica', tool=Group")
    assert got.texts["id"].tolist() == ["A.1", "A.2"]
    assert got.texts["target"].tolist() == ["leica", "leica"]


@pytest.mark.parametrize(
    ("text", "map_", "words"),
    cases("log_refusals"),
)
def test_refused(tmp_path, text, map_, words):
    if "left out" in words:  # a line at the end without a number: left out, and the note shows it
        assert "behind the last row left out: 'p2' (line 3)" in read(tmp_path, text, map_).notes[0]
        return
    with pytest.raises(BayescalError, match=words):
        read(tmp_path, text, map_)


def test_a_decimal_comma_that_is_stated(tmp_path):
    got = read(tmp_path, "a;b\n1;2,500\n", "x=b mm", decimal="comma")
    assert got.numbers["x"] == pytest.approx([2.5e-3])


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"\x81\x8d,1\n", "the encoding is not known"), ("a,b\n1,2\n".encode("utf-16-le"), "not a text file")],
)
def test_bytes_that_are_no_text(tmp_path, content, words):
    with pytest.raises(BayescalError, match=words):
        read(tmp_path, content, "x=a mm")


MIDNIGHT = [0.0, 1.5, 86399.25, 86401.0]
"""s after 2026-11-22 00:00:00."""


@pytest.mark.parametrize(
    ("kind", "cells", "clock"),
    cases("time_stamps"),
)
def test_time_stamps(tmp_path, kind, cells, clock):
    text = "\n".join(["t;x", *(f"{cell};1" for cell in cells)])
    got = read(tmp_path, text, f"time=t {kind}, x=x mm")
    time = got.numbers["time"]
    np.testing.assert_allclose(time - time[0], MIDNIGHT, atol=1e-6)
    assert got.clock == clock
    if clock == "UTC":
        assert time[0] == pytest.approx(1795305600.0)


def test_date_and_time_in_two_columns(tmp_path):
    got = read(tmp_path, "Date,Time\n22.11.2026,10:00:00\n22.11.2026,10:00:02\n", "time={Date} {Time} dmy")
    assert np.diff(got.numbers["time"]).tolist() == [2.0]


@pytest.mark.parametrize(
    ("cells", "kind", "words"),
    cases("time_stamp_refusals"),
)
def test_no_time_stamps(tmp_path, cells, kind, words):
    with pytest.raises(BayescalError, match=words):
        read(tmp_path, "\n".join(["t;x", *(f"{cell};1" for cell in cells)]), f"time=t {kind}")


def test_the_header_that_a_message_shows(tmp_path):
    from bayescal.importing.log import header_of

    for text, header in (
        (LAB, ("Point", "A1 [deg]", "X [mm]", "u / µm")),
        ("1 2\n3 4\n", ()),
        ("a,b,\n1,2,\n", ("a", "b")),
    ):
        (tmp_path / "log.csv").write_text(text, encoding="utf-8")
        assert header_of(tmp_path / "log.csv") == header
