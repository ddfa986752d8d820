"""Measuring flower motion: synthetic frames of a moving truss with known truth, end to end."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from alike import check_kept

from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics, inverse, look_at, transform_points
from anther.core.oscillation import choose_rate
from anther.perception.flowers import Flowers
from anther.pollination.response import measure_response
from anther.pollination.response._following import without_outliers
from anther.pollination.response._petals import petal_weight
from anther.robot.devices import Frame
from anther.sim.robot import SimCamera

CAMERA = Intrinsics(240, 180, 424.0, 424.0, 119.5, 89.5)
T_WORLD_CAM = look_at([0.72, -0.55, 0.1], [0.72, 0.0, 0.1])
REST = np.array([[0.70, 0.0, 0.12], [0.722, 0.01, 0.11], [0.75, -0.01, 0.09]])
DIRECTION = np.array([0.8, 0.3, 0.52]) / np.linalg.norm([0.8, 0.3, 0.52])
FINE = 4  # drawn this many times finer, so that petals move by fractions of a pixel


def draw(flowers: Array, time: float, rng: np.random.Generator, colour: tuple[int, int, int]) -> Frame:
    """Return a frame with a grey wall at 2 m, a green leaf and one petal disc a flower, with noise."""
    K = CAMERA
    rgb = np.full((K.height * FINE, K.width * FINE, 3), (140, 150, 140), np.uint8)
    depth = np.full(rgb.shape[:2], 2.0, np.float32)
    cv2.rectangle(rgb, (100, 500), (500, 640), (60, 105, 45), -1)
    cv2.rectangle(depth, (100, 500), (500, 640), 0.55, -1)  # type: ignore[call-overload]
    points = transform_points(inverse(T_WORLD_CAM), flowers)
    for p, pixel in zip(points, K.project(points), strict=True):
        centre = tuple(int(x) for x in np.rint((pixel + 0.5) * FINE - 0.5))
        radius = round(0.007 * K.fx / p[2] * FINE)
        cv2.circle(rgb, centre, radius, colour, -1)
        cv2.circle(rgb, centre, radius // 3, (230, 170, 25), -1)
        cv2.circle(depth, centre, radius, float(p[2]), -1)
    rgb = cv2.resize(rgb, (K.width, K.height), interpolation=cv2.INTER_AREA)
    near = depth[FINE // 2 :: FINE, FINE // 2 :: FINE].copy()
    near += rng.normal(0, 0.0008, near.shape).astype(np.float32)
    noisy = np.clip(rgb + rng.normal(0, 2, rgb.shape), 0, 255).astype(np.uint8)
    return Frame(time, noisy, near)


@lru_cache(maxsize=6)
def record(
    amplitude: float,
    frequency: float,
    *,
    count: int = 45,
    colour: tuple[int, int, int] = (245, 215, 40),
    overtone: float = 0.0,
) -> list[Frame]:
    rng = np.random.default_rng(0)
    rate = choose_rate(frequency, SimCamera.rates)
    gain = np.array([1.0, 0.5, 1.5])[:, None]
    frames = []
    for i in range(count):
        phase = 2 * np.pi * frequency * i / rate + 0.4
        shift = amplitude * (np.sin(phase) + overtone * np.sin(2 * phase))
        frames.append(draw(REST + 0.002 + gain * shift * DIRECTION, i / rate, rng, colour))
    return frames


def flowers(positions: Array = REST) -> Flowers:
    return Flowers(positions, np.zeros(len(positions), dtype=int))


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.001, 30.0), (0.002, 10.0), (0.004, 5.0), (0.008, 1.5)])
def test_amplitude_and_frequency_are_measured(amplitude: float, frequency: float) -> None:
    response = measure_response(record(amplitude, frequency), CAMERA, T_WORLD_CAM, flowers(), frequency)
    truth = amplitude * np.array([1.0, 0.5, 1.5])
    assert response.visible.all()
    assert np.abs(response.amplitude - truth).max() < max(0.0003, 0.1 * truth.max())
    assert response.frequency == pytest.approx(np.full(3, frequency), rel=0.01 if amplitude > 0.001 else 0.02)
    sine = response.amplitude * (2 * np.pi * response.frequency) ** 2
    assert response.acceleration_peak == pytest.approx(sine, rel=1e-6 if frequency > 8.0 else 0.06)


def test_a_swing_that_is_no_sine_is_measured_with_its_overtones() -> None:
    """A flower that swings far about its pedicel is pulled along it twice a period."""
    response = measure_response(record(0.006, 5.0, overtone=0.4), CAMERA, T_WORLD_CAM, flowers(), 5.0)
    truth = 0.006 * np.array([1.0, 0.5, 1.5])
    phase = np.linspace(0, 2 * np.pi, 1000)
    sharper = np.abs(np.sin(phase) + 4 * 0.4 * np.sin(2 * phase)).max()
    assert response.visible.all(), response.notes
    assert response.amplitude == pytest.approx(truth, rel=0.1)
    assert response.acceleration_peak == pytest.approx(sharper * truth * (10 * np.pi) ** 2, rel=0.15)


@pytest.mark.parametrize(
    ("frequency", "rate"),
    [(27.0, 60.0), *(pytest.param(f, 90.0, marks=pytest.mark.slow) for f in (27.0, 30.0))],
)
def test_a_fast_swing_seen_through_an_open_shutter_is_made_up_for(frequency: float, rate: float) -> None:
    """Fewer than four frames a period, and 11 ms of each of them blurred: the frequency is known, the exposure too."""
    rng, exposure, gain = np.random.default_rng(0), 0.011, np.array([1.0, 0.5, 1.5])[:, None]
    frames = []
    for i in range(45):
        open_ = i / rate + exposure * (np.arange(5) - 2) / 5
        places = [REST + gain * 0.0015 * np.sin(2 * np.pi * frequency * t + 0.4) * DIRECTION for t in open_]
        seen = [draw(place, i / rate, rng, (245, 215, 40)) for place in places]
        rgb = np.mean([frame.rgb for frame in seen], axis=0)
        depth = np.mean([frame.depth for frame in seen], axis=0).astype(np.float32)
        frames.append(Frame(i / rate, rgb.astype(np.uint8), depth))
    found, plain = (measure_response(frames, CAMERA, T_WORLD_CAM, flowers(), frequency, exposure=e) for e in (0.011, 0))
    truth = 0.0015 * gain[:, 0]
    assert found.visible.all()
    assert found.amplitude == pytest.approx(truth, rel=0.15)
    assert found.acceleration_peak == pytest.approx(found.amplitude * (2 * np.pi * found.frequency) ** 2)
    assert np.median(plain.amplitude / truth) < 0.9
    with pytest.raises(InputError, match="exposure"):
        measure_response(frames, CAMERA, T_WORLD_CAM, flowers(), frequency, exposure=0.02)


def test_white_petals_are_followed_too() -> None:
    frames = record(0.003, 5.0, colour=(245, 245, 240))
    response = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(), 5.0)
    assert response.amplitude == pytest.approx(0.003 * np.array([1, 0.5, 1.5]), abs=3e-4)


def test_a_flower_that_is_not_there_is_nan_with_a_note() -> None:
    absent = np.vstack([REST, [0.66, 0.0, 0.02]])
    response = measure_response(record(0.002, 5.0), CAMERA, T_WORLD_CAM, flowers(absent), 5.0)
    assert response.visible.tolist() == [True, True, True, False]
    assert np.isnan(response.amplitude[3])
    assert any("Flower 4" in note for note in response.notes)


def test_flowers_that_overlap_in_the_view_are_told_apart_and_said_to_be_unsure() -> None:
    pair = np.vstack([REST[0], REST[0] + [0.006, 0.0, 0.004], REST[2]])
    rng = np.random.default_rng(0)
    swing = 0.003 * np.sin(2 * np.pi * 5 * np.arange(45) / 60)
    gain = np.array([1.0, 0.6, 1.0])[:, None]
    frames = [draw(pair + gain * np.array([x, 0, 0]), i / 60, rng, (245, 215, 40)) for i, x in enumerate(swing)]
    response = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(pair), 5.0)
    assert np.all(np.abs(response.amplitude - 0.003 * gain[:, 0]) < 2 * response.amplitude_std + 1e-4)
    assert response.amplitude[1] < response.amplitude[0]
    assert response.amplitude_std[0] > 0.15 * response.amplitude[0] > response.amplitude_std[2]
    assert response.notes == ("Flowers 1, 2 overlap in the view: their motions may be mixed up.",)


def test_phase_and_frequency_come_with_deviations() -> None:
    response = measure_response(record(0.003, 5.0), CAMERA, T_WORLD_CAM, flowers(), 5.0)
    along = response.direction @ DIRECTION
    miss = np.mod(response.phase - np.where(along > 0, 0.4, 0.4 + np.pi) + np.pi, 2 * np.pi) - np.pi
    assert np.all(np.abs(along) > 0.9)
    assert np.all(np.abs(miss) < 3 * response.phase_std)
    assert np.all(np.abs(response.frequency - 5.0) < np.maximum(3 * response.frequency_std, 0.01))
    assert np.nanmedian(response.tracks, axis=0) == pytest.approx(REST + 0.002, abs=0.0015), "where they are, too"
    assert np.all((response.phase_std < 0.15) & (response.frequency_std < 0.05))


def test_a_frame_rate_that_hides_the_shake_is_refused_with_the_reason() -> None:
    frames = [f for i, f in enumerate(record(0.002, 30.0, count=48)) if i % 3 == 0]  # 90 Hz -> 30 Hz
    response = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(), 30.0)
    assert not response.visible.any()
    assert any("frame rate" in note for note in response.notes)


def test_white_petals_in_shade_before_a_bright_wall_are_followed_by_their_depth() -> None:
    frames = record(0.003, 5.0, colour=(150, 152, 148))  # no brighter than the wall
    response = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(), 5.0)
    assert response.visible.all()
    assert response.amplitude == pytest.approx(0.003 * np.array([1, 0.5, 1.5]), abs=4e-4)


def test_a_swing_too_small_to_tell_is_nan_with_one_note() -> None:
    response = measure_response(record(3e-5, 5.0), CAMERA, T_WORLD_CAM, flowers(), 5.0)
    assert not response.visible.any()
    assert np.all((response.at_most > 3e-5) & (response.at_most < 5e-4))
    assert len(response.notes) == 1
    assert response.notes[0].startswith("Flowers 1, 2, 3: moved less than the camera can tell")


def test_flowers_outside_the_picture_are_said_to_be_so() -> None:
    positions = np.vstack([REST, [0.72, 0.0, 0.6]])
    response = measure_response(record(0.002, 5.0), CAMERA, T_WORLD_CAM, flowers(positions), 5.0)
    assert response.visible.tolist() == [True, True, True, False]
    assert response.notes == ("Flower 4: outside the side camera's picture.",)


@pytest.mark.parametrize("edge", [-0.004, 0.002, 0.005, 0.006])
def test_a_flower_that_swings_behind_a_post_is_not_underrated(edge: float) -> None:
    rng, swing = np.random.default_rng(0), 0.005 * np.sin(2 * np.pi * 5 * np.arange(45) / 60)
    frames = [draw(REST[:1] + np.array([x, 0, 0]), i / 60, rng, (245, 215, 40)) for i, x in enumerate(swing)]
    u = int(CAMERA.project(transform_points(inverse(T_WORLD_CAM), REST[:1] + np.array([edge, 0, 0])))[0, 0])
    for frame in frames:
        frame.rgb[:, u : u + 14], frame.depth[:, u : u + 14] = (70, 110, 50), 0.5
    response = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(REST[:1]), 5.0)
    assert response.visible[0] == (len(response.notes) == 0)
    assert not response.visible[0] or response.amplitude[0] == pytest.approx(0.005, rel=0.25)


def test_white_petals_are_told_from_the_bright_gaps_around_a_plant() -> None:
    frame = draw(REST[:1], 0.0, np.random.default_rng(0), (215, 215, 205))
    frame.depth[60:120, :100] = 0.0  # a gap beside the plant without a depth reading
    weight = petal_weight(frame, 0.4, 0.7)
    u, v = np.rint(CAMERA.project(transform_points(inverse(T_WORLD_CAM), REST[:1]))[0]).astype(int)
    assert weight[v - 3, u] > 0.9
    assert weight[60:120, :90].max() < 0.2


@pytest.mark.parametrize("axis", range(3))
def test_a_sample_that_is_off_along_any_axis_is_left_out(axis: int) -> None:
    rng, times = np.random.default_rng(4), np.arange(90) / 60
    track = 0.002 * np.sin(2 * np.pi * 4 * times)[:, None] + 1e-4 * rng.standard_normal((90, 3))
    track[40, axis] += 0.005
    left = np.isnan(without_outliers(times, track, 4.0)).all(axis=1)
    assert left[40]
    assert left.sum() < 4


def test_flowers_behind_the_camera_and_no_flowers_at_all() -> None:
    frames = record(0.002, 5.0, count=10)
    behind = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(REST - [0, 2.0, 0]), 5.0)
    assert not behind.visible.any()
    assert behind.notes
    none = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(np.zeros((0, 3))), 5.0)
    assert none.amplitude.shape == (0,)
    assert none.tracks.shape == (10, 0, 3)


def test_without_depth_a_swing_across_the_view_is_still_measured() -> None:
    """A webcam's frames: what moves towards it is left out, and said to be."""
    frames = record(0.002, 5.0)
    flat = [replace(frame, depth=np.zeros_like(frame.depth)) for frame in frames]
    deep, flat_too = (measure_response(f, CAMERA, T_WORLD_CAM, flowers(), 5.0) for f in (frames, flat))
    assert flat_too.visible.all()
    share = flat_too.amplitude / deep.amplitude
    assert np.all((share > 0.9) & (share <= 1.01))
    assert any("motion towards the camera is left out" in note for note in flat_too.notes)


