"""anther calibrate: rendered images in, calibration.json out; one clear message for every bad file or option."""

from __future__ import annotations

import io
import json
import re
import shutil
from contextlib import redirect_stdout
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_board import T_BASE_BOARD, T_FLANGE_CAM, errors, poses, render
from matplotlib.image import imread

from anther.cli.main import main
from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics, pose7, small_transform
from anther.robot.calibration import CharucoBoard, Chessboard, HandEye, read_poses

CAMERA = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5)
CHARUCO, CHESS = "charuco:7x5:30mm:22mm", "chessboard:6x5:30mm"
HEADER = "image,x,y,z,qx,qy,qz,qw"


def write_poses(path: Path, flange: Array) -> None:
    rows = [",".join([f"{i:02}.png", *(f"{x:.9f}" for x in pose7(T))]) for i, T in enumerate(flange)]
    path.write_text("\n".join([HEADER, *rows]) + "\n")


def write_case(folder: Path, board: CharucoBoard | Chessboard, count: int) -> Path:
    """Images, poses and intrinsics of a simulated calibration; view 3 has a wrong pose, 99.png has none."""
    flange, seen = poses(count, np.random.default_rng(2))
    (folder / "images").mkdir()
    for i, T in enumerate(seen):
        cv2.imwrite(str(folder / "images" / f"{i:02}.png"), render(board, T, CAMERA))
    cv2.imwrite(str(folder / "images" / "99.png"), np.zeros((480, 640), np.uint8))
    (folder / "images" / "intrinsics.json").write_text(json.dumps(asdict(CAMERA)))
    flange[3] = flange[3] @ small_transform([0.02, 0, 0], [0, 0.01, 0])
    write_poses(folder / "poses.csv", flange)
    return folder


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_case(tmp_path_factory.mktemp("charuco"), CharucoBoard(), 12)


