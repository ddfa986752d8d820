"""What looks like a petal, where petals have their middle, and finding a piece of a picture again, to its rules."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.pollination.response._petals import (
    Patch,
    centre_of_petals,
    common_shift,
    cut_patch,
    flower_weight,
    follow,
    petal_weight,
    seek,
    smoothed,
    vertex,
)
from anther.robot.devices import Frame

NEAREST, FARTHEST = 0.4, 0.7
YELLOW, WHITE, LEAF = (235, 215, 60), (215, 215, 210), (60, 130, 40)
HEIGHT, WIDTH = 60, 80


def plain(colour: tuple[int, int, int], depth: float, height: int = 8, width: int = 8) -> Frame:
    rgb = np.full((height, width, 3), colour, np.uint8)
    return Frame(0.0, rgb, np.full((height, width), depth, np.float32))


def weight_of(colour: tuple[int, int, int], depth: float = 0.5) -> float:
    """Return the petal weight of a picture of one colour and depth."""
    weight = petal_weight(plain(colour, depth), NEAREST, FARTHEST)
    assert np.ptp(weight) == 0
    return float(weight[0, 0])


def before(background: tuple[int, int, int], colour: tuple[int, int, int], depth: float = 0.5) -> float:
    """Return the petal weight of a spot of a colour before a far background."""
    frame = plain(background, 2.0, 100, 100)
    frame.rgb[48:52, 48:52], frame.depth[48:52, 48:52] = colour, depth
    return float(petal_weight(frame, NEAREST, FARTHEST)[50, 50])


@pytest.mark.parametrize(
    ("colour", "weight"),
    [
        (YELLOW, 1.0),
        ((200, 200, 100), 0.75),  # half saturated
        ((100, 200, 30), 0.0),  # yellow green: more green than red
        ((180, 200, 20), 0.2025),  # nearly
        ((200, 120, 30), 0.5),  # orange is as saturated as its second colour
        ((90, 90, 10), 0.5),  # dim
        ((60, 60, 5), 0.0),  # in the dark
        ((0, 0, 0), 0.0),
        ((30, 30, 200), 0.0),
        ((255, 255, 255), 0.0),  # nothing tells it from what is behind
    ],
)
def test_yellow_is_saturated_bright_and_no_more_green_than_red(colour, weight: float) -> None:
    assert weight_of(colour) == pytest.approx(weight, abs=0.002)


@pytest.mark.parametrize(("depth", "counts"), [(0.39, 0), (0.41, 1), (0.69, 1), (0.71, 0), (0.0, 1)])
def test_petals_are_as_far_as_flowers_or_have_no_depth(depth: float, counts: int) -> None:
    assert weight_of(YELLOW, depth) == counts
    assert before((100, 100, 100), WHITE, depth) == pytest.approx(counts)


@pytest.mark.parametrize("depth", [0.3, 0.8])
def test_yellow_counts_two_pixels_from_what_is_as_far_as_flowers(depth: float) -> None:
    """Stereo mixes depths at edges; white might be the wall."""
    frame = plain(YELLOW, depth, 9, 20)
    frame.depth[:, :5] = 0.5
    weight = petal_weight(frame, NEAREST, FARTHEST)
    assert weight[:, :7].min() == 1
    assert weight[:, 7:].max() == 0


@pytest.mark.parametrize(
    ("background", "colour", "weight"),
    [
        ((130, 130, 130), (150, 150, 150), 0.5),  # brighter by 20
        ((130, 130, 130), (140, 140, 140), 0.0),
        ((150, 150, 150), (130, 130, 130), 0.0),
        ((20, 20, 20), (90, 90, 90), 0.5),  # dim
        ((20, 20, 20), (60, 60, 60), 0.0),
        ((100, 100, 100), (200, 110, 200), 0.0),  # white has no dark channel
        ((100, 100, 100), (110, 200, 200), 0.0),
        ((100, 100, 100), (200, 200, 126), 0.875),  # whitish, and hardly yellow
        ((200, 100, 100), (120, 120, 120), 0.5),  # a wall is as bright as its darkest channel
    ],
)
def test_white_is_brighter_than_what_is_behind(background, colour, weight: float) -> None:
    assert before(background, colour) == pytest.approx(weight, abs=0.01)


def test_what_is_behind_is_what_is_far_near_the_pixel() -> None:
    """On the left a bright wall, on the right a dark one; the leaves before them are no background."""
    frame = plain((170, 170, 170), 2.0, 100, 400)
    frame.rgb[:, 200:] = 80
    frame.rgb[::25], frame.depth[::25] = LEAF, 0.6
    frame.depth[45:55, :] = 0.5
    frame.rgb[45:55, :] = 150
    weight = petal_weight(frame, NEAREST, FARTHEST)
    assert weight[50, 40] == 0
    assert weight[50, 360] == pytest.approx(1)


def test_where_nothing_is_far_white_is_brighter_than_nearly_all_of_the_picture() -> None:
    frame = plain((100, 110, 100), 0.5, 50, 50)
    frame.rgb[10, 10:20] = 180
    weight = petal_weight(frame, NEAREST, FARTHEST)
    assert weight[10, 10:20].min() == 1
    assert np.count_nonzero(weight) == 10


def test_what_is_nearly_black_has_no_colour() -> None:
    shades = np.array([[(6, 6, 5), (10, 20, 10), (100, 100, 100), (100, 110, 100), (110, 100, 110), (50, 60, 60)]])
    depth = np.full((1, 6), 0.5, np.float32)
    weight = flower_weight(Frame(0.0, shades.astype(np.uint8), depth), np.zeros((1, 6), np.float32), 0.4, 0.7)
    assert weight[0].tolist() == [0.5, 0.0, 0.5, 0.0, 0.5, 0.5], "green by more than 6 % of all light is a leaf"


def test_what_is_not_green_and_as_far_as_flowers_counts_half_as_much_as_a_petal() -> None:
    frame = plain((150, 155, 150), 0.5, 1, 2)
    frame.depth[0, 0] = 0.3
    assert flower_weight(frame, np.zeros((1, 2), np.float32), NEAREST, FARTHEST)[0].tolist() == [0, 0.5]
    assert flower_weight(frame, np.ones((1, 2), np.float32), NEAREST, FARTHEST).min() == 1


def spots(*centres: tuple[float, float], radius: float = 3.0) -> NDArray[np.float32]:
    """Return the weight (60, 80) of round spots."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.max([(np.hypot(u - x, v - y) < radius).astype(np.float32) for x, y in centres], axis=0)


