"""Probing programs, run by interpreters of their subsets on a simulated arm: touch, no touch, early touch.

The interpreters and the cell share no code with the package. None of this is a controller.
"""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_up_plans import made_up_plan
from other_interpreters import Abb, Fanuc, Kuka
from probing_cell import cell_of, on_planes
from urscript_interpreter import Program

from bayescal.importing import Request, convert
from bayescal.programs.probing import FORMATS, Probe
from bayescal.public.planning import PlanResult
from bayescal.reporting.page.plan import write_plan

ERROR = {"a": [0, 2e-4, 5e-4, -3e-4, 0, 0], "offset": [0, 1e-3, -8e-4, 5e-4, -6e-4, 0]}
SHIFT = {"cube.+z": 6e-4, "cube.-x": -4e-4, "cube.+y": 3e-4}
SPEED, NEAR = 5e-3, 50e-3
FASTER = 1.2
"""The true arm is a little faster than the nominal one."""
NAMES = ("urscript", "fanuc", "kuka", "abb")


@pytest.fixture(scope="module")
def plan(cube):
    """Seven contacts with a change before the sixth."""
    return on_planes(made_up_plan(cube(seed=1, count=90).dataset, count=6, validation=1))


def ran(plan, name="urscript", probe=None, **cell):
    """The interpreted program of a plan."""
    texts = list(FORMATS[name].files(plan, probe or Probe()).values())
    make = {"urscript": Program, "fanuc": Fanuc, "kuka": Kuka, "abb": Abb}[name]
    return make(*texts, cell_of(plan, ERROR, SHIFT, **cell)).run()


def log_of(program, folder):
    """What the controller leaves behind, as a file."""
    files = {
        Program: ("log.txt", lambda p: "".join(f"2026-11-23 10:00:00 {line}\n" for line in p.log)),
        Fanuc: ("POSREG.VA", lambda p: p.listing),
        Kuka: ("bcplan.dat", lambda p: p.data),
        Abb: ("bayescal.log", lambda p: p.log),
    }
    name, text = files[type(program)]
    (folder / name).write_text(text(program))
    return folder / name


@pytest.fixture(scope="module")
def folder(plan, tmp_path_factory):
    out = tmp_path_factory.mktemp("plan") / "run"
    write_plan(plan, out)
    return out


def imported(program, folder, tmp_path):
    return convert(Request(log=log_of(program, tmp_path), plan=folder))


def off_surface(cell, readings, rows):
    """Depths, m, of the ball at readings (M, 6) inside the surfaces of rows (M,)."""
    return -np.einsum("mi,mi->m", cell.true.ball(readings) - cell.points[rows], cell.normals[rows])


@pytest.mark.parametrize(("name", "cycle"), [("urscript", 2e-3), *((name, 8e-3) for name in NAMES[1:])])
def test_every_contact_is_touched_and_latched_in_the_cycle_of_the_touch(plan, folder, tmp_path, name, cycle):
    """The readings come home by `import`, and put the ball on the surface within latency times speed."""
    program = ran(plan, name, cycle=cycle)
    cell = program.cell
    assert not program.halted
    m = imported(program, folder, tmp_path).dataset.measurements
    assert m.ids == plan.session.measurements.ids
    depth = off_surface(cell, m.readings, np.arange(7))
    assert (depth > -1e-7).all()  # digits of the log
    assert (depth <= FASTER * SPEED * cycle).all()
    assert cell.deepest <= FASTER * (SPEED * 2 * cycle + SPEED**2 / (2 * 0.5))
    ends = np.array([q for kind, q in cell.travelled if kind == "joint"])
    assert len(ends) == 1 + 7 + 2 * 6  # where it begins, approaches, raised poses
    np.testing.assert_allclose(ends[0], plan.leave[0][0], atol=1e-6)
    said = " ".join(program.popups if name == "urscript" else program.messages)
    assert "attach 0.5 kg beyond the tool" in said.replace("' ", "")


