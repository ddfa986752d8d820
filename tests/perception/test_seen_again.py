"""Where a plant is that was seen on the way: found again by what one view shows of it, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, Intrinsics, inverse, look_at, small_transform, transform_points
from anther.perception.capture import View
from anther.perception.cloud import Cloud, Support, moved_since
from anther.perception.cloud._seen_again import SEARCH_ALONG, find_again

WAY = np.array([0.0, 0.5, 0.0])


def leaves(seed: int) -> Array:
    """Points (N, 3) of a dozen bent leaves around a stem [m]."""
    rng, parts = np.random.default_rng(seed), list[Array]()
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.06, 0.06, 40), np.linspace(-0.025, 0.025, 17)))
    for _ in range(12):
        sheet = np.stack([u, v, 3 * u**2 - 4 * v**2], axis=1)
        place = small_transform(rng.normal(0, 1.0, 3), rng.uniform([0.62, -0.12, -0.25], [0.78, 0.12, 0.3]))
        parts.append(transform_points(place, sheet))
    return np.concatenate(parts)


@pytest.mark.parametrize("seed", range(4))
def test_a_plant_is_found_again_where_it_is(seed: int) -> None:
    """It may be as far off as odometry and calibration err, and half of it hidden from there."""
    rng, plant = np.random.default_rng(seed), leaves(seed)
    turned, shift = rng.normal(0, 0.004, 3), np.array([0.01, rng.choice([-1, 1]) * 0.045, 0.004])
    about = transform_points(small_transform(turned, np.zeros(3)), [[0.7, 0, 0]])[0]
    moved = small_transform(turned, shift + np.array([0.7, 0, 0]) - about)
    shown = transform_points(moved, plant)[plant[:, 1] < 0.03]
    found = find_again(plant, WAY, shown + rng.normal(0, 0.0005, shown.shape))
    off = np.linalg.norm(transform_points(found, plant) - transform_points(moved, plant), axis=1)
    assert off.max() < 0.003


def test_another_plant_is_refused_and_so_is_one_that_is_too_far() -> None:
    for shown in (leaves(2), leaves(1) + np.array([0.0, 2 * SEARCH_ALONG, 0.0])):
        with pytest.raises(StageFailure, match=r"not where it was seen on the way.*Drive by again") as failure:
            find_again(leaves(1), WAY, shown)
        assert failure.value.kind == "no_plant_found"
    with pytest.raises(StageFailure, match="3 points of surface are seen from here, 100 are needed"):
        find_again(leaves(1), WAY, leaves(1)[[0, 200, 400]])


def test_a_view_from_where_the_cart_stands_moves_all_that_was_seen() -> None:
    """What lies outside the workspace takes no part, nor do leaves far from the stem: each plant sways by itself."""
    plant, by = leaves(5) * [1.0, 0.7, 1.0], small_transform(np.zeros(3), [0.008, 0.03, -0.004])
    neighbours = np.concatenate(
        [leaves(seed) * [1.0, 0.5, 1.0] + [0.02, y, 0.0] for seed, y in ((6, 0.22), (7, -0.22))]
    )
    stem = np.stack([np.full(60, 0.7), np.zeros(60), np.linspace(-0.3, 0.3, 60)], axis=1)
    wall = np.stack([np.full(4000, 1.6), *np.random.default_rng(0).uniform(-0.4, 0.4, (2, 4000))], axis=1)
    lens, pose = Intrinsics(480, 480, 424.0, 424.0, 239.5, 239.5), look_at([0.2, -0.3, 0.05], [0.7, 0.0, 0.0])
    depth = np.zeros((480, 480), np.float32)
    for point in transform_points(inverse(pose), np.concatenate([wall, neighbours, transform_points(by, plant)])):
        column, row = np.rint(lens.project(point[None])[0]).astype(int)
        if 1 <= row < 479 and 1 <= column < 479:
            patch = depth[row - 1 : row + 2, column - 1 : column + 2]
            patch[(patch == 0) | (patch > point[2])] = point[2]
    poses = np.stack([look_at([0.1, y, 0.0], [0.7, y, 0.0]) for y in (-0.3, 0.0, 0.3)])
    string = Support("string", np.array([[0.7, 0.2, -0.3], [0.7, 0.2, 0.4]]), 0.001, plant[:3])
    seen = Cloud(
        np.concatenate([plant, neighbours]),
        obstacles=plant[:5],
        loose=plant[5:9],
        supports=(string,),
        T_world_cam=poses,
    )
    box = Box(np.array([0.4, -0.4, -0.4]), np.array([1.0, 0.4, 0.5]))
    found = moved_since(seen, stem, View(depth, None, lens, pose), box)
    np.testing.assert_allclose(transform_points(found, plant), transform_points(by, plant), atol=0.004)
    here = seen.moved(by)
    for name in ("points", "obstacles", "loose"):
        np.testing.assert_allclose(getattr(here, name), transform_points(by, getattr(seen, name)))
    np.testing.assert_allclose(here.supports[0].axis, transform_points(by, string.axis))
    assert here.T_world_cam is not None
    np.testing.assert_allclose(here.T_world_cam[:, :3, 3], transform_points(by, poses[:, :3, 3]))
