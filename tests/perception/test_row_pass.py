"""Hooks of a row by parallax against closed forms, tags of posts, what hangs elsewhere, and bad input."""

from __future__ import annotations

import re
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from anther.core.errors import InputError
from anther.core.geometry import Array, Box, inverse, look_at, transform, transform_points
from anther.perception import find_hooks
from anther.sim.greenhouse import joined, leaves_at, shell
from anther.sim.plant import Organ
from anther.sim.render import Scene, d455
from anther.sim.row_house import TAG, Tag

CAMERA = d455(424, 240)
ON_ITS_SIDE = transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.zeros(3))
T_CART_CAM = look_at([-0.25, 0.0, 2.0], [0.75, 0.0, 2.25]) @ ON_ITS_SIDE
LINE, WIRE = 0.45, 2.7
PLACES = np.arange(0, 2.01, 0.06)
WHERE = {"line": LINE, "wire": WIRE}


def drawn(at: float, lines: list[tuple[float, float, float]]) -> NDArray[np.uint8]:
    """Return the image at a place of the cart of strings at (x, y) [m], green below `head` [m], on a grey wall."""
    image = np.full((CAMERA.height, CAMERA.width, 3), 120, np.uint8)
    for x, y, head in lines:
        for low, high, colour, width in ((1.0, head, (60, 130, 50), 3), (head, WIRE, (230, 230, 225), 1)):
            points = np.column_stack([np.full(60, x), np.full(60, y - at), np.linspace(low, high, 60)])
            pixels = CAMERA.project(transform_points(inverse(T_CART_CAM), points))
            cv2.polylines(image, [np.round(16 * pixels).astype(np.int32)], False, colour, width, cv2.LINE_AA, 4)
    return image


def frames(lines: list[tuple[float, float, float]]) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    return ((at, drawn(at, lines)) for at in PLACES)


def test_strings_are_where_their_rays_meet() -> None:
    strings = [(0.45, 0.4, 2.4), (0.46, 0.85, 2.3), (0.44, 1.5, 2.45)]
    elsewhere = [(0.62, 1.15, 1.0), (0.95, 0.6, 2.3), (0.95, 1.1, 2.3)]  # a hanger, and strings of the far line
    seen = find_hooks(frames(strings + elsewhere), CAMERA, T_CART_CAM, **WHERE)
    assert seen.position == pytest.approx([0.4, 0.85, 1.5], abs=0.004)
    assert seen.across == pytest.approx([0.45, 0.46, 0.44], abs=0.01)
    assert seen.appearance[:, 0] == pytest.approx([2.4, 2.3, 2.45], abs=0.05)
    assert (seen.begin, seen.end, seen.posts) == (PLACES[0], PLACES[-1], ())


def test_a_line_that_is_known_badly_is_still_the_one_that_most_hang_on() -> None:
    strings = [(0.45, 0.4, 2.4), (0.45, 0.8, 2.4), (0.45, 1.2, 2.4), (0.45, 1.6, 2.4)]
    seen = find_hooks(frames([*strings, (0.55, 1.0, 1.0)]), CAMERA, T_CART_CAM, line=LINE + 0.05, wire=WIRE)
    assert seen.position == pytest.approx([0.4, 0.8, 1.2, 1.6], abs=0.004)


@pytest.fixture(scope="module")
def no_strings() -> list[tuple[float, Array]]:
    """Frames past leaves, and a post's tag, where no string hangs."""
    rng, half = np.random.default_rng(2), TAG * 10 / 8 / 2
    middle = np.array([0.7, 1.0, 2.5])
    across = np.array([0.0, half, half])
    tag = Tag("tag", Box(middle - across - [0.003, 0, 0], middle + across), number=77)
    green = leaves_at(
        np.column_stack([rng.uniform(0.5, 1.2, 600), rng.uniform(-0.5, 2.5, 600), rng.uniform(1.6, 2.2, 600)]), rng
    )
    scene = Scene(*joined([tag.painted(), (green[0], Organ.SURROUNDINGS, green[1]), *shell(np.zeros(3), rng)]))
    carts = np.tile(np.eye(4), (len(PLACES), 1, 1))
    carts[:, 1, 3] = PLACES
    return [(at, scene.render(CAMERA, cart @ T_CART_CAM).rgb) for at, cart in zip(PLACES, carts, strict=True)]


def test_a_row_without_strings_has_none_and_its_post_is_read(no_strings) -> None:
    seen = find_hooks(no_strings, CAMERA, T_CART_CAM, **WHERE)
    assert len(seen.position) == 0
    ((number, at),) = seen.posts
    assert number == 77
    assert at == pytest.approx(1.0, abs=0.01)


GIVEN = {
    "0 frames": [],
    "each further on": [(1.0, drawn(0, [])), (0.9, drawn(0, [])), (0.8, drawn(0, []))],
    "(240, 424, 3)": [(0.0, np.zeros((10, 10, 3), np.uint8))],
}


@pytest.mark.parametrize("message", GIVEN)
def test_frames_that_are_no_pass_are_one_message(message) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        find_hooks(GIVEN[message], CAMERA, T_CART_CAM, **WHERE)


def test_a_camera_that_looks_elsewhere_is_refused() -> None:
    away = look_at([-0.25, 0.0, 2.0], [-1.25, 0.0, 2.25])
    with pytest.raises(InputError, match="T_cart_cam"):
        find_hooks(frames([]), CAMERA, away, **WHERE)


def test_a_hook_beyond_the_way_is_not_told_and_none_is_told_twice() -> None:
    strings = [(0.45, -0.05, 2.4), (0.45, 0.4, 2.4), (0.45, 0.42, 2.4), (0.45, 1.2, 2.4), (0.45, 2.06, 2.4)]
    seen = find_hooks(frames(strings), CAMERA, T_CART_CAM, **WHERE)
    assert len(seen.position) == 2
    assert seen.position == pytest.approx([0.41, 1.2], abs=0.02)
