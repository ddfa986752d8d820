"""anther calibrate --live and --check: the camera's hidden place is found, and that it moved; no view is lost."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from board_cell import BOARD, CAMERA, EYE, TRUE_FLANGE_CAM, BoardArm, BoardCamera, Truth, start_joints
from made_board import BOARD_CENTRE, CORNERS, T_BASE_BOARD, errors, jitter

from anther.cli.live_calibration import Asking, Eye, first_look, gather
from anther.cli.main import main
from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array, inverse, look_at, pose7, small_transform, transform_points
from anther.robot.arm import _kinematics
from anther.robot.arm.model import outline
from anther.robot.arm.sawyer import SAWYER
from anther.robot.calibration import (
    BoardCorners,
    BoardViews,
    HandEye,
    Moved,
    board_views,
    calibrate,
    find_movement,
    flange_motions,
)
from anther.robot.calibration.live import (
    Taken,
    candidates,
    is_steady,
    lacks,
    read_camera_reference,
    read_earlier_views,
    sees_board,
    spread,
)  # fmt: skip
from anther.robot.cells import read_cell
from anther.robot.cells.rewriting import point_to_calibration
from anther.robot.devices import DeviceError
from anther.robot.safety import GuardedArm, GuardedCamera

EXAMPLE = (Path(__file__).parents[1] / "support" / "cells" / "sawyer.toml").read_text()
CENTRE = np.array([0.105, 0.075, 0.0])
POSE_LINE = "T_flange_cam = [0.09, 0.0, 0.03, 0.0, 0.0, 0.70710678, 0.70710678]"


def write_cell(folder: Path, truth: Truth, *changes: tuple[str, str]) -> Path:
    """A cell file with the drivers of `board_cell`, and the file with their truth."""
    world = folder / "world.json"
    truth.write(world)
    text, ours = EXAMPLE, f'world = "{world}"'
    for old, new in (
        ('"sawyer-ros1"\nmaster = "MASTER"\nmode = "trajectory"', f'"board_cell:BoardArm"\n{ours}'),
        ('"robotiq-2f"\nport = "GRIPPER"', '"board_cell:BoardGripper"'),
        (f'"fake_robot:FakeCamera"\n{POSE_LINE}', f'"board_cell:BoardCamera"\n{ours}\n{POSE_LINE}  # by a ruler'),
        *changes,
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "cell.toml").write_text(text)
    return folder / "cell.toml"


def an_eye(cell: Path) -> tuple[Eye, BoardArm]:
    """The cell's machines in this process."""
    file = read_cell(cell)
    arm = BoardArm(str(cell.parent / "world.json"))
    camera = BoardCamera(str(cell.parent / "world.json"), arm)
    return Eye(file, GuardedArm(arm, file.safety_limits()), GuardedCamera(camera)), arm


def begun(folder: Path) -> Taken:
    return Taken(folder / "calib", BOARD, CAMERA, np.zeros(5))


