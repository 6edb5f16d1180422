"""Pages in headless Chromium: width, errors, requests, the view in 3-D, accessibility, inert names."""

import json
from functools import lru_cache
from pathlib import Path

import axe_core_python
import numpy as np
import pytest
from playwright import sync_api as playwright
from test_pages import EVIL, record_of, renamed

from bayescal.estimate import calibrated
from bayescal.model.scene import Scene
from bayescal.reporting.body import placed
from bayescal.reporting.page import Run
from bayescal.reporting.page.build import run_page

NARROW, WIDE = 380, 900
WAIT = 180_000
"""ms; a machine that is shared may be slow."""

SELDOM = """
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;
"""
"""The processor draws a view in 3-D as long as its page is open: five times a second are enough."""


@pytest.fixture(scope="module")
def browser(chromium):
    with playwright.sync_playwright() as p:
        running = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture(scope="module")
def record(cube):
    found = calibrated(Scene(cube(seed=1, count=80).dataset), ("geometry",))
    return record_of(found, "named") | {"marked": "joint 3"}


@pytest.fixture(scope="module")
def pages(record, tmp_path_factory):
    """A page as a diagnosis writes it, and one in which every name of a file is markup."""
    folder = tmp_path_factory.mktemp("pages")
    for name, content in (("plain", record), ("evil", renamed(record))):
        (folder / f"{name}.html").write_text(run_page(Run("gap", content, "runs/x")), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def problems():
    """Errors of the console, dialogs and requests of all pages."""
    return []


@pytest.fixture(autouse=True)
def without_problems(problems):
    """After every test there must be none."""
    yield
    found = problems.copy()
    problems.clear()
    assert found == []


@pytest.fixture(scope="module")
def opened(browser, pages, problems):
    """A page at a width, for all tests of it in turn: a test leaves its medium as it was.

    One page is open at a time. Each takes seconds: tests of the same page follow each other, in one scheme.
    """

    @lru_cache(maxsize=1)
    def open_(name: str, width: int, scheme: str, scripts: bool):
        for context in browser.contexts:
            context.close()
        view = {"width": width, "height": 900}
        context = browser.new_context(viewport=view, java_script_enabled=scripts, color_scheme=scheme)
        context.add_init_script(SELDOM)
        page = context.new_page()
        page.set_default_timeout(WAIT)
        page.on("console", lambda m: m.type == "error" and problems.append(m.text))
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("dialog", lambda dialog: (problems.append(dialog.message), dialog.dismiss()))
        page.on("request", lambda r: r.url.startswith(("file:", "data:", "blob:")) or problems.append(r.url))
        page.goto((pages / f"{name}.html").as_uri())
        return page

    return lambda name, width, scheme="light", scripts=True: open_(name, width, scheme, scripts)


def drawn(page, section: str) -> None:
    """Scroll to a section, and wait until its figure is drawn."""
    page.wait_for_selector("html[data-ready]", state="attached")
    page.locator(f"#{section}").scroll_into_view_if_needed()
    page.wait_for_selector(f"#{section}[data-drawn]", state="attached")


def until(page, expression: str, act) -> None:
    """Act, and again every second, until an expression holds: a page that is busy may lose an event.

    The policy of the page forbids `wait_for_function`.
    """
    for k in range(WAIT // 50):
        if k % 20 == 0:
            act()
        if page.evaluate(expression):
            return
        page.wait_for_timeout(50)
    pytest.fail(f"never true: {expression}")


def drag(page, place: str) -> None:
    """Drag the mouse over a part of the page, then take it away."""
    box = page.locator(place).bounding_box()
    page.mouse.move(box["x"] + 120, box["y"] + 150)
    page.mouse.down()
    page.mouse.move(box["x"] + 240, box["y"] + 190, steps=4)
    page.mouse.up()
    page.mouse.move(1, 1)  # a contact under the pointer poses the arm too


def test_fits_the_width(opened):
    page = opened("evil", NARROW)  # with names without blanks
    drawn(page, "residuals")
    assert page.evaluate("document.documentElement.scrollWidth") <= NARROW
    assert page.title() == EVIL


def test_names_from_files_are_inert(opened):
    page = opened("evil", NARROW)
    drawn(page, "arm")
    page.locator("#scene-colour").select_option("target")
    drawn(page, "residuals")
    assert page.locator("h1").inner_text() == EVIL
    legend = page.locator("#residual-plot .legendtext").first.text_content()
    assert "<script>" in legend


@pytest.mark.parametrize(("name", "scheme"), [("evil", "light"), ("plain", "dark")])
def test_accessible(opened, name, scheme):
    """Contrast too, in both schemes; a wide page has the same elements in the same colours."""
    page = opened(name, NARROW, scheme)
    drawn(page, "residuals")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 25, 30)"
    assert dark == (scheme == "dark")
    colour = page.evaluate("document.getElementById('residual-plot').layout.paper_bgcolor")
    assert colour == ("#14191e" if dark else "#fff")
    script = next(Path(axe_core_python.__file__).parent.glob("*.min.js")).read_text(encoding="utf-8")
    page.evaluate(script)  # by the debugger: the page's policy does not concern it
    nodes = "r.violations.map(v => [v.id, v.nodes.map(n => n.html.slice(0, 200))])"
    assert page.evaluate(f"axe.run(document).then(r => {nodes})") == []


def test_the_arm_responds(opened, record):
    page = opened("plain", NARROW, "dark")
    drawn(page, "arm")
    times = page.evaluate("Object.assign({}, document.documentElement.dataset)")
    assert int(times["ready"]) < int(times["library"])  # a page to be read does not wait for plotly.js
    camera = "JSON.stringify(document.getElementById('scene-plot')._fullLayout.scene._scene.getCamera())"
    before = page.evaluate(camera)
    until(page, f"{camera} !== {json.dumps(before)}", lambda: drag(page, "#scene-plot"))
    # the slider, which a keyboard moves too, poses the arm: its end is at the contact of the row
    line = "document.getElementById('scene-plot').data[0]"
    tip = f"[{line}.x.at(-1), {line}.y.at(-1), {line}.z.at(-1)]"
    posed = f"{tip}[0] === {record['rows']['point_mm'][7][0]}"
    until(page, posed, lambda: page.locator("#scene-row").fill("7"))
    assert page.evaluate(tip) == pytest.approx(record["rows"]["point_mm"][7])
    assert record["rows"]["id"][7] in page.locator("#scene-pose").inner_text()
    plot = "document.getElementById('scene-plot')"
    page.evaluate(f"{plot}.emit('plotly_hover', {{ points: [{{ customdata: 3 }}] }})")
    assert record["rows"]["id"][3] in page.locator("#scene-pose").inner_text()
    page.locator("#scene-colour").select_option("target")
    assert set(page.evaluate(f"{plot}.data.slice(5).map(t => t.name)")) == set(record["rows"]["target"])


def test_the_arm_is_a_body(opened, record):
    """All corners of its surface are on the capsules of the record at the row; artefacts stand still."""
    page = opened("plain", NARROW, "dark")
    drawn(page, "arm")
    page.locator("#scene-row").fill("7")
    plot = "document.getElementById('scene-plot').data"
    script = "['x', 'y', 'z'].map((axis) => Array.from({}[{}][axis]))"
    mesh, fixed = (np.array(page.evaluate(script.format(plot, k))).T for k in (3, 4))
    arm, moved = record["arm"], placed(record["arm"], np.radians(record["rows"]["angle_deg"][7]))
    count = len(mesh) // len(arm["capsules"])
    for k, c in enumerate(arm["capsules"]):
        turn, shift = moved[c["joint"]]
        a, b = np.array(c["ends_mm"]) @ turn.T + shift
        own = mesh[k * count : (k + 1) * count] - a
        along = np.clip(own @ (b - a) / max((b - a) @ (b - a), 1e-9), 0, 1)[:, None] * (b - a)
        assert np.linalg.norm(own - along, axis=1) == pytest.approx(c["radius_mm"], abs=0.3)
    (cube,) = [a for a in arm["artefacts"] if "half_mm" in a]
    corners = (fixed[:8] - cube["centre_mm"]) @ np.array(cube["axes"]).T
    assert np.abs(corners) == pytest.approx(np.tile(cube["half_mm"], (8, 1)), abs=0.1)


def test_figures_are_those_of_the_record(opened, record):
    page = opened("plain", NARROW, "dark")
    drawn(page, "residuals")
    data = page.evaluate("document.getElementById('residual-plot').data.map(t => [t.customdata, t.y])")
    got = {k: y for rows, values in data for k, y in zip(rows, values, strict=True)}
    assert [got[k] for k in range(len(got))] == record["rows"]["residual_um"]
    text = page.locator("main").inner_text()
    for line in record["words"]:
        assert line.rpartition(": ")[2].lower() in text.lower()
    assert f"{record['gap']['excess_um']['value']:.1f} µm" in text


def test_print_has_the_drawings(opened):
    page = opened("plain", NARROW, "dark")
    drawn(page, "arm")
    page.emulate_media(media="print")
    try:
        assert page.locator("#arm figure.static svg").is_visible()
        assert not page.locator(".interactive").first.is_visible()
    finally:
        page.emulate_media(media="screen")


def test_without_scripts_the_drawings_stay(opened):
    page = opened("plain", WIDE, scripts=False)
    assert page.locator("#arm figure.static svg").is_visible()
    assert page.locator("#residuals .figures svg").first.is_visible()
    assert not page.locator(".interactive").first.is_visible()
