"""The layers of a scene, and that viewer, log and pictures draw the same ones; the film with the robot in it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import viser
from foxglove.messages import Timestamp
from PIL import Image
from test_viewer import shaken

from anther.core.geometry import Box, Intrinsics, look_at
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import Frame
from anther.show import run_scene, scene
from anther.show.film import save_film, with_robot
from anther.show.log import _scene
from anther.show.pictures.plant import draw_layers
from anther.show.style import quantity
from anther.show.viewer import _add_title
from anther.show.viewer._scene import build_scene


def test_viewer_log_and_pictures_draw_the_same_layers(tmp_path: Path) -> None:
    results = shaken(tmp_path)
    layers = run_scene.layers_of(results)
    names = {layer.name for layer in layers}
    assert {"cloud", "main stem", "branches", "flowers", "grasp", "gripper", "arm"} <= names
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        handles = build_scene(server, results)
    finally:
        server.stop()
    assert names <= set(handles.layers)
    assert not any(part.visible for part in handles.layers["axes of the world"])
    assert all(f"{layer.name}" in handles.legend for layer in layers if layer.shown)
    legend = draw_layers(layers, results.grasp).legends[0]
    assert {text.get_text() for text in legend.get_texts()} == names - {"arm", "shake, 20 times as long"}


@pytest.mark.parametrize("narrow", [False, True])
def test_pictures_name_axes_with_units_and_keep_their_ticks_apart(narrow: bool, tmp_path: Path) -> None:
    results = shaken(tmp_path)
    figure = draw_layers(run_scene.layers_of(results), results.grasp, narrow=narrow)
    figure.canvas.draw()
    for plot in figure.axes:
        assert plot.get_xlabel().endswith("[m]")
        assert plot.get_ylabel().endswith("[m]")
        boxes = [t.get_window_extent() for t in plot.get_xticklabels() if t.get_text()]
        inside = [b for b in boxes if plot.bbox.x0 - 1 <= (b.x0 + b.x1) / 2 <= plot.bbox.x1 + 1]
        assert all(left.x1 < right.x0 for left, right in zip(inside, inside[1:], strict=False))
    least = min(text.get_fontsize() for plot in figure.axes for text in plot.get_xticklabels())
    on_screen = least / 72 * (340 / figure.get_figwidth() if narrow else 1032 / figure.get_figwidth())
    assert on_screen >= 9, "pixels, on a phone of 390 px and on a desk"


def test_the_log_draws_lines_balls_arrows_and_solids() -> None:
    boxes = scene.keep_out([Box(np.zeros(3), np.ones(3))])
    chain = scene.main_stem(np.array([[0, 0, 0], [0, 0, 1.0], [0, 1, 1]]))
    balls = scene.outline(np.array([[0, 0, 0, 0.1], [1, 1, 1, 0]]))
    drawn = repr(_scene.update("all", [boxes, chain, balls], Timestamp(0, 0), "world"))
    count = {kind: drawn.count(f"{kind} {{") for kind in ("LinePrimitive", "SpherePrimitive", "TriangleListPrimitive")}
    assert count == {"LinePrimitive": 1, "SpherePrimitive": 1, "TriangleListPrimitive": 1}, "no ball without a radius"
    assert drawn.count("Point3 {") == 4 + 36, "two segments; six faces of two triangles"


def test_the_written_page_has_a_legend_and_says_that_the_scene_opens() -> None:
    page = _add_title("<title>Viser</title><body><div id=root></div></body>", "tomato & co", "red: stem")
    assert "<title>Anther: tomato &amp; co</title>" in page
    assert "red: stem" in page[page.index("<body>") : page.index("<div id=root>")]
    assert "The scene opens" in page


@pytest.mark.parametrize(
    ("value", "unit", "said"),
    [
        (0.0011841, "m", "1.18 mm"), (0.0098, "-", "0.980 %"), (13.2, "s", "13.2 s"), (2.26, "m/s2", "2.26 m/s²"),
        (200.0, "m/s2", "200 m/s²"), (0.0, "m", "0 mm"), (None, "Hz", "not measured"),
        (float("nan"), "m", "not measured"),
        (2.15e8, "Pa", "215 MPa"), (1e-9, "m", "0.000 mm"),
    ],
)  # fmt: skip
def test_a_value_is_written_in_the_unit_that_people_read(value: float | None, unit: str, said: str) -> None:
    assert quantity(value, unit) == said


CAMERA = Intrinsics(60, 60, 60.0, 60.0, 29.5, 29.5)


def test_the_robot_is_drawn_where_it_is_in_front_of_what_the_camera_saw(tmp_path: Path) -> None:
    results = shaken(tmp_path)
    assert results.trial is not None
    arm = run_scene.arm_of(results)
    assert arm is not None
    hand = arm.forward(SAWYER.neutral)[:3, 3]
    pose = look_at(hand + np.array([0.0, -1.0, 0.2]), hand)
    robot = cast(Any, SimpleNamespace(side_camera=SimpleNamespace(intrinsics=CAMERA), T_world_side_camera=pose))
    grey = np.full((60, 60, 3), 90, np.uint8)
    far, near = (Frame(0.5, grey, np.full((60, 60), depth, np.float32)) for depth in (0.0, 0.05))
    before, behind = with_robot([far, near], results.trial, robot, arm)
    assert (before.rgb != grey).any(axis=2)[25:35, 29:31].all(), "the gripper in the middle"
    assert np.array_equal(behind.rgb, grey), "what is nearer hides it"


def test_a_film_has_the_colours_of_its_frames(tmp_path: Path) -> None:
    shade = np.linspace(60, 200, 420).astype(np.uint8)
    ramp = np.stack(
        [np.tile(shade, (420, 1)), np.tile(shade[:, None], (1, 420)), np.full((420, 420), 120, np.uint8)], 2
    )
    save_film(tmp_path / "film.webp", [Frame(k / 30, ramp, np.zeros((420, 420), np.float32)) for k in range(4)])
    with Image.open(tmp_path / "film.webp") as film:
        assert film.n_frames >= 1
        shown = np.asarray(film.convert("RGB"), dtype=int)
    assert np.abs(shown - ramp).mean() < 2
    assert np.abs(np.diff(shown.astype(int), axis=1)).max() < 12, "no dots of a dithered palette"
