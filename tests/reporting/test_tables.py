"""Tables of the terminal: at any width every figure is there in full."""

import io

import pytest
from rich.console import Console

from bayescal.reporting.shared.text import FigureTable, plain_table, with_u

NAMES = ("nominal", "geometry + compliance + eccentricity of joint 3 + second-harmonic of joint 5", "x" * 90)
FIGURES = ("+1234.56", "-0.071(12)", "-1733 .. +1698", "(> 0.99)", "98.7654 %", "17.125")
HEADINGS = (
    "planes RMS",
    "distances RMS",
    "predicted 95 % interval",
    "probability",
    "within",
    "maximum error",
)


def printed(table: FigureTable, width: int) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def table(names) -> FigureTable:
    out = plain_table("model level (µm)", *HEADINGS)
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


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (0.02441, 0.00098, "0.02441(98)"),
        (0.02441, 0.000996, "0.0244(10)"),
        (300.0551, 0.0081, "300.0551(81)"),
        (12.34, 1.44, "12.3(1.4)"),
        (5317.0, 238.0, "5320(240)"),
        (-0.5, 0.0, "-0.5"),
    ],
)
def test_two_digits_of_the_uncertainty(value, u, text):
    assert with_u(value, u) == text
