"""The depth sensor: its statistics against the formula, its limits, its edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.sim.capture import DepthNoise, camera_errors, noisy_depth
from anther.sim.render import d455
from anther.sim.truth import NOMINAL, Truth, draw

CAMERA = d455(640, 360)
IDEAL = DepthNoise(
    subpixel=0, quantum=0, window=1, evidence=0, patchiness=0, flying=0, stereo_shadow=False, max_range=50
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


def test_bars_look_fat_where_they_show_more_texture_than_what_is_behind() -> None:
    def width(contrast: float) -> float:
        params = DepthNoise(evidence=0, contrast=contrast, flying=0, stereo_shadow=False)
        return float((read(bar(20), params)[5:-5] < 0.65).sum(axis=1).mean())

    assert width(1.0) == pytest.approx(20, abs=1)
    assert width(0.5) < 19
    assert 21 < width(2.0) < 24


@pytest.mark.parametrize("window", [3, 5, 7, 9, 11])
def test_a_bar_narrower_than_half_the_window_is_lost_to_what_is_behind(window: int) -> None:
    even = DepthNoise(window=window, evidence=0, patchiness=0, contrast=1, flying=0, stereo_shadow=False)

    def right(width: int) -> float:
        return float((np.abs(read(bar(width), even)[20:-20, 300 : 300 + width] - 0.6) < 0.02).mean())

    assert right(window // 2) == 0
    assert right(window // 2 + 1) > 0
    assert right(2 * window) == 1


def test_a_bar_close_before_a_wall_is_read_where_one_far_before_it_is_lost() -> None:
    params = DepthNoise(evidence=0.2, contrast=1)
    right = [(np.abs(read(bar(3, 0.6, far), params)[20:-20, 300:303] - 0.6) < 0.02).mean() for far in (0.65, 0.8, 4.0)]
    assert right[0] > 0.5 > right[1] >= right[2]


def test_less_is_read_of_thin_bars_and_the_more_evidence_is_asked() -> None:
    def seen(width: int, evidence: float) -> float:
        reading = read(bar(width), DepthNoise(evidence=evidence, contrast=1, patchiness=1))
        return float((np.abs(reading[5:-5, 300 : 300 + width] - 0.6) < 0.03).mean())

    found = [[seen(width, evidence) for width in (2, 4, 6, 9, 20)] for evidence in (0.1, 0.4, 0.8)]
    assert np.all(np.diff(found, axis=1) >= -0.02)
    assert np.all(np.diff(found, axis=0) <= 0.02)
    assert found[0][-1] > 0.9
    assert found[0][0] < 0.1


def test_edges_have_holes_and_flying_pixels_and_nothing_else_has() -> None:
    reading = read(bar(20), DepthNoise(evidence=0.3, patchiness=0.2, stereo_shadow=False))
    flying, holes = (reading > 0.66) & (reading < 1.1), reading == 0
    assert flying[:, 285:335].sum() == flying.sum() > 20
    assert holes[:, 285:335].sum() == holes.sum() > 100


def test_the_wide_truth_reads_less_of_thin_parts_than_the_nominal_camera() -> None:
    def seen(truth: Truth, seed: int) -> float:
        reading = read(bar(5), camera_errors(truth).depth, seed)
        return float((np.abs(reading[:, 300:305] - 0.6) < 0.03).mean())

    wide = [seen(draw(seed, "depth of thin parts"), seed) for seed in range(30)]
    assert max(wide) <= seen(NOMINAL, 0)
    assert np.ptp(wide) > 0.3
    assert np.median(wide) < 0.5


def test_what_the_second_imager_cannot_see_is_not_read() -> None:
    near, far = 0.6, 1.2
    depth = wall(far)
    depth[:, 300:500] = near
    hidden = CAMERA.fx * 0.095 * (1 / near - 1 / far)
    params = replace(IDEAL, stereo_shadow=True, max_range=6)
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
        DepthNoise(flying=value)
    with pytest.raises(InputError, match="odd"):
        DepthNoise(window=4)


def test_a_depth_image_of_the_wrong_size_is_refused() -> None:
    with pytest.raises(InputError, match="exact depth"):
        noisy_depth(np.ones((3, 4)), CAMERA, np.random.default_rng(0))
    bad = wall(1.0)
    bad[0, 0] = np.nan
    with pytest.raises(InputError, match="NaN"):
        read(bad)
