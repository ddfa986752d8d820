"""What perception does when something is wrong: a clear message, or a result with a stated warning, never a silently
wrong stem. One small simulated capture (8 views of 640 x 360) is spoiled in one way after another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from grown_plants import grown
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Box, small_transform
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud, fuse
from anther.perception.masks import PLANT, Masks, segment
from anther.perception.skeleton import Skeleton, skeletonize
from anther.perception.stem import Stem, find_stem
from anther.perception.stem.confidence import DOUBTFUL
from anther.pollination.grasp import Grasp, plan_grasps
from anther.sim.capture import CaptureTruth, capture_from_poses, orbit_poses
from anther.sim.plant import SimPlant
from anther.sim.render import Scene, d455

WORKSPACE = Box(np.array([0.32, -0.4, -0.48]), np.array([1.12, 0.4, 0.5]))
NEAR = 0.005


@dataclass(frozen=True)
class Seen:
    """What perception made of a capture."""

    cloud: Cloud
    skeleton: Skeleton
    stem: Stem
    grasps: list[Grasp]

    @property
    def notes(self) -> str:
        """All notes for the user."""
        return "\n".join((*self.cloud.notes, *self.skeleton.notes, *self.stem.notes))


@pytest.fixture(scope="module")
def plant() -> SimPlant:
    return grown("tomato", 11)


@pytest.fixture(scope="module")
def taken(plant: SimPlant) -> tuple[Capture, CaptureTruth]:
    poses = orbit_poses(8, (0.72, 0.0, -0.05), distance=0.6)
    return capture_from_poses(plant, poses, intrinsics=d455(640, 360), rng=np.random.default_rng(2))


@pytest.fixture(scope="module")
def capture(taken: tuple[Capture, CaptureTruth]) -> Capture:
    return taken[0]


@pytest.fixture(scope="module")
def masks(capture: Capture) -> Masks:
    return segment(capture, WORKSPACE)


def perceived(capture: Capture, masks: Masks | None = None, workspace: Box = WORKSPACE) -> Seen:
    cloud = fuse(capture, masks or segment(capture, workspace), workspace)
    skeleton = skeletonize(cloud)
    stem = find_stem(skeleton)
    return Seen(cloud, skeleton, stem, plan_grasps(stem, skeleton, cloud))


def right_share(plant: SimPlant, points: NDArray[Any], near: float = NEAR) -> float:
    """The share of points (n, 3) that lie within `near` [m] of the true stem's axis."""
    k = plant.stem_segments()
    t = np.linspace(0, 1, 30)[:, None, None]
    axis = (plant.start[k] + t * (plant.end[k] - plant.start[k])).reshape(-1, 3)
    return float((KDTree(axis).query(points)[0] <= near).mean())


def is_right(seen: Seen, plant: SimPlant) -> bool:
    return right_share(plant, seen.skeleton.nodes[seen.stem.node_ids]) >= 0.9


def grasp_is_right(seen: Seen, plant: SimPlant) -> bool:
    return right_share(plant, seen.grasps[0].point[None]) == 1


def test_without_a_fault_the_stem_is_right_sure_and_without_a_warning(
    capture: Capture, masks: Masks, plant: SimPlant
) -> None:
    seen = perceived(capture, masks)
    assert is_right(seen, plant)
    assert grasp_is_right(seen, plant)
    assert seen.stem.confidence is not None
    assert seen.stem.confidence >= DOUBTFUL
    assert seen.grasps[0].confidence is not None
    assert seen.grasps[0].confidence >= 0.9
    assert not any(word in seen.notes for word in ("view", "plant", "confidence"))


def test_empty_masks(capture: Capture, masks: Masks) -> None:
    with pytest.raises(StageFailure, match=r"0 pixels.*Check the masks") as failure:
        fuse(capture, Masks(masks.labels * 0, "x"), WORKSPACE)
    assert failure.value.kind == "no_plant_found"


def test_inverted_masks(capture: Capture, masks: Masks) -> None:
    inverted = Masks(np.where(masks.labels == 0, PLANT, 0).astype(np.uint8), "x")
    with pytest.raises(StageFailure, match="inverted") as failure:
        fuse(capture, inverted, WORKSPACE)
    assert failure.value.kind == "no_plant_found"


def test_one_view_with_a_wrong_pose_is_named(capture: Capture, masks: Masks, plant: SimPlant) -> None:
    poses = capture.T_world_cam.copy()
    poses[3] @= small_transform(np.zeros(3), [0.03, 0.0, 0.0])
    seen = perceived(replace(capture, T_world_cam=poses), masks)
    assert is_right(seen, plant)
    assert grasp_is_right(seen, plant)
    assert "view 3" in seen.notes


def test_half_the_views_missing(capture: Capture, masks: Masks, plant: SimPlant) -> None:
    assert capture.rgb is not None
    half = capture.select(list(range(4)))
    seen = perceived(half, Masks(masks.labels[:4], "x"))
    assert "from one side only, over 80 degrees" in seen.notes
    assert right_share(plant, seen.skeleton.nodes[seen.stem.node_ids], near=0.01) >= 0.95  # no more can be asked then


