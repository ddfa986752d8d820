"""Flowers: clusters of flower points of a flower's size, each on a plausible node."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from alike import check_kept

from anther.core.choices import Crop
from anther.perception.cloud import Cloud
from anther.perception.flowers import PEDICEL, assume_flowers, find_flowers, flower_centres
from anther.perception.hanging import StringLine
from anther.perception.masks import FLOWER, PLANT
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, TRUSS, Stem, find_stem

Z = np.linspace(0, 0.5, 51)
SKELETON = Skeleton(
    np.concatenate([np.c_[0 * Z, 0 * Z, Z], [[0.02, 0, 0.4], [0.04, 0, 0.4]]]),
    np.r_[np.arange(-1, 50), 40, 51],
    np.full(53, 0.003),
)
STEM: Stem = find_stem(SKELETON)


def flower(centre: list[float], size: float = 0.018, count: int = 800, seed: int = 0) -> np.ndarray:
    shell = np.random.default_rng(seed).normal(size=(count, 3))
    return np.array(centre) + size / 2 * shell / np.linalg.norm(shell, axis=1)[:, None]


def cloud_of(*flowers: np.ndarray) -> Cloud:
    plant = np.c_[0 * Z, 0 * Z, Z]
    labels = np.r_[np.full(len(Z), PLANT), np.full(sum(map(len, flowers)), FLOWER)].astype(np.uint8)
    return Cloud(np.concatenate([plant, *flowers]), labels=labels)


@pytest.mark.parametrize("size", [0.008, 0.018, 0.028])
def test_each_flower_is_found_once(size: float) -> None:
    centres = [[0.05, 0, 0.4], [-0.03, 0, 0.2], [0.05, 0.04, 0.41]]
    found = find_flowers(cloud_of(*(flower(c, size) for c in centres)), SKELETON, STEM)
    assert len(found.positions) == 3
    for c in centres:
        assert np.linalg.norm(found.positions - c, axis=1).min() < 0.002


def test_touching_flowers_are_told_apart() -> None:
    found = find_flowers(cloud_of(flower([0.05, 0, 0.4]), flower([0.07, 0, 0.4])), SKELETON, STEM)
    assert len(found.positions) == 2


def test_small_flowers_joined_by_specks_are_told_apart() -> None:
    specks = np.array([0.05, 0, 0.4]) + np.outer(np.arange(0, 0.036, 0.003), [1, 0, 0])
    small = [flower([0.05, 0, 0.4], 0.005), flower([0.086, 0, 0.4], 0.005)]
    assert len(flower_centres(cloud_of(*small, specks))) == 2


def test_a_clip_on_the_stem_is_no_flower_and_a_flower_that_touches_it_is_one() -> None:
    """A clip reaches as far off the stem as twine and a camera's error are thick, a flower as far as it is wide."""
    turn, up = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0.19, 0.21, 14))
    ring = 0.007 * np.stack([np.cos(turn), np.sin(turn), 0 * up], axis=2) + np.stack([0 * up, 0 * up, up], axis=2)
    clip = ring[np.cos(turn) > -0.3]  # as it is seen from one side
    touching = flower([0.003 + 0.005, 0, 0.35], 0.010)
    found = find_flowers(cloud_of(clip, touching), SKELETON, STEM)
    assert len(flower_centres(cloud_of(clip, touching))) == 2
    np.testing.assert_allclose(found.positions, [[0.008, 0, 0.35]], atol=0.002)
    assert any("a clip or a string" in note for note in found.notes)


def test_a_flower_hangs_on_the_nearest_node() -> None:
    found = find_flowers(cloud_of(flower([0.05, 0, 0.4]), flower([-0.03, 0, 0.2])), SKELETON, STEM)
    by_x = found.attachment[np.argsort(found.positions[:, 0])]
    assert list(by_x) == [20, 52]


def test_a_blade_is_less_likely_to_carry_a_flower() -> None:
    width = np.full(53, 0.003)
    width[52] = 0.02
    flatness = np.where(width > 0.01, 1.0, 0.0)
    leafy = Skeleton(SKELETON.nodes, SKELETON.parent, SKELETON.radius, width=width, flatness=flatness)
    found = find_flowers(cloud_of(flower([0.031, 0, 0.4])), leafy, find_stem(leafy))
    assert list(found.attachment) == [51]


