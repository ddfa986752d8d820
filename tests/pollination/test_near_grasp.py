"""The main stem beside the pads, in synthetic frames of a slanted stem before a textured wall, with known truth."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from anther.core.geometry import Array, Intrinsics, inverse, look_at, transform_points
from anther.core.oscillation import fit_swing
from anther.perception.flowers import Flowers
from anther.pollination.learning import GripMeasurement, ObservedShake
from anther.pollination.response import Response, StemNear, measure_response, stem_near
from anther.pollination.response._near_grasp import (
    StemMotion,
    _alike,
    _followed,
    _stem_in,
    _Strip,
    _strip,
    _swing,
    measure_stem,
)
from anther.pollination.response.thresholds import LEAST_SPREAD, SHIFT, SPREAD
from anther.pollination.shake import ShakePlan
from anther.robot.devices import Frame

CAMERA = Intrinsics(240, 180, 424.0, 424.0, 119.5, 89.5)
T_WORLD_CAM = look_at([0.72, -0.5, 0.1], [0.72, 0.0, 0.1])
FINE, F, RATE = 4, 5.0, 40.0
ROOT, WAY = np.array([0.70, 0.0, 0.0]), np.array([0.15, 0.1, 1.0]) / np.linalg.norm([0.15, 0.1, 1.0])
ARC = np.arange(0, 0.2, 0.008)
SHAKE = np.array([1.0, 0.3, 0.0]) / np.hypot(1, 0.3)


def gain(arc: Array) -> Array:
    """How much of the shake the stem does at an arc length; the pads are at 0.1 m."""
    return 1 + 6 * (arc - 0.1)


def draw(shift: float, time: float, rng: np.random.Generator, wall: NDArray[np.uint8], hidden: bool) -> Frame:
    K = CAMERA
    rgb, depth = wall.copy(), np.full(wall.shape[:2], 0.9, np.float32)
    fine = np.linspace(0, 0.2, 60)
    moved = ROOT + fine[:, None] * WAY + 0.001 + shift * gain(fine)[:, None] * SHAKE
    camera = transform_points(inverse(T_WORLD_CAM), moved)
    pixels = (K.project(camera) + 0.5) * FINE - 0.5
    for a, b, z in zip(pixels[:-1], pixels[1:], camera[:, 2], strict=False):
        ends = [tuple(int(x) for x in np.rint(16 * p)) for p in (a, b)]
        width = round(2 * 0.004 * K.fx / z * FINE)
        cv2.line(rgb, ends[0], ends[1], (70, 120, 50), width, cv2.LINE_AA, 4)
        cv2.line(depth, ends[0], ends[1], float(z), width, cv2.LINE_8, 4)  # type: ignore[call-overload]
    if hidden:  # a leaf before the upper part
        cv2.rectangle(rgb, (400, 0), (640, 300), (60, 105, 45), -1)
        cv2.rectangle(depth, (400, 0), (640, 300), 0.45, -1)  # type: ignore[call-overload]
    rgb = cv2.resize(rgb, (K.width, K.height), interpolation=cv2.INTER_AREA)
    near = depth[FINE // 2 :: FINE, FINE // 2 :: FINE] + rng.normal(0, 0.001, (K.height, K.width)).astype(np.float32)
    return Frame(time, np.clip(rgb + rng.normal(0, 2, rgb.shape), 0, 255).astype(np.uint8), near)


@lru_cache(maxsize=4)
def film(size: float, *, hidden: bool = False, began: float = 0.0) -> list[Frame]:
    rng = np.random.default_rng(0)
    wall = np.kron(rng.integers(90, 190, (45, 60, 3)), np.ones((16, 16, 1))).astype(np.uint8)
    times = 12.0 + np.arange(60) / RATE
    return [draw(size * np.sin(2 * np.pi * F * (t - began)), t, rng, wall, hidden) for t in times]


def near() -> StemNear:
    return stem_near(ROOT + ARC[:, None] * WAY, ARC, np.full(len(ARC), 0.004), 0.1)


def measured(frames: list[Frame]) -> Response:
    nobody = Flowers(np.zeros((0, 3)), np.zeros(0, dtype=int))
    return measure_response(frames, CAMERA, T_WORLD_CAM, nobody, F, stem=near())


def arc_of(points: Array) -> Array:
    return (points - ROOT) @ WAY


def test_noise_is_no_outlier_and_a_leap_is() -> None:
    rng, times = np.random.default_rng(2), np.arange(120) / 60
    noisy = 1e-3 * np.sin(2 * np.pi * F * times) + rng.normal(0, 1e-4, 120)
    every = fit_swing(times, np.outer(noisy, [1, 0, 0]), F).coefficients[:2, 0]
    phasor, _ = _swing(times, noisy, F, 1e-3) or (0j, 0.0)
    assert [phasor.imag, phasor.real] == pytest.approx(every), "all frames count"
    noisy[60] += 5e-3
    leapt, _ = _swing(times, noisy, F, 1e-3) or (0j, 0.0)
    assert leapt == pytest.approx(phasor, abs=1e-5)


def test_a_swing_may_be_missed_by_a_share_of_itself_and_is_seen_in_most_frames() -> None:
    rng, times = np.random.default_rng(3), np.arange(120) / 60
    sine, noise = np.sin(2 * np.pi * F * times), rng.standard_normal(120)
    rough, wild, blinking, gone = 10e-3 * sine + 1e-3 * noise, 10e-3 * sine + 4e-3 * noise, 10e-3 * sine, 10e-3 * sine
    blinking[::4], gone[::2] = np.nan, np.nan
    assert _swing(times, rough, F, 1e-3)
    assert not _swing(times, wild, F, 1e-3)
    assert _swing(times, blinking, F, 1e-3)
    assert not _swing(times, gone, F, 1e-3)


@pytest.mark.parametrize("turned", [0.0, 0.7, -1.2])
def test_a_strip_is_cut_across_the_stem_however_it_leans(turned: float) -> None:
    rows, columns = np.mgrid[:180, :240].astype(np.float32)
    u = np.array([np.cos(turned), np.sin(turned)])
    strip = _Strip(np.array([120.0, 90.0]), u, (12, 5), 1e-3, 0.5, 4.0, np.zeros(3))
    along = np.array([-u[1], u[0]])
    m, n = np.mgrid[-5:6, -12:13]
    places = strip.centre + (n[..., None] + 7.0) * u + m[..., None] * along
    for image, expected in ((columns, places[..., 0]), (rows, places[..., 1])):
        np.testing.assert_allclose(strip.cut(image, 7.0), expected, atol=0.05)  # OpenCV rounds to 1/32 pixel


@pytest.mark.parametrize("size", [0.5e-3, 2e-3, 6e-3])
def test_the_motion_across_the_stem_is_measured_beside_the_pads(size: float) -> None:
    stem = measured(film(size, began=0.013)).stem
    assert len(stem.points) >= 8
    expected = size * gain(arc_of(stem.points)) * (stem.axis @ SHAKE) * np.exp(-2j * np.pi * F * 0.013)
    assert np.all(np.abs(stem.motion - expected) < 3 * stem.std)
    assert np.all(stem.std < 2e-4 + 0.1 * size)
    assert np.abs(stem.motion - expected).mean() < 1e-4 + 0.04 * size
    across = np.cross(stem.axis, T_WORLD_CAM[:3, 2])
    assert np.allclose(np.linalg.norm(stem.axis, axis=1), 1)
    assert np.abs(np.abs(across @ WAY)).min() > 0.9, "across the stem, as the camera sees it"


def test_what_is_hidden_is_left_out_and_what_stands_still_is_said_to() -> None:
    all_of_it, part = measured(film(2e-3)).stem, measured(film(2e-3, hidden=True)).stem
    assert 0 < len(part.points) < len(all_of_it.points)
    assert arc_of(part.points).max() < arc_of(all_of_it.points).max() - 0.02
    still = measured(film(0.0)).stem
    assert np.all(np.abs(still.motion) < 3 * still.std)


def test_only_points_beside_the_pads_are_looked_at() -> None:
    apart = np.abs(arc_of(near().points) - 0.1)
    assert 0.015 - 1e-9 <= apart.min() < 0.025
    assert 0.05 < apart.max() <= 0.06 + 1e-9
    assert np.allclose(near().tangents, WAY)


def test_the_stem_is_kept_and_told_relative_to_the_grippers_motion(tmp_path: Path) -> None:
    response = measured(film(2e-3, began=0.013))
    response.save(tmp_path / "r.npz")
    again = Response.load(tmp_path / "r.npz").stem
    assert np.array_equal(again.motion, response.stem.motion)
    assert np.array_equal(again.points, response.stem.points)
    plan = ShakePlan.__new__(ShakePlan)
    object.__setattr__(plan, "frequency", F)
    told = ObservedShake.of(plan, response, GripMeasurement(start=0.013)).stem
    real = told.motion * np.sign(told.axis @ SHAKE)
    assert np.all(real.real > 0)
    assert np.all(np.abs(real.imag) < 4 * told.std)
    assert len(ObservedShake.of(plan, response).stem.points) == 0


# Rules that single functions state.


@pytest.mark.parametrize("began", [0.0, 12.37])
def test_the_phasor_of_a_swing_is_on_the_clock_of_the_frames(began: float) -> None:
    times, phasor = began + np.arange(60) / 40, 3e-3 * np.exp(0.7j)
    found, std = _swing(times, np.imag(phasor * np.exp(2j * np.pi * F * times)), F, 1e-3) or (0j, 0.0)
    assert found == pytest.approx(phasor, abs=1e-8)
    assert std == pytest.approx(np.hypot(SPREAD * 3e-3, LEAST_SPREAD)), "a quiet one's"


def test_a_stems_swing_may_be_missed_by_three_quarters_of_a_pixel() -> None:
    rng, times = np.random.default_rng(3), np.arange(120) / 60
    small, noise = 1e-3 * np.sin(2 * np.pi * F * times), rng.standard_normal(120)
    assert _swing(times, small + 0.6e-3 * noise, F, 1e-3)
    assert not _swing(times, small + 0.9e-3 * noise, F, 1e-3)
    assert _swing(times, small + 0.9e-3 * noise, F, 2e-3), "of a larger pixel it may"


def test_a_frame_rate_at_which_the_swing_is_not_told_tells_none() -> None:
    times = np.arange(60) / F
    assert _swing(times, 1e-3 * np.sin(2 * np.pi * F * times), F, 1e-3) is None


PLACE, UP = np.array([0.08, -0.05, 0.5]), np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize("way", [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.8, 0.0], [0.6, -0.8, 0.0], [1.0, 0.1, 0.3]])
def test_a_strip_lies_across_the_stem_to_the_right_however_the_stem_runs(way: list[float]) -> None:
    tangent = np.array(way) / np.linalg.norm(way)
    strip = _strip(CAMERA, PLACE, tangent, 0.004)
    assert strip is not None
    ahead, here = CAMERA.project(np.array([PLACE + 1e-4 * tangent, PLACE]))
    assert strip.centre == pytest.approx(here)
    assert np.linalg.norm(strip.across) == pytest.approx(1)
    assert strip.across[0] > 0
    assert strip.across @ (ahead - here) == pytest.approx(0, abs=1e-4)
    assert strip.metres == pytest.approx(0.5 / 424)
    assert strip.radius == pytest.approx(0.004 * 424 / 0.5)


@pytest.mark.parametrize("place", [PLACE, [-0.1, 0.07, 0.5], [0.0, 0.0, 0.8]])
def test_a_strips_axis_says_what_a_motion_shows_across_the_stem(place: list[float]) -> None:
    middle, rng = np.array(place), np.random.default_rng(0)
    strip = _strip(CAMERA, middle, np.array([0.3, 0.9, 0.1]), 0.004)
    assert strip is not None
    for move in 1e-5 * rng.standard_normal((4, 3)):
        after, before = CAMERA.project(np.array([middle + move, middle]))
        assert strip.across @ (after - before) * strip.metres == pytest.approx(strip.axis @ move, abs=1e-8)


def test_a_strip_reaches_as_far_as_the_plant_may_have_shifted() -> None:
    strip, far = _strip(CAMERA, PLACE, UP, 0.004), _strip(CAMERA, [0.0, 0.0, 2.0] * np.ones(3), UP, 0.004)
    assert strip is not None
    assert far is not None
    assert strip.half == (int(np.ceil((SHIFT + 0.004) * 848)), 4)
    assert far.half[1] == 2, "of a stem far away some of it is looked at"


@pytest.mark.parametrize("place", [[-0.2, 0, 0.5], [0.2, 0, 0.5], [0, -0.15, 0.5], [0, 0.15, 0.5]])
def test_outside_the_picture_there_is_no_strip(place: list[float]) -> None:
    assert _strip(CAMERA, np.array(place), UP, 0.004) is None


def test_a_stem_seen_from_its_end_has_no_strip() -> None:
    ray = PLACE / np.linalg.norm(PLACE)
    assert _strip(CAMERA, PLACE, ray, 0.004) is None
    assert _strip(CAMERA, PLACE, np.array([0.3, 0.0, 0.95]), 0.004) is None
    assert _strip(CAMERA, PLACE, np.array([0.95, 0.0, 0.3]), 0.004) is not None


def strip_of(radius: float) -> _Strip:
    return _Strip(np.array([120.0, 90.0]), np.array([1.0, 0.0]), (30, 4), 1e-3, 0.5, radius, np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("runs", "where"),
    [
        ([(26, 35)], 0.0),  # columns 26 to 34 of 61: the middle
        ([(26, 36)], 0.5),
        ([(5, 14), (40, 49)], 14.0),  # the nearer
        ([(12, 21), (50, 59)], -14.0),
        ([(0, 9)], -26.0),
        ([(52, 61)], 26.0),
        ([(30, 33), (44, 53)], 18.0),  # the first is thinner than the stem's radius
        ([(16, 36), (44, 53)], 18.0),  # and this wider than 3.5 of them and a margin
        ([(20, 38)], -1.5),  # this not
        ([(0, 61)], None),
        ([], None),
    ],
)
def test_the_stem_is_the_nearest_run_of_columns_as_wide_as_it(runs: list[tuple[int, int]], where: float | None) -> None:
    own = np.zeros(61, dtype=bool)
    for begin, end in runs:
        own[begin:end] = True
    assert _stem_in(own, strip_of(4.0)) == where


def test_a_thin_stem_is_two_columns_or_more() -> None:
    one, two = np.zeros(61, dtype=bool), np.zeros(61, dtype=bool)
    one[30] = two[30:32] = True
    assert _stem_in(one, strip_of(0.7)) is None
    assert _stem_in(two, strip_of(0.7)) == 0.5


def test_a_pixel_is_like_the_stem_by_how_near_its_colour_is() -> None:
    colour = np.array([70.0, 120.0, 50.0])
    shades = colour + np.array([[[0, 0, 0], [20, 0, 0], [0, -20, 0], [0, 12, 16], [200, 0, 0]]], dtype=float)
    found = _alike(shades, colour, 20.0)
    assert found[0] == pytest.approx([1, np.exp(-0.5), np.exp(-0.5), np.exp(-0.5), 0], abs=1e-6)


BAND = 4.0  # px to either side


def bands(places: Array, depth: float = 0.5) -> list[Frame]:
    """Return pictures of an upright stem at columns (T,), NaN for hidden, before a wall of patches."""
    rng = np.random.default_rng(0)
    wall = np.kron(rng.integers(90, 190, (18, 24, 3)), np.ones((10, 10, 1)))
    u, made = np.arange(240.0), []
    for i, place in enumerate(places):
        away = np.abs(u - (place if np.isfinite(place) else 1e9))
        cover = np.clip(BAND + 0.5 - away, 0, 1)[None, :, None]
        rgb = wall + cover * ([70.0, 120.0, 50.0] - wall) + rng.normal(0, 1, wall.shape)
        z = np.where(away < BAND + 0.5, depth, 0.9) * np.ones((180, 1))
        made.append(Frame(7.0 + i / RATE, np.clip(rgb, 0, 255).astype(np.uint8), z.astype(np.float32)))
    return made


def followed(places: Array, depth: float = 0.5) -> Array | None:
    frames = bands(places, depth)
    return _followed(frames, [frame.rgb.astype(np.float32) for frame in frames], strip_of(BAND))


@pytest.mark.parametrize("start", [-6.3, 0.0, 4.4])
def test_a_stem_is_followed_across_to_a_fraction_of_a_pixel(start: float) -> None:
    moved = start + 2.3 * np.sin(2 * np.pi * np.arange(25) / 12)
    moved -= moved[0] - start
    found = followed(120 + moved)
    assert found is not None
    assert found - found[0] == pytest.approx(moved - moved[0], abs=0.25)
    assert found == pytest.approx(moved, abs=0.6), "where it is, to the pixel that its depth tells"


@pytest.mark.parametrize("way", [1, -1])
def test_a_stem_that_speeds_up_is_followed_farther_than_it_is_looked_for(way: int) -> None:
    """It is looked for within 12 px of where it is going."""
    moved = way * np.cumsum([0.0, 4, 8, 12, 15, 16, 16])
    found = followed(120 + moved)
    assert found is not None
    assert found == pytest.approx(moved, abs=0.3)


def test_a_stem_that_is_hidden_for_some_frames_is_looked_for_where_it_was() -> None:
    moved = np.array([0.0, 5, 10, 15, np.nan, np.nan, 13, 8, 3, np.nan, 6, 6])
    found = followed(120 + moved)
    assert found is not None
    assert found == pytest.approx(moved, abs=0.3, nan_ok=True)
    moved = np.array([0.0, np.nan, 11, 7, 7, 7])  # how far it came while it was hidden says nothing of where it goes
    assert followed(120 + moved) == pytest.approx(moved, abs=0.3, nan_ok=True)


def test_a_stem_that_is_not_as_far_as_it_should_be_is_not_followed() -> None:
    assert followed(np.full(8, 120.0), 0.5 + 0.02) is not None
    assert followed(np.full(8, 120.0), 0.5 - 0.02) is not None
    assert followed(np.full(8, 120.0), 0.5 + 0.03) is None
    assert followed(np.full(8, 120.0), 0.5 - 0.03) is None


def test_a_stems_motion_is_told_along_what_the_camera_sees_of_it() -> None:
    """At the picture's edge it looks aslant, so that motion away from it shows too."""
    camera, size = Intrinsics(240, 180, 424.0, 424.0, 10.0, 89.5), 3e-3
    times = 7.0 + np.arange(40) / RATE
    here = np.array([[(120 - 10) / 424 * 0.5, 0.0, 0.5], [(120 - 10) / 424 * 0.5, 0.03, 0.5], [0, 0, 0.07], [0, 0, -1]])
    near = StemNear(here, np.tile(UP, (4, 1)), np.full(4, BAND * 0.5 / 424))
    columns = 120 + size * np.sin(2 * np.pi * F * times + 0.3) * 424 / 0.5
    found = measure_stem(bands(columns), camera, np.eye(4), near, F)
    assert found.points == pytest.approx(here[:2]), "what is at the camera or behind it is left out"
    slant = (120 - 10) / 424
    assert found.axis == pytest.approx(np.array([[1, 0, -slant]] * 2) / np.hypot(1, slant))
    assert found.motion == pytest.approx(size * found.axis[:, 0] * np.exp(0.3j), rel=0.02)
    told = np.hypot(LEAST_SPREAD, SPREAD * size) / np.hypot(1, slant)
    assert found.std == pytest.approx([told] * 2, rel=0.03)


def test_of_nothing_measured_there_are_no_rows() -> None:
    nothing = StemMotion.of([])
    assert nothing.points.shape == nothing.axis.shape == (0, 3)
    assert nothing.motion.shape == nothing.std.shape == (0,)


def test_pads_and_what_is_far_from_them_are_left_out_at_either_side() -> None:
    arc = np.array([0.03, 0.041, 0.08, 0.086, 0.1, 0.114, 0.116, 0.159, 0.161])
    found = stem_near(ROOT + arc[:, None] * WAY, arc, np.arange(9.0), 0.1)
    assert found.radii.tolist() == [1, 2, 6, 7]
    assert found.points == pytest.approx(ROOT + arc[[1, 2, 6, 7], None] * WAY)
    assert found.tangents == pytest.approx(np.tile(WAY, (4, 1)))
