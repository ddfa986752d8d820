"""The depth sensor: its statistics against the formula, its limits, its edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.sim.capture import DepthNoise, noisy_depth
from anther.sim.render import d455

CAMERA = d455(640, 360)
IDEAL = DepthNoise(
    subpixel=0, quantum=0, fattening=0, thin=0, edge_dropped=0, edge_flying=0, stereo_shadow=False, max_range=50
)
SMOOTH = DepthNoise(quantum=0)


def wall(z: float) -> np.ndarray:
    return np.full((CAMERA.height, CAMERA.width), z, dtype=np.float32)


def bar(width: int, near: float = 0.6, far: float = 1.2) -> np.ndarray:
    depth = wall(far)
    depth[:, 300 : 300 + width] = near
    return depth


def read(depth: np.ndarray, params: DepthNoise | None = None, seed: int = 0) -> np.ndarray:
    return noisy_depth(depth, CAMERA, np.random.default_rng(seed), params)


@pytest.mark.parametrize("z", [0.5, 0.8, 1.5])
def test_noise_has_the_published_spread(z: float) -> None:
    reading = read(wall(z), SMOOTH)[20:-20, 160:-20]
    assert (reading > 0).mean() > 0.999
    error = reading - z
    sigma = 1.3e-3 * z**2 * d455().fx / CAMERA.fx  # of a D455 1.3 mm at 1 m (facts: perception)
    assert error.std() == pytest.approx(sigma, rel=0.07)
    assert abs(error.mean()) < 0.1 * sigma


def test_noise_is_correlated_between_neighbours_only() -> None:
    error = read(wall(0.8), SMOOTH)[20:-20, 160:-20] - 0.8
    error = error / error.std()
    assert (error[:, 1:] * error[:, :-1]).mean() > 0.5
    assert abs((error[:, 15:] * error[:, :-15]).mean()) < 0.05


def test_disparity_comes_in_32nds_of_a_pixel() -> None:
    reading = read(wall(0.7))
    steps = CAMERA.fx * 0.095 / reading[reading > 0].astype(float) * 32
    assert np.abs(steps - np.round(steps)).max() < 1e-2
    assert len(np.unique(reading[reading > 0])) > 3


def test_too_near_and_too_far_is_not_read() -> None:
    nearest = 0.4825 * CAMERA.fx / d455().fx  # of a D455 0.4825 m (facts: perception)
    assert read(wall(0.97 * nearest)).max() == 0
    assert (read(wall(1.03 * nearest))[:, 160:] > 0).mean() > 0.99
    assert read(wall(7.0)).max() == 0
    assert read(wall(0.0)).max() == 0


def test_without_errors_the_exact_depth_is_read() -> None:
    depth = bar(12)
    np.testing.assert_allclose(read(depth, IDEAL), depth, rtol=1e-6)


def test_bars_look_fat_by_one_to_two_pixels_a_side() -> None:
    params = DepthNoise(edge_dropped=0, edge_flying=0, stereo_shadow=False)
    width = (read(bar(10), params)[5:-5] < 0.65).sum(axis=1)
    assert width.min() >= 12
    assert width.max() <= 14
    assert 12.2 < width.mean() < 13.8


def test_thin_bars_are_lost_and_thick_ones_are_not() -> None:
    assert (np.abs(read(bar(2)) - 0.6) < 0.02).sum() == 0
    thick = np.abs(read(bar(8))[:, 300:308] - 0.6) < 0.02
    assert thick.mean() > 0.9


def test_bars_of_middling_width_are_lost_in_patches() -> None:
    found = (np.abs(read(bar(4)) - 0.6) < 0.02).any(axis=1).mean()
    assert 0.5 < found < 0.99


def test_edges_have_holes_and_flying_pixels() -> None:
    params = DepthNoise(stereo_shadow=False)
    reading = read(bar(20), params)
    flying = (reading > 0.66) & (reading < 1.1)
    assert 20 < flying.sum() < 0.5 * CAMERA.height * 4
    holes = reading == 0
    assert holes.sum() > 100
    assert not holes[:, :290].any()
    assert not holes[:, 335:].any()


def test_what_the_second_imager_cannot_see_is_not_read() -> None:
    near, far = 0.6, 1.2
    depth = wall(far)
    depth[:, 300:500] = near
    hidden = CAMERA.fx * 0.095 * (1 / near - 1 / far)
    params = DepthNoise(edge_dropped=0, edge_flying=0, fattening=0)
    reading = read(depth, params)[5:-5]
    holes = (reading[:, 100:300] == 0).sum(axis=1)
    np.testing.assert_allclose(holes, hidden, atol=3)
    assert (reading[:, 505:] > 0).all()
    band = int(CAMERA.fx * 0.095 / far)
    assert (reading[:, : band - 1] == 0).all()
    assert (reading[:, band + 2 : 200] > 0).all()


def test_same_seed_same_reading() -> None:
    np.testing.assert_array_equal(read(bar(9), seed=4), read(bar(9), seed=4))
    assert np.any(read(bar(9), seed=4) != read(bar(9), seed=5))


@settings(max_examples=20)
@given(value=st.floats(1.01, 1e6) | st.just(float("nan")))
def test_nonsense_parameters_are_refused(value: float) -> None:
    with pytest.raises(InputError):
        DepthNoise(subpixel=value + 1)
    with pytest.raises(InputError):
        DepthNoise(edge_dropped=value)


def test_a_depth_image_of_the_wrong_size_is_refused() -> None:
    with pytest.raises(InputError, match="exact depth"):
        noisy_depth(np.ones((3, 4)), CAMERA, np.random.default_rng(0))
    bad = wall(1.0)
    bad[0, 0] = np.nan
    with pytest.raises(InputError, match="NaN"):
        read(bad)
