"""Blades: sheets of known width and area, flat and bent, turned, scaled, thinned, noisy, half seen; plants."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.perception.blades import UNSEEN, Blade, measure_blade, measure_blades, together
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER
from anther.perception.skeleton import Skeleton, skeletonize
from anther.perception.stem import LEAF, STEM, Stem, find_stem
from anther.perception.traits import Traits, measure
from tests.support.made_plants import simple_plant, tube

LENGTH, WIDTH = 0.15, 0.04
AREAS = {"rectangle": LENGTH * WIDTH, "ellipse": np.pi / 4 * LENGTH * WIDTH}
STRAIGHT = 1e6


def sheet(
    shape: str, count: int = 2000, *, bend: float = STRAIGHT, curl: float = STRAIGHT, noise: float = 0.0
) -> tuple[Array, Array]:
    """Return points and midrib of a blade, rolled along its length with radius `bend`, or across with `curl` [m]."""
    rng = np.random.default_rng(0)
    s, u = rng.uniform(0, LENGTH, 4 * count), rng.uniform(-WIDTH / 2, WIDTH / 2, 4 * count)
    half = WIDTH / 2 * (np.sqrt(1 - (2 * s / LENGTH - 1) ** 2) if shape == "ellipse" else np.ones_like(s))
    s, u = (values[np.abs(u) < half][:count] for values in (s, u))

    def place(s: Array, u: Array) -> Array:
        rise = 2 * curl * np.sin(u / curl / 2) ** 2
        return np.stack(
            [bend * np.sin(s / bend), curl * np.sin(u / curl), rise - 2 * bend * np.sin(s / bend / 2) ** 2], 1
        )

    rib = np.linspace(0, LENGTH, 16)
    points = place(s, u)
    return points + rng.normal(0, noise, points.shape), place(rib, 0 * rib)


@pytest.mark.parametrize("shape", AREAS)
@pytest.mark.parametrize("noise", [0.0, 0.0005])
@pytest.mark.parametrize(
    "rolled",
    [{}, {"bend": 0.08}, {"bend": 0.05}, {"curl": 0.03}],  # by 107 and 172 degrees along, 76 across
    ids=["flat", "drooping", "rolled", "curled"],
)
def test_width_and_area_are_those_of_the_surface(shape: str, rolled: dict[str, float], noise: float) -> None:
    found = measure_blade(*sheet(shape, noise=noise, **rolled))
    assert found.area_m2 == pytest.approx(AREAS[shape], rel=0.03)
    assert found.width_m == pytest.approx(WIDTH, rel=0.05)
    assert found.coverage > 0.95


@pytest.mark.parametrize("shape", AREAS)
@pytest.mark.parametrize("count", [250, 500, 1000, 8000])
def test_fewer_points_give_the_same(shape: str, count: int) -> None:
    found = measure_blade(*sheet(shape, count, bend=0.1))
    assert found.area_m2 == pytest.approx(AREAS[shape], rel=0.06)
    assert found.width_m == pytest.approx(WIDTH, rel=0.08)
    assert found.coverage > 0.9


@given(st.integers(0, 1000), st.floats(0.2, 5))
def test_turning_changes_nothing_and_scale_what_it_must(seed: int, scale: float) -> None:
    points, midrib = sheet("ellipse", bend=0.1, noise=0.0003)
    turn, still = Rotation.random(rng=np.random.default_rng(seed)), measure_blade(points, midrib)
    moved = measure_blade(scale * turn.apply(points) + 1, scale * turn.apply(midrib) + 1)
    assert moved.width_m == pytest.approx(scale * still.width_m, rel=1e-3)
    assert moved.area_m2 == pytest.approx(scale**2 * still.area_m2, rel=1e-3)
    assert moved.coverage == pytest.approx(still.coverage, abs=0.03)


def test_strays_do_not_widen_a_blade() -> None:
    points, midrib = sheet("rectangle")
    stray = points[::100] * [1, 4, 1] + [0, 0, 0.01]  # 1 %
    found = measure_blade(np.concatenate([points, stray]), midrib)
    assert found.area_m2 == pytest.approx(AREAS["rectangle"], rel=0.06)


def test_a_blade_seen_on_one_side_of_its_midrib_is_half_covered() -> None:
    points, midrib = sheet("rectangle")
    found = measure_blade(points[points[:, 1] > 0], midrib)
    assert found.area_m2 == pytest.approx(AREAS["rectangle"] / 2, rel=0.05)
    assert found.coverage == pytest.approx(0.5, abs=0.05)


def test_a_hole_counts_as_area_and_not_as_covered() -> None:
    points, midrib = sheet("rectangle", 4000)
    hole = (np.abs(points[:, 0] - LENGTH / 2) < LENGTH / 6) & (np.abs(points[:, 1]) < 0.45 * WIDTH)  # 30 %
    gap = np.abs(points[:, 0] - LENGTH / 2) < LENGTH / 6
    for missing, share in ((hole, 0.7), (gap, 2 / 3)):
        found = measure_blade(points[~missing], midrib)
        assert found.area_m2 == pytest.approx(AREAS["rectangle"], rel=0.05)
        assert found.coverage == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        sheet("rectangle", 150)[0],
        np.tile(sheet("rectangle", 150)[0], (10, 1)),
        sheet("rectangle")[0] * [1, 0, 0],
        sheet("rectangle")[0] * [0, 1, 1],
    ],
    ids=["none", "few", "repeated", "along a line", "across alone"],
)
def test_what_is_too_thinly_seen_is_not_measured(points: Array) -> None:
    assert np.isnan(measure_blade(points, sheet("rectangle")[1])).all()


def test_together() -> None:
    assert np.isnan(together([])).all()
    assert together([Blade(0.01, 1.0, 0.5), UNSEEN, Blade(0.03, 3.0, 0.9)]) == pytest.approx((0.03, 4.0, 0.8))


def traits_of(points: Array) -> Traits:
    cloud = Cloud(points)
    skeleton = skeletonize(cloud)
    return measure(skeleton, find_stem(skeleton), cloud)


def test_the_leaves_of_a_plant() -> None:
    found = traits_of(simple_plant())
    each = 2 / np.pi * 0.05 * 0.09 * np.linalg.norm([1, 0.14])  # a sine over 0.091 m
    assert [limb.area_m2 for limb in found.limbs] == pytest.approx([each] * 4, rel=0.08)
    assert [limb.width_m for limb in found.limbs] == pytest.approx([0.05] * 4, rel=0.08)
    assert found.leaf_area_m2 == pytest.approx(sum(limb.area_m2 for limb in found.limbs))
    assert found.leaf_coverage > 0.9
    assert found.notes == ()


def test_a_stem_without_leaves_has_no_leaf_area() -> None:
    rng = np.random.default_rng(0)
    stem = tube([0, 0, 0], [0, 0, 0.5], (0.005, 0.003), 0.0012, rng)
    found = traits_of(stem + rng.normal(0, 3e-4, stem.shape))
    assert found.leaf_area_m2 == 0
    assert np.isnan(found.leaf_coverage)


def bare_leaf(count: int) -> tuple[Skeleton, Stem, Array]:
    """A stem of 0.2 m along z and, from its middle, a blade along x that begins on it; and the blade's points."""
    points, midrib = (places + np.array([0, 0, 0.1]) for places in sheet("rectangle", count))
    nodes = np.concatenate([np.outer(np.arange(21) * 0.01, [0, 0, 1]), midrib[1:]])
    parent = np.array([-1, *range(20), 10, *range(21, 35)])
    organ = np.where(np.arange(36) < 21, STEM, LEAF).astype(np.uint8)
    stem = Stem(np.arange(21), 0.01 * np.arange(21), np.array([10]), organ)
    return Skeleton(nodes, parent, np.full(36, 0.002)), stem, points


def test_thin_leaves_are_named_in_a_note_and_flowers_are_no_leaf() -> None:
    skeleton, stem, points = bare_leaf(2000)
    found = measure(skeleton, stem, Cloud(points))
    assert found.leaf_area_m2 == found.limbs[0].area_m2 == pytest.approx(AREAS["rectangle"], rel=0.08)
    thin = measure(skeleton, stem, Cloud(points[::20]))
    assert np.isnan([thin.leaf_area_m2, *thin.limbs[0][-3:]]).all()
    assert thin.notes == ("blades too thinly seen to measure: 1 of 1",)
    flowers = Cloud(points, labels=np.full(len(points), FLOWER, np.uint8))
    assert np.isnan(list(measure_blades(skeleton, stem, flowers).values())).all()
    assert np.isnan(measure(skeleton, stem).leaf_area_m2), "without a cloud nothing is known"
