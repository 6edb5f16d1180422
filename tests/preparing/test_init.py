"""A new set-up: it is read as it was meant, refused until it is filled in, and nothing is overwritten."""

import re

import numpy as np
import pytest
from cases import refused

import bayescal as bc
from bayescal.dataset import read_dataset
from bayescal.dataset.read import SETTINGS, TABLE, read_settings
from bayescal.dataset.write import write_setup
from bayescal.errors import BayescalError
from bayescal.planning.setup import read_setup
from bayescal.preparing import folder as starting
from bayescal.preparing.artefacts import ARTEFACTS, Room
from bayescal.robots import builtin_robots, full_name, load_robot, robot_to_yaml
from bayescal.storage.files import FILL_IN

ROBOT = "fanuc-lrmate200ic"


@pytest.fixture(scope="module")
def room():
    return Room.of(load_robot(ROBOT)[0])


@pytest.fixture(scope="module")
def every(tmp_path_factory, room):
    """A set-up with every artefact."""
    folder = tmp_path_factory.mktemp("init") / "cell"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(starting.Room, "of", lambda robot: room)
        bc.init(folder, "lrmate200ic", list(ARTEFACTS))
    return folder


@pytest.fixture
def quick(monkeypatch, room):
    monkeypatch.setattr(starting.Room, "of", lambda robot: room)


def filled(text: str) -> str:
    """The settings as a user who takes every example for right leaves them."""
    return text.replace(f"{FILL_IN} ", "")


def test_what_is_written_is_what_was_meant(every, room, tmp_path):
    """Every target, certificate and region comes back from the commented file, once it is filled in."""
    (tmp_path / SETTINGS).write_text(filled((every / SETTINGS).read_text()))
    found, _, _ = read_settings(tmp_path / SETTINGS)
    outlines = [artefact.outline(room) for artefact in ARTEFACTS.values()]
    targets = [t for outline in outlines for t in outline.targets]
    assert [(t.name, t.kind) for t in found.targets] == [(t.name, t.kind) for t in targets]
    for here, meant in zip(found.targets, targets, strict=True):
        for key, value in meant.values.items():
            assert np.allclose(here.values[key], value, atol=1e-9)
    certificates = [c for outline in outlines for c in outline.certificates]
    assert [(c.kind, c.targets) for c in found.certificates] == [(c.kind, c.targets) for c in certificates]
    assert {c.u_distance for c in found.certificates if c.kind == "diameter"} == {1e-6}
    regions = {name: p for outline in outlines for name, p in outline.regions.items()}
    assert set(found.plan.regions) == set(regions)
    assert [t.name for t in found.tools] == ["probe", "reflector"]
    assert found.robot_reference == ROBOT
    assert found.noise.contact == 5e-6
    assert found.noise.point == 20e-6


def test_the_record_is_there_as_comments(every, tmp_path):
    """Without the marks of comments the keys are read as they were meant."""
    text = filled((every / SETTINGS).read_text())
    head, _, tail = text.partition("# record:\n")
    keys, own = tail.splitlines(), 5
    uncommented = "\n".join(["record:", *(line.removeprefix("#") for line in keys[:own]), *keys[own:]])
    (tmp_path / SETTINGS).write_text(head + uncommented)
    found, _, _ = read_settings(tmp_path / SETTINGS)
    assert set(found.record.serials) == {"arm", "probe", "artefact", "instrument"}
    assert (found.record.date, found.record.temperature) == ("2026-01-31", 20.0)
    # a single mark is enough to refuse
    text = text.replace("u_form_mm: &flat-uform 0.003", f"u_form_mm: {FILL_IN} 0.003")
    text = text.replace("u_form_mm: *flat-uform ", "u_form_mm: 0.003")
    text = re.sub(r"(&flat\S+) 0.003", rf"\1 {FILL_IN} 0.003", text)
    (tmp_path / SETTINGS).write_text(text)
    refused("`u_form_mm` is not filled in", lambda: read_settings(tmp_path / SETTINGS))
    # a value is filled in once for all placements
    text = filled((every / SETTINGS).read_text())
    changed = re.sub(r"(distance_mm: &distance-A-B) [\d.]+", r"\1 123.5", text)
    assert changed != text
    (tmp_path / SETTINGS).write_text(changed)
    certificates = read_settings(tmp_path / SETTINGS)[0].certificates
    assert [c.distance for c in certificates if c.targets[0] == "ball.A@3"][1] == pytest.approx(0.1235)


def test_every_certified_value_and_every_value_of_the_tool_is_marked(every, tmp_path):
    found, _, _ = read_settings(every / SETTINGS, assume=True)
    marked = {(path[0], path[-1]) for path in found.unfilled}
    tools = {("tools", k) for k in ("centre_mm", "ball_radius_mm", "mass_kg", "centre_of_mass_mm")}
    of_targets = {("targets", "diameter_mm"), ("targets", "length_mm")}
    keys = ("distance_mm", "u_distance_mm", "u_angle_rad", "u_diameter_mm", "u_form_mm")
    certified = {("certificates", k) for k in keys}
    assert marked == tools | of_targets | certified | {("noise", "contact_mm"), ("noise", "point_mm")}
    stated = sum(k.u_distance is not None for k in found.certificates if k.kind == "distance")
    assert sum(path[-1] == "distance_mm" for path in found.unfilled) == stated + 1  # and that of the cube
    # The run folder of a plan holds the set-up: what was assumed for the plan is not stated there
    write_setup(found, tmp_path)
    again, _, _ = read_settings(tmp_path / SETTINGS, assume=True)
    assert set(again.unfilled) == set(found.unfilled)
    refused("not filled in", lambda: read_settings(tmp_path / SETTINGS))


