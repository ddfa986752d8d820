"""A cart that drives past a row: what is in its camera's view, and how wrong its odometry is."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.choices import Crop
from anther.core.errors import InputError
from anther.core.geometry import inverse, transform_points
from anther.sim import draw, drive_past, grow_row
from anther.sim.render import d455
from anther.sim.row_cell import before_arm
from anther.sim.row_drive import BEYOND, RATE, look_ahead


@pytest.mark.parametrize("crop", ["tomato", "pepper"])
def test_hooks_and_flowers_come_into_view_on_the_way(crop: Crop) -> None:
    row = grow_row(crop, 5, 4)
    drive = drive_past(row, 1, truth=draw(1))
    camera, near = drive.intrinsics, row.plants[: row.near]
    points = np.vstack([[t.hook for p in near for t in p.twines], *(p.flower_position for p in near)])
    pixels = np.array([camera.project(transform_points(inverse(T), points)) for T in drive.T_world_cam])
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=2)
    assert (inside.sum(axis=0) >= 4).all()
    assert drive.blur > 0


def test_the_odometry_goes_wrong_and_the_cart_does_not() -> None:
    row = grow_row("tomato", 5, 4)
    drive, again = (drive_past(row, seed, speed=0.5) for seed in (1, 2))
    hooks = row.hooks[: row.near, 1]
    assert drive.place[0] == pytest.approx(hooks.min() - BEYOND)
    assert np.diff(drive.place) == pytest.approx(0.5 / RATE)
    wrong = drive.odometry - (drive.place - drive.place[0])
    assert 0.001 < np.abs(wrong[-1]) < 0.1
    assert not np.allclose(drive.odometry, again.odometry)
    elsewhere = drive_past(row.at([0, 3.0, 0]), 1, speed=0.5)
    assert elsewhere.odometry == pytest.approx(drive.odometry)
    assert elsewhere.T_world_cam[:, 1, 3] == pytest.approx(drive.T_world_cam[:, 1, 3] + 3.0)


@pytest.mark.parametrize("crop", ["tomato", "pepper"])
def test_a_stem_ahead_the_camera_has_the_plant_in_view_and_odometry_errs_until_the_cart_stands(
    crop: Crop,
) -> None:
    before = before_arm(grow_row(crop, 5, 4))
    beside = before.worked.end[before.worked.stem_segments()]
    stem = beside[np.abs(beside[:, 2] - before.flowers[2]) < 0.1]
    errors = []
    for seed in range(20):
        believed, true = look_ahead(before, np.random.default_rng(seed), draw(seed))
        pixels = np.array([d455().project(transform_points(inverse(T), stem)) for T in true])
        assert ((pixels >= 0) & (pixels < [1280, 720])).all(axis=2).mean() > 0.9
        assert (np.diff(true[:, 1, 3]) > 0).all(), "on along the rails"
        errors.append(np.linalg.norm(believed[:, :3, 3] - true[:, :3, 3], axis=1))
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert 0.005 < spread[-1] < 0.02, "from there to where the cart stands"
    assert spread[0] > 1.2 * spread[-1]


def test_every_post_has_a_tag_of_its_own_towards_the_path() -> None:
    row = grow_row("pepper", 5, 6)
    posts, tags = [part for part in row.parts if part.name == "post"], row.tags
    assert len(posts) == len(tags) == len({tag.number for tag in tags}) > 0
    assert [tag.number for tag in row.at([1.0, 0, 0]).tags] == [tag.number for tag in tags]
    for post, tag in zip(posts, tags, strict=True):
        assert tag.box.upper[0] == pytest.approx(post.box.lower[0])
        assert post.box.lower[1] < (tag.box.lower[1] + tag.box.upper[1]) / 2 < post.box.upper[1]


def test_a_cart_that_stands_is_refused() -> None:
    with pytest.raises(InputError, match="speed of the cart"):
        drive_past(grow_row("tomato", 5, 4), 1, speed=0.0)