# ---- the whole way, by the command line


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a cell that was calibrated live."""
    folder = tmp_path_factory.mktemp("live")
    cell = write_cell(folder, Truth())
    assert (
        main(["calibrate", "--live", "--cell", str(cell), "--board", BOARD, "--out", str(folder / "calib"), "--yes"])
        == 0
    )
    return folder


@pytest.fixture
def copied(calibrated: Path, tmp_path: Path) -> Path:
    """The same in a folder of its own."""
    shutil.copytree(calibrated, tmp_path / "cell")
    cell = tmp_path / "cell" / "cell.toml"
    cell.write_text(cell.read_text().replace(str(calibrated), str(tmp_path / "cell")))
    return tmp_path / "cell"


def test_the_hidden_place_of_the_camera_is_found(calibrated: Path) -> None:
    found = HandEye.load(calibrated / "calib" / "calibration.json")
    rotation, translation = errors(found.T_flange_cam, TRUE_FLANGE_CAM)
    assert rotation < 0.06  # the file said 5 degrees and 17 mm else
    assert translation < 0.5
    assert max(errors(found.T_base_board, T_BASE_BOARD)) < 0.6
    assert translation < 4e3 * found.translation_error
    assert 10 <= len(found.images) < Taken.most


def test_the_views_cover_image_tilt_and_turns(calibrated: Path) -> None:
    record = read_camera_reference(calibrated / "calib")
    motions = flange_motions(record.T_base_flange)
    assert motions.largest > np.deg2rad(40)
    assert motions.second > np.deg2rad(30)
    assert np.rad2deg(np.arccos(np.abs(record.T_cam_board[:, 2, 2]))).max() > 30
    taken = taken_again(calibrated)
    assert taken.coverage() >= 0.4


def taken_again(calibrated: Path) -> Taken:
    folder = calibrated / "calib"
    other = folder.parent / "again"
    shutil.copytree(folder, other, dirs_exist_ok=True)
    (other / "calibration.json").unlink(missing_ok=True)
    taken = read_earlier_views(other, BOARD)
    assert taken is not None
    return taken


def test_only_the_pose_in_the_cell_file_changed(calibrated: Path) -> None:
    cell = calibrated / "cell.toml"
    kept = calibrated / "cell.toml.old1"
    before, after = kept.read_text().splitlines(), cell.read_text().splitlines()
    assert len(before) == len(after)
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert changed == [(f"{POSE_LINE}  # by a ruler", 'calibration = "calib/calibration.json"  # by a ruler')]
    found = HandEye.load(calibrated / "calib" / "calibration.json")
    assert read_cell(cell).T_flange_cam == pytest.approx(found.T_flange_cam)


def test_the_folder_is_one_for_calibrate_from_files(calibrated: Path, tmp_path: Path, capsys) -> None:
    folder = calibrated / "calib"
    words = ["--images", folder, "--poses", folder / "poses.csv", "--board", BOARD, "--out", tmp_path]
    assert main(["calibrate", *map(str, words)]) == 0
    live, files = (HandEye.load(at / "calibration.json") for at in (folder, tmp_path))
    rotation, translation = errors(live.T_flange_cam, files.T_flange_cam)
    assert rotation < 1e-4
    assert translation < 1e-3


def check(folder: Path, truth: Truth, capsys) -> tuple[int, str]:
    truth.write(folder / "world.json")
    capsys.readouterr()
    code = main(["calibrate", "--check", "--cell", str(folder / "cell.toml"), "--yes"])
    return code, capsys.readouterr().out


def test_a_check_finds_that_nothing_has_moved(copied: Path, capsys) -> None:
    code, said = check(copied, Truth(seed=5), capsys)
    assert code == 0, said
    assert "the camera has not moved: within" in said
    assert "4 views in" in said


def test_a_check_finds_a_camera_that_has_moved(copied: Path, capsys) -> None:
    moved = TRUE_FLANGE_CAM @ small_transform(np.deg2rad([0.36, -0.36, 0.31]), [0.003, -0.002, 0.002])
    code, said = check(copied, Truth(T_flange_cam=pose7(moved).tolist(), seed=6), capsys)
    assert code == 1
    told = re.search(r"THE CAMERA HAS MOVED by ([\d.]+) mm, ([\d.]+) deg", said)
    assert told is not None, said
    assert float(told[1]) == pytest.approx(4.1, abs=0.6)
    assert float(told[2]) == pytest.approx(0.6, abs=0.1)
    assert "Calibrate again: anther calibrate --live" in said


def test_a_check_without_the_board_says_so(copied: Path, capsys) -> None:
    code, said = check(copied, Truth(board=False), capsys)
    assert code == 1
    assert "4 of 4 views do not show the board" in said


def test_a_check_needs_a_live_calibration(tmp_path: Path, capsys) -> None:
    cell = write_cell(tmp_path, Truth())
    assert main(["calibrate", "--check", "--cell", str(cell), "--yes"]) == 2
    assert "Calibrate once with --live" in capsys.readouterr().err


# ---- what moved, by corners alone: many mornings


@pytest.fixture(scope="module")
def known() -> list[tuple[HandEye, Array, Array, Array]]:
    """Calibrations of arms that err by 0.05 degrees and 0.5 mm, the same at a place each time; cameras of 0.1 px."""
    first = inverse(inverse(look_at(EYE, BOARD_CENTRE[:3], up=(-1, 0, 0.3))) @ T_BASE_BOARD)
    options = candidates(first, CENTRE, CAMERA, known=True)
    reported = T_BASE_BOARD @ options[spread(options, 12, 0, CENTRE, CAMERA)] @ inverse(TRUE_FLANGE_CAM)
    out = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        true = jitter(reported, rng, 0.05, 0.0005)
        views = seen_from(jitter(true, rng, *REPEATS), rng)
        out.append((calibrate(reported, views, CAMERA), reported, true, views.T_cam_board))
    return out


REPEATS = 0.02, 0.0002
"""The arm comes back to a place so well, per axis [degrees], [m]."""


def seen_from(
    flange: Array, rng: np.random.Generator, X: Array = TRUE_FLANGE_CAM, Z: Array = T_BASE_BOARD
) -> BoardViews:
    T = inverse(flange @ X) @ Z
    pixels = tuple(CAMERA.project(transform_points(M, CORNERS)) + 0.1 * rng.normal(size=(len(CORNERS), 2)) for M in T)
    return board_views(BoardCorners(np.arange(len(T)), tuple(CORNERS for _ in T), pixels), CAMERA)


def morning(case: tuple[HandEye, Array, Array, Array], seed: int, D: Array, E: Array) -> Moved:
    """A check after the camera moved by D on the flange and the board by E in its own frame."""
    found, reported, true, T_cam_board = case
    rng = np.random.default_rng([seed, 7])
    places = spread(inverse(T_cam_board), 4, int(rng.integers(len(true))), CENTRE, CAMERA)
    today = seen_from(jitter(true[places], rng, *REPEATS), rng, TRUE_FLANGE_CAM @ D, T_BASE_BOARD @ E)
    return find_movement(found, (reported[places], T_cam_board[places]), reported[places], today, CAMERA, CENTRE)


def step(seed: int, degrees: float, metres: float) -> Array:
    turn, shift = np.random.default_rng([seed, 3]).normal(size=(2, 3))
    return small_transform(np.deg2rad(degrees) * turn / np.linalg.norm(turn), metres * shift / np.linalg.norm(shift))


def test_a_camera_that_has_not_moved_is_not_accused(known) -> None:
    said = [morning(case, seed, np.eye(4), np.eye(4)).verdict for case in known for seed in range(25)]
    assert said.count("still") == 100


def test_a_moved_camera_is_found_and_by_how_much(known) -> None:
    found = [(morning(case, seed, step(seed, 0.6, 0.004), np.eye(4))) for case in known for seed in range(10)]
    assert sum(m.verdict == "still" for m in found) == 0
    assert sum(m.verdict in ("camera", "camera or board") for m in found) >= 38
    miss = np.array([m.translation - 0.004 for m in found]) / np.array([m.translation_error for m in found])
    assert np.sqrt(np.mean(miss**2)) < 2
    assert np.median([m.rotation for m in found]) == pytest.approx(np.deg2rad(0.6), rel=0.25)


def test_a_moved_board_is_not_taken_for_the_camera(known) -> None:
    found = [morning(case, seed, np.eye(4), step(seed, 1.0, 0.008)).verdict for case in known for seed in range(10)]
    assert "still" not in found
    assert found.count("camera") == 0
    assert found.count("board") >= 30


def test_when_both_have_moved_it_is_told(known) -> None:
    found = [
        morning(case, seed, step(seed, 1, 0.008), step(seed + 50, 2, 0.02)).verdict
        for case in known
        for seed in range(5)
    ]
    assert "still" not in found
    assert found.count("more") >= 18


# ---- views, one after the other


def test_candidates_show_the_whole_board_from_all_sides() -> None:
    first = inverse(inverse(look_at(EYE, BOARD_CENTRE[:3], up=(-1, 0, 0.3))) @ T_BASE_BOARD)
    many, few = (candidates(first, CENTRE, CAMERA, known=known) for known in (True, False))
    assert len(many) > 100
    assert sees_board(many, CENTRE, CAMERA).all()
    assert len(few) == 6
    assert sees_board(few, CENTRE, CAMERA).all()
    assert np.linalg.norm(many[:, :3, 3] - CENTRE, axis=1).min() > 0.24
    assert (np.sign(many[:, 2, 3]) == np.sign(first[2, 3])).all()
    away = np.linalg.norm((few[:, :3, 3] - CENTRE), axis=1)
    assert away == pytest.approx(np.linalg.norm(first[:3, 3] - CENTRE))


def test_keep_outs_are_respected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A box where the arm went without it; then no part of the arm comes into it, by the arm's own outline."""
    monkeypatch.setattr(Taken, "most", 8)
    free, arm = an_eye(write_cell(tmp_path, Truth()))
    first_look(free, (taken := begun(tmp_path / "free")), Asking(True))
    gather(free, taken, Asking(True))
    cameras = (SAWYER.forward(np.concatenate(arm.passed)) @ TRUE_FLANGE_CAM)[:, :3, 3]
    far = cameras[np.abs(cameras - EYE).sum(axis=1).argmax()]
    box = np.array([far - 0.05, far + 0.05])
    stated = f"[[keep_out]]\nlower = {box[0].tolist()}\nupper = {box[1].tolist()}\n\n[limits]"
    shy, arm = an_eye(write_cell(tmp_path, Truth(), ("[limits]", stated)))
    first_look(shy, (taken := begun(tmp_path / "shy")), Asking(True))
    gather(shy, taken, Asking(True))
    assert len(taken) == 8
    balls = outline(SAWYER, np.concatenate(arm.passed)[::5]).reshape(-1, 4)
    gap = np.linalg.norm(np.maximum(np.maximum(box[0] - balls[:, :3], balls[:, :3] - box[1]), 0), axis=1) - balls[:, 3]
    assert gap.min() > 0


