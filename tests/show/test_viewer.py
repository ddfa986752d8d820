"""The viewer: what it plays is what arm, model and camera say; the file it writes opens and plays in a browser."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import viser
from fake_robot import horizontal_grasp
from made_arm import CELL
from made_foresight import made_plan
from sample_plants import branched

from anther.cli.args.view import Args
from anther.cli.view import skeleton_results
from anther.core.geometry import look_at
from anther.perception.cloud import Cloud
from anther.perception.formats.skeletons import write_skeleton
from anther.plant.imported import node_named, read_source
from anther.plant.model import TOMATO, build_plant
from anther.pollination.execution import Trial
from anther.pollination.response import Response
from anther.pollination.shake import Pads
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.show.results import RunResults
from anther.show.run_scene import arm_of
from anther.show.viewer import write_html
from anther.show.viewer._motion import RATE, motion_of
from anther.show.viewer._scene import build_scene

FREQUENCY, SECONDS, SWING = 4.0, 2.0, 0.01
FIRM = Pads(stiffness=1e9, turning=1e6, stiffness_spread=0.0, turning_spread=0.0)


def shaken(folder: Path) -> RunResults:
    """A run whose arm swung its first joint by 0.01 rad at 4 Hz while it held the stem of a branched plant."""
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    times = np.arange(0, SECONDS, 0.01)
    joints = np.tile(SAWYER.neutral, (len(times), 1))
    joints[:, 0] += SWING * np.sin(2 * np.pi * FREQUENCY * times)
    moved = grip_at(joints) - grip_at(SAWYER.neutral[None])
    way = moved[np.abs(joints[:, 0] - SAWYER.neutral[0]).argmax()]
    trial = Trial(
        phases=("shake",),
        phase_times=np.array([[0.0, SECONDS]]),
        shake_times=times,
        commanded=joints,
        measured=joints,
        gripper=np.array([[0.008, 8.0, 1.0]]),
        frame_times=np.zeros(0),
        stop_reason="finished",
    )
    held = plant.rods.nodes[plant.stem_nodes[len(plant.stem_nodes) // 2]]
    grasp = horizontal_grasp(held, SAWYER.neutral)
    shake = replace(
        made_plan(), grasp=grasp, direction=way / np.linalg.norm(way), frequency=FREQUENCY, amplitude=0.005, pads=FIRM
    )
    cloud = Cloud(np.repeat(skeleton.nodes, 3, axis=0))
    return RunResults(
        folder=folder, cloud=cloud, skeleton=skeleton, stem=stem, flowers=flowers, plant=plant, shake=shake, trial=trial
    )


def grip_at(joints: Any) -> Any:
    """Return (T, 3) where the pads' middle is [m]."""
    T = SAWYER.forward(joints)
    return T[:, :3, :3] @ TOOL.T_flange_grasp[:3, 3] + T[:, :3, 3]


def test_the_plant_goes_where_the_arm_takes_it(tmp_path: Path) -> None:
    results = shaken(tmp_path)
    motion, shake, plant = motion_of(results), results.shake, results.plant
    assert motion is not None
    assert shake is not None
    assert plant is not None
    arm = (grip_at(motion.joints) - grip_at(SAWYER.neutral[None])) @ shake.direction
    held = np.linalg.norm(plant.rods.nodes - shake.grasp.point, axis=1).argmin()
    np.testing.assert_allclose(motion.nodes[:, held] @ shake.direction, arm, atol=0.03 * np.abs(arm).max())
    assert np.abs(motion.nodes[:, 0]).max() < 1e-9  # the root stays in the soil
    tips = np.abs(motion.nodes[:, plant.flower_nodes]).max()
    assert 0.2 * np.abs(arm).max() < tips < 50 * np.abs(arm).max()


def test_an_arm_of_ones_own_is_read_from_the_runs_cell_file_while_it_is_there(tmp_path: Path) -> None:
    told = {"arm": "my_arm", "cell": str(CELL)}
    arm = arm_of(RunResults(tmp_path, told))
    assert arm is not None
    assert arm.name == "my_arm"
    assert motion_of(replace(shaken(tmp_path), params=told | {"cell": str(tmp_path / "gone.toml")})) is None


def test_a_fast_shake_is_slowed_until_a_period_has_ten_pictures(tmp_path: Path) -> None:
    motion = motion_of(shaken(tmp_path))
    assert motion is not None
    assert np.diff(motion.times).max() <= 1 / (10 * FREQUENCY) + 1e-9


def test_a_flower_is_shown_where_it_was_filmed_and_not_where_it_was_lost(tmp_path: Path) -> None:
    seen = np.array([0.0, 0.1, 0.2, 1.5, 1.6])
    track = np.column_stack([seen, 2 * seen, 0 * seen])[:, None]
    one = np.ones(1)
    response = Response(seen, track, one, one, one, one, one, one, one, one, np.ones((1, 3)), np.ones(1, bool))
    motion = motion_of(replace(shaken(tmp_path), response=response))
    assert motion is not None
    known = np.isfinite(motion.flowers[:, 0, 0])
    assert known[motion.times < 0.19].all()
    assert not known[(motion.times > 0.21) & (motion.times < 1.49)].any()
    np.testing.assert_allclose(motion.flowers[known, 0, 0], motion.times[known], atol=1e-9)