def test_refused_in_one_line_until_filled_in(every):
    line = (every / SETTINGS).read_text().split(FILL_IN, 3)  # the first two are in the head and in its text
    first = FILL_IN.join(line[:2]).count("\n") + 1
    caught = refused(r"`centre_mm` is not filled in: .* more lines", lambda: read_dataset(every))
    assert caught.where == f"{SETTINGS}:{first}"


def test_plan_assumes_the_examples_and_says_so(every):
    setup = read_setup(every)
    assert any("only assumed: tools.centre_mm (2)" in note for note in setup.notes)
    assert {"cube.+z", "seat.A", "bar@2", "plate@3", "ball.C@4"} <= set(setup.regions)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("gravity_mps2: [0", f"gravity_mps2: {FILL_IN} [0", "`gravity_mps2` is not filled in"),
    ("ball_radius_mm: 3", f"ball_radius_mm: {FILL_IN}", "`ball_radius_mm` .* no value that could be"),
    ("ball_radius_mm: 3", f"ball_radius_mm: {FILL_IN} ''", "no value that could be assumed"),
])  # fmt: skip
def test_marks_that_are_not_assumed(every, tmp_path, old, new, words):
    text = filled((every / SETTINGS).read_text())
    assert old in text
    (tmp_path / SETTINGS).write_text(text.replace(old, new))
    refused(words, lambda: read_settings(tmp_path / SETTINGS, assume=True))


def test_the_table_has_the_columns_of_robot_and_artefacts(every, tmp_path):
    header = (every / TABLE).read_text().strip().split(",")
    wanted = "id role target tool x_mm j6_deg j6_degps time_s payload_kg repeat stop"
    assert set(wanted.split()) <= set(header)
    (tmp_path / SETTINGS).write_text(filled((every / SETTINGS).read_text()))
    (tmp_path / TABLE).write_text((every / TABLE).read_text())
    refused("no rows below the header", lambda: read_dataset(tmp_path))
    readme = (every / "README.md").read_text()
    assert all(f"`{c}`" in readme for c in header if not re.match(r"j\d", c))


@pytest.mark.parametrize(("robot", "bends"), [("yaskawa-gp7", False), ("fanuc-lrmate200ic", True)])
def test_an_arm_without_masses_is_practised_without_compliance(tmp_path, robot, bends):
    starting.start(tmp_path / "new", robot, ["cube"])
    assert ("--out practice --effects geometry`" in (tmp_path / "new" / "README.md").read_text()) != bends


def test_editors_find_the_schema(every):
    line = (every / SETTINGS).read_text().splitlines()[0]
    assert (every / re.search(r"\$schema=(\S+)", line)[1]).is_file()


@pytest.mark.parametrize(
    ("robot", "artefact"), [("lrmate200ic", "cub"), ("lrmate200xx", "cube"), (ROBOT, "cube,cube")]
)
def test_nothing_is_written_where_something_is_wrong(tmp_path, robot, artefact):
    with pytest.raises(BayescalError):
        bc.init(tmp_path / "cell", robot, artefact)
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(every, tmp_path, quick):
    (tmp_path / "notes.txt").write_text("mine")
    refused("not empty", lambda: bc.init(tmp_path, ROBOT))
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    before = (every / SETTINGS).read_bytes()
    refused("not empty", lambda: bc.init(every, ROBOT, "tracker"))
    assert (every / SETTINGS).read_bytes() == before


def test_the_tool_and_the_name_that_are_given(tmp_path, quick):
    bc.init(tmp_path / "cell", ROBOT, "tracker", tool="0.1 0.2 0.3 m", name="Monday")
    found, _, _ = read_settings(tmp_path / "cell" / SETTINGS, assume=True)
    assert np.allclose(found.tools[0].centre, [0.1, 0.2, 0.3])
    assert not any(path[-1] == "centre_mm" for path in found.unfilled)
    assert found.name == "Monday"


def test_a_robot_of_ones_own_is_copied_beside(tmp_path, quick):
    own = tmp_path / "own.yaml"
    own.write_text(robot_to_yaml(load_robot(ROBOT)[0]))
    bc.init(tmp_path / "cell", str(own), "cube")
    found, _, _ = read_settings(tmp_path / "cell" / SETTINGS, assume=True)
    assert found.robot_reference == "robot.yaml"
    assert robot_to_yaml(found.robot) == own.read_text()


def test_a_new_robot_is_to_be_filled_in(tmp_path, quick):
    assert "robot.yaml" in bc.init(tmp_path / "cell", "new", "cube")
    refused("`normal` is not filled in", lambda: read_setup(tmp_path / "cell"))
    caught = refused(r"`name` is not filled in", lambda: load_robot("robot.yaml", tmp_path / "cell"))
    assert caught.where.startswith("robot.yaml:")


def test_a_part_of_a_name_is_taken_where_it_is_unique():
    assert full_name("ur5e") == "universal-robots-ur5e"
    assert all(full_name(name) == name for name in builtin_robots())
    assert full_name("fanuc") == "fanuc"  # two of them
    assert bc.simulate("lrmate200ic", contacts=16, later=0, repeats=0, spheres=0).dataset.robot.name == ROBOT


def test_a_simulated_session_has_the_same_targets(room):
    """To practise on: the cube and the first placement of the spheres stand where `init` puts them."""
    dataset = bc.simulate(ROBOT, contacts=16, later=0, repeats=0, placements=1).dataset
    meant = [*ARTEFACTS["cube"].outline(room).targets, *ARTEFACTS["spheres"].outline(room).targets[:3]]
    assert [t.name for t in dataset.targets] == [t.name for t in meant]
    for here, there in zip(dataset.targets, meant, strict=True):
        for key, value in there.values.items():
            assert np.allclose(here.values[key], value, atol=1e-9)
