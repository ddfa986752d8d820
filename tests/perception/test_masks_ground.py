"""Pot, soil and bench removed from masks that bleed, whatever made them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import test_masks

from anther.core.errors import InputError
from anther.core.geometry import Box
from anther.perception.capture import Capture
from anther.perception.masks import Masks, without_ground
from anther.perception.masks._survey import foot_cells
from anther.sim.capture import CaptureTruth
from anther.sim.plant import SOIL_Z, Organ

WORKSPACE = Box(np.array([0.32, -0.4, -0.48]), np.array([1.12, 0.4, 0.5]))


def seen() -> tuple[Capture, CaptureTruth]:
    capture, truth, _ = test_masks.seen("pepper")
    return capture, truth


def bleeding(kind: str, truth: CaptureTruth) -> Masks:
    plant = truth.organ <= Organ.FLOWER
    if kind == "wide":
        labels = np.stack([cv2.dilate(view.astype(np.uint8), np.ones((17, 17), np.uint8)) for view in plant])
    else:
        labels = (plant | np.isin(truth.organ, [Organ.POT, Organ.SOIL])).astype(np.uint8)
    return Masks(labels, kind)


@pytest.mark.parametrize("kind", ["pot", "wide"])
@pytest.mark.parametrize("colour", [True, False])
def test_pot_and_soil_go_and_the_plant_stays(kind: str, colour: bool) -> None:
    capture, truth = seen()
    bare = capture if colour else Capture(capture.depth, capture.intrinsics, capture.T_world_cam)
    freed = without_ground(bleeding(kind, truth), bare, WORKSPACE)
    kept, measured = freed.labels > 0, capture.depth > 0
    assert freed.source == kind
    pot = np.isin(truth.organ, [Organ.POT, Organ.SOIL])
    right = np.abs(capture.depth - truth.depth) < 0.01  # elsewhere the sensor puts plant before the pot
    assert (pot & kept & measured & right).sum() < 0.005 * (kept & measured).sum()
    plant = (truth.organ <= Organ.FLOWER) & measured
    assert kept[plant].mean() > (0.95 if colour else 0.85)


def test_the_foot_of_the_stem_stays() -> None:
    capture, truth = seen()
    freed = without_ground(bleeding("pot", truth), capture, WORKSPACE)
    stem = (truth.organ == Organ.STEM) & (capture.depth > 0)
    height = np.full(stem.shape, np.inf)
    for view in range(capture.views):
        rays = capture.intrinsics.rays() @ truth.T_world_cam[view, :3, :3].T
        height[view] = truth.T_world_cam[view, 2, 3] + truth.depth[view] * rays[..., 2] - SOIL_Z
    foot = stem & (height > 0.006) & (height < 0.02)
    assert foot.sum() > 50
    assert (freed.labels[foot] > 0).mean() > 0.7


def test_only_background_is_added() -> None:
    capture, truth = seen()
    before = bleeding("pot", truth)
    after = without_ground(before, capture, WORKSPACE)
    changed = after.labels != before.labels
    assert changed.any()
    assert not after.labels[changed].any()


def test_masks_of_other_views_are_refused() -> None:
    capture, truth = seen()
    with pytest.raises(InputError, match="mask labels"):
        without_ground(Masks(bleeding("pot", truth).labels[:3], "three views"), capture, WORKSPACE)


def test_a_stem_is_carried_on_down_and_a_wide_leaf_is_not() -> None:
    below, plant = np.zeros((40, 40, 20), dtype=bool), np.zeros((40, 40, 20), dtype=bool)
    below[:, :, :8] = True
    plant[10:12, 10:12, 8:15] = True  # stem
    plant[20:35, 20:35, 8] = True  # leaf on the soil
    foot = foot_cells(plant, below, 0.005)
    assert foot[10:12, 10:12, 6:8].all()
    assert foot.sum() == 8
