"""Names of files are text: no markup of the terminal, no element of a page, whatever they contain."""

import io
import sys
from dataclasses import replace
from html.parser import HTMLParser
from itertools import count, cycle
from types import SimpleNamespace

import pytest
from cases import refused
from gap_diagnoses import diagnosis
from rich.console import Console
from sessions import plain
from typer.testing import CliRunner

import bayescal as bc
from bayescal.cli import app
from bayescal.dataset import Record, write_dataset
from bayescal.reporting.fleet import fleet_page

HOSTILE = (
    "[/]", "[bold]x[/bold]", "[link=http://a]y", ":smile:",
    "<hostile>", "</title><hostile>", "</script><hostile>",
    "\"'><hostile a='", "$a_$", "{x}", "%s", "`code`", "a/b\\c", "&lt;",
)  # fmt: skip


def hostile(dataset):
    """The same session with hostile names in every field of dataset, robot and table."""
    texts, number, known = cycle(HOSTILE), count(), {}

    def named(name: str) -> str:
        return known.setdefault(name, f"{next(texts)} {next(number)}<hostile y>")

    robot, rows = dataset.robot, dataset.measurements
    return replace(
        dataset,
        name="[/] <hostile>",
        robot=replace(robot, name="[/] <hostile>", joint_names=tuple(map(named, robot.joint_names))),
        robot_reference="robot.yaml",
        tools=tuple(replace(t, name=named(t.name)) for t in dataset.tools),
        targets=tuple(replace(t, name=named(t.name)) for t in dataset.targets),
        certificates=tuple(replace(c, targets=tuple(map(named, c.targets))) for c in dataset.certificates),
        measurements=replace(rows, ids=tuple(map(named, rows.ids))),
        record=Record(
            "2026-01-31", "[/] <hostile>", {"arm": "</script><hostile>"}, ("[/b] <hostile>",), 20.0
        ),
        source="[/] </pre><hostile>",
    )


class Elements(HTMLParser):
    """The elements of a page with their attributes, and its text; titles are read as markup, as in SVG."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags, self.text = set(), ""
        self.feed(page.replace("<title>", "<g>").replace("</title>", "</g>"))
        assert not [each for each in self.tags if "hostile" in each or each == "y"]

    def handle_starttag(self, tag, attrs):
        self.tags |= {tag, *(f"{tag} {name}" for name, _ in attrs if "hostile" in name)}

    def handle_data(self, data):
        self.text += data


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exception is None, f"{arguments}: {done.exception!r}"
    return done.output


@pytest.fixture(scope="module")
def session(cube, tmp_path_factory):
    folder = tmp_path_factory.mktemp("[b]hostile") / "session"
    write_dataset(hostile(plain(cube(seed=9, count=60).dataset)), folder)
    return folder


@pytest.fixture(scope="module")
def fitted(session):
    return bc.fit(session, "joint", samples=0)


def test_commands_print_names_as_they_are(session):
    out = session.parent / "[red]run"
    checked = run("check", str(session))
    fitted = run(
        "fit", str(session), "--model", "joint", "--samples", "0", "--no-pictures", "--out", str(out)
    )
    assert "[/] <hostile>  [/] <hostile>" in checked
    assert "[/] <hostile>  [/] <hostile>" in fitted
    assert f"{out}/fit.json" in fitted
    for target in bc.read_dataset(session).targets:
        assert target.name.split()[0] in checked
    run("budget", str(out))
    urdf = str(session.parent / "a.urdf")
    assert "hostile" in run("export", str(out), "--to", "urdf", "--force", "--out", urdf)
    run("report", str(out))
    page = Elements((out / "report.html").read_text(encoding="utf-8"))
    assert "<hostile>" in page.text
    assert {"svg", "table"} <= page.tags


def test_no_name_is_an_element_of_any_page(session, fitted, tmp_path, quick_search, monkeypatch):
    """Of a fit, a diagnosis, both side by side and a plan: pages, and what a notebook shows of them."""
    named = SimpleNamespace(diagnose=lambda dataset, *_, **__: diagnosis(dataset, "named+unexplained"))
    monkeypatch.setitem(sys.modules, "bayescal.gap.diagnose", named)
    monkeypatch.setattr("bayescal.reporting.figures.plan.plan_picture", lambda plan: b"\x89PNG")
    options = {"contacts": 40, "model": "joint", "purpose": "distances", "candidates": 80, "order": "random"}
    results = {"report.html": fitted, "gap.html": bc.diagnose(session, "geometry")}
    results["plan.html"] = bc.plan(session, **options)
    for name, result in results.items():
        result.save(tmp_path / name, **({} if name == "plan.html" else {"pictures": False}))
        assert "<hostile" in Elements((tmp_path / name / name).read_text(encoding="utf-8")).text
        assert "<hostile" in Elements(result._repr_html_()).text
    assert "<hostile" in Elements(bc.compare(session)._repr_html_()).text
    bc.report([tmp_path / "report.html", tmp_path / "gap.html"], tmp_path / "both.html")
    assert "<hostile" in Elements((tmp_path / "both.html").read_text(encoding="utf-8")).text


def test_no_name_is_an_element_of_the_page_of_a_fleet():
    """Of arms, sessions, robots, targets, files, with their links; nor what a session fails with."""
    texts, number = cycle(HOSTILE), count()

    def named() -> str:
        return f"{next(texts)} {next(number)}<hostile y>"

    arms, sessions, robot = [named() for _ in HOSTILE], [named() for _ in HOSTILE], named()
    found = {"parameter": named(), "value": 1.0, "u": 0.1, "unit": "mm", "p_all": 0.01, "stated": True}
    effects = [{"effect": "backlash", "site": named()}]
    record = {
        "arms": [
            {"arm": arm, "robot": robot, "sessions": [s], "expanded_U_um": 50.0, "measured_rms_um": 20.0,
             "effects": effects, "differs": [found], "changed": [found | {"since": s}], "log_score_nats": 1.0}
            for arm, s in zip(arms, sessions, strict=True)
        ],
        "effects": [
            effects[0]
            | {"arms": arms, "of": len(arms), "expected_arms": 1.0, "values": [1.0, 2.0], "unit": "deg"}
        ],
        "sessions": [
            {"session": s, "arm": arm, "status": "fitted", "fit": {"expanded_U_um": 50.0}, "error": named(),
             "gap": {"words": [named()]}, "folder": f"sessions/{s}"}
            for arm, s in zip(arms, sessions, strict=True)
        ],
        "models": [
            {"robot": robot, "arms": arms, "parameters": [], "file": named(), "comparisons": 10,
             "comparisons_between_sessions": 5}
        ],
        "count": {"sessions": len(arms), "fitted": len(arms), "kept": 0, "failed": 0},
        "inputs": {"model": [named()]},
    }  # fmt: skip
    text = Elements(fleet_page(record)).text
    for name in (*arms, *sessions, robot, found["parameter"]):
        assert name in text


def test_a_console_with_markup_prints_a_table_of_hostile_names(fitted):
    shown = io.StringIO()
    Console(file=shown, width=200).print(fitted.report(verbose=True))
    assert "[/]" in shown.getvalue()


def test_a_run_folder_names_its_dataset(session):
    folder = session.parent.parent / "kept"
    (folder / "dataset").mkdir(parents=True)
    for file in session.iterdir():
        (folder / "dataset" / file.name).write_bytes(file.read_bytes())
    refused(r"no dataset\.yaml in it; .*kept/dataset", lambda: bc.fit(folder))
