"""The renderer against analytic scenes, and flowers where the truth says they are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from grown_plants import grown

from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, inverse, look_at, transform_points
from anther.sim.plant import Organ
from anther.sim.render import Scene, d455

SMALL = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
LEVEL = look_at([0, 0, 0], [1, 0, 0])
"""At the origin, looking along world x."""


def scene_of(vertices: np.ndarray, faces: np.ndarray, organ: Organ = Organ.POT) -> Scene:
    colour = np.full((len(vertices), 3), 128, dtype=np.uint8)
    return Scene(vertices, faces, np.full(len(faces), organ), colour)


def wall(x: float) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, -9, -9], [x, 9, -9], [x, 9, 9], [x, -9, 9]], dtype=float)
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def test_depth_of_a_wall_is_the_same_in_every_pixel() -> None:
    image = scene_of(*wall(0.8)).render(SMALL, LEVEL)
    np.testing.assert_allclose(image.depth, 0.8, rtol=1e-6)
    assert np.all(image.organ == Organ.POT)
    assert np.all(image.organ != Organ.NOTHING)


@pytest.mark.parametrize("to", [0.1, 0.25])
def test_what_stands_still_is_cast_apart_and_looks_alike(to: float) -> None:
    """A leaf before and behind a wall, which it shades: as in a scene of which all may move."""
    leaf, (far, faces) = np.array([[0.2, -0.1, -0.1], [0.2, 0.1, -0.1], [0.2, 0, 0.1]]), wall(0.22)
    vertices, faces = np.vstack([leaf, far]), np.vstack([[[0, 1, 2]], faces + 3])
    organ, colour = np.array([Organ.LEAF, Organ.POT, Organ.POT]), np.full((7, 3), 128, np.uint8)
    whole, apart = (
        Scene(vertices, faces, organ, colour, moving=moving).moved(leaf + np.array([to - 0.2, 0, 0.02]))
        for moving in (None, 3)
    )
    images = [scene.render(SMALL, LEVEL) for scene in (whole, apart)]
    for name in ("rgb", "depth", "organ"):
        np.testing.assert_array_equal(*(getattr(image, name) for image in images))
    assert np.any(images[0].organ == Organ.LEAF) == (to < 0.22)
    np.testing.assert_array_equal(*(scene.visible(leaf, [0, 0, 0]) for scene in (whole, apart)))
    still = apart.still(SMALL, LEVEL)
    assert not still.shown.all()
    assert still.shown[0].any() == (to < 0.22)


def test_depth_of_a_slanted_plane_is_analytic() -> None:
    corners, faces = wall(0.8)
    corners[:, 0] += 0.5 * corners[:, 1] * 0.05
    image = scene_of(corners, faces).render(SMALL, LEVEL)
    ray_y = -SMALL.rays()[..., 0]  # camera x points along world -y
    np.testing.assert_allclose(image.depth, 0.8 / (1 - 0.025 * ray_y), rtol=1e-5)


def test_depth_of_a_sphere_is_analytic() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    image = scene_of(ball.vertices + np.array([0.5, 0, 0]), ball.faces).render(SMALL, LEVEL)
    ray = SMALL.rays()
    a, b, c = (ray**2).sum(axis=2), -2 * 0.5 * ray[..., 2], 0.5**2 - 0.1**2
    root = b**2 - 4 * a * c
    inside = root > 0.01
    z = (-b - np.sqrt(np.maximum(root, 0))) / (2 * a)
    assert inside.sum() > 1000
    np.testing.assert_allclose(image.depth[inside], z[inside], atol=2e-4)
    assert np.all(image.depth[root < -1e-3] == 0)
    assert np.all(image.organ[root < -1e-3] == Organ.NOTHING)


def test_back_projected_depth_lies_on_the_wall_from_anywhere() -> None:
    T = look_at([0.2, 0.5, 0.4], [0.9, 0.1, 0.0])
    image = scene_of(*wall(0.8)).render(SMALL, T)
    world = transform_points(T, SMALL.back_project(image.depth))
    np.testing.assert_allclose(world[:, 0], 0.8, atol=1e-5)


def test_shadow_falls_away_from_the_sun() -> None:
    corners = np.array([[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], dtype=float)
    ground = (corners, np.array([[0, 1, 2], [0, 2, 3]]))
    lid = (corners * 0.05 + [0, 0, 0.3], ground[1])
    vertices, faces = np.vstack([ground[0], lid[0]]), np.vstack([ground[1], lid[1] + 4])
    T = look_at([0.0, 0.01, 1.5], [0, 0, 0])
    image = scene_of(vertices, faces).render(SMALL, T)
    ground_seen = image.depth > 1.4
    level = image.rgb[..., 1].astype(float)
    dark = ground_seen & (level < level[ground_seen].max() - 20)
    assert 20 < dark.sum() < 0.1 * ground_seen.sum()
    shade = transform_points(T, SMALL.back_project(image.depth, dark)).mean(axis=0)
    assert shade[0] > 0.1
    assert shade[1] > 0.08


def test_nothing_is_seen_past_the_last_surface() -> None:
    image = scene_of(*wall(0.8)).render(SMALL, look_at([0, 0, 0], [-1, 0, 0]))
    assert image.depth.max() == 0
    assert np.all(image.organ == Organ.NOTHING)
    assert image.rgb.min() > 100


def test_moved_scene_moves_the_plant_only() -> None:
    plant = grown("tomato", 0)
    scene = Scene.of_plant(plant)
    T = look_at([0.0, 0, 0.1], [0.72, 0, 0.0])
    before = scene.render(SMALL, T)
    shift = np.where(plant.vertex_segment[:, None] >= 0, [0.05, 0, 0], 0.0)
    after = scene.moved(plant.vertices + shift).render(SMALL, T)
    pot = (before.organ == Organ.POT) & (after.organ == Organ.POT)
    np.testing.assert_allclose(after.depth[pot], before.depth[pot], atol=1e-6)
    stem = (before.organ == Organ.STEM) & (after.organ == Organ.STEM)
    assert stem.sum() > 20
    assert np.median(after.depth[stem] - before.depth[stem]) == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize(("species", "seed"), [("tomato", 0), ("tomato", 3), ("pepper", 2)])
def test_flowers_are_seen_where_the_truth_has_them(species: str, seed: int) -> None:
    plant = grown(species, seed)
    scene, camera = Scene.of_plant(plant), d455(848, 480)
    seen = 0
    for azimuth in np.radians([90, 180, 270]):
        target = plant.flower_position.mean(axis=0)
        T = look_at(target + 0.45 * np.array([np.cos(azimuth), np.sin(azimuth), -0.1]), target)
        image = scene.render(camera, T)
        cam = transform_points(inverse(T), plant.flower_position)
        for (u, v), z in zip(np.round(camera.project(cam)).astype(int), cam[:, 2], strict=True):
            around = np.s_[v - 3 : v + 4, u - 3 : u + 4]
            if abs(np.median(image.depth[around]) - z) < 0.012:
                seen += 1
                assert (image.organ[around] == Organ.FLOWER).any()
    assert seen >= 3


def test_visible_says_what_stands_in_between() -> None:
    scene = scene_of(*wall(0.5))
    points = np.array([[0.4, 0, 0], [0.6, 0, 0], [0.5, 0.1, 0]])
    np.testing.assert_array_equal(scene.visible(points, np.zeros(3)), [True, False, True])


def test_organs_have_believable_colours() -> None:
    plant = grown("tomato", 1)
    target = np.array([0.72, 0, 0.0])
    image = Scene.of_plant(plant).render(d455(640, 360), look_at(target + np.array([-0.7, 0, 0.1]), target))
    leaf = image.rgb[image.organ == Organ.LEAF].astype(int)
    assert (leaf[:, 1] > leaf[:, 0]).mean() > 0.95
    assert (leaf[:, 1] > leaf[:, 2]).mean() > 0.99
    flower = image.rgb[image.organ == Organ.FLOWER].astype(int)
    assert (np.minimum(flower[:, 0], flower[:, 1]) > flower[:, 2] + 40).mean() > 0.5


def test_d455_focal_length_scales_with_the_image() -> None:
    assert d455().fx == 640
    assert d455(848, 480).fx == pytest.approx(424)
    assert d455(848, 480).cx == pytest.approx(423.5)


def test_a_skewed_pose_is_refused() -> None:
    with pytest.raises(InputError, match="rigid"):
        scene_of(*wall(1.0)).render(SMALL, np.diag([1, 2, 1, 1.0]))