@pytest.mark.parametrize("reading", [0.0, 65.535])
def test_one_blind_depth_image_is_named(capture: Capture, plant: SimPlant, reading: float) -> None:
    depth = capture.depth.copy()
    depth[5] = reading
    seen = perceived(replace(capture, depth=depth))
    assert "view 5: the depth image is blind" in seen.notes
    assert is_right(seen, plant)


@pytest.mark.parametrize("reading", [0.0, 15.0])
def test_blind_depth_in_every_view(capture: Capture, reading: float) -> None:
    with pytest.raises(StageFailure, match="plant pixels") as failure:
        segment(replace(capture, depth=np.full_like(capture.depth, reading)), WORKSPACE)
    assert failure.value.kind == "no_plant_found"


@pytest.mark.parametrize("reading", [np.nan, np.inf])
def test_depth_that_is_no_number(capture: Capture, reading: float) -> None:
    depth = capture.depth.copy()
    depth[0] = reading
    with pytest.raises(InputError, match="NaN or infinite"):
        replace(capture, depth=depth)


def together(one: SimPlant, two: SimPlant) -> Scene:
    """Return the scene of both plants, each in its pot."""
    scene = Scene.of_plant(one)
    return Scene(
        np.vstack([scene.vertices, two.vertices]),
        np.vstack([scene.faces, two.faces + len(scene.vertices)]),
        np.concatenate([scene.face_organ, two.face_organ]),
        np.vstack([scene.vertex_color, two.vertex_color]),
    )


@pytest.mark.parametrize("apart", [0.18, pytest.param(0.36, marks=pytest.mark.slow)])
def test_two_plants_in_view(plant: SimPlant, apart: float) -> None:
    """Their leaves mingle at 0.18 m; at 0.36 m they hardly touch."""
    two = grown("tomato", 12, axis=(0.72, apart))
    both = together(plant, two)
    poses = orbit_poses(8, (0.72, apart / 2, -0.05), distance=0.7)
    capture, _ = capture_from_poses(both, poses, intrinsics=d455(640, 360), rng=np.random.default_rng(3))
    seen = perceived(capture)
    assert "2 stems in view" in seen.notes or "second" in seen.notes
    share = max(right_share(p, seen.skeleton.nodes[seen.stem.node_ids]) for p in (plant, two))
    assert share >= 0.9 or "confidence" in seen.notes


def test_a_leaf_that_touches_the_camera(capture: Capture, plant: SimPlant) -> None:
    assert capture.rgb is not None
    depth, rgb = capture.depth.copy(), capture.rgb.copy()
    v, u = np.mgrid[: depth.shape[1], : depth.shape[2]]
    blob = np.hypot(u - 200, v - 180) < 150
    depth[2][blob] = 0.08 + 0.02 * np.sin(u[blob] / 20)
    rgb[2][blob] = (50, 100, 40)
    seen = perceived(replace(capture, depth=depth, rgb=rgb))
    assert "view 2: something nearer than" in seen.notes
    assert is_right(seen, plant)
    assert grasp_is_right(seen, plant)


def moved_aside(shift: float) -> Box:
    aside = np.array([0.0, shift, 0.0])
    return Box(WORKSPACE.lower + aside, WORKSPACE.upper + aside)


def test_a_plant_at_the_edge_of_the_workspace_is_cut_and_said_to_be(capture: Capture, plant: SimPlant) -> None:
    seen = perceived(capture, workspace=moved_aside(0.36))
    assert "edge y = -0.04 m: the plant is cut off there" in seen.notes
    assert is_right(seen, plant)
    assert grasp_is_right(seen, plant)


def test_a_plant_whose_stem_is_outside_the_workspace(capture: Capture, plant: SimPlant) -> None:
    workspace = moved_aside(0.45)
    cloud = fuse(capture, segment(capture, workspace), workspace)
    skeleton = skeletonize(cloud)
    stem = find_stem(skeleton)
    assert right_share(plant, skeleton.nodes[stem.node_ids]) < 0.9
    notes = " ".join((*cloud.notes, *skeleton.notes, *stem.notes))
    assert "edge y = 0.05 m: the plant is cut off there" in notes
    assert "left out" in notes
    assert "main stem: confidence" in notes
    with pytest.raises(StageFailure, match="probably not the main stem"):
        plan_grasps(stem, skeleton, cloud)


@pytest.mark.parametrize("scale", [1000.0, 0.001])
def test_depth_in_other_units_is_refused(capture: Capture, scale: float) -> None:
    with pytest.raises(InputError, match=r"depth: got a median of.*metres"):
        replace(capture, depth=capture.depth * np.float32(scale))


def test_poses_in_millimetres_are_refused(capture: Capture) -> None:
    poses = capture.T_world_cam.copy()
    poses[:, :3, 3] *= 1000
    with pytest.raises(InputError, match=r"camera .* m from the world's origin.*metres"):
        replace(capture, T_world_cam=poses)


@pytest.mark.parametrize("scale", [1000.0, 0.001])
def test_a_cloud_in_other_units_is_refused(scale: float) -> None:
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (2000, 3)) * [0.02, 0.02, 1.5]
    with pytest.raises(InputError, match=r"plant size: got .*m or mm"):
        skeletonize(Cloud(points * scale))
