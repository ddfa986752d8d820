"""Simulated plants: valid trees, plausible by the facts, posed rigidly, reproducible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from grown_plants import GROW, grown
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError
from anther.core.geometry import small_transform, transform, transform_points
from anther.sim.growth import SELF_SUPPORT, Growth, buckling_factor, pedicel_radius
from anther.sim.plant import GRAVITY, POT_AXIS, SOIL_Z, Organ, SimPlant

SEEDS = range(6)


@pytest.fixture(scope="module", params=[(s, n) for s in GROW for n in SEEDS], ids=lambda p: f"{p[0]}{p[1]}")
def plant(request: pytest.FixtureRequest) -> SimPlant:
    species, seed = request.param
    return grown(species, seed)


def test_is_one_connected_tree(plant: SimPlant) -> None:
    assert plant.parent[0] == -1
    assert np.all(plant.parent[1:] < np.arange(1, len(plant.parent)))
    np.testing.assert_allclose(plant.start[1:], plant.end[plant.parent[1:]], atol=1e-12)
    np.testing.assert_allclose(plant.start[0], [*POT_AXIS, SOIL_Z], atol=1e-12)


def test_stem_tapers_and_other_radii_are_positive(plant: SimPlant) -> None:
    points, radii, arc = plant.stem_centreline()
    assert np.all(np.diff(radii) < 0)
    assert np.all(np.diff(arc) > 0)
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), np.diff(arc))
    assert min(plant.radius_start.min(), plant.radius_end.min()) > 0


def test_every_flower_hangs_on_a_pedicel_that_carries_its_mass(plant: SimPlant) -> None:
    assert len(plant.flower_segment) == len(set(plant.flower_segment.tolist())) > 0
    assert np.all(plant.organ[plant.flower_segment] == Organ.PEDICEL)
    assert np.all(plant.lump_mass[plant.flower_segment] >= 0.05e-3)
    assert np.all(plant.lump_mass[plant.flower_segment] <= 0.15e-3)
    reach = np.linalg.norm(plant.flower_position - plant.end[plant.flower_segment], axis=1)
    assert np.all(reach < 0.006)


def centrelines(plant: SimPlant, organ: Organ) -> list[np.ndarray]:
    """Return one polyline (n, 3) [m] for every unbroken run of segments of one organ, base first."""
    lines: dict[int, list[np.ndarray]] = {}
    run: dict[int, int] = {}
    continued: set[int] = set()
    for k in np.flatnonzero(plant.organ == organ).tolist():
        parent = int(plant.parent[k])
        goes_on = parent in run and parent not in continued
        run[k] = run[parent] if goes_on else k
        continued.add(parent)
        lines.setdefault(run[k], [plant.start[k]]).append(plant.end[k])
    return [np.array(line) for line in lines.values()]


def test_pedicels_lie_in_the_published_range(plant: SimPlant) -> None:
    lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in centrelines(plant, Organ.PEDICEL)]
    assert len(lengths) == len(plant.flower_segment)
    assert min(lengths) >= 0.009
    assert max(lengths) <= 0.022
    pedicel = plant.organ == Organ.PEDICEL
    assert np.all((plant.youngs[pedicel] >= 50e6) & (plant.youngs[pedicel] <= 100e6))


def test_size_and_stem_are_plausible(plant: SimPlant) -> None:
    height = plant.end[plant.organ <= Organ.BRANCH][:, 2].max() - SOIL_Z
    assert 0.5 <= height <= 0.75 if plant.species == "tomato" else 0.25 <= height <= 0.6
    _, radii, _ = plant.stem_centreline()
    assert 0.004 <= radii[0] <= 0.006
    leaf_mass = plant.lump_mass.sum()
    assert 0.005 <= leaf_mass <= 0.1
    assert 30e6 <= plant.youngs[0] <= 600e6


def test_tomato_taper_trusses_and_leaves() -> None:
    for seed in SEEDS:
        plant = grown("tomato", seed)
        _, radii, _ = plant.stem_centreline()
        assert 0.4 <= radii[-1] / radii[0] <= 0.6
        trusses = centrelines(plant, Organ.PEDUNCLE)
        assert 1 <= len(trusses) <= 3
        assert all(0.055 <= np.linalg.norm(np.diff(t, axis=0), axis=1).sum() <= 0.12 for t in trusses)
        assert 4 * len(trusses) <= len(plant.flower_segment) <= 8 * len(trusses)
        assert 8 <= len(centrelines(plant, Organ.RACHIS)) <= 14


def test_pepper_leaves_below_the_first_fork() -> None:
    for seed in SEEDS:
        plant = grown("pepper", seed)
        stem = set(plant.stem_segments().tolist())
        petioles = np.flatnonzero(plant.organ == Organ.PETIOLE)
        on_stem = [k for k in petioles if int(plant.parent[k]) in stem]
        assert 7 <= len(on_stem) <= 12
        forks = [k for k in np.flatnonzero(plant.organ == Organ.BRANCH) if int(plant.parent[k]) in stem]
        assert 2 <= len(forks) <= 3


def test_holds_itself_up(plant: SimPlant) -> None:
    assert buckling_factor(plant) >= 0.99 * SELF_SUPPORT


def test_every_organ_has_faces(plant: SimPlant) -> None:
    organs = {Organ.STEM, Organ.PETIOLE, Organ.LEAF, Organ.PEDICEL, Organ.FLOWER, Organ.POT, Organ.SOIL}
    organs |= {Organ.RACHIS, Organ.PEDUNCLE} if plant.species == "tomato" else {Organ.BRANCH}
    assert {Organ(k) for k in np.unique(plant.face_organ)} == organs
    still = np.isin(plant.face_organ, (Organ.POT, Organ.SOIL))
    np.testing.assert_array_equal(np.all(plant.vertex_segment[plant.faces] == -1, axis=1), still)


def test_mesh_of_a_stem_surrounds_its_centreline(plant: SimPlant) -> None:
    k = plant.stem_segments()
    rides = np.isin(plant.vertex_segment, k)
    points, radii, _ = plant.stem_centreline()
    distance = np.linalg.norm(plant.vertices[rides][:, None] - points[None], axis=2)
    near = distance.argmin(axis=1)
    assert np.all(distance.min(axis=1) <= radii[near] + 1e-9)


def test_identity_leaves_the_mesh_at_rest(plant: SimPlant) -> None:
    T = np.tile(np.eye(4), (len(plant.parent), 1, 1))
    np.testing.assert_array_equal(plant.posed_vertices(T), plant.vertices)


def test_one_rigid_motion_moves_the_plant_but_not_the_pot(plant: SimPlant) -> None:
    T = small_transform([0.1, -0.2, 0.3], [0.01, 0.02, -0.03])
    posed = plant.posed_vertices(np.tile(T, (len(plant.parent), 1, 1)))
    rides = plant.vertex_segment >= 0
    np.testing.assert_allclose(posed[rides], transform_points(T, plant.vertices[rides]), atol=1e-12)
    np.testing.assert_array_equal(posed[~rides], plant.vertices[~rides])


def test_posed_vertices_follow_their_own_segment() -> None:
    plant = grown("tomato", 0)
    T = np.tile(np.eye(4), (len(plant.parent), 1, 1))
    k = int(plant.flower_segment[0])
    T[k, :3, 3] = [0.1, 0.0, 0.0]
    moved = np.any(plant.posed_vertices(T) != plant.vertices, axis=1)
    np.testing.assert_array_equal(moved, plant.vertex_segment == k)


@pytest.mark.parametrize("species", list(GROW))
def test_same_seed_same_plant_and_other_seed_another(species: str) -> None:
    a, b, c = GROW[species](3), GROW[species](3), GROW[species](4)
    for name in ("start", "radius_end", "youngs", "lump_mass", "vertices", "vertex_color", "flower_position"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert a.start.shape != c.start.shape or not np.allclose(a.start, c.start)


def test_viewpoint_turns_the_plant_about_the_pot_axis() -> None:
    a, b = grown("pepper", 1), grown("pepper", 1, viewpoint=90.0)
    axis = np.array([*POT_AXIS, 0.0])
    T = transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.zeros(3))
    np.testing.assert_allclose(b.vertices - axis, transform_points(T, a.vertices - axis), atol=1e-12)
    np.testing.assert_allclose(b.lump_centre - axis, transform_points(T, a.lump_centre - axis), atol=1e-12)


def test_placement_moves_everything() -> None:
    a, b = grown("tomato", 1), grown("tomato", 1, axis=(0.0, 0.5))
    shift = np.array([0.0 - POT_AXIS[0], 0.5 - POT_AXIS[1], 0.0])
    np.testing.assert_allclose(b.flower_position - a.flower_position, np.tile(shift, (len(a.flower_segment), 1)))
    assert b.pot.soil_z == SOIL_Z
    assert b.pot.bench_z == pytest.approx(SOIL_Z - 0.18)


def test_masses_are_frusta_and_lumps() -> None:
    plant = grown("tomato", 2)
    np.testing.assert_allclose(
        plant.mass[0],
        1000 * np.pi / 3 * plant.length[0] * np.polyval([1, 0, 0], [plant.radius_start[0]]) *
        (1 + plant.radius_end[0] / plant.radius_start[0] + (plant.radius_end[0] / plant.radius_start[0]) ** 2),
    )  # fmt: skip
    bare = plant.lump_mass == 0
    np.testing.assert_allclose(plant.lump_centre[bare], (plant.start + plant.end)[bare] / 2)


def pole(length: float, radius: float, youngs: float, pieces: int) -> SimPlant:
    growth = Growth(np.random.default_rng(0), youngs)
    points = np.stack([np.zeros(pieces + 1), np.zeros(pieces + 1), np.linspace(0, length, pieces + 1)], axis=1)
    k = growth.chain(points, np.full(pieces + 1, radius), Organ.STEM, -1, (0, 255, 0))
    still = {
        "length": (1e-5, 1e-5),
        "mass": (1e-12, 1e-12),
        "nod": (0.0, 0.0),
        "parts": (0.5, 0.5),
        "widths": (1, 1, 1),
    }
    growth.flower(k[-1], np.array([1.0, 0, 0]), (0, 9, 0), **still)
    return growth.finish("tomato", 0, axis=(0, 0), viewpoint=0)


def test_buckling_of_a_bare_pole_is_greenhills_limit() -> None:
    length, radius, youngs = 0.5, 0.004, 200e6
    plant = pole(length, radius, youngs, 60)
    limit = 7.8373 * youngs * (np.pi / 4 * radius**4) / (1000 * np.pi * radius**2 * GRAVITY * length**3)
    assert buckling_factor(plant) == pytest.approx(limit, rel=0.01)


def test_a_pole_that_is_too_soft_is_stiffened() -> None:
    soft = pole(0.5, 0.004, 1e6, 20)
    assert soft.youngs[0] > 1e6
    assert buckling_factor(soft) == pytest.approx(SELF_SUPPORT, rel=1e-3)


def test_pedicel_resonates_as_asked() -> None:
    length, mass, youngs, f = 0.015, 1e-4, 75e6, 28.0
    r = pedicel_radius(length, mass, youngs, f)
    stiffness = 3 * youngs * np.pi / 4 * r**4 / length**3
    assert np.sqrt(stiffness / mass) / (2 * np.pi) == pytest.approx(f)
    assert 0.0004 < r < 0.0007


def test_a_tree_out_of_order_is_refused() -> None:
    plant = grown("tomato", 0)
    parent = plant.parent.copy()
    parent[3] = 9
    with pytest.raises(InputError, match="parent"):
        replace(plant, parent=parent)
    with pytest.raises(InputError, match="> 0"):
        replace(plant, radius_end=-plant.radius_end)
