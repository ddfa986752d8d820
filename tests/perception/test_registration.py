from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from anther.core.geometry import Array, inverse, look_at, small_transform, transform_points
from anther.perception.cloud import _registration
from anther.perception.cloud._fusion import slant
from anther.perception.cloud._registration import register
from anther.perception.cloud._wrong_views import thinnest


def shape(rng: np.random.Generator) -> tuple[Array, Array]:
    """Points and outward normals of a stem with four petioles and six tilted leaf discs."""
    points, normals = [], []
    rods = [([0, 0, -0.2], [0.01, 0, 0.2], 0.006)]
    rods += [([0, 0, z], [0.1 * np.cos(a), 0.1 * np.sin(a), z + 0.05], 0.002) for z, a in zip(
        (-0.1, -0.02, 0.06, 0.12), (0.3, 2.0, 3.9, 5.2), strict=True)]  # fmt: skip
    for start, end, radius in rods:
        axis = np.subtract(end, start)
        side = np.cross(axis, [1, 0.2, 0.1])
        side /= np.linalg.norm(side)
        other = np.cross(axis / np.linalg.norm(axis), side)
        t, angle = rng.random(3000), rng.random(3000) * 2 * np.pi
        n = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
        points.append(start + t[:, None] * axis + radius * n)
        normals.append(n)
    for k in range(6):
        n = rng.normal(size=3) + np.array([0, 0, 2])
        n /= np.linalg.norm(n)
        u = np.cross(n, [1, 0, 0.3])
        u /= np.linalg.norm(u)
        r, angle = 0.04 * np.sqrt(rng.random(3000)), rng.random(3000) * 2 * np.pi
        disc = r[:, None] * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(n, u))
        points += [disc + np.array([0.1 * np.cos(k), 0.1 * np.sin(k), 0.06 * k - 0.15])] * 2
        normals += [np.tile(n, (3000, 1)), np.tile(-n, (3000, 1))]
    return np.concatenate(points), np.concatenate(normals)


def views_of(rng: np.random.Generator, count: int = 12, noise: float = 0.0004) -> tuple[list[Array], Array]:
    """Return per view the points it sees in its camera frame, and the true poses."""
    points, normals = shape(rng)
    poses = np.stack(
        [
            look_at([0.6 * np.cos(a), 0.6 * np.sin(a), 0.1 + 0.2 * (i % 3)], [0, 0, 0])
            for i, a in enumerate(np.linspace(0, 4, count))
        ]
    )
    clouds = []
    for T in poses:
        faces = np.einsum("ni,ni->n", normals, T[:3, 3] - points) > 0.1 * np.linalg.norm(T[:3, 3] - points, axis=1)
        seen = transform_points(inverse(T), points[faces])
        clouds.append(seen * (1 + rng.normal(0, noise / 0.6, (len(seen), 1))))
    return clouds, poses


def perturbed(poses: Array, rng: np.random.Generator, degrees: float = 0.2, shift: float = 0.0015) -> Array:
    return np.stack(
        [T @ small_transform(np.deg2rad(degrees) * rng.normal(size=3), shift * rng.normal(size=3)) for T in poses]
    )


def small_normals(cloud: Array) -> Array:
    """Return normals fitted to 20 neighbours, towards the camera."""
    _, near = KDTree(cloud).query(cloud, 20)
    spread = cloud[near] - cloud[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]
    return np.where(np.einsum("ni,ni->n", normals, cloud)[:, None] > 0, -normals, normals)


def displacement(found: Array, true: Array, clouds: list[Array]) -> float:
    """RMS displacement of the points [m]."""
    moved = [transform_points(a, c) - transform_points(b, c) for a, b, c in zip(found, true, clouds, strict=True)]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(moved) ** 2, axis=1))))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_registration_recovers_the_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clouds, true = views_of(rng)
    given = perturbed(true, rng)
    result = register(clouds, given)
    before, after = displacement(given, true, clouds), displacement(result.T_world_cam, true, clouds)
    assert before > 0.0025
    assert result.accepted
    assert after < 0.5 * before
    assert result.distance_after < result.distance_before