@pytest.mark.parametrize("shift", [(0, 0), (4, 0), (0, -4), (-3, 2), (6, -6)])
def test_the_common_shift_is_the_spots_own_if_no_other_is_near(shift: tuple[int, int]) -> None:
    expected = np.array([[20.0, 20.0], [50.0, 33.0]])
    weight = spots(*(expected + shift), radius=2.0)
    _, found = common_shift(weight, expected, 60 // 3)
    assert found == pytest.approx(shift, abs=0.5)


def test_of_two_places_that_fit_alike_the_nearer_counts() -> None:
    for sign in (-1, 1):
        _, found = common_shift(spots((40 + 9 * sign, 30), (40 - 14 * sign, 30)), np.array([[40.0, 30.0]]), 15)
        assert found == pytest.approx([9 * sign, 0], abs=1)
        _, found = common_shift(spots((40, 30 + 9 * sign), (40, 30 - 14 * sign)), np.array([[40.0, 30.0]]), 15)
        assert found == pytest.approx([0, 9 * sign], abs=1)


def test_a_fit_falls_by_thirty_per_cent_towards_the_reach() -> None:
    home = np.array([[30.0, 30.0]])
    here, _ = common_shift(spots((30, 30)), home, 20)
    half, _ = common_shift(spots((40, 30)), home, 20)
    far, shift = common_shift(spots((50, 30)), home, 20)
    assert half == pytest.approx(0.85 * here, rel=0.01)
    assert far == pytest.approx(0.7 * here, rel=0.02)
    assert shift == pytest.approx([20, 0], abs=1)


@pytest.mark.parametrize("place", [(2.0, 30.0), (77.0, 30.0), (40.0, 2.0), (40.0, 57.0)])
def test_a_shift_may_lead_beyond_any_edge_of_the_picture(place: tuple[float, float]) -> None:
    fit, shift = common_shift(spots(place, (place[0] + 3, 30)), np.array([place]), 12)
    assert fit > 0.2
    assert np.abs(shift).max() < 4


def disc(u: float, v: float, radius: float = 6.0) -> NDArray[np.float32]:
    return spots((u, v), radius=radius)


@pytest.mark.parametrize("start", [(42.0, 31.0), (37.0, 33.0), (40.0, 26.0), (35.0, 29.0)])
def test_the_middle_of_petals_is_found_from_any_side(start: tuple[float, float]) -> None:
    assert centre_of_petals(disc(40, 30), np.array(start), 6.0) == pytest.approx([40, 30], abs=0.1)
    assert centre_of_petals(disc(20, 30), np.array(start) - [20, 0], 6.0) == pytest.approx([20, 30], abs=0.1)


def test_the_middle_leans_to_the_heavier_petals_and_faint_ones_do_not_count() -> None:
    weight = disc(40, 30)
    weight[:, :40] *= 0.5
    assert centre_of_petals(weight, np.array([40.0, 30.0]), 6.0)[0] > 40.5
    faint = np.maximum(disc(40, 30), 0.19 * disc(46, 30, 12.0))
    assert centre_of_petals(faint, np.array([41.0, 30.0]), 6.0) == pytest.approx([40, 30], abs=0.1)


def test_petals_far_away_do_not_pull() -> None:
    both = np.maximum(disc(20, 30), disc(60, 25, 9.0))
    assert centre_of_petals(both, np.array([21.0, 32.0]), 6.0) == pytest.approx([20, 30], abs=0.1)


def test_a_flower_whose_petals_do_not_show_beside_a_large_neighbour_stays_where_it_was_expected() -> None:
    own = np.array([30.0, 30.0])
    for neighbour in (disc(42, 30, 8.0), disc(30, 42, 8.0)):
        assert centre_of_petals(neighbour, own, 6.0) == pytest.approx(own)


def flower_frame(u: float, v: float, radius: float = 5.0, depth: float = 0.5) -> Frame:
    """Return a yellow disc before leaves at 0.9 m."""
    frame = plain(LEAF, 0.9, HEIGHT, WIDTH)
    own = disc(u, v, radius) > 0
    frame.rgb[own], frame.depth[own] = YELLOW, depth
    return frame


def cut(frame: Frame, pixel: tuple[float, float], petals: bool = True, radius: float = 5.0) -> Patch:
    seen = petal_weight(frame, NEAREST, FARTHEST) if petals else np.zeros((HEIGHT, WIDTH), np.float32)
    return cut_patch(frame, smoothed(frame), seen, np.array(pixel), radius, 0.5, 0.025)


def test_a_patch_is_the_flower_and_its_middle_counts_most() -> None:
    patch = cut(flower_frame(40.3, 29.6), (40.3, 29.6))
    assert patch.centre.tolist() == [40, 30]
    assert patch.weight.shape == (17, 17), "1.5 radii to each side"
    assert patch.image.shape == (17, 17, 3)
    v, u = np.mgrid[-8:9, -8:9]
    away = np.hypot(u - 0.3, v + 0.4)
    assert np.array_equal(patch.weight > 0, away < 5)
    inside = away < 5
    assert patch.weight[inside] == pytest.approx(np.exp(-0.5 * (away[inside] / 3.5) ** 2), rel=1e-4), "0.7 radii"
    assert patch.cover == pytest.approx(1.0, abs=0.06)
    assert patch.image[8, 8] == pytest.approx(YELLOW, abs=1)


def test_cover_is_the_share_of_the_flowers_disc_that_shows() -> None:
    frame = flower_frame(40, 30)
    frame.rgb[:, :40], frame.depth[:, :40] = LEAF, 0.3
    assert cut(frame, (40, 30)).cover == pytest.approx(0.55, abs=0.06)
    assert cut(plain(LEAF, 0.5, HEIGHT, WIDTH), (40, 30)).cover == 0


@pytest.mark.parametrize(
    ("colour", "depth", "petals", "own"),
    [
        ((120, 120, 125), 0.5, False, True),  # whatever is not green and as far
        ((120, 120, 125), 0.524, False, True),
        ((120, 120, 125), 0.476, False, True),
        ((120, 120, 125), 0.526, False, False),
        ((120, 120, 125), 0.474, False, False),
        (LEAF, 0.5, False, False),
        (YELLOW, 0.0, True, True),  # petals of which there is no reading
        ((120, 120, 125), 0.0, False, False),
        (YELLOW, 0.6, True, False),
    ],
)
def test_a_flowers_own_pixels_are_not_green_and_as_far_or_petals_without_a_reading(colour, depth, petals, own) -> None:
    frame = plain(LEAF, 0.9, HEIGHT, WIDTH)
    frame.rgb[disc(40, 30) > 0], frame.depth[disc(40, 30) > 0] = colour, depth
    assert (cut(frame, (40, 30), petals).cover > 0.9) == own


def test_nothing_beyond_one_point_four_radii_is_a_flowers_own() -> None:
    weight = cut(plain((120, 120, 125), 0.5, HEIGHT, WIDTH), (40, 30)).weight
    away = np.hypot(*np.mgrid[-8:9, -8:9])
    assert np.array_equal(weight > 0, away < 7)


@pytest.mark.parametrize(
    ("pixel", "whole"),
    [
        ((8, 30), True), ((7, 30), False), ((71, 30), True), ((72, 30), False),
        ((40, 8), True), ((40, 7), False), ((40, 51), True), ((40, 52), False),
    ],
)  # fmt: skip
def test_a_patch_that_is_not_whole_in_the_picture_is_nothing(pixel: tuple[float, float], whole: bool) -> None:
    patch = cut(plain((120, 120, 125), 0.5, HEIGHT, WIDTH), pixel)
    assert patch.weight.shape == (17, 17)
    assert patch.image.shape == (17, 17, 3)
    assert (patch.cover > 0) == whole
    assert patch.centre.tolist() == list(pixel)


def textured(shift: tuple[float, float]) -> NDArray[np.float32]:
    """Return (60, 80, 3) a smooth pattern that does not repeat, moved by `shift` [px]."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    u, v = u - shift[0], v - shift[1]
    grey = 100 + 40 * np.sin(0.5 * u + 0.1 * v) + 30 * np.cos(0.45 * v - 0.13 * u) + 20 * np.sin(0.02 * u * v / 10)
    return np.stack([grey, 0.8 * grey, 0.5 * grey + 20], axis=2).astype(np.float32)


PATCH = Patch(textured((0, 0))[25:36, 35:46], np.ones((11, 11), np.float32), np.array([40, 30]), 4.0)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (2.4, 0.0), (0.0, -1.6), (-2.3, 1.4), (3.6, 3.3)])
def test_a_patch_is_found_to_a_fraction_of_a_pixel(shift: tuple[float, float]) -> None:
    places = np.array([[40.0, 30.0], [41.4, 29.3]])
    found = seek([textured(shift)] * 2, PATCH, places, 5, 0.6)
    assert found == pytest.approx(np.array([[40.0, 30.0]] * 2) + shift, abs=0.1)


def test_a_patch_is_found_only_where_it_is_much_more_alike_than_around() -> None:
    rng = np.random.default_rng(1)
    wall = rng.uniform(0, 200, (HEIGHT, WIDTH, 3)).astype(np.float32)
    wall[25:36, 35:46] = 0.5 * wall[25:36, 35:46] + 0.5 * PATCH.image
    place = np.array([[40.0, 30.0]])
    assert seek([wall], PATCH, place, 5, 0.8) == pytest.approx(place, abs=0.5)
    assert np.isnan(seek([wall], PATCH, place, 5, 0.05)).all()


def test_only_the_weighted_pixels_of_a_patch_are_compared() -> None:
    weight = np.zeros((11, 11), np.float32)
    weight[:, :6] = 1
    wall = textured((1, 0))
    wall[:, 43:] = 0
    part = PATCH._replace(weight=weight)
    assert seek([wall], part, np.array([[40.0, 30.0]]), 4, 0.6) == pytest.approx(np.array([[41.0, 30.0]]), abs=0.1)


def test_a_patch_is_found_at_the_edge_of_the_picture_where_it_is_whole() -> None:
    edge = Patch(textured((0, 0))[49:60, 69:80], np.ones((11, 11), np.float32), np.array([74, 54]), 4.0)
    found = seek([textured((0, 0))], edge, np.array([[75.0, 55.0]]), 6, 0.6)
    assert found == pytest.approx(np.array([[74.0, 54.0]]), abs=0.1)


WALL = np.random.default_rng(0).uniform(0, 80, (HEIGHT, 200, 3)).astype(np.float32)
TEXTURE = np.random.default_rng(2).uniform(100, 250, (11, 11, 3)).astype(np.float32)


def moving(places: Array) -> tuple[list[NDArray[np.float32]], Patch]:
    """Return pictures of a texture at whole pixels (T, 2), NaN for hidden, and its patch."""
    images = [WALL.copy() for _ in places]
    for image, place in zip(images, places, strict=True):
        if np.isfinite(place).all():
            u, v = place.astype(int)
            image[v - 5 : v + 6, u - 5 : u + 6] = TEXTURE
    return images, Patch(TEXTURE, np.ones((11, 11), np.float32), places[0].astype(int), 5.0)


def test_a_patch_farther_away_than_the_reach_or_without_a_place_is_not_found() -> None:
    _, patch = moving(np.array([[100.0, 30.0]]))
    wall = np.random.default_rng(3).uniform(100, 250, WALL.shape).astype(np.float32)  # as bright as the patch
    wall[25:36, 95:106] = TEXTURE
    places = np.array([[100, 30.0], [96, 27], [93, 30], [100, 37], [np.nan, np.nan], [100, np.nan], [np.nan, 30]])
    found = seek([wall] * 7, patch, places, 5, 0.6)
    assert found[:2] == pytest.approx(np.array([[100.0, 30.0]] * 2), abs=0.5)
    assert np.isnan(found[2:]).all()


@pytest.mark.parametrize("way", [(1, 0), (-1, 0)])
def test_what_speeds_up_either_way_is_followed_beyond_the_reach_of_one_look(way: tuple[int, int]) -> None:
    along = np.cumsum([0, 3, 6, 9, 9, 9, 9, 9])
    places = np.array([100.0, 30.0]) + along[:, None] * way
    images, patch = moving(places)
    assert follow(images, patch, reach=6, worst=0.6) == pytest.approx(places, abs=0.5)


@pytest.mark.parametrize("way", [1, -1])
def test_what_goes_up_or_down_is_followed(way: int) -> None:
    places = np.column_stack([np.full(8, 100.0), 30 + way * np.cumsum([0, 1, 2, 3, 4, 3, 3, 3])])
    images, patch = moving(places)
    assert follow(images, patch, reach=3, worst=0.6) == pytest.approx(places, abs=0.5)


def test_what_was_hidden_is_looked_for_where_it_was_last_seen() -> None:
    places = np.array([[100.0, 30.0], [104, 30], [108, 30], [np.nan, np.nan], [np.nan, np.nan], [107, 31], [103, 32]])
    images, patch = moving(places)
    assert follow(images, patch, reach=5, worst=0.6) == pytest.approx(places, abs=0.5, nan_ok=True)


def test_the_top_of_three_values_is_that_of_their_parabola() -> None:
    x = np.arange(5.0)
    for top in (1.6, 2.0, 2.4):
        assert vertex(7 - 3 * (x - top) ** 2, 2) == pytest.approx(top - 2)
    assert vertex(-3 * (x - 0.3) ** 2, 0) == vertex(-3 * (x - 3.8) ** 2, 4) == 0, "at the border nothing tells"
    assert vertex(np.ones(5), 2) == vertex((x - 2.3) ** 2, 2) == 0, "nor does what is no top"
