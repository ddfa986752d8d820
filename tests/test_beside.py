"""The main stem beside the pads, in synthetic frames of a slanted stem before a textured wall, with known truth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from anther.devices import Frame
from anther.flowers import Flowers
from anther.geometry import Array, Intrinsics, inverse, look_at, transform_points
from anther.identification import Felt, ObservedShake
from anther.oscillation import fit_swing
from anther.response import Response, StemNear, measure_response, stem_near
from anther.response._beside import _Strip, _swing
from anther.shake import ShakePlan

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
    told = ObservedShake.of(plan, response, Felt(began=0.013)).beside
    real = told.motion * np.sign(told.axis @ SHAKE)
    assert np.all(real.real > 0)
    assert np.all(np.abs(real.imag) < 4 * told.std)
    assert len(ObservedShake.of(plan, response).beside.points) == 0