@pytest.mark.parametrize("name", NAMES)
def test_the_tool_of_a_program_is_that_of_the_session(plan, name):
    """Its centre from the flange, mm; in a program that sets the load, mass, kg, and centre of mass, mm."""
    tool = replace(plan.session.tools[0], mass=1.25, centre_of_mass=np.array([0.011, -0.022, 0.033]))
    session = replace(plan.session, tools=(tool,))
    text = "\n".join(FORMATS[name].files(replace(plan, session=session), Probe()).values())
    centre = (1e3 * tool.centre).tolist()
    triples = re.findall(r"(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) mm", text)
    assert [[float(x) for x in t] for t in triples] == [pytest.approx(centre)]
    for stated in re.findall(r"tooldata bcTool:=(.*);", text):
        held, (at, turn), (mass, cog, axes, *inertia) = json.loads(stated.replace("TRUE", "true"))
        assert [held, mass, turn, axes, inertia] == [True, 1.25, [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0]]
        assert at == pytest.approx(centre)
        assert cog == pytest.approx([11.0, -22.0, 33.0])
    assert ("tooldata" in text) == (name == "abb")


@pytest.mark.parametrize("name", NAMES)
def test_no_contact_ends_the_program_within_the_stated_distance(plan, folder, tmp_path, name):
    """The id is on the screen and in the log, the tool at its approach; earlier contacts come home."""
    program = ran(plan, name, absent={2}, cycle=8e-3)
    cell = program.cell
    assert program.halted
    said = (program.popups if name == "urscript" else program.messages)[-1]
    assert "p003" in said
    assert "no contact" in said.lower()
    np.testing.assert_allclose(cell.q, plan.approach[2], atol=1e-6)
    end = next(q for kind, q in cell.travelled[-2:] if kind == "line")
    at = plan.session.measurements.readings[2]
    beyond = -(cell.nominal.ball(end) - cell.nominal.ball(at))[0] @ cell.normals[2]
    assert beyond == pytest.approx(5e-3, abs=2e-6)
    draft = imported(program, folder, tmp_path)
    assert draft.dataset.measurements.ids == ("p001", "p002")
    assert any("no contact: p003" in note for note in (*draft.understood, *draft.notes))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("height", [15e-3, 25e-3])
def test_an_early_contact_ends_the_program_where_the_tool_is(plan, folder, tmp_path, name, height):
    """On the line before the search, and on the motion to the approach; no reading of it is taken."""
    program = ran(plan, name, raised={1: height}, cycle=8e-3)
    cell = program.cell
    assert program.halted
    said = (program.popups if name == "urscript" else program.messages)[-1]
    assert "p002" in said
    assert "early contact" in said.lower()
    fast = NEAR if height < 20e-3 else 0.5  # m/s
    assert cell.deepest <= FASTER * fast * 3 * cell.cycle + fast**2 / (2 * 0.5)
    assert np.abs(cell.q - plan.approach[0]).max() > 0.01
    draft = imported(program, folder, tmp_path)
    assert draft.dataset.measurements.ids == ("p001",)
    assert any("early contact: p002" in note for note in (*draft.understood, *draft.notes))


def test_the_force_of_a_ur_stops_the_motion(plan):
    """Its change since the motion began: the weight of the tool is no contact."""
    program = ran(plan, probe=Probe(force=5.0, beyond=2e-3), cycle=2e-3, absent={2})
    records = [json.loads(re.fullmatch(r"bayescal, p\d+, rad, (.*)", line)[1]) for line in program.log]
    assert [r[0] for r in records] == [1, 1, 2]
    depth = off_surface(program.cell, np.array([r[1:] for r in records[:2]]), np.arange(2))
    assert (depth > 0.25e-3 - 1e-6).all()  # 5 N at 20 N/mm
    assert (depth < 0.25e-3 + FASTER * SPEED * 2e-3).all()


def test_a_saved_plan_has_the_probe_that_was_asked_for(monkeypatch, tmp_path):
    """Of lengths in mm; without any it is that of the programs themselves."""
    seen = []
    monkeypatch.setattr("bayescal.reporting.page.plan.write_plan", lambda *given: seen.append(given[2:]))
    result = PlanResult(SimpleNamespace())
    result.save(tmp_path, "urscript,csv", probe_force_n=12.0, probe_beyond_mm=8.0)
    result.save(tmp_path)
    assert seen == [(("urscript", "csv"), Probe("", 12.0, 8e-3)), ((), Probe())]