def test_what_was_not_shaken_does_not_play(tmp_path: Path) -> None:
    still = replace(shaken(tmp_path), trial=None)
    assert motion_of(still) is None
    write_html(tmp_path / "still.html", still, exaggeration=5.0)
    assert "__VISER_EMBED_DATA__" in (tmp_path / "still.html").read_text()


LARGER = 8.0


def in_picture(points: Any, results: RunResults, height: float) -> Any:
    """Return (..., 2) the pixels of world points, from its middle, in the first view of a canvas of this height: viser
    sees 75 degrees."""
    assert results.cloud is not None
    middle = results.cloud.points.mean(axis=0)
    T = look_at(middle + np.array([0.4, -0.6, 0.2]), middle)
    seen = (points - T[:3, 3]) @ T[:3, :3]
    return height / 2 / np.tan(np.radians(75) / 2) * seen[..., :2] / seen[..., 2:]


def pink(page: Any, time: float) -> Any:
    """Return (2,) the middle of what is pink in the page at a time of its play [px]."""
    field = page.locator("input[inputmode=decimal]")
    field.fill(f"{time:.3f}")
    field.press("Enter")
    seen: list[Any] = []
    for _ in range(30):  # a busy machine draws late
        page.wait_for_timeout(1500)
        image = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR).astype(int)
        image[:60] = image[-60:] = 255  # without the legend and the slider
        b, g, r = image[..., 0], image[..., 1], image[..., 2]
        rows, columns = np.nonzero((r > 120) & (b > 90) & (r > 2 * g) & (b > 1.5 * g))
        seen.append(np.array([columns.mean(), rows.mean()]) if len(rows) > 10 else np.full(2, np.nan))
        if len(seen) > 1 and np.abs(seen[-1] - seen[-2]).max() < 0.5:
            return seen[-1]
    raise AssertionError(f"no flower stays in the picture: {seen}")


@pytest.mark.slow
def test_the_page_plays_in_a_browser_and_flowers_move_by_the_right_number_of_pixels(tmp_path: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = next((p for p in ("/usr/bin/chromium", "/usr/bin/chromium-browser") if Path(p).exists()), None)
    if chromium is None:
        pytest.skip("chromium (a Debian package) is not installed")
    results = shaken(tmp_path)
    motion, plant, shake = motion_of(results), results.plant, results.shake
    assert motion is not None
    assert plant is not None
    assert shake is not None
    write_html(tmp_path / "run.html", results, exaggeration=LARGER)
    assert (tmp_path / "run.html").stat().st_size < 8e6
    flowers = plant.rods.nodes[plant.flower_nodes] + LARGER * motion.nodes[:, plant.flower_nodes]
    turn = motion.nodes[:, plant.flower_nodes].mean(axis=1) @ shake.direction
    i, j = int(turn.argmin()), int(turn.argmax())
    errors: list[str] = []
    with sync_api.sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        page = browser.new_page(viewport={"width": 1000, "height": 800})
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        page.goto((tmp_path / "run.html").as_uri(), wait_until="commit")
        page.locator("input[inputmode=decimal]").wait_for()
        page.locator("button:left-of(input[inputmode=decimal])").last.click()  # pause
        legend, slider = page.get_by_text("main stem").first, page.locator("input[inputmode=decimal]")
        boxes = [part.bounding_box() for part in (legend, slider)]
        assert boxes[0]["y"] + boxes[0]["height"] < boxes[1]["y"], "the legend lies on the slider"
        first, second = (pink(page, (k + 0.5) / RATE) for k in (i, j))
        expected = in_picture(flowers[[i, j]], results, page.locator("canvas").first.bounding_box()["height"])
        title = page.title()
        browser.close()
    assert not errors
    assert title.startswith("Anther: ")
    way = np.diff(expected.mean(axis=1), axis=0)[0]
    assert np.linalg.norm(way) > 20
    np.testing.assert_allclose(second - first, way, atol=0.15 * np.linalg.norm(way))


def test_a_click_names_the_node_as_commands_take_it(tmp_path: Path) -> None:
    skeleton = branched()[0]
    write_skeleton(tmp_path / "plant.swc", skeleton)
    results = skeleton_results(Args(tmp_path / "plant.swc"))
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        said = build_scene(server, results).said
    finally:
        server.stop()
    source, _ = read_source(tmp_path / "plant.swc")
    assert len(said) == len(skeleton.nodes)
    for j, text in enumerate(said):
        number, place = re.search(r"node (\d+):.*`--root=(\S+)`", text, re.DOTALL).groups()
        assert (source.node(int(number)), node_named("--root", place, source)) == (j, int(number))
