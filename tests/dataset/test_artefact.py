"""artefact.yaml: what follows from it for a session, what is refused, and that it is kept."""

import numpy as np
import pytest
from tiny_dataset import SETTINGS, line_of, write

from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.consistency import contradictions
from bayescal.errors import BayescalError

STATED = "  - {kind: distance, between: [ball.A, ball.B], distance_mm: 150.0, u_distance_mm: 0.001}\n"
USED = SETTINGS.replace(STATED, "").replace("temperature_of", "artefact: plate.yaml\ntemperature_of")
PLATE = """\
schema: bayescal-artefact/1
name: plate
points:
  ball.A: {mm: [0, 0, 0], u_mm: 0.002}
  ball.B: {mm: [90, 120, 0], u_mm: [0.001, 0.003, 0.002]}
  spare: {mm: [0, 120, 0], u_mm: 0.001}
"""
FULL = (
    PLATE.replace(", u_mm: 0.002", "")
    .replace(", u_mm: [0.001, 0.003, 0.002]", "")
    .replace(", u_mm: 0.001", "")
)
MATRIX = [[1e-6 * (4 * (i == j) + (i % 3 == j % 3)) for j in range(9)] for i in range(9)]


def session(folder, plate=PLATE, settings=USED):
    (folder / "plate.yaml").write_text(plate)
    return write(folder, settings)


def with_matrix(matrix=MATRIX) -> str:
    return FULL + "covariance_mm2:\n" + "".join(f"  - {row}\n" for row in matrix)


def test_distances_follow_with_their_uncertainty(tmp_path):
    data = read_dataset(session(tmp_path))
    whole, pair = data.certificates[-2:]
    assert (whole.kind, whole.targets, whole.points.of) == ("points", ("ball.A", "ball.B"), (0, 1))
    assert (pair.targets, pair.distance, pair.derived) == (("ball.A", "ball.B"), pytest.approx(0.15), True)
    along = np.array([0.6, 0.8, 0.0])
    expected = along**2 @ np.array([4 + 1, 4 + 9, 4 + 4])  # um2
    assert pair.u_distance == pytest.approx(1e-6 * np.sqrt(expected))
    assert not list(contradictions(data))


def test_a_covariance_is_used_with_its_correlations(tmp_path):
    pair = read_dataset(session(tmp_path, with_matrix())).certificates[-1]
    assert pair.u_distance == pytest.approx(1e-6 * np.sqrt(2 * 4))  # the common part of both points cancels


@pytest.mark.parametrize("plate", [PLATE, with_matrix()], ids=["u", "covariance"])
def test_it_comes_back(tmp_path, plate):
    data = read_dataset(session(tmp_path, plate))
    write_dataset(data, tmp_path / "out")
    again = read_dataset(tmp_path / "out")
    assert [(c.kind, c.targets) for c in again.certificates] == [
        (c.kind, c.targets) for c in data.certificates
    ]
    one, other = data.certificates[-2].points, again.certificates[-2].points
    assert (one.names, one.of, one.placements) == (other.names, other.of, other.placements)
    np.testing.assert_allclose(other.coordinates, one.coordinates, atol=1e-12)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-8, atol=1e-24)


def test_its_content_is_part_of_the_hash(tmp_path):
    one = read_dataset(session(tmp_path)).sha256
    assert read_dataset(session(tmp_path, PLATE.replace("90,", "90.1,"))).sha256 != one


def test_a_wrong_unit_of_its_coordinates_is_named(tmp_path):
    data = read_dataset(session(tmp_path, PLATE.replace("[90, 120, 0]", "[0.09, 0.12, 0]")))
    (found,) = contradictions(data)
    assert (found.place, found.remedy) == (("artefact",), "the certified value looks like m: write it in mm")


@pytest.mark.parametrize(
    ("plate", "line", "words"),
    [
        (PLATE.replace(", u_mm: 0.002", ""), "ball.A", "neither `u_mm` nor `covariance_mm2`"),
        (with_matrix().replace("[0, 120, 0]", "[0, 120, 0], u_mm: 0.001"), "spare", "both `u_mm` and"),
        (with_matrix(MATRIX[:8]), "covariance", "is not 9 x 9; 3 points have 9 coordinates"),
        (with_matrix([[x + 1e-6 * (i < j) for j, x in enumerate(row)] for i, row in enumerate(MATRIX)]),
         "covariance", "not symmetric"),
        (with_matrix((np.array(MATRIX) - 5.5e-6 * np.eye(9)).tolist()), "covariance", "no covariance"),
        (PLATE.replace("[90, 120, 0]", "[0, 120, 0]"), "spare", "`ball.B` and `spare` have the same coord"),
        (PLATE.replace("ball.", "sphere."), "points", "no two targets of one placement"),
        (PLATE.replace("u_mm: 0.002", "u_mm: [0, 0, 0]").replace("[0.001, 0.003, 0.002]", "[0, 0, 0]"),
         "ball.B", "has no uncertainty"),
        (PLATE.replace("u_mm: 0.002", "u_mm: 0"), "ball.A", "more than 0"),
        (PLATE.replace("mm: [0, 0, 0]", "m: [0, 0, 0]"), "ball.A", "is it `mm`"),
        (PLATE.replace("artefact/1", "artefact/2"), "schema", "another version"),
    ],
)  # fmt: skip
def test_refusals(tmp_path, plate, line, words):
    with pytest.raises(BayescalError) as caught:
        read_dataset(session(tmp_path, plate))
    assert words in str(caught.value)
    assert caught.value.where == f"plate.yaml:{line_of(plate, line)}"


def test_a_distance_is_certified_once(tmp_path):
    settings = SETTINGS.replace("temperature_of", "artefact: plate.yaml\ntemperature_of")
    with pytest.raises(BayescalError, match="is certified by dataset"):
        read_dataset(session(tmp_path, settings=settings))


@pytest.mark.parametrize("path", ["../plate.yaml", "/etc/hostname", "none.yaml"])
def test_it_lies_in_the_folder(tmp_path, path):
    (tmp_path / "in").mkdir()
    (tmp_path / "plate.yaml").write_text(PLATE)
    with pytest.raises(BayescalError, match=r"outside the dataset folder|no such file"):
        read_dataset(session(tmp_path / "in", settings=USED.replace("plate.yaml", path)))