def drifted(true: Array, slip: float, rng: np.random.Generator) -> Array:
    """Return the poses as odometry tells them that errs by so much after a metre [m], backwards from the last."""
    steps = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1)
    given = true.copy()
    given[:-1, :3, 3] += np.cumsum((slip * np.sqrt(steps)[:, None] * rng.normal(size=(len(steps), 3)))[::-1], axis=0)[
        ::-1
    ]
    return given


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_views_on_a_way_told_by_odometry_are_moved_to_the_last_one(seed: int) -> None:
    """Errors add up backwards from there; taken for errors of each view by itself, they would be shared out."""
    rng = np.random.default_rng(seed)
    clouds, true = views_of(rng)
    given = drifted(true, 0.01, rng)
    by_odometry, by_arm = (register(clouds, given, _registration.Params(walk=walk)) for walk in (0.01, 0.0))
    before, after = displacement(given, true, clouds), displacement(by_odometry.T_world_cam, true, clouds)
    assert before > 0.02
    assert after < 0.003
    assert after < 0.5 * displacement(by_arm.T_world_cam, true, clouds)
    assert by_odometry.used.all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_views_are_placed_one_after_the_other_where_odometry_errs_by_more_than_matching_finds_its_way_from(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    clouds, true = views_of(rng)
    given = drifted(true, 0.02, rng)
    found = register(clouds, given, _registration.Params(walk=0.02))
    assert displacement(given, true, clouds) > 0.04
    assert displacement(found.T_world_cam, true, clouds) < 0.003
    assert found.used.all()


def test_a_common_hand_eye_error_is_recovered() -> None:
    rng = np.random.default_rng(5)
    clouds, true = views_of(rng)
    wrong = small_transform([0, 0, 0], [0.0015, 0, 0])  # along the image's rows: views from all sides contradict it
    result = register(clouds, true @ wrong)
    assert displacement(result.T_world_cam, true, clouds) < 0.7 * displacement(true @ wrong, true, clouds)


def test_true_poses_stay_where_they_are() -> None:
    rng = np.random.default_rng(3)
    clouds, true = views_of(rng)
    result = register(clouds, true)
    assert displacement(result.T_world_cam, true, clouds) < 0.0004


def test_exact_poses_of_noisy_views_are_kept_as_they_are() -> None:
    clouds, true = views_of(np.random.default_rng(3), noise=0.0006)
    result = register(clouds, true)
    assert not result.accepted
    assert np.array_equal(result.T_world_cam, true)
    assert "registration declined" in result.notes[0]


def test_a_flat_wall_is_declined_or_harmless() -> None:
    rng = np.random.default_rng(11)
    poses = np.stack([look_at([1, y, 0], [0, y, 0]) for y in np.linspace(-0.1, 0.1, 5)])
    wall = np.column_stack([rng.normal(0, 0.0005, 20000), rng.uniform(-0.3, 0.3, (20000, 2))])
    clouds = [transform_points(inverse(T), wall) for T in poses]
    given = perturbed(poses, rng)
    result = register(clouds, given)
    assert displacement(result.T_world_cam, poses, clouds) <= 1.05 * displacement(given, poses, clouds)


def test_too_little_overlap_keeps_the_arms_poses() -> None:
    rng = np.random.default_rng(12)
    clouds, true = views_of(rng, count=5)
    given = perturbed(true, rng)
    slices = [
        c[np.abs(transform_points(T, c)[:, 2] - 0.1 * k + 0.2) < 0.02]
        for k, (T, c) in enumerate(zip(true, clouds, strict=True))
    ]
    result = register(slices, given)
    assert not result.accepted
    assert np.array_equal(result.T_world_cam, given)


@pytest.mark.parametrize("shift", [0.01, 0.03])
def test_a_wrong_pose_is_found_and_corrected(shift: float) -> None:
    rng = np.random.default_rng(13)
    clouds, true = views_of(rng)
    given = perturbed(true, rng)
    given[5] = given[5] @ small_transform([0, 0, 0], shift * np.array([0.6, 0.0, 0.8]))
    result = register(clouds, given)
    assert result.used.all()
    assert displacement(result.T_world_cam[5:6], true[5:6], clouds[5:6]) < 0.002
    assert [note for note in result.notes if "view 5: its pose was off by" in note]
    assert result.agreement.min() > 0.8


@pytest.mark.parametrize("wrong", [small_transform([0, 0, 1.2], [0, 0, 0]), small_transform([0, 0, 0], [0.6, 0, 0])])
def test_a_view_that_fits_nowhere_is_left_out_and_named(wrong: Array) -> None:
    rng = np.random.default_rng(14)
    clouds, true = views_of(rng)
    given = perturbed(true, rng)
    given[5] = given[5] @ wrong
    result = register(clouds, given)
    assert result.used.tolist() == [v != 5 for v in range(12)]
    assert np.array_equal(result.T_world_cam[5], given[5])
    assert [note for note in result.notes if "view 5 is left out" in note]
    rest = result.used
    some = [clouds[v] for v in np.flatnonzero(rest)]
    assert displacement(result.T_world_cam[rest], true[rest], some) < 0.5 * displacement(given[rest], true[rest], some)


def test_good_views_agree_and_none_is_called_wrong() -> None:
    rng = np.random.default_rng(15)
    clouds, true = views_of(rng)
    result = register(clouds, perturbed(true, rng))
    assert result.used.all()
    assert result.agreement.min() > 0.8
    assert not [note for note in result.notes if "left out" in note]


@pytest.mark.parametrize("reach", [0.0, 0.0025])
def test_the_bias_of_slanted_surfaces_is_seen(reach: float) -> None:
    """Depths are shortened as a matching window does; its reach is found roughly, and not where there is none."""
    rng = np.random.default_rng(16)
    clouds, true = views_of(rng, count=8)
    short = [c * (1 - reach * slant(c, small_normals(c)))[:, None] for c in clouds]
    found = register(short, perturbed(true, rng)).reach
    assert found < 0.0007 if reach == 0 else reach / 2 < found < 2 * reach


def test_views_of_different_things_keep_the_arms_poses() -> None:
    rng = np.random.default_rng(4)
    clouds, true = views_of(rng, count=4)
    apart = np.stack([small_transform([0, 0, 0], [3.0 * i, 0, 0]) @ T for i, T in enumerate(true)])
    result = register(clouds, apart)
    assert not result.accepted
    assert np.array_equal(result.T_world_cam, apart)
    assert "share no surface" in result.notes[0]


def test_noise_without_structure_is_declined_or_harmless() -> None:
    rng = np.random.default_rng(6)
    _, true = views_of(rng, count=5)
    clouds = [transform_points(inverse(T), rng.uniform(-0.05, 0.05, (2000, 3))) for T in true]
    result = register(clouds, true)
    assert displacement(result.T_world_cam, true, clouds) < 0.0015


@pytest.mark.parametrize("empty", [0, 3])
def test_empty_views_are_left_alone(empty: int) -> None:
    rng = np.random.default_rng(7)
    clouds, true = views_of(rng, count=6)
    given = perturbed(true, rng)
    clouds[empty] = np.zeros((0, 3))
    result = register(clouds, given)
    assert np.isfinite(result.T_world_cam).all()
    rest = [i for i in range(6) if i != empty]
    some = [clouds[i] for i in rest]
    assert displacement(result.T_world_cam[rest], true[rest], some) < displacement(given[rest], true[rest], some)


def test_one_view_only_is_not_registered() -> None:
    clouds, true = views_of(np.random.default_rng(8), count=2)
    result = register([clouds[0], np.zeros((0, 3))], true)
    assert not result.accepted
    assert "fewer than two" in result.notes[0]


def test_the_result_does_not_depend_on_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(9)
    clouds, true = views_of(rng, count=5)
    given = perturbed(true, rng)
    monkeypatch.setattr(_registration, "MATCHED", (0.01,))
    first, second = (register(clouds, given) for _ in range(2))
    assert np.array_equal(first.T_world_cam, second.T_world_cam)


def test_thinnest_directions_are_those_of_an_eigenvalue_solver() -> None:
    rng = np.random.default_rng(0)
    turned = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    points = rng.normal(size=(200, 12, 3)) * [3, 1, 0.1] @ turned * rng.choice([1e-4, 1, 1e3], (200, 1, 1))
    scatter = np.swapaxes(points, 1, 2) @ points
    reference = np.linalg.eigh(scatter)[1][:, :, 0]
    np.testing.assert_allclose(np.abs(np.sum(thinnest(scatter) * reference, axis=1)), 1, atol=1e-9)


def test_what_has_no_thinnest_direction_gives_no_numbers_that_are_none() -> None:
    assert np.isfinite(thinnest(np.stack([np.zeros((3, 3)), np.eye(3), np.diag([1.0, 0, 0])]))).all()
