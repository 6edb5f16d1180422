"""Images of a board, rendered by a homography, to a session: corners, lens and mount, and what is refused."""

import shlex
import shutil

import numpy as np
import pytest
from camera_sessions import CENTRE, FIXED, FOCAL, ON_FLANGE, SIZE, camera_session
from cases import refused

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.dataset import Target, read_dataset, write_dataset
from bayescal.dataset.table import joint_columns
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write
from bayescal.reporting.page.plan import commands

cv2 = pytest.importorskip("cv2")
PER_MM = 4
COUNT = 12
"""Of the images of a session."""
WIDE, HIGH = 210, 150
BOARD = "charuco:7x5:30mm:22mm"


def drawn():
    """The board as printed, px."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    layout = cv2.aruco.CharucoBoard((7, 5), 0.03, 0.022, dictionary)
    return layout.generateImage((WIDE * PER_MM, HIGH * PER_MM))


def checkered():
    """A checkerboard of the same squares, with a white margin of one square, px."""
    squares = np.kron(np.indices((5, 7)).sum(axis=0) % 2 * 255, np.ones((30 * PER_MM,) * 2))
    return np.pad(squares, 30 * PER_MM, constant_values=255).astype(np.uint8)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder of images for each mount, with their joint readings."""
    return rendered(tmp_path_factory.mktemp("images"), drawn(), FIXED)