@pytest.fixture(scope="module")
def calibrated(case: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of its calibration, and what was said."""
    out, said = tmp_path_factory.mktemp("calibrated"), io.StringIO()
    with redirect_stdout(said):
        assert main(words(case, out)) == 0
    return out, said.getvalue()


def words(case: Path, out: Path, *more: object, board: str = CHARUCO) -> list[str]:
    start = ["calibrate", "--images", case / "images", "--poses", case / "poses.csv", "--board", board, "--out", out]
    return [str(word) for word in [*start, *more]]


def refused(capsys, command: list[str]) -> str:
    """Run a command that must fail with exit code 2 and one message; return it."""
    try:
        code = main(command)
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert code == 2
    assert "Traceback" not in out + err
    return re.sub(r"[\s│]+", " ", err + out)


def test_rendered_images_become_a_calibration(calibrated: tuple[Path, str]) -> None:
    out, text = calibrated
    found = HandEye.load(out / "calibration.json")
    rotation, translation = errors(found.T_flange_cam)
    assert rotation < 0.06
    assert translation < 0.6
    assert max(errors(found.T_base_board, T_BASE_BOARD)) < 1
    assert list(np.flatnonzero(~found.used)) == [3]
    assert found.intrinsics == CAMERA
    assert "warning: left out as outliers: views 03.png" in text
    assert "warning: no pose for 99.png: not used" in text
    assert re.search(r"daniilidis.*\n.*refined", text)
    assert " ".join(f"{x:.6f}" for x in pose7(found.T_flange_cam)) in text
    picture = imread(out / "calibration.png")
    assert picture.shape[1] > 1000
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 100


def test_a_chessboard_with_estimated_intrinsics_as_json(tmp_path: Path, capsys) -> None:
    case = write_case(tmp_path, Chessboard(6, 5, 0.03), 12)
    assert main(words(case, tmp_path, "--estimate-intrinsics", "--json", board=CHESS)) == 0
    result = json.loads(capsys.readouterr().out)
    assert [result["intrinsics"]["fx"], result["intrinsics"]["fy"]] == pytest.approx([500, 500], rel=0.01)
    # The chessboard's own origin is another corner than the rendered page's; the camera's place does not depend on it.
    rotation, translation = errors(np.array(result["T_flange_cam"]), T_FLANGE_CAM)
    assert rotation < 0.2  # a principal point that is off by 1 px turns the camera by 0.11 deg
    assert translation < 1.5
    assert [name for name, used in zip(result["images"], result["used"], strict=True) if not used] == ["03.png"]
    assert (result["kind"], result["schema"]) == ("hand-eye", 2)


def test_results_do_not_change_from_run_to_run(calibrated: tuple[Path, str], case: Path, tmp_path: Path) -> None:
    assert main(words(case, tmp_path)) == 0
    assert (tmp_path / "calibration.json").read_bytes() == (calibrated[0] / "calibration.json").read_bytes()


def test_bad_options_are_refused(case: Path, tmp_path: Path, capsys) -> None:
    def message(*more: object, board: str = CHARUCO) -> str:
        return refused(capsys, words(case, tmp_path, *more, board=board))

    assert "charuco:7x5:30mm:22mm" in message(board="charuco:7x5")
    assert "none with 8 corners" in message(board="charuco:7x5:30mm:22mm:DICT_6X6_50")
    assert "not both" in message("--estimate-intrinsics", "--intrinsics", case / "images" / "intrinsics.json")
    assert "no such file" in message("--intrinsics", tmp_path / "none.json")
    (tmp_path / "other.json").write_text(json.dumps(asdict(Intrinsics(1280, 720, 640, 640, 640, 360))))
    assert "640 x 480 px, as the images" in message("--intrinsics", tmp_path / "other.json")
    assert "tsai" in message("--method", "andreff")
    assert "--board" in refused(capsys, ["calibrate", "--images", "x", "--poses", "y"])
    assert not (tmp_path / "calibration.json").exists()


def test_bad_folders_and_files_are_refused(case: Path, tmp_path: Path, capsys) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(case, copy)
    (copy / "images" / "intrinsics.json").unlink()
    assert "--estimate-intrinsics" in refused(capsys, words(copy, tmp_path))
    given = ("--intrinsics", case / "images" / "intrinsics.json")
    cv2.imwrite(str(copy / "images" / "05.png"), np.zeros((100, 100), np.uint8))
    assert "100 x 100 (05.png)" in refused(capsys, words(copy, tmp_path, *given))
    (copy / "images" / "05.png").write_bytes(b"no image")
    assert "not a whole image" in refused(capsys, words(copy, tmp_path, *given))
    (copy / "images" / "05.png").write_bytes(b"")
    assert "not a whole image" in refused(capsys, words(copy, tmp_path, *given))
    (copy / "images" / "05.png").unlink()
    assert "poses for 05.png" in refused(capsys, words(copy, tmp_path, *given))
    (copy / "poses.csv").unlink()
    assert "poses.csv: no such file" in refused(capsys, words(copy, tmp_path, *given))
    shutil.rmtree(copy / "images")
    assert "images: no such file or folder" in refused(capsys, ["calibrate", "--images", str(copy / "images"),
        "--poses", str(case / "poses.csv"), "--board", CHARUCO, "--estimate-intrinsics"])  # fmt: skip


def test_poses_that_do_not_belong_to_the_images_are_refused(case: Path, tmp_path: Path, capsys) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(case, copy)
    flange = np.stack(list(read_poses(case / "poses.csv").values()))
    write_poses(copy / "poses.csv", flange[::-1])
    assert "belong together" in refused(capsys, words(copy, tmp_path))
    write_poses(
        copy / "poses.csv", np.stack([flange[0] @ small_transform([0, 0, 0.1 * i], [0, 0, 0]) for i in range(12)])
    )
    assert "one axis only" in refused(capsys, words(copy, tmp_path))
    write_poses(copy / "poses.csv", flange[:2])
    assert "3 or more" in refused(capsys, words(copy, tmp_path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses"),
        (HEADER, "no poses"),
        ("image,x,y,z,qw,qx,qy", "line 1: got columns"),
        (f"{HEADER}\na.png,0,0,0,0,0,1", "line 2: got 7 entries"),
        (f"{HEADER}\na.png,0,0,zero,0,0,0,1", "line 2.*not 7 numbers"),
        (f"{HEADER}\na.png,0,0,0,0,0,0,2", "line 2.*quaternion norm 2"),
        (f"{HEADER}\na.png,nan,0,0,0,0,0,1", "line 2.*NaN"),
        (f"{HEADER}\na.png,500,20,300,0,0,0,1", "in metres"),
        (f"{HEADER}\na.png,0,0,0,0,0,0,1\n# again\na.png,0,0,0,0,0,0,1", "line 4: got image 'a.png' again"),
    ],
)
def test_bad_pose_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_poses(tmp_path / "poses.csv")


@pytest.mark.parametrize(
    "text", ["[]", "{}", '{"a.png": 3}', '{"a.png": [1, 2]}', '{"a.png": ["x", 0, 0, 0, 0, 0, 1]}', "{"]
)
def test_bad_json_poses_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises(InputError, match=r"poses\.json"):
        read_poses(tmp_path / "poses.json")
