"""Plant model: beams, masses and pedicels from a scanned tree, and whether it stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from alike import check_kept
from hypothesis import given
from hypothesis import strategies as st
from sample_plants import branched, read_paper_plant, stem_along, straight_stem, turned
from scipy.integrate import quad

from anther.core.errors import InputError, StageFailure
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.plant._shape import bar_radius, edge_radii, leaf_mass
from anther.plant.model import PEPPER, TOMATO, Material, Params, build_plant
from anther.rods import natural_frequencies, simulate

NO_FLOWERS = Flowers(np.zeros((0, 3)), np.zeros(0, dtype=int))


@given(st.floats(1e-3, 1e-2), st.floats(1e-3, 1e-2))
def test_bar_radius_keeps_the_bending_compliance_of_a_frustum(a: float, b: float) -> None:
    whole = quad(lambda s: 1 / (a + (b - a) * s) ** 4, 0, 1)[0]
    assert bar_radius(a, b) ** -4 == pytest.approx(whole, rel=1e-6)


def test_a_blade_does_not_become_a_thick_beam() -> None:
    skeleton, stem, _ = branched(1)
    thick = np.array(skeleton.radius)
    thick[25:] = [1.5e-3, 1.5e-3, 1.5e-3, 12e-3, 15e-3, 15e-3]
    edges = edge_radii(Skeleton(skeleton.nodes, skeleton.parent, thick), stem)
    assert np.all(edges[25:] <= 1.5e-3 + 1e-12)
    swollen = np.where(np.arange(len(thick)) < 25, thick, 15e-3)
    edges = edge_radii(Skeleton(skeleton.nodes, skeleton.parent, swollen), stem)
    assert np.all(edges[25:] <= 0.7 * thick[10] + 1e-9)


def test_branch_base_uses_the_branch_radius_and_one_bad_stem_radius_does_no_harm() -> None:
    skeleton, stem, _ = branched(2)
    clean = edge_radii(skeleton, stem)
    assert clean[25] == pytest.approx(1.2e-3)
    bad = np.array(skeleton.radius)
    bad[12] = 0.03
    assert edge_radii(Skeleton(skeleton.nodes, skeleton.parent, bad), stem) == (pytest.approx(clean, rel=0.05))


def sheet(rng: np.random.Generator, side: float, spacing: float, noise: float) -> np.ndarray:
    """Points on a square of random attitude."""
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    u = np.arange(0, side, spacing)
    flat = np.stack(np.meshgrid(u, u), axis=-1).reshape(-1, 2)
    return flat @ Q[:2] + rng.normal(0, noise, (len(flat), 1)) * Q[2]


def test_leaf_mass_is_area_times_areal_density_whatever_the_attitude() -> None:
    rng = np.random.default_rng(0)
    skeleton, stem, _ = branched(1)
    masses = []
    for noise in np.repeat([0.0, 0.0005, 0.001], 4):
        points = skeleton.nodes[30] + [0.02, 0.05, 0.05] + sheet(rng, 0.1, 0.001, noise)
        cloud = Cloud(np.concatenate([skeleton.nodes[:25], points]))
        masses.append(leaf_mass(skeleton, stem, cloud, areal_density=0.3))
    total = np.sum(masses, axis=1)
    assert np.mean(total) == pytest.approx(0.3 * 0.01, rel=0.2)
    assert np.ptp(total) < 0.5 * np.mean(total)
    assert np.all(np.array(masses)[:, :25] == 0)


def test_stem_points_and_flowers_weigh_nothing() -> None:
    skeleton, stem, _ = branched(1)
    around = np.repeat(skeleton.nodes[:25], 40, axis=0)
    angle = np.linspace(0, 20 * np.pi, len(around))
    around = around + 4e-3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    petals = skeleton.nodes[30] + np.random.default_rng(0).normal(0, 0.01, (200, 3))
    cloud = Cloud(np.concatenate([around, petals]), labels=np.array([1] * len(around) + [2] * 200, dtype=np.uint8))
    assert leaf_mass(skeleton, stem, cloud, areal_density=0.3).sum() < 5e-5


def test_first_frequency_of_a_stiff_stem_is_euler_bernoulli() -> None:
    skeleton = straight_stem(41, radius=(4e-3, 4e-3))
    plant = build_plant(skeleton, stem_along(skeleton, 40), NO_FLOWERS, None, Material(youngs=5e9, density=1000))
    found = natural_frequencies(plant.rods, plant.clamp, 2)[0][0]
    expected = 1.8751**2 / (2 * np.pi) * np.sqrt(5e9 * (4e-3) ** 2 / 4 / 1000) / 0.4**2
    assert found == pytest.approx(expected, rel=0.03)


def test_least_stiffness_is_greenhills() -> None:
    skeleton = straight_stem(61, radius=(3e-3, 3e-3))
    plant = build_plant(skeleton, stem_along(skeleton, 60), NO_FLOWERS, None, Material(density=1000))
    greenhill = 1000 * 9.81 * 0.4**3 / (7.8373 * (3e-3) ** 2 / 4)
    assert plant.least_youngs == pytest.approx(greenhill, rel=0.05)


def test_flower_resonates_on_its_pedicel_where_tomato_flowers_do(monkeypatch: pytest.MonkeyPatch) -> None:
    skeleton, stem, flowers = branched(1, radius=(0.02, 0.02))
    monkeypatch.setattr("anther.plant._shape.PEDUNCLE_RADIUS", 0.02)  # rigid
    plant = build_plant(skeleton, stem, flowers, None, Material(youngs=1e12, damping_ratio=0.05))
    lowest = natural_frequencies(plant.rods, plant.clamp, 3)[0]
    p = Params()
    EI, length = p.pedicel_youngs * np.pi * p.pedicel_radius**4 / 4, p.pedicel_length
    stiffness = EI / length**3 * np.array([[12, -6 * length], [-6 * length, 4 * length**2]])
    inertia = np.diag([p.flower_mass, 0.4 * p.flower_mass * 5e-3**2])
    square = np.linalg.eigvals(np.linalg.solve(inertia, stiffness)).real.min()
    turning = EI / plant.material.bend_over_twist / length / inertia[1, 1]
    assert lowest[0] == pytest.approx(np.sqrt(turning) / (2 * np.pi), rel=0.01)
    assert lowest[1:] == pytest.approx(np.sqrt(square) / (2 * np.pi), rel=0.03)
    assert np.all((lowest > 20) & (lowest < 35))


def test_the_scanned_shape_hangs_still() -> None:
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    path = simulate(plant.rods_at(5.0), plant.clamp, None, 0.3, 2e-3, start="scanned")
    assert np.abs(path.positions - path.positions[0]).max() < 1e-6


def test_skeleton_nodes_keep_their_numbers_and_flowers_their_places() -> None:
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    assert np.array_equal(plant.rods.nodes[: len(skeleton.nodes)], skeleton.nodes)
    assert plant.rods.nodes[plant.flower_nodes] == pytest.approx(flowers.positions, abs=1e-9)
    assert plant.branch_bases.tolist() == [25, 31, 37]
    assert plant.is_pedicel.sum() == 9  # three of each


def test_turning_the_plant_changes_nothing() -> None:
    skeleton, stem, flowers = branched()
    other = turned(skeleton, flowers, 1.1)
    first = build_plant(skeleton, stem, flowers, None, TOMATO)
    second = build_plant(other[0], stem, other[1], None, TOMATO)
    lowest = [natural_frequencies(p.rods, p.clamp, 6)[0] for p in (first, second)]
    assert lowest[0] == pytest.approx(lowest[1], rel=1e-6)


def test_a_plant_that_would_buckle_is_stiffened_with_a_note_or_refused() -> None:
    skeleton, stem, flowers = branched(radius=(2e-3, 1e-3))
    soft = Material(youngs=5e6)
    plant = build_plant(skeleton, stem, flowers, None, soft)
    assert plant.material.youngs == pytest.approx(1.5 * plant.least_youngs)
    assert plant.material.youngs > 5e6
    assert any("buckle" in note for note in plant.notes)
    with pytest.raises(StageFailure, match="buckles under its own weight") as refused:
        build_plant(skeleton, stem, flowers, None, soft, params=Params(stiffen=False))
    assert refused.value.kind == "no_convergence"
    with pytest.raises(StageFailure, match="buckles"):
        plant.with_material(Material(youngs=0.5 * plant.least_youngs))


def test_leaf_mass_lowers_the_frequencies_and_is_reported() -> None:
    skeleton, stem, flowers = branched()
    rng = np.random.default_rng(1)
    leaf = skeleton.nodes[30] + [0, 0, 0.01] + sheet(rng, 0.12, 0.003, 0.0005)
    leafy = build_plant(skeleton, stem, flowers, Cloud(np.concatenate([skeleton.nodes, leaf])), TOMATO)
    bare = build_plant(skeleton, stem, flowers, None, leafy.material)
    slow, quick = (natural_frequencies(p.rods, p.clamp, 1)[0][0] for p in (leafy, bare))
    assert slow < 0.95 * quick
    assert "leaves" in leafy.notes[0]
    assert "without a cloud" in bare.notes[0]


def test_stiffness_scales_frequencies_and_pedicels_keep_theirs() -> None:
    skeleton, stem, flowers = branched(radius=(5e-3, 5e-3))
    plant = build_plant(skeleton, stem, flowers, None, Material(youngs=2e9))
    stiffer = plant.with_material(Material(youngs=4e9))
    ratio = np.asarray(stiffer.rods.youngs) / np.asarray(plant.rods.youngs)
    assert ratio[~plant.is_pedicel] == pytest.approx(2.0)
    assert ratio[plant.is_pedicel] == pytest.approx(1.0)


def test_round_trip(tmp_path: Path) -> None:
    skeleton, stem, flowers = branched()
    check_kept(build_plant(skeleton, stem, flowers, None, PEPPER), tmp_path / "plant.npz")


def test_a_flower_seen_at_its_branch_still_gets_a_whole_pedicel() -> None:
    skeleton, stem, _ = branched(1)
    tip = len(skeleton.nodes) - 1
    for place in (skeleton.nodes[tip], skeleton.nodes[tip - 1]):  # on the node, and folded back along the branch
        plant = build_plant(skeleton, stem, Flowers(place[None], np.array([tip])), None, TOMATO)
        length = np.linalg.norm(plant.rods.nodes[plant.flower_nodes[0]] - skeleton.nodes[tip])
        assert length == pytest.approx(Params().pedicel_length)


def test_wrong_units_and_foreign_flowers_are_refused() -> None:
    skeleton, stem, flowers = branched()
    huge = Skeleton(1000 * skeleton.nodes, skeleton.parent, skeleton.radius)
    with pytest.raises(InputError, match="plant size"):
        build_plant(huge, stem, flowers, None, TOMATO)
    with pytest.raises(InputError, match="flower attachment"):
        build_plant(skeleton, stem, Flowers(flowers.positions, np.array([1, 2, 999])), None, TOMATO)


@given(st.sampled_from(["youngs", "density", "damping_ratio", "bend_over_twist"]), st.floats(max_value=0))
def test_impossible_materials_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        Material(**{name: value})


@given(st.sampled_from(sorted(set(Params.__dataclass_fields__) - {"stiffen"})), st.sampled_from([-1.0, np.nan, 1e15]))
def test_impossible_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        Params(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "flower"), [("tomato2", 73), ("pepper0", 143)])
def test_the_papers_plants_stand(data: Path, name: str, flower: int) -> None:
    skeleton, stem, flowers = read_paper_plant(data / "skeletons" / f"{name}.txt", flower)
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    lowest = natural_frequencies(plant.rods, plant.clamp, 1)[0][0]
    assert 0.2 < lowest < 10
    assert plant.material.youngs >= 1.49 * plant.least_youngs


def test_the_rib_in_a_blade_falls_to_the_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    skeleton, stem, _ = branched(1)
    flat = np.where(np.arange(len(skeleton.nodes)) >= 27, 1.0, 0.2)
    seen = Skeleton(skeleton.nodes, skeleton.parent, np.where(flat > 0.5, 8e-3, skeleton.radius), flatness=flat)
    monkeypatch.setattr("anther.plant._shape.LEAST_RADIUS", 1e-4)
    edges = edge_radii(seen, stem)
    assert np.all(np.diff(edges[26:]) < 0)
    assert edges[-1] < 0.5e-3
    bare = edge_radii(skeleton, stem)
    assert edges[:26] == pytest.approx(bare[:26])


def test_a_leaf_too_heavy_for_its_thin_rib_does_not_stiffen_the_plant() -> None:
    skeleton, stem, _ = branched(1)
    leaf = skeleton.nodes[30] + 0.1 * np.random.default_rng(0).uniform(-0.5, 0.5, (40000, 3)) * [1, 1, 0]
    thin = np.where(np.arange(len(skeleton.nodes)) < 25, skeleton.radius, 5e-4)
    light, heavy = (
        build_plant(
            Skeleton(skeleton.nodes, skeleton.parent, radius),
            stem,
            NO_FLOWERS,
            Cloud(np.concatenate([skeleton.nodes[:25], leaf])),
            TOMATO,
        )
        for radius in (skeleton.radius, thin)
    )
    assert heavy.least_youngs == pytest.approx(light.least_youngs, rel=0.1)
    stiffer = np.asarray(heavy.rods.youngs) / heavy.material.youngs
    assert np.all(stiffer[1:25] == 1)
    assert np.all(stiffer[26:31] > 2)


def test_no_piece_of_a_leaf_gets_stiffer_than_what_cannot_bend(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even where a blade and the branch that bears it both need the most that is tried."""
    skeleton, stem, _ = branched(1)
    flat = np.where(np.arange(len(skeleton.nodes)) >= 27, 1.0, 0.2)
    seen = Skeleton(skeleton.nodes, skeleton.parent, skeleton.radius, flatness=flat)
    monkeypatch.setattr("anther.plant._shape._until_it_stands", lambda _: 1.2**39)
    plant = build_plant(seen, stem, NO_FLOWERS, None, TOMATO)
    assert (np.asarray(plant.rods.youngs) / plant.material.youngs).max() == pytest.approx(1e4)