@pytest.mark.parametrize("wrong", [[0, 0, np.pi / 2], [0.25, 0, 0]], ids=["turned about its axis", "tilted"])
def test_a_wrong_pose_in_the_file_is_found_out_by_small_motions(
    tmp_path: Path, wrong: list[float], monkeypatch
) -> None:
    monkeypatch.setattr(Taken, "most", 9)
    told = pose7(TRUE_FLANGE_CAM @ small_transform(wrong, [0.03, 0, 0]))
    eye, _ = an_eye(write_cell(tmp_path, Truth(), (POSE_LINE, f"T_flange_cam = {told.tolist()}")))
    first_look(eye, (taken := begun(tmp_path)), Asking(True))
    found = gather(eye, taken, Asking(True))
    assert found is not None
    rotation, translation = errors(found.T_flange_cam, TRUE_FLANGE_CAM)
    assert rotation < 0.15
    assert translation < 1.5


def test_a_lens_that_bends_is_taken_into_account(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(Taken, "most", 9)
    bend = [-0.12, 0.03, 0.001, -0.001, 0.0]
    eye, _ = an_eye(write_cell(tmp_path, Truth(distortion=bend)))
    first_look(eye, (taken := replace(begun(tmp_path), distortion=np.array(bend))), Asking(True))
    found = gather(eye, taken, Asking(True))
    assert found is not None
    rotation, translation = errors(found.T_flange_cam, TRUE_FLANGE_CAM)
    assert rotation < 0.1
    assert translation < 1.0


class Person:
    """Moves the arm by hand whenever it is asked to."""

    def __init__(self, arm: BoardArm, places: Iterator[Array]) -> None:
        self.arm, self.places, self.asked = arm, places, []

    def __call__(self, question: str) -> str:
        self.asked.append(question)
        q = next(self.places, None)
        if q is None:
            return "done"
        self.arm.put(q)
        return ""


def test_a_person_may_move_the_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    away = start_joints() + np.array([0.9, 0, 0, 0, 0, 0, 0])
    eye, arm = an_eye(write_cell(tmp_path, Truth(joints=away.tolist())))
    ways = [EYE + rng.uniform(-0.12, 0.12, 3) for _ in range(6)]
    flange = [
        look_at(e, BOARD_CENTRE[:3], up=(-1.0, 0, 0.3)) @ small_transform([0, 0, rng.uniform(-1, 1)], [0, 0, 0])
        @ inverse(TRUE_FLANGE_CAM) for e in ways
    ]  # fmt: skip
    solved = [_kinematics.inverse(SAWYER, T, near=start_joints()) for T in flange]
    person = Person(arm, iter([start_joints(), *(q[0] for q in solved if len(q))]))
    monkeypatch.setattr("builtins.input", person)
    first_look(eye, (taken := begun(tmp_path)), Asking(False))
    found = gather(eye, taken, Asking(False), by_hand=True)
    assert found is not None
    assert errors(found.T_flange_cam, TRUE_FLANGE_CAM)[1] < 2
    assert not arm.passed
    assert "press Enter" in person.asked[0]
    assert re.search(r"view 2: camera .* (cm|deg)", person.asked[1])
    assert any("take 15 to 20" in note for note in lacks(taken, found))


# ---- what goes wrong


def live(cell: Path, *more: object) -> int:
    return main(
        [
            str(w)
            for w in ["calibrate", "--live", "--cell", cell, "--board", BOARD, "--out", cell.parent / "calib", *more]
        ]
    )


def test_an_interrupt_holds_the_arm_and_loses_no_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    eye, arm = an_eye(write_cell(tmp_path, Truth(interrupted_after=9)))
    first_look(eye, (taken := begun(tmp_path)), Asking(True))
    with pytest.raises(KeyboardInterrupt):
        gather(eye, taken, Asking(True))
    assert arm.held >= 1
    assert len(taken) == 5  # two motions for each but the first
    again = read_earlier_views(tmp_path / "calib", BOARD)
    assert again is not None
    assert again.names == taken.names
    assert again.flange == pytest.approx(taken.flange, abs=1e-6)
    assert again.T_cam_board == pytest.approx(taken.T_cam_board, abs=1e-6)
    monkeypatch.setattr(Taken, "most", 8)
    eye, _ = an_eye(write_cell(tmp_path, Truth(joints=arm.now.tolist())))
    found = gather(eye, again, Asking(True))
    assert len(again) == 8
    assert found is not None
    assert found.used.all()


def test_an_interrupt_on_the_command_line_says_how_to_go_on(tmp_path: Path, monkeypatch, capsys) -> None:
    cell = write_cell(tmp_path, Truth())

    def tired(_: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("builtins.input", tired)
    before = cell.read_text()
    assert live(cell) == 130
    said = capsys.readouterr()
    assert f"1 views are kept in {tmp_path / 'calib'}" in said.out
    assert "--out" in said.out
    assert (tmp_path / "calib" / "view_01.png").exists()
    assert cell.read_text() == before


def test_no_answer_moves_nothing_and_leaves_the_file(tmp_path: Path, monkeypatch, capsys) -> None:
    cell = write_cell(tmp_path, Truth())
    before = cell.read_text()
    monkeypatch.setattr("builtins.input", lambda _: "no")
    assert live(cell) == 1
    said = capsys.readouterr().out
    assert "lacking: 1 views, which do not determine" in said
    assert "the cell file is unchanged" in said
    assert cell.read_text() == before


def test_a_board_that_is_not_seen(tmp_path: Path) -> None:
    def said(truth: Truth) -> str:
        eye, _ = an_eye(write_cell(tmp_path, truth))
        with pytest.raises(InputError) as told:
            first_look(eye, begun(tmp_path), Asking(True))
        return str(told.value)

    assert "bring it into view" in said(Truth(board=False))
    assert "markers of DICT_6X6" in said(Truth(dictionary="DICT_6X6_50"))
    away = start_joints() + np.array([0.9, 0, 0, 0, 0, 0, 0])
    assert "not seen from where the arm stands" in said(Truth(joints=away.tolist()))


def test_another_board_of_the_same_markers_is_refused(tmp_path: Path) -> None:
    eye, _ = an_eye(write_cell(tmp_path, Truth()))
    taken = Taken(tmp_path / "calib", "charuco:9x5:30mm:22mm", CAMERA, np.zeros(5))
    with pytest.raises(InputError, match=r"board"):
        first_look(eye, taken, Asking(True))


def test_an_arm_that_refuses_ends_it_with_the_views_kept(tmp_path: Path) -> None:
    eye, _ = an_eye(write_cell(tmp_path, Truth(refuses_after=4)))
    first_look(eye, (taken := begun(tmp_path)), Asking(True))
    with pytest.raises(DeviceError, match="its cuff is held"):
        gather(eye, taken, Asking(True))
    assert len(taken) == 3
    assert len(json.loads((tmp_path / "calib" / "views.json").read_text())["views"]) == 3


def test_an_arm_that_is_not_still_is_told(tmp_path: Path) -> None:
    eye, _ = an_eye(write_cell(tmp_path, Truth(joint_noise=0.01)))
    with pytest.raises(DeviceError, match="Hold it still"):
        eye.look()


def test_a_start_within_a_keep_out_is_refused(tmp_path: Path) -> None:
    here = SAWYER.forward(start_joints())[:3, 3]
    box = f"[[keep_out]]\nlower = {(here - 0.1).tolist()}\nupper = {(here + 0.1).tolist()}\n\n[limits]"
    eye, arm = an_eye(write_cell(tmp_path, Truth(), ("[limits]", box)))
    first_look(eye, (taken := begun(tmp_path)), Asking(True))
    with pytest.raises(StageFailure, match="too near"):
        gather(eye, taken, Asking(True))
    assert not arm.passed


def test_views_are_enough_when_their_error_is_steady() -> None:
    class Told:
        def __init__(self, pixel: float) -> None:
            self.methods = [type("row", (), {"left_out_pixel": pixel})()]

    def steady(*pixels: float) -> bool:
        return is_steady([None, *map(Told, pixels)])  # type: ignore[arg-type]

    assert steady(0.5, 0.3, 0.29, 0.31, 0.3)
    assert not steady(0.5, 0.3, 0.29, 0.4)
    assert not steady(0.3, 0.3, 0.3)
    assert not steady(np.nan, 0.3, 0.3, 0.3)


BAD = [
    (["--live"], "--cell is missing"),
    (["--live", "--cell", "x.toml"], "--board is missing"),
    (["--check"], "--cell is missing"),
    (["--live", "--check"], "not both"),
    (["--live", "--cell", "x.toml", "--board", BOARD, "--images", "x"], "--images: got it with --live"),
    (["--check", "--cell", "x.toml", "--by-hand"], "--by-hand: got it with --check"),
    (["--cell", "x.toml", "--images", "x", "--poses", "y", "--board", BOARD], "--cell: got it with --images"),
    (["--live", "--cell", "none.toml", "--board", BOARD], "no such file"),
    (["--images", "x", "--board", BOARD], "--poses is missing"),
]


@pytest.mark.parametrize(("words", "message"), BAD)
def test_options_that_do_not_go_together(words: list[str], message: str, capsys) -> None:
    assert main(["calibrate", *words]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said


def test_a_finished_or_other_folder_is_not_gone_on_with(copied: Path, capsys) -> None:
    cell = copied / "cell.toml"
    assert live(cell, "--yes") == 2
    assert "a finished calibration" in capsys.readouterr().err
    (copied / "calib" / "calibration.json").unlink()
    with pytest.raises(InputError, match="as in"):
        read_earlier_views(copied / "calib", "charuco:7x5:31mm:22mm")
    (copied / "calib" / "view_02.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"view_02.png"):
        read_earlier_views(copied / "calib", BOARD)
    (copied / "calib" / "views.json").write_text('{"kind": "calibration-views", "schema": 1, "board": 7}')
    with pytest.raises(InputError, match=r"views.json"):
        read_earlier_views(copied / "calib", BOARD)


# ---- the cell file


OVER_LINES = """T_flange_cam = [ # where it is
  0.09, 0.0, 0.03, # m
  0.0, 0.0, 0.70710678, 0.70710678,
]"""
LAYOUTS: list[Callable[[str], str]] = [
    lambda text: text,
    lambda text: text.replace("\n", "\r\n"),
    lambda text: text.replace(POSE_LINE, OVER_LINES),
    lambda text: text.replace(POSE_LINE, f"  {POSE_LINE}   # 'T_flange_cam' = [1]"),
    lambda text: text.replace(POSE_LINE, 'calibration = "old #1.json" # measured'),
    lambda text: text.replace("[wrist_camera]", "[wrist_camera] # on it").replace("[arm]", "# T_flange_cam = 1\n[arm]"),
]


@pytest.mark.parametrize("layout", LAYOUTS, ids=["plain", "CRLF", "many lines", "indented", "calibration", "comments"])
def test_all_else_in_a_cell_file_stays(calibrated: Path, tmp_path: Path, layout: Callable[[str], str]) -> None:
    cell = write_cell(tmp_path, Truth())
    shutil.copy(calibrated / "calib" / "calibration.json", tmp_path / "old #1.json")
    shutil.copytree(calibrated / "calib", tmp_path / "new")
    cell.write_bytes(layout(cell.read_text()).encode())
    before = cell.read_bytes()
    kept = point_to_calibration(cell, tmp_path / "new" / "calibration.json")
    assert kept.read_bytes() == before
    old, new = (tomllib.loads(text.decode()) for text in (before, cell.read_bytes()))
    assert new["wrist_camera"].pop("calibration") == "new/calibration.json"
    for key in ("calibration", "T_flange_cam"):
        old["wrist_camera"].pop(key, None)
    assert new == old
    assert cell.read_bytes().count(b"#") == before.count(b"#") - before.count(b"old #1")
    untouched = [row for row in before.splitlines(keepends=True) if b"flange_cam" not in row and b"old #" not in row]
    after = cell.read_bytes().splitlines(keepends=True)
    assert sum(row in after for row in untouched) >= len(untouched) - 3
    assert point_to_calibration(cell, tmp_path / "new" / "calibration.json").name == "cell.toml.old2"


def test_a_cell_file_that_cannot_be_changed_by_lines_stays(calibrated: Path, tmp_path: Path) -> None:
    cell = write_cell(tmp_path, Truth())
    text = cell.read_text()
    at = text.index("[wrist_camera]")
    end = text.index("[side_camera]")
    rows = [row.partition("  #")[0] for row in text[at:end].splitlines()[1:] if row]
    cell.write_text(f"wrist_camera = {{ {', '.join(rows)} }}\n" + text[:at] + text[end:])
    before = cell.read_text()
    with pytest.raises(InputError, match=r"Write there: calibration = "):
        point_to_calibration(cell, calibrated / "calib" / "calibration.json")
    assert cell.read_text() == before
    assert not list(tmp_path.glob("*.old*"))