def rendered(place, board, mounts, margin=0.0, images=COUNT):
    """Images of a board whose pattern starts `margin` (m) behind its upper left corner."""
    matrix = np.array([[FOCAL[0], 0, CENTRE[0]], [0, FOCAL[1], CENTRE[1]], [0, 0, 1]])
    edge = 0.5e-3 / PER_MM - margin
    to_board = np.array([[1e-3 / PER_MM, 0, edge], [0, 1e-3 / PER_MM, edge], [0, 0, 1]])
    for mount in mounts:
        session = camera_session(mount, images=images, velocity=False)
        m, folder = session.measurements, place / mount
        folder.mkdir()
        readings = m.readings[:: len(m.ids) // images]
        tool = frames(chain_of(session.robot), link_angles(session.robot, readings))[:, -1] @ ON_FLANGE
        lines = [",".join(["image", *joint_columns("deg", session.robot.units)])]
        for k, (q, t) in enumerate(zip(readings, tool, strict=True)):
            seen = np.linalg.inv(t) @ FIXED[mount] if mount == "flange" else np.linalg.inv(FIXED[mount]) @ t
            warp = matrix @ seen[:3, [0, 1, 3]] @ to_board
            size = tuple(SIZE.astype(int).tolist())
            image = cv2.warpPerspective(board, warp, size, flags=cv2.INTER_AREA, borderValue=255)
            cv2.imwrite(str(folder / f"{k:02d}.png"), cv2.GaussianBlur(image, (3, 3), 0.7))
            lines.append(",".join([f"{k:02d}.png", *(f"{v:.7f}" for v in np.degrees(q))]))
        (place / f"{mount}.csv").write_text("\n".join(lines) + "\n")
    return place


@pytest.fixture(scope="module")
def converted(made):
    return convert(asked(made))


def asked(place, mount="flange", board=BOARD, **more):
    joints = str(place / f"{mount}.csv")
    given = {"map": "", "robot": "fanuc-lrmate200ic", "joints": joints, "board": board} | more
    return Request(log=place / mount, **given)


@pytest.mark.parametrize("mount", FIXED)
def test_images_to_a_session(made, mount, tmp_path):
    write(convert(asked(made, mount)), tmp_path / "cell")
    read = read_dataset(tmp_path / "cell")
    assert read.targets[0].texts["mount"] == mount
    assert abs(read.targets[0].values["fx"] / FOCAL[0] - 1) < 0.02
    np.testing.assert_allclose(read.tools[0].centre, ON_FLANGE[:3, 3], atol=0.01)
    truth = camera_session(mount, images=COUNT, velocity=False, noise=0.0).measurements
    pixel = {(s, int(k)): (u, v) for s, (u, v, k) in zip(truth.stop, truth.pixel, strict=True)}
    m = read.measurements
    own = np.array([pixel[f"i{int(s[:2])}", int(k)] for s, k in zip(m.stop, m.pixel[:, 2], strict=True)])
    assert np.sqrt(np.mean((m.pixel[:, :2] - own) ** 2)) < 0.3
    assert cv2.imread(str(tmp_path / "cell" / "found.jpg")) is not None


def test_the_command(made, tmp_path, output_of):
    given = ("--board", BOARD, "--joints", made / "flange.csv", "--robot", "fanuc-lrmate200ic")
    text = output_of("import", made / "flange", *given, "--out", tmp_path / "cell")
    assert f"{COUNT} images of {COUNT}" in text
    assert "mount: flange" in text


def test_refusals(made, tmp_path):
    other = shutil.copytree(made / "flange", tmp_path / "flange")
    shutil.copy(made / "flange.csv", tmp_path)
    (other / "03.png").write_bytes(b"no image")
    refused("not an image", lambda: convert(asked(tmp_path)))
    cv2.imwrite(str(other / "03.png"), np.zeros((100, 100), np.uint8))
    refused("the others have 1280 x 720", lambda: convert(asked(tmp_path)))
    (tmp_path / "flange.csv").write_text("image,j1_deg\n00.png,1\n")
    refused("j2_deg", lambda: convert(asked(tmp_path)))


def test_mirrored_images(made, tmp_path):
    mirrored = shutil.copytree(made / "flange", tmp_path / "flange")
    shutil.copy(made / "flange.csv", tmp_path)
    for path in mirrored.iterdir():
        cv2.imwrite(str(path), cv2.imread(str(path))[:, ::-1])
    refused(f"in 0 of {COUNT} images: they are mirrored", lambda: convert(asked(tmp_path)))


def renamed(made, tmp_path, names):
    """The request for images whose readings have other names, by number."""
    shutil.copytree(made / "flange", tmp_path / "flange")
    head, *rows = (made / "flange.csv").read_text().splitlines()
    lines = [f"{k:02d}.png,{row.partition(',')[2]}" for k, row in zip(names, rows, strict=True)]
    (tmp_path / "flange.csv").write_text("\n".join([head, *lines, ""]))
    return asked(tmp_path)


def test_images_at_other_readings_are_not_a_board_of_another_size(made, tmp_path):
    with pytest.raises(BayescalError, match="images of `camera` fit the joint readings of the image"):
        write(convert(renamed(made, tmp_path, [COUNT - 1, *range(COUNT - 1)])), tmp_path / "cell")


def test_an_image_at_other_readings_is_told_with_its_line(made, tmp_path):
    request = renamed(made, tmp_path, [0, 1, 2, 4, 3, *range(5, COUNT)])
    refused(r"^flange.csv:[56]: impossible image", lambda: write(convert(request), tmp_path / "cell"))


def test_images_without_readings_are_named(made, converted, tmp_path):
    shutil.copytree(made / "flange", tmp_path / "flange")
    shutil.copy(made / "flange.csv", tmp_path)
    assert not any("without joint readings" in note for note in converted.notes)
    shutil.copy(tmp_path / "flange" / "00.png", tmp_path / "flange" / "more.png")
    assert "without joint readings, not used: more.png" in convert(asked(tmp_path)).notes


@pytest.mark.parametrize(("options", "words"), [
    ({"board": "charuco:5x4:30mm:22mm"}, "another board"),
    ({"board": "charuco:7x5"}, "is no board"),
    ({"board": "charuco:7x5:25mm:18.3mm"}, "squares of 30 mm"),
    ({"joints": "none.csv"}, "no such file"),
    ({"tool": "0 0 31 mm"}, "is not an option of images"),
])  # fmt: skip
def test_refused_options(made, tmp_path, options, words):
    refused(words, lambda: write(convert(asked(made, **options)), tmp_path / "cell"))


def test_images_that_validate(made):
    m = convert(asked(made, validate="every:5")).dataset.measurements
    assert set(m.stop[m.role == "validate"]) == {"04.png", "09.png"}


def test_of_two_tags_none_is_taken(made, tmp_path):
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    (folder := tmp_path / "flange").mkdir()
    shutil.copy(made / "flange.csv", tmp_path)
    for k in range(COUNT):
        image, number = np.full((720, 1280), 255, np.uint8), int(k == 7)
        image[200:400, 300:500] = cv2.aruco.generateImageMarker(family, number, 200)
        cv2.imwrite(str(folder / f"{k:02d}.png"), image)
    refused("tags 0, 1 are seen", lambda: convert(asked(tmp_path, board="apriltag:36h11:40mm")))


def test_a_checkerboard_is_numbered_from_one_end_in_all_images(tmp_path):
    place = rendered(tmp_path, checkered(), ["flange"], margin=0.03, images=7)
    draft = convert(asked(place, board="checkerboard:6x4:30mm"))
    truth = camera_session("flange", images=7, velocity=False, noise=0.0).measurements
    pixel = {(s, int(k)): uv for s, (*uv, k) in zip(truth.stop, truth.pixel, strict=True)}
    m, ends = draft.dataset.measurements, []
    for s, (*uv, k) in zip(m.stop, m.pixel, strict=True):
        one, other = (pixel[f"i{int(s[:2])}", n] for n in (int(k), 23 - int(k)))
        ends.append(np.linalg.norm(np.subtract(uv, one)) < np.linalg.norm(np.subtract(uv, other)))
    assert len(set(ends)) == 1
    # OpenCV numbers some images from the other end
    assert ".png" in next(note for note in draft.notes if "from the other end" in note)


def test_images_are_named_by_the_ids_of_a_plan(made, converted, tmp_path):
    plan = tmp_path / "plan.csv"
    rows = [line.split(",") for line in (made / "flange.csv").read_text().splitlines()]
    head = ["id", "role", *rows[0][1:], "payload_kg", "repeat"]
    lines = [head, *([row[0].removesuffix(".png"), "calibrate", *row[1:], "0", ""] for row in rows[1:])]
    plan.write_text("\n".join(map(",".join, lines)) + "\n")
    one, other = converted, convert(asked(made, joints=str(plan)))
    np.testing.assert_array_equal(one.dataset.measurements.pixel, other.dataset.measurements.pixel)
    np.testing.assert_array_equal(one.dataset.measurements.readings, other.dataset.measurements.readings)


def test_the_command_of_a_plan_imports_its_images(made, tmp_path, output_of):
    plan, template = tmp_path / "run" / "plan.csv", camera_session("flange", images=COUNT, velocity=False)
    write_dataset(template, tmp_path / "run")
    rows = [line.split(",") for line in (made / "flange.csv").read_text().splitlines()]
    ids = [["id", *rows[0][1:]], *([row[0].removesuffix(".png"), *row[1:]] for row in rows[1:])]
    plan.write_text("\n".join(map(",".join, ids)) + "\n")
    words = shlex.split(commands(tmp_path / "run", template.targets)["images"])
    given = {"IMAGES": str(made / "flange"), "SESSION": str(tmp_path / "new")}
    output_of(*(given.get(word, word) for word in words[1:]))
    assert len(set(read_dataset(tmp_path / "new").measurements.stop)) == COUNT
    log = commands(tmp_path / "run", (Target("a", "plane", {}), *template.targets))
    assert list(log) == ["import", "fit", "gap"]
