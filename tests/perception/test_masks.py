from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from alike import check_kept
from grown_plants import grown

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Box, Intrinsics, look_at, transform_points
from anther.perception.capture import Capture
from anther.perception.formats.kinect import read_kinect
from anther.perception.masks import BACKGROUND, FLOWER, PLANT, Masks, Params, segment
from anther.perception.masks._survey import ground_cells
from anther.sim.capture import CaptureTruth, capture_from_poses, orbit_poses
from anther.sim.plant import Organ
from anther.sim.render import d455

WORKSPACE = Box(np.array([0.32, -0.4, -0.48]), np.array([1.12, 0.4, 0.5]))


@cache
def seen(species: str) -> tuple[Capture, CaptureTruth, Masks]:
    plant = grown(species, 1)
    height = 0.05 if species == "tomato" else -0.1
    poses = orbit_poses(6, (0.72, 0, height), distance=0.6)
    capture, truth = capture_from_poses(plant, poses, intrinsics=d455(848, 480), rng=np.random.default_rng(1))
    return capture, truth, segment(capture, WORKSPACE)


@pytest.mark.parametrize("species", ["tomato", "pepper"])
def test_plant_is_found_and_pot_is_not(species: str) -> None:
    capture, truth, masks = seen(species)
    plant, found, measured = truth.organ <= Organ.FLOWER, masks.labels != BACKGROUND, capture.depth > 0
    both, either = (plant & found & measured).sum(), ((plant | found) & measured).sum()
    assert both / either > 0.82  # a pixel is 1.4 mm wide here; see docs/reports/masks.md for full resolution
    leaked = found & measured & np.isin(truth.organ, [Organ.POT, Organ.SOIL])
    assert leaked.sum() < 0.005 * (found & measured).sum()
    assert masks.source == "colour and geometry"


@pytest.mark.parametrize("species", ["tomato", "pepper"])
def test_flower_labels_lie_on_flowers(species: str) -> None:
    _, truth, masks = seen(species)
    flower = masks.labels == FLOWER
    assert flower.any()
    assert (truth.organ[flower] == Organ.FLOWER).mean() > 0.5
    leaf = truth.organ == Organ.LEAF
    assert (masks.labels[leaf] == FLOWER).mean() < 0.002


def test_white_balance_and_exposure_do_not_matter_much() -> None:
    capture, truth, masks = seen("tomato")
    assert capture.rgb is not None
    warm = np.clip(capture.rgb * np.array([1.0, 0.85, 0.7]) * 0.8, 0, 255).astype(np.uint8)
    changed = segment(Capture(capture.depth, capture.intrinsics, capture.T_world_cam, warm), WORKSPACE)
    plant, measured = truth.organ <= Organ.FLOWER, capture.depth > 0
    scores = []
    for m in (masks, changed):
        found = m.labels != BACKGROUND
        scores.append((plant & found & measured).sum() / ((plant | found) & measured).sum())
    assert scores[1] > scores[0] - 0.05


def test_geometry_alone_finds_the_plant() -> None:
    capture, truth, _ = seen("pepper")
    masks = segment(Capture(capture.depth, capture.intrinsics, capture.T_world_cam), WORKSPACE)
    plant, found, measured = truth.organ <= Organ.FLOWER, masks.labels == PLANT, capture.depth > 0
    assert (plant & found & measured).sum() / (plant & measured).sum() > 0.85
    assert (truth.organ[found] <= Organ.FLOWER).mean() > 0.75
    assert masks.source == "geometry"
    assert not (masks.labels == FLOWER).any()


def test_the_workspace_is_estimated_when_it_is_not_given() -> None:
    capture, truth, _ = seen("pepper")
    masks = segment(capture)
    plant = (truth.organ <= Organ.FLOWER) & (capture.depth > 0)
    assert (masks.labels[plant] != BACKGROUND).mean() > 0.85


