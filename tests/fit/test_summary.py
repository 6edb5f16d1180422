"""The summary of a fit at the width of a terminal: every figure of the wide one is in the narrow one."""

import io
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bayescal.calibration import fit
from bayescal.dataset import read_dataset
from bayescal.model.options import FitOptions
from bayescal.reporting.fit.summary import fit_summary

FULL = ("geometry", "compliance")
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
FIGURE = re.compile(r"[+-]?\d+(?:\.\d+)?(?:\(\d+(?:\.\d+)?\))?")
NOT_SAID = ("as drawn", "held out", "worst", "data decide", " um ", "ladder")


def printed(found, width: int, verbose: bool = False) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(fit_summary(found, verbose))
    return console.export_text()


def validating(session, every: int = 4):
    role = np.where(np.arange(len(session.measurements.ids)) % every == 0, "validate", "calibrate")
    return replace(session, measurements=replace(session.measurements, role=role))


@pytest.fixture(scope="module")
def fits(cube, tracker):
    made = {
        "faces": fit(
            validating(cube(seed=6, count=160).dataset), FULL, FitOptions(tolerance=2e-5), samples=0
        ),
        "tracker": fit(validating(tracker(seed=2, count=90).dataset), FULL, samples=0),
        "long names": fit(
            cube(seed=6, count=120).dataset, (*FULL, "eccentricity", "second-harmonic"), samples=0
        ),
    }
    for name in ("worlds-dev/005", "real/panda-ball-socket-4"):
        if (SHARED / name).exists():
            made[name] = fit(read_dataset(SHARED / name), FULL, FitOptions(tolerance=2e-5), samples=0)
    return made


@pytest.mark.parametrize("verbose", [False, True])
@pytest.mark.parametrize("width", [60, 80])
def test_no_figure_is_lost(fits, width, verbose):
    for name, found in fits.items():
        wide, narrow = printed(found, 300, verbose), printed(found, width, verbose)
        assert "…" not in narrow, name
        assert max(map(len, narrow.splitlines())) <= width
        lost = Counter(FIGURE.findall(wide)) - Counter(FIGURE.findall(narrow))
        assert not lost, (name, lost)


def test_the_words_are_those_of_the_field(fits):
    for found in fits.values():
        text = printed(found, 120, True)
        for words in NOT_SAID:
            assert words not in text
        assert "µm" in text


def test_the_first_lines_say_what_to_know(fits):
    for found in fits.values():
        lines = printed(found, 80).splitlines()
        heads = [line.split("  ")[0] for line in lines[:20]]
        assert heads[1] == "verdict"
        assert heads.index("distance error") < heads.index("validation") < heads.index("next")
        assert found.acceptance.verdict in lines[1]


def test_every_parameter_of_the_arm_has_its_uncertainty(fits):
    found = fits["faces"]
    text = printed(found, 80)
    for name in found.final.estimate.model.names[: len(found.final.estimate.model.parameters)]:
        assert re.search(
            rf"^{re.escape(name)} +-?\d+(\.\d+)? +-?\d+(\.\d+)?\(\d+(\.\d+)?\) ", text, re.MULTILINE
        )
