"""Parts of real sessions that are compared: which rows are in which part, and the page."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bayescal as bc
from analysis import real_changes
from bayescal.dataset import Target


@pytest.fixture(scope="module")
def session():
    return bc.simulate(effects="geometry", contacts=40, later=4, repeats=2, spheres=0, seed=1).dataset


def named(d, names, of_row, repeat=None):
    """A session whose rows are of fixed points, or planes, with these names."""
    count = len(of_row)
    columns = {k: v if v is None else v[:count] for k, v in vars(d.measurements).items()}
    m = type(d.measurements)(**columns | {"target": np.array(of_row), "repeat": repeat})
    kind = "plane" if repeat is not None else "fixed-point"
    targets = tuple(Target(n, kind, {"centre": np.array([k, 0.0, 0.0])}) for k, n in enumerate(names))
    return replace(d, targets=targets, measurements=m)


def test_halves_are_all_poses_once(session):
    one, other = real_changes.halves(session, 1)
    assert sorted((*one.measurements.ids, *other.measurements.ids)) == sorted(session.measurements.ids)
    again, _ = real_changes.halves(session, 2)
    assert one.measurements.ids != again.measurements.ids
    repeats = [set(h.measurements.repeat) - {""} for h in (one, other)]
    assert not repeats[0] & repeats[1]  # rows of one pose stay together


def test_sockets_of_a_place_are_one_target(session):
    d = named(session, ("left.0", "left.1", "right.0", "right.1"), [0, 1, 2, 3, 3, 0])
    one, other = real_changes.sockets(d)
    assert [t.name for t in one.targets] == ["left", "right"] == [t.name for t in other.targets]
    assert one.measurements.target.tolist() == [0, 1, 0]
    assert other.measurements.target.tolist() == [0, 1, 1]
    # both have the place that is stated of the first
    assert [t.values["centre"][0] for t in other.targets] == [0, 2]


def test_the_second_run_has_what_is_repeated_and_the_wall_of_the_second(session):
    repeat = np.array(["", "", "a", "b", "a", "b"])
    d = named(session, ("wall@1", "wall@2", "table"), [0, 1, 2, 2, 2, 2], repeat)
    one, other = real_changes.runs(d)
    assert [t.name for t in one.targets] == ["wall", "table"]
    assert one.measurements.ids == tuple(d.measurements.ids[k] for k in (0, 2, 3))
    assert other.measurements.ids == tuple(d.measurements.ids[k] for k in (1, 4, 5))
    assert other.measurements.target.tolist() == [0, 1, 1]
    assert set(other.measurements.role) == {"calibrate"}


def test_a_face_takes_the_name_of_another(session):
    tools = tuple(replace(session.tools[0], name=n) for n in ("face0", "face1", "face2"))
    d = named(session, ("table",), [0] * 24, np.array([""] * 24))
    tool = np.arange(24) % 3
    d = replace(d, tools=tools, measurements=replace(d.measurements, tool=tool))
    one, other = real_changes.faces(d)
    of_face = [set(m.ids) & {i for i, k in zip(d.measurements.ids, tool, strict=True) if k == f}
               for f, m in ((0, one.measurements), (1, other.measurements))]  # fmt: skip
    assert [len(of) for of in of_face] == [8, 8]
    assert set(other.measurements.tool) == {0, 2}
    assert not set(one.measurements.ids) & set(other.measurements.ids)


def test_a_record_and_the_page(tmp_path, monkeypatch, capsys):
    for name in ("panda-1", "ur5"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "dataset.yaml").touch()
    keys = [t.key for t in real_changes.tasks(tmp_path)]
    assert keys == [
        "panda-1 | sockets",
        "panda-1 | halves 1",
        "panda-1 | halves 2",
        "ur5 | halves 1",
        "ur5 | halves 2",
    ]
    item = SimpleNamespace(name="base")
    found = SimpleNamespace(
        verdict="changed", arm="same", same=0.0, arm_same=0.8,
        differences=[SimpleNamespace(item=item, group=("base", "theta1"), stated=True)] * 6,
    )  # fmt: skip
    monkeypatch.setattr(real_changes, "read_dataset", lambda folder: None)
    monkeypatch.setattr(real_changes, "modelled", lambda scene: ("geometry",))
    monkeypatch.setattr(real_changes, "changed", lambda pair, effects: found)
    monkeypatch.setitem(real_changes.PARTS, "sockets", lambda d: (None, None))
    record = real_changes.made(real_changes.Task(Path("panda-1"), "sockets"))
    assert record["named"] == ["base or theta1"]
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "records.json").write_text(json.dumps(dict.fromkeys(keys, record)))
    page = tmp_path / "page.md"
    page.write_text("\n".join(real_changes.MARKS))
    real_changes.main(["--real", str(tmp_path), "--runs", str(tmp_path / "runs"), "--out", str(page)])
    assert "| panda-1 | sockets | changed | same | 0.80 | base or theta1 |" in page.read_text()
    assert capsys.readouterr().out.count("\n") >= 5
