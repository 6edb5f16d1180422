"""What is written reads back; whole or not at all."""

from dataclasses import fields, replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny_dataset import SETTINGS, TABLE, write

from bayescal.dataset import Dataset, Record, read_dataset, write_dataset
from bayescal.errors import BayescalError
from bayescal.robots import load_robot

FOLDERS = sorted(
    p.parent
    for pattern in ("real/*/dataset.yaml", "worlds-dev*/*0/dataset.yaml")  # simulated ones differ little
    for p in foreign.DATA.glob(pattern)
) or [foreign.DATA]


KEPT = {"payload": 6e-7, "mass": 6e-7, "torque": 6e-7, "velocity": 1e-8, "time": 6e-5, "temperature": 6e-5}
"""What half a last decimal is, in SI, where it is not a nanometre or two nanoradians."""


def same(a: object, b: object, path: str = "") -> None:
    """Equal to what `write_dataset` promises to keep."""
    if hasattr(a, "__dataclass_fields__"):
        for f in fields(a):  # type: ignore[arg-type]
            if f.name not in ("folder", "sha256", "robot_reference", "line"):
                same(getattr(a, f.name), getattr(b, f.name), f"{path}.{f.name}")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), path  # type: ignore[arg-type]
        for i, (x, y) in enumerate(zip(a, b, strict=True)):  # type: ignore[call-overload]
            same(x, y, f"{path}[{i}]")
    elif isinstance(a, dict):
        assert a.keys() == b.keys(), path  # type: ignore[attr-defined]
        for key in a:
            same(a[key], b[key], f"{path}.{key}")  # type: ignore[index]
    elif isinstance(a, float) or (isinstance(a, np.ndarray) and a.dtype.kind == "f"):
        atol = KEPT.get(path.rpartition(".")[2], 1.1e-9)
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=atol, err_msg=path)
    else:
        np.testing.assert_array_equal(a, b, err_msg=path)


@foreign.needs()
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: p.name)
def test_shared_datasets_read_and_come_back(folder, tmp_path):
    data = read_dataset(folder)
    write_dataset(data, tmp_path / "out")
    same(data, read_dataset(tmp_path / "out"))


def test_tiny_comes_back_and_hashes_differ_with_content(tmp_path):
    data = read_dataset(write(tmp_path))
    assert data.record == Record(
        date="2026-03-04",
        operator="A. <b>Operator</b>",
        serials={"arm": "0123", "probe": "P: 7, [/]"},
        certificates=("DKD-K-1234", "77"),
        temperature=20.5,
    )
    write_dataset(data, tmp_path / "new" / "out")
    again = read_dataset(tmp_path / "new" / "out")
    same(data, again)
    assert again.robot_reference == "fanuc-lrmate200ic"
    assert sorted(p.name for p in (tmp_path / "new" / "out").glob("[!.]*")) == [
        "dataset.yaml",
        "measurements.csv",
    ]
    assert read_dataset(write(tmp_path)).sha256 == data.sha256
    assert read_dataset(write(tmp_path, SETTINGS.replace("tiny", "tiny2"))).sha256 != data.sha256
    assert read_dataset(write(tmp_path, table=TABLE.replace("21.5", "21.6"))).sha256 != data.sha256


def test_changed_builtin_is_written_beside(tmp_path):
    data = read_dataset(write(tmp_path))
    arm = replace(data.robot, a=data.robot.a + 1e-5)
    write_dataset(replace(data, robot=arm), tmp_path / "out")
    again = read_dataset(tmp_path / "out")
    assert again.robot_reference == "robot.yaml"
    np.testing.assert_allclose(again.robot.a, arm.a, atol=1e-15)


