"""Next view: what is expected to be seen of a stem with a screen beside it, against what is seen then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.capture import Capture
from anther.errors import InputError
from anther.geometry import Array, Intrinsics, inverse, look_at, transform_points
from anther.next_view import Params, expected_new_volume

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
MIDDLE = np.array([0.0, 0.0, 0.15])
STEM = np.stack([np.zeros(16), np.zeros(16), np.linspace(0, 0.3, 16)], axis=1)
PARAMS = Params(enough=1)


def seen_from(degrees: float, distance: float = 0.5) -> Array:
    turn = np.radians(degrees)
    return look_at(MIDDLE + distance * np.array([np.cos(turn), np.sin(turn), 0.2]), MIDDLE)


def picture(T_world_cam: Array, solid: Array) -> np.ndarray:
    """Return the depth image of points (N, 3), a wall 2 m away behind them."""
    points = transform_points(inverse(T_world_cam), solid)
    points = points[np.argsort(-points[:, 2])]
    u, v = np.round(CAMERA.project(points)).astype(int).T
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, dtype=np.float32)
    for du in (-1, 0, 1):
        for dv in (-1, 0, 1):
            depth[np.clip(v + dv, 0, 239), np.clip(u + du, 0, 319)] = points[:, 2]
    return depth


def screen() -> Array:
    """Return a wall of leaves 3 cm in front of the stem, as seen from 0 degrees."""
    y, z = np.meshgrid(np.arange(-0.1, 0.1, 0.002), np.arange(-0.05, 0.35, 0.002))
    return np.stack([np.full(y.size, 0.03), y.ravel(), z.ravel()], axis=1)


def capture_of(*degrees: float, solid: Array) -> Capture:
    poses = np.stack([seen_from(a) for a in degrees])
    return Capture(np.stack([picture(T, solid) for T in poses]), CAMERA, poses)


def test_views_past_the_screen_show_what_it_hides() -> None:
    candidates = np.stack([seen_from(a) for a in (0, 10, 90, 180)])
    same, beside, across, behind = expected_new_volume(capture_of(0, solid=screen()), STEM, candidates, PARAMS)
    assert max(same, beside) < 0.05 * min(across, behind)


def test_a_view_taken_makes_good_most_of_its_promise() -> None:
    before = capture_of(0, solid=screen())
    promised = expected_new_volume(before, STEM, seen_from(180)[None], PARAMS)[0]
    left = expected_new_volume(capture_of(0, 180, solid=screen()), STEM, seen_from(180)[None], PARAMS)[0]
    assert promised > 1e-4
    assert left < 0.1 * promised


def test_no_gain_where_enough_views_have_seen_all() -> None:
    nothing = np.array([[0.3, 0.3, 0.0]])
    around = capture_of(0, 90, 180, 270, solid=nothing)
    gain = expected_new_volume(around, STEM, seen_from(45)[None], PARAMS)[0]
    assert gain < 10 * PARAMS.voxel**3  # all but the few voxels that the four points hide
    assert expected_new_volume(around, STEM, seen_from(45)[None], replace(PARAMS, enough=8))[0] > 1e-4


def test_gain_is_bounded_by_the_volume_of_interest() -> None:
    blind = capture_of(0, solid=screen())
    blind = replace(blind, depth=np.zeros_like(blind.depth))
    gain = expected_new_volume(blind, STEM, seen_from(90)[None], replace(PARAMS, opacity=0.0))[0]
    capsule = np.pi * PARAMS.reach**2 * (0.3 + 4 / 3 * PARAMS.reach)
    assert 0.8 * capsule < gain < 1.1 * capsule


def test_a_view_that_looks_away_shows_nothing() -> None:
    away = look_at([0.5, 0, 0.15], [1.0, 0, 0.15])
    assert expected_new_volume(capture_of(0, solid=screen()), STEM, away[None], PARAMS)[0] == 0


@settings(max_examples=20)
@given(st.sampled_from(["voxel", "reach", "surroundings", "opacity"]), st.floats(-10, -1e-6) | st.floats(10, 1e6))
def test_bad_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError):
        Params(**{name: value})  # pyright: ignore[reportArgumentType]


def test_bad_hypotheses_are_refused() -> None:
    capture = capture_of(0, solid=screen())
    for stem in (np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(InputError, match="hypothesis"):
            expected_new_volume(capture, stem, seen_from(90)[None])