def test_too_few_frames_and_a_wrong_size_are_refused() -> None:
    frames = record(0.002, 5.0, count=9)
    with pytest.raises(InputError, match="8 or more"):
        measure_response(frames[:5], CAMERA, T_WORLD_CAM, flowers(), 5.0)
    other = Intrinsics(320, 240, 424.0, 424.0, 160, 120)
    with pytest.raises(InputError, match="this camera's intrinsics"):
        measure_response(frames, other, T_WORLD_CAM, flowers(), 5.0)
    for part in ({"rgb": frames[0].rgb[1:]}, {"depth": frames[0].depth[1:]}):
        with pytest.raises(InputError, match="this camera's intrinsics"):
            measure_response([*frames[1:], replace(frames[0], **part)], CAMERA, T_WORLD_CAM, flowers(), 5.0)


def test_flowers_far_and_near_are_followed_alike() -> None:
    apart = REST[[0, 2]] + [[0, -0.12, 0], [0, 0.1, 0]]
    swing = 0.003 * np.sin(2 * np.pi * 5 * np.arange(45) / 60)
    rng = np.random.default_rng(0)
    frames = [draw(apart + np.array([x, 0, 0]), i / 60, rng, (245, 215, 40)) for i, x in enumerate(swing)]
    response = measure_response(frames, CAMERA, T_WORLD_CAM, flowers(apart), 5.0)
    assert response.visible.all()
    assert response.amplitude == pytest.approx([0.003, 0.003], rel=0.15)


def test_a_response_survives_the_disk(tmp_path: Path) -> None:
    response = measure_response(record(0.002, 5.0, count=12), CAMERA, T_WORLD_CAM, flowers(), 5.0)
    check_kept(response, tmp_path / "r.npz")