def test_real_sorghum_without_colour(data: Path) -> None:
    capture = read_kinect(data / "captures" / "sorghum_kinect")
    masks = segment(capture)
    world = np.concatenate(
        [
            transform_points(T, capture.intrinsics.back_project(d, m > 0))
            for T, d, m in zip(capture.T_world_cam, capture.depth, masks.labels, strict=True)
        ]
    )
    # By eye: soil at -0.455 m, the pot's rim at -0.43 m, leaves up to 0.2 m; bench at -0.72 m.
    assert (world[:, 2] > -0.46).mean() > 0.97
    assert np.percentile(world[:, 2], 99) == pytest.approx(0.15, abs=0.05)
    assert np.ptp(np.percentile(world[:, 0], [1, 99])) > 0.6


def test_brown_stem_and_hidden_soil() -> None:
    """A green ball on a thin brown stem in a brown pot: the stem is plant, pot and bench are not."""
    capture, kind = painted_scene()
    masks = segment(capture, Box(np.array([-0.3, -0.3, 0.0]), np.array([0.3, 0.3, 0.6])))
    found = masks.labels != BACKGROUND
    assert found[kind == 1].mean() > 0.9  # crown
    assert found[kind == 2].mean() > 0.7  # brown stem
    assert found[kind == 3].mean() < 0.01  # pot and soil
    assert found[kind == 4].mean() < 0.01  # bench


def painted_scene() -> tuple[Capture, np.ndarray]:
    """Ray-cast by hand: crown (sphere), stem (thin cylinder), pot (cylinder with lid) and bench (plane)."""
    camera = Intrinsics(320, 240, 240.0, 240.0, 159.5, 119.5)
    colours = np.array([[200, 205, 210], [50, 120, 40], [110, 85, 55], [120, 80, 55], [150, 150, 150]])
    poses = np.stack([look_at([0.6 * np.cos(a), 0.6 * np.sin(a), 0.45], [0, 0, 0.2]) for a in np.linspace(0, 5, 6)])
    depth, kind = np.zeros((6, 240, 320), np.float32), np.zeros((6, 240, 320), np.uint8)
    for v, T in enumerate(poses):
        ray = camera.rays() @ T[:3, :3].T
        eye = T[:3, 3]
        hits = [
            (sphere(eye, ray, np.array([0, 0, 0.38]), 0.07), 1),
            (cylinder(eye, ray, 0.004, 0.15, 0.36), 2),
            (cylinder(eye, ray, 0.08, 0.0, 0.17), 3),
            (plane(eye, ray, 0.15, 0.08), 3),
            (plane(eye, ray, 0.002, 9.0), 4),
        ]
        nearest = np.full(depth.shape[1:], 5.0)
        for z, what in hits:
            closer = z < nearest
            nearest[closer], kind[v][closer] = z[closer], what
        depth[v] = np.where(kind[v] > 0, nearest, 0)
    return Capture(depth, camera, poses, colours[kind].astype(np.uint8)), kind


def sphere(eye: np.ndarray, ray: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    a, b = (ray**2).sum(-1), ray @ (eye - centre)
    root = b**2 - a * ((eye - centre) @ (eye - centre) - radius**2)
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)


def cylinder(eye: np.ndarray, ray: np.ndarray, radius: float, low: float, high: float) -> np.ndarray:
    a, b = (ray[..., :2] ** 2).sum(-1), ray[..., :2] @ eye[:2]
    root = b**2 - a * (eye[:2] @ eye[:2] - radius**2)
    z = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    height = eye[2] + np.where(np.isfinite(z), z, 0) * ray[..., 2]
    return np.where((height > low) & (height < high), z, np.inf)


def plane(eye: np.ndarray, ray: np.ndarray, height: float, radius: float) -> np.ndarray:
    z = np.where(ray[..., 2] < -1e-6, (height - eye[2]) / np.minimum(ray[..., 2], -1e-6), np.inf)
    hit = eye[:2] + np.where(np.isfinite(z), z, 0)[..., None] * ray[..., :2]
    return np.where(np.linalg.norm(hit, axis=-1) < radius, z, np.inf)