def test_a_pedicel_in_the_skeleton_does_not_carry_its_flower_itself() -> None:
    cloud = cloud_of(flower([0.02, 0, 0.395], size=0.01))
    stalk = Skeleton(
        np.concatenate([np.c_[0 * Z, 0 * Z, Z], [[0.008, 0, 0.4], [0.015, 0, 0.399]]]),
        np.r_[np.arange(-1, 50), 40, 51],
        np.full(53, 0.003),
    )
    stem = find_stem(stalk, flowers_at=flower_centres(cloud))
    assert list(stem.organ[51:]) == [TRUSS, TRUSS]
    assert list(find_flowers(cloud, stalk, stem).attachment) == [40]


def test_centres_are_those_of_the_flowers() -> None:
    centre = [0.05, 0, 0.4]
    assert flower_centres(cloud_of(flower(centre))) == pytest.approx(np.array([centre]), abs=0.002)
    assert flower_centres(cloud_of()).shape == (0, 3)


def test_specks_and_far_clusters_are_left_out() -> None:
    found = find_flowers(cloud_of(flower([0.05, 0, 0.4], size=0.001), flower([0.5, 0, 0.4])), SKELETON, STEM)
    assert len(found.positions) == 0
    assert any("too far" in note for note in found.notes)


def test_no_flower_is_a_valid_result() -> None:
    found = find_flowers(cloud_of(), SKELETON, STEM)
    assert found.positions.shape == (0, 3)
    assert "no flowers" in found.notes[0]


def test_save_and_load(tmp_path) -> None:
    check_kept(find_flowers(cloud_of(flower([0.05, 0, 0.4])), SKELETON, STEM), tmp_path / "flowers.npz")


def test_flowers_nobody_saw_are_supposed_at_the_ends_of_trusses_or_branches_or_else_the_stem() -> None:
    side = np.array([*[0] * 51, BRANCH, BRANCH], dtype=np.uint8)
    for organ, carrier in ((np.where(side, TRUSS, side), 52), (side, 52), (0 * side, 50)):
        plant = Stem(STEM.node_ids, STEM.arc_length, STEM.attachments, organ.astype(np.uint8))
        found = assume_flowers(SKELETON, plant)
        assert found.attachment.tolist() == [carrier]
        assert np.linalg.norm(found.positions[0] - SKELETON.nodes[carrier]) == pytest.approx(PEDICEL)
        assert "no flower was detected" in found.notes[0]


def test_a_flower_nearer_to_another_string_is_of_the_stem_that_hangs_there() -> None:
    beside = StringLine((0.13, 0.0, 1.0), (0.13, 0.0, 0.0))
    string = StringLine((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (beside,))
    cloud = cloud_of(flower([0.06, 0, 0.4]), flower([0.09, 0, 0.4]))
    assert len(find_flowers(cloud, SKELETON, STEM).positions) == 2
    found = find_flowers(cloud, SKELETON, STEM, string=string)
    assert found.positions[:, 0] == pytest.approx([0.06], abs=0.002)
    assert "nearer to another string" in found.notes[0]


def test_what_is_not_yellow_is_no_flower_of_a_tomato_that_has_yellow_ones() -> None:
    petals, clip = flower([0.05, 0, 0.4]), flower([-0.03, 0, 0.2])
    cloud = cloud_of(petals, clip)

    def seen(colour: tuple[int, int, int], crop: Crop | None) -> int:
        colors = np.full((len(cloud.points), 3), (40, 90, 30), np.uint8)
        colors[-len(petals) - len(clip) : -len(clip)], colors[-len(clip) :] = colour, (130, 140, 138)
        return len(find_flowers(replace(cloud, colors=colors), SKELETON, STEM, crop=crop).positions)

    assert (seen((170, 155, 60), "tomato"), seen((170, 155, 60), "pepper"), seen((170, 155, 60), None)) == (1, 2, 2)
    assert seen((150, 160, 158), "tomato") == 2, "a light in which no flower is yellow"
