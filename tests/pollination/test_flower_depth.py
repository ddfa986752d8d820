"""How far a flower is along its path, read from its own pixels: made depth images of a slanted petal, known truth."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.geometry import Array
from anther.core.oscillation import fit_swing, swing_basis
from anther.pollination.response._depth import _readings, depth_along
from anther.pollination.response._petals import Patch
from anther.robot.devices import Frame

SIZE, F = 48, 5.0
TIMES = 3.0 + np.arange(40) / 60
SWING = swing_basis(TIMES, F)
DISC = (np.hypot(*np.mgrid[-6:7, -6:7]) < 5).astype(np.float32)
PATCH = Patch(np.zeros((13, 13, 3), np.float32), DISC, np.array([24, 24]), 4.0)
PATH = np.add([24.0, 23.0], np.outer(np.sin(2 * np.pi * F * TIMES), [2.4, -1.3]))
TRUE = 0.5 + 0.004 * np.sin(2 * np.pi * F * TIMES + 0.7)


def frames(true: Array = TRUE, path: Array = PATH, slope: float = 0.001) -> list[Frame]:
    """Return depth images of a petal that slants by `slope` [m/px] and fills them all."""
    v, u = np.mgrid[:SIZE, :SIZE]
    blank = np.zeros((SIZE, SIZE, 3), np.uint8)
    return [
        Frame(float(t), blank, (z + slope * (u - x) - 0.5 * slope * (v - y)).astype(np.float32))
        for t, z, (x, y) in zip(TIMES, true, path, strict=True)
    ]


def depth(film: list[Frame], path: Array = PATH, about: float = 0.502) -> Array:
    return depth_along(film, PATCH, path, SWING, np.array(about), 0.02)


def test_a_slanted_petals_middle_is_as_far_as_it_is_however_it_moves() -> None:
    assert depth(frames()) == pytest.approx(TRUE, abs=2e-5)


def test_a_bulged_petals_middle_is_as_far_as_it_is() -> None:
    v, u = np.mgrid[:SIZE, :SIZE]
    film = frames(slope=0.0)
    for frame, (x, y) in zip(film, PATH, strict=True):
        frame.depth[:] += 2e-4 * ((u - x) ** 2 - (v - y) ** 2) + 1e-4 * (u - x) * (v - y)
    assert depth(film) == pytest.approx(TRUE, abs=5e-5)


def test_readings_mixed_with_something_else_do_not_count() -> None:
    """Three of ten readings of every third frame lie 12 mm behind."""
    rng, film = np.random.default_rng(0), frames()
    for frame in film[::3]:
        frame.depth[rng.random((SIZE, SIZE)) < 0.3] += 0.012
    assert depth(film) == pytest.approx(TRUE, abs=1e-4)


def test_noise_of_a_millimetre_is_averaged_over_the_petal() -> None:
    rng, film = np.random.default_rng(1), frames()
    for frame in film:
        frame.depth[:] += 0.002 * rng.standard_normal((SIZE, SIZE)).astype(np.float32)
    off = depth(film) - TRUE
    assert off.std() < 0.002 / np.sqrt(DISC.sum()) * 1.5, "all count alike"
    assert abs(off.mean()) < 2e-4


def test_a_frame_off_the_swing_is_off_by_what_its_readings_are() -> None:
    true = TRUE.copy()
    true[17] += 0.001
    assert depth(frames(true)) == pytest.approx(true, abs=1e-4)


def test_depth_is_unknown_where_fewer_than_three_pixels_are_read() -> None:
    film = frames()
    film[5].depth[:] = 0.0
    keep = film[6].depth[22:24, 23].copy()
    film[6].depth[:] = 0.0
    film[6].depth[22:24, 23] = keep
    keep = film[7].depth[22:26, 23].copy()
    film[7].depth[:] = 0.0
    film[7].depth[22:26, 23] = keep
    assert np.flatnonzero(np.isnan(depth(film))).tolist() == [5, 6]


def test_depth_is_unknown_where_the_flower_was_not_seen_and_where_nothing_is_as_far() -> None:
    path = PATH.copy()
    path[[3, 20]] = np.nan
    assert np.flatnonzero(np.isnan(depth(frames(), path))).tolist() == [3, 20]
    assert np.isnan(depth(frames(), about=0.55)).all()
    assert np.isnan(depth(frames(), about=0.45)).all()


def test_twice_as_many_readings_are_wanted_as_numbers_that_are_fitted() -> None:
    weight = np.zeros_like(DISC)
    weight[5:7, 6:8] = 1  # four pixels
    least = 2 * (SWING.shape[1] + 9) // 4
    for count, known in ((least - 1, 0), (least + 1, least + 1)):
        film = frames()
        for frame in film[count:]:
            frame.depth[:] = 0.0
        found = depth_along(film, PATCH._replace(weight=weight), PATH, SWING, np.array(0.502), 0.02)
        assert np.isfinite(found).sum() == known


def test_readings_are_told_by_their_offset_from_the_middle_in_radii() -> None:
    film, path = frames(slope=0.0)[:2], np.array([[20.25, 24.0], [24.0, 30.5]])
    found = _readings(film, PATCH, path, np.full(2, 0.5), 0.02)
    assert found[:, 0].tolist() == [0.0] * int(DISC.sum()) + [1.0] * int(DISC.sum())
    first, second = (found[found[:, 0] == k] for k in (0, 1))
    assert first[:, 1].min() == pytest.approx((-4 - 0.25) / 4)
    assert first[:, 1].max() == pytest.approx((4 - 0.25) / 4)
    assert sorted({*first[:, 2]}) == pytest.approx(np.arange(-4, 5) / 4)
    assert second[:, 2].max() == pytest.approx((4 - 0.5) / 4)
    assert first[:, 3] == pytest.approx(np.full(len(first), film[0].depth[0, 0]))


@pytest.mark.parametrize("way", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_depth_is_not_read_where_the_patch_is_not_whole_in_the_picture(way: tuple[int, int]) -> None:
    path = 24 + np.linspace(0, 24, 40)[:, None] * way
    film = frames(path=path, slope=0.0)
    middle = np.rint(path)
    inside = np.all((middle >= 6) & (middle + 6 < SIZE), axis=1)
    assert 10 < inside.sum() < 35
    assert np.array_equal(np.isfinite(depth(film, path)), inside)


def test_depth_is_followed_through_gaps_slopes_and_other_things_readings() -> None:
    rng, size, hint = np.random.default_rng(3), 64, 5.0
    times = np.arange(60) / 60.0
    true = 0.5 + 0.002 * np.sin(2 * np.pi * hint * times + 0.7)
    path = 30.0 + np.outer(np.sin(2 * np.pi * hint * times + 0.7), [2.4, -1.3])
    v, u = np.mgrid[:size, :size]
    frames = []
    for time, z, (x, y) in zip(times, true, path, strict=True):
        depth = z + 0.001 * (u - x) + 0.0005 * rng.standard_normal((size, size))  # a petal at 45 degrees
        depth[rng.random(depth.shape) < 0.3] = 0.0
        depth[(v > y + 2) & (rng.random() < 0.4)] = 0.515  # a leaf's, now and then
        frames.append(Frame(float(time), np.zeros((size, size, 3), np.uint8), depth.astype(np.float32)))
    disc = (np.hypot(*np.mgrid[-8:9, -8:9]) < 6).astype(np.float32)
    patch = Patch(np.zeros((17, 17, 3), np.float32), disc, np.array([30, 30]), 5.5)
    basis = swing_basis(times, hint)
    found = depth_along(frames, patch, path, basis, np.array(0.502), 0.02)
    swing = fit_swing(times, np.column_stack([found] * 3), hint)
    assert swing.amplitude / np.sqrt(3) == pytest.approx(0.002, abs=2e-4)
    assert np.mod(swing.phase, np.pi) == pytest.approx(0.7, abs=0.1)
    assert np.isnan(depth_along(frames, patch, path, basis, np.array(0.9), 0.02)).all()  # nothing is there
    for frame, (x, y) in zip(frames, np.rint(path).astype(int), strict=True):
        few = frame.depth[y, x - 1 : x + 3].copy()
        frame.depth[:] = 0.0
        frame.depth[y, x - 1 : x + 3] = few if frame.time < 0.1 else 0.0
    assert np.isnan(depth_along(frames, patch, path, basis, np.array(0.502), 0.02)).all()  # too few for what is fitted


def test_depth_is_not_read_where_the_flower_leaves_the_picture() -> None:
    times, size = np.arange(60) / 60.0, 64
    path = np.column_stack([np.linspace(20, 61, 60), np.full(60, 30.0)])
    frames = [
        Frame(float(t), np.zeros((size, size, 3), np.uint8), np.full((size, size), 0.5, np.float32)) for t in times
    ]
    patch = Patch(np.zeros((17, 17, 3), np.float32), np.ones((17, 17), np.float32), np.array([20, 30]), 5.5)
    found = depth_along(frames, patch, path, swing_basis(times, 5.0), np.array(0.502), 0.02)
    inside = np.rint(path[:, 0]) + 8 < size
    np.testing.assert_array_equal(np.isfinite(found), inside)
    np.testing.assert_allclose(found[inside], 0.5, atol=1e-4)