def test_ground_is_what_lies_below_a_wide_surface() -> None:
    solid = np.zeros((60, 60, 60), dtype=bool)
    x, y = np.meshgrid(np.arange(60) - 30, np.arange(60) - 30, indexing="ij")
    solid[np.hypot(x, y) > 15, 4] = True  # bench, hidden under the pot
    solid[np.hypot(x, y) < 14, 25] = True  # soil
    solid[30, 30, 26:50] = True  # stem
    below, rim = ground_cells(solid, solid, 0.005, radius=0.035, sure_radius=0.035, rings=True)
    assert below[30, 30, 26]
    assert not below[30, 30, 28:].any()
    assert not rim[30, 30].any()
    assert rim[30, 16, 20]
    assert not below[2, 2, 8:].any()


def test_a_leaf_over_the_bench_is_not_ground() -> None:
    solid = np.zeros((60, 60, 60), dtype=bool)
    solid[:, :, 4] = True
    solid[20:40, 20:40, 30] = True
    below, _ = ground_cells(solid, solid, 0.005, radius=0.035, sure_radius=0.035, rings=False)
    assert not below[:, :, 8:].any()


def test_what_a_plant_hangs_below_is_not_ground() -> None:
    """A spool on the wire of a row, and the stem that hangs from it."""
    spool, seen = np.zeros((2, 60, 60, 60), dtype=bool)
    spool[20:40, 18:42, 50:54] = True
    seen[20:40, 18:42:2, 20:30] = True  # leaves
    seen[30, 30, :50] = True  # stem
    for plant in (seen, seen & False):
        below, _ = ground_cells(spool, spool | plant, 0.005, radius=0.035, sure_radius=0.035, rings=True)
        assert below[30, 30, 25] == (not plant.any())


def test_a_pot_whose_soil_is_hidden_is_found_by_its_wall() -> None:
    x, y = np.meshgrid(np.arange(60) - 30, np.arange(60) - 30, indexing="ij")
    wall = np.abs(np.hypot(x, y) - 15) < 1
    solid = np.zeros((60, 60, 60), dtype=bool)
    solid[wall, 2:30] = True
    settings = {"radius": 0.035, "sure_radius": 0.035}
    assert ground_cells(solid, solid, 0.005, rings=True, **settings)[0][30, 30, 20]
    assert not ground_cells(solid, solid, 0.005, rings=False, **settings)[0][30, 30, 20]


def empty_view(rgb: bool = True) -> Capture:
    camera = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)
    pose = look_at([0.8, 0, 0.2], [0, 0, 0])[None]
    grey = np.full((1, 48, 64, 3), 128, np.uint8) if rgb else None
    return Capture(np.full((1, 48, 64), 0.8, np.float32), camera, pose, grey)


def test_views_without_a_plant_are_a_failure_of_its_own_kind() -> None:
    with pytest.raises(StageFailure, match="plant pixels") as failure:
        segment(empty_view(), WORKSPACE)
    assert failure.value.kind == "no_plant_found"


def test_a_workspace_nobody_looks_at_is_a_failure_of_its_own_kind() -> None:
    with pytest.raises(StageFailure) as failure:
        segment(empty_view(rgb=False), Box(np.full(3, 5.0), np.full(3, 6.0)))
    assert failure.value.kind == "no_plant_found"


@pytest.mark.parametrize("change", [{"green": 2}, {"ground_radius": 1e-4}])
def test_impossible_parameters_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError):
        Params(**change)  # type: ignore[arg-type]


def test_round_trip(tmp_path: Path) -> None:
    check_kept(Masks(np.arange(24, dtype=np.uint8).reshape(2, 3, 4) % 3, "by hand"), tmp_path / "masks.npz")