def test_whole_or_not_at_all(tmp_path):
    data = read_dataset(write(tmp_path))
    with pytest.raises(BayescalError, match="not empty"):
        write_dataset(data, tmp_path)
    broken = replace(data, targets=(replace(data.targets[0], values={}), *data.targets[1:]))
    with pytest.raises(KeyError):
        write_dataset(broken, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    write_dataset(data, tmp_path / "out")
    assert not [p for p in tmp_path.glob("[!.]*") if p.name.endswith(".part")]


NAMES = st.text(
    st.characters(exclude_categories=["Cs", "Cc", "Cf", "Zl", "Zp"]), min_size=1, max_size=12
).filter(lambda s: s == s.strip())


@st.composite
def datasets(draw) -> Dataset:
    """The tiny dataset's fixed point and instrument, under any names and with any optional column."""
    from bayescal.dataset import Certificate, Measurements, Noise, Target, Tool

    count, n = 3, 6
    floats = st.floats(-1, 1, allow_subnormal=False)
    column = st.lists(floats, min_size=count, max_size=count).map(np.array)
    block = st.lists(st.lists(floats, min_size=n, max_size=n), min_size=count, max_size=count).map(np.array)
    names = draw(st.lists(NAMES, min_size=3, max_size=3, unique=True))
    words = st.lists(NAMES | st.just(""), min_size=count, max_size=count).map(np.array)
    uncertain = st.none() | st.just(0.0) | st.floats(1e-8, 0.1)
    rows = Measurements(
        ids=tuple(draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))),
        role=np.array(
            draw(st.lists(st.sampled_from(("calibrate", "validate", "locate")), min_size=3, max_size=3))
        ),
        target=np.zeros(count, int),
        tool=np.array([0, 1, 0]),
        readings=np.deg2rad(draw(block)) + 0.1,
        line=np.arange(2, 2 + count),
        velocity=draw(st.none() | block),
        torque=draw(st.none() | block),
        stop=draw(st.none() | words),
        repeat=draw(st.none() | words),
        time=draw(st.none() | column),
        temperature=draw(st.none() | column),
        payload=draw(st.none() | column.map(np.abs)),
        u=draw(st.none() | column.map(lambda v: np.where(v > 0, v + 1e-6, np.nan))),
    )
    centre = np.array([0.675, 0.0, 0.3])
    u = draw(uncertain)
    return Dataset(
        name=draw(NAMES),
        folder=Path(),
        robot=load_robot("fanuc-lrmate200ic")[0],
        robot_reference="fanuc-lrmate200ic",
        readings="command",
        gravity=np.array([0.1, 0.0, -9.8]),
        tools=(
            Tool(names[0], np.array([0.06, 0.0, 0.12]), u=u, u_angle=u, rpy=np.array([0.1, -3.0, 1e-7])),
            Tool(names[1], np.array([0.06, 0.0, 0.12]), mass=0.1, ball_radius=0.003),
        ),
        noise=Noise(1e-5, draw(st.none() | st.just(2e-6)), 1e-5, draw(st.none() | st.just(3e-4))),
        targets=(
            Target(names[0], "fixed-point", {"centre": centre}, u_angle=u),
            Target(names[1], "distance", {"centre": centre - [0, 0, 0.3], "length": np.nan}),
            Target(names[2], "plane", {"normal": np.array([0.6, 0.0, 0.8]), "offset": 0.1}),
        ),
        certificates=(
            Certificate("distance", (names[0], names[1]), distance=0.3, u_distance=1e-6),
            Certificate("flat", (names[2],), u_form=2.5e-6),
        ),
        measurements=rows,
        temperature_of=draw(st.sampled_from((None, "arm", "air", "artefact"))),
        source=draw(st.none() | NAMES),
        record=Record(
            date=draw(st.just("") | st.dates().map(str)),
            operator=draw(st.just("") | NAMES),
            serials=draw(st.dictionaries(st.sampled_from(("arm", "probe", "artefact", "instrument")), NAMES)),
            certificates=tuple(draw(st.lists(NAMES, max_size=2))),
            temperature=draw(st.none() | st.floats(-40, 60).map(lambda t: round(t, 3))),
        ),
    )


@given(data=datasets())
@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
def test_any_dataset_comes_back(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("any") / "out"
    write_dataset(data, folder)
    same(data, read_dataset(folder))
