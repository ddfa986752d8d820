"""Skeleton, stem and flowers against the truth of simulated plants; the mesh is sampled, with noise, not rendered."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from anther.perception.cloud import Cloud
from anther.perception.flowers import find_flowers
from anther.perception.masks import FLOWER, PLANT
from anther.perception.skeleton import skeletonize
from anther.perception.stem import find_stem
from anther.sim.pepper import grow_pepper
from anther.sim.plant import Organ, SimPlant
from anther.sim.tomato import grow_tomato

PLANTS = {"tomato": grow_tomato, "pepper": grow_pepper}


def sampled(plant: SimPlant, noise: float = 0.0007, per_mm2: float = 0.25) -> Cloud:
    """Return points of the plant's surface (not of pot and soil), as dense as a fused capture."""
    rng = np.random.default_rng(0)
    faces = plant.faces[plant.face_organ <= Organ.FLOWER]
    organ = plant.face_organ[plant.face_organ <= Organ.FLOWER]
    a, b, c = (plant.vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    pick = rng.choice(len(faces), size=int(area.sum() * 1e6 * per_mm2), p=area / area.sum())
    u, v = np.sort(rng.uniform(0, 1, (2, len(pick))), axis=0)
    points = u[:, None] * a[pick] + (v - u)[:, None] * b[pick] + (1 - v)[:, None] * c[pick]
    labels = np.where(organ[pick] == Organ.FLOWER, FLOWER, PLANT).astype(np.uint8)
    return Cloud(points + rng.normal(0, noise, points.shape), labels=labels)


def axis_of(plant: SimPlant) -> tuple[np.ndarray, np.ndarray]:
    """Return points along the stem, and along what continues it above a fork, with their radii."""
    stem = np.isin(plant.organ, [Organ.STEM, Organ.BRANCH])
    t = np.linspace(0, 1, 20)[:, None, None]
    points = plant.start[stem] + t * (plant.end[stem] - plant.start[stem])
    radii = plant.radius_start[stem] + t[..., 0] * (plant.radius_end[stem] - plant.radius_start[stem])
    return points.reshape(-1, 3), radii.ravel()


@pytest.mark.parametrize("species", ["tomato", "pepper"])
def test_stem_radius_root_and_flowers_against_truth(species: str) -> None:
    plant = PLANTS[species](0)
    cloud = sampled(plant)
    skeleton = skeletonize(cloud)
    stem = find_stem(skeleton)
    points, radii = axis_of(plant)
    nodes = skeleton.nodes[stem.node_ids]
    away, nearest = KDTree(points).query(nodes)
    assert np.median(away) < 0.0015
    assert np.quantile(away, 0.95) < 0.005
    assert abs(np.median(skeleton.radius[stem.node_ids] / radii[nearest]) - 1) < 0.25
    assert abs(skeleton.nodes[0, 2] - plant.pot.soil_z) < 0.02
    assert nodes[-1, 2] - nodes[0, 2] > 0.7 * (points[:, 2].max() - plant.pot.soil_z)
    flowers = find_flowers(cloud, skeleton, stem)
    found = KDTree(flowers.positions).query(plant.flower_position)[0] < 0.015
    assert found.mean() >= 0.8
    assert len(flowers.positions) <= 1.2 * len(plant.flower_position)
