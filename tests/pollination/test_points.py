"""Points followed in a film of a shake: drawn blobs that swing as is known over a background that stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array, ComplexArray, Intrinsics
from anther.pollination.escalation._knowledge import measure_sharpness
from anther.pollination.response._petals import smoothed
from anther.pollination.response.points import (
    SLOW,
    Sight,
    Swings,
    _basis,
    _fitted,
    _flower_path,
    _gain,
    _growing,
    _middles,
    _own_depth,
    _paths,
    _picture,
    _rough,
    _swung,
    _with_overtones,
    likeness,
    sight,
    swings,
)
from anther.robot.devices import Frame

CAMERA = Intrinsics(240, 180, 300.0, 300.0, 119.5, 89.5)
DEPTH, RADIUS, RATE = 0.6, 13, 60.0
PER_PIXEL = DEPTH / CAMERA.fx
HOMES = np.array([[60.0, 60.0], [160.3, 55.6], [110.7, 120.2]])  # px
TONES = np.array([2.4, 4.1, 7.3])
WHERE = np.random.default_rng(0).normal(size=(3, 3, 2)) + 1j * np.random.default_rng(1).normal(size=(3, 3, 2))
SWUNG = 1.2 * WHERE / np.abs(WHERE)  # px, of every point, tone and axis
Path = Callable[[Array], Array]


def wave(phasors: ComplexArray, tones: Array = TONES) -> Path:
    """Return the way (T, 2) of phasors (K, 2)."""
    return lambda t: np.imag(np.exp(2j * np.pi * t[:, None] * tones) @ phasors)


_V, _U = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
_FINE = 12 * np.sin(0.9 * _U) * np.sin(0.8 * _V)
BACKGROUND = 90 + 25 * np.sin(0.31 * _U + 0.17 * _V) * np.cos(0.23 * _V - 0.11 * _U) + _FINE


def drawn(centres: Array, light: float, rng: np.random.Generator, noise: float) -> np.ndarray:
    """Return a picture of blobs, each of its own texture, at centres (P, 2), NaN for none."""
    grey = BACKGROUND.copy()
    for i, (x, y) in enumerate(centres):
        if np.isfinite(x):
            left, top = (max(int(place) - RADIUS - 8, 0) for place in (x, y))
            near = np.s_[top : max(int(y) + RADIUS + 9, 0), left : max(int(x) + RADIUS + 9, 0)]
            a, b = _U[near] - x, _V[near] - y
            texture = 120 + 45 * np.sin((0.5 + 0.1 * i) * a + 0.3 * b + i) + 35 * np.cos(0.25 * a - (0.6 - 0.1 * i) * b)
            cover = 1 / (1 + np.exp(2 * (np.hypot(a, b) - RADIUS)))
            grey[near] += cover * (texture - grey[near])
    rgb = light * np.repeat(grey[..., None], 3, axis=2) + noise * rng.normal(size=(*grey.shape, 3))
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


def film(
    paths: list[Path], *, seconds: float = 1.4, rate: float = RATE, light: float = 0.0, noise: float = 2.0
) -> tuple[Frame, list[Frame]]:
    """Return the picture at rest and a film; exposure goes up and down by a share `light`, as fast as a tone."""
    rng = np.random.default_rng(5)
    times, homes = 7.3 + np.arange(0, seconds, 1 / rate), HOMES[: len(paths)]
    depth = np.full((CAMERA.height, CAMERA.width), DEPTH, np.float32)
    shown = np.array([home + path(times) for home, path in zip(homes, paths, strict=True)])
    lights = 1 + light * np.sin(2 * np.pi * TONES[1] * times)
    frames = [Frame(float(t), drawn(shown[:, i], lights[i], rng, noise), depth) for i, t in enumerate(times)]
    return Frame(0.0, drawn(homes, 1.0, rng, noise), depth), frames


def seen(rest: Frame, homes: Array = HOMES) -> Sight:
    """Return what is in sight of points at their places in the picture, all at DEPTH before the camera."""
    places = np.column_stack([(homes - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, np.full(len(homes), DEPTH)])
    return sight(rest, CAMERA, np.eye(4), np.zeros((0, 3)), places)


def off(found: Swings, truth: ComplexArray = SWUNG) -> Array:
    """Return the error of every point and tone, over the size of the motion in truth."""
    return np.linalg.norm(found.phasors[..., :2] / PER_PIXEL - truth, axis=2) / np.linalg.norm(truth, axis=2)


@pytest.mark.parametrize("light", [0.0, 0.2])
def test_amplitude_and_phase_of_every_tone_are_found_whatever_the_exposure(light: float) -> None:
    rest, frames = film([wave(phasors) for phasors in SWUNG], light=light)
    at = seen(rest)
    assert at.shown.all()
    assert at.pixels == pytest.approx(HOMES, abs=1e-6)
    found = swings(at, frames, TONES)
    assert off(found).max() < 0.02
    assert np.all(found.std[:, :2] < 0.05 * PER_PIXEL)
    assert np.all(found.std[:, :2] >= 1e-6)
    assert np.isnan(found.std[:, 2]).all(), "only of flowers"


def test_wind_and_swings_that_die_out_are_not_taken_for_tones() -> None:
    def drifting(phasors: ComplexArray) -> Path:
        return lambda t: wave(phasors)(t) + np.outer(2.0 * np.sin(2 * np.pi * 0.3 * t), [1.0, -0.5])

    rest, frames = film([drifting(phasors) for phasors in SWUNG])
    assert off(swings(seen(rest), frames, TONES)).max() < 0.06


def test_a_tone_that_is_not_there_is_found_to_be_nothing() -> None:
    quiet = SWUNG.copy()
    quiet[:, 1] = 0
    rest, frames = film([wave(phasors) for phasors in quiet])
    found = swings(seen(rest), frames, TONES)
    sizes = np.linalg.norm(found.phasors[..., :2], axis=2) / PER_PIXEL
    assert sizes[:, 1].max() < 0.06
    assert sizes[:, [0, 2]].min() > 1.5


def test_tones_near_half_the_frame_rate_are_told_from_what_they_would_be_aliased_to() -> None:
    tones = np.array([3.0, 13.5])  # at 30 frames a second a 13.5 Hz that is aliased would be 16.5 Hz, or slower
    truth = np.array([[[1.0, 0.5j], [0.8j, -0.7]]] * 2)
    rest, frames = film([wave(truth[0], tones), wave(truth[1], tones)], rate=30.0)
    found = swings(seen(rest, HOMES[:2]), frames, tones)
    assert off(found, truth).max() < 0.06


def test_tones_above_half_the_frame_rate_are_measured_where_no_two_seem_alike() -> None:
    tones = np.array([21.0, 34.5])  # at 30 frames a second they seem to be 9 and 4.5 Hz
    assert likeness(30.0, 1.0, tones) < 1.5
    truth = np.array([[[1.0, 0.5j], [0.8j, -0.7]]] * 2)
    rest, frames = film([wave(truth[0], tones), wave(truth[1], tones)], rate=30.0)
    assert off(swings(seen(rest, HOMES[:2]), frames, tones), truth).max() < 0.06


@pytest.mark.parametrize(
    ("tones", "why"),
    [
        ([30.1], "stands still"), ([15.2], "sine and cosine seem alike"), ([4.0, 25.8], "seem alike"),
        ([4.0, 4.4], "too short"), ([2.0, 3.5, 5.0, 6.5, 8.0, 9.5, 11.0], "too few frames"),
    ],
)  # fmt: skip
def test_tones_that_frames_cannot_tell_apart_look_alike(tones: list[float], why: str) -> None:
    assert likeness(30.0, 0.7, np.array(tones)) > 3, why
    assert 1 <= likeness(61.0, 2.5, np.array(tones)) < 2


@pytest.mark.parametrize("tones", [[4.0], [3.0, 5.0, 7.5], [2.0, 3.5, 5.0, 6.5, 8.0]])
def test_tones_are_told_only_by_more_frames_than_there_are_numbers_to_fit(tones: list[float]) -> None:
    fitted = 2 * len(tones) + SLOW
    assert likeness(30.0, (fitted + 5 - 0.5) / 30, np.array(tones)) == np.inf
    assert likeness(30.0, (fitted + 5 + 0.5) / 30, np.array(tones)) < np.inf


@pytest.mark.parametrize("rate", [1.6, 0.0, -1.6])
def test_all_flowers_together_tell_how_fast_their_swing_grows_or_dies_out(rate: float) -> None:
    """A mode that nears its swing as 1 - exp(-1.6 t), or falls as 1 + exp(-1.6 t), or neither, 0.4 s after a change."""
    times, tones, rng = 0.4 + np.arange(0, 0.6, 1 / 30), np.array([17.0]), np.random.default_rng(3)
    size = 1 - np.sign(rate) * np.exp(-1.6 * times)
    swung = [size[:, None] * np.sin(2 * np.pi * 17 * times + phase)[:, None] * [2.0, -1.0] for phase in range(5)]
    found = _growing(times, _basis(times, tones), [path + rng.normal(0, 0.05, path.shape) for path in swung])
    middle = np.exp(-1.6 * times.mean())
    true = 1.6 * np.sign(rate) * middle / (1 - np.sign(rate) * middle)
    assert found == pytest.approx(true, rel=0.15) if rate else found == 0


def test_the_overtones_of_a_tone_are_told_from_it_and_change_nothing_of_it() -> None:
    every = 4.3 * np.arange(1, 4)
    rest, frames = film([wave(phasors, every) for phasors in SWUNG], seconds=0.7)
    found = swings(seen(rest), frames, every[:1])
    assert found.phasors.shape[1] == 1
    assert off(found._replace(phasors=np.concatenate([found.phasors, found.overtones], axis=1))).max() < 0.05
    assert swings(seen(rest), frames, every[:2]).overtones.size == 0, "of one tone only"
    assert swings(seen(rest), frames, 2 * every[:1]).overtones.size == 0, "nor of a fast one"


def test_overtones_that_frames_cannot_tell_from_the_tone_are_left_out() -> None:
    tone = np.array([7.45])  # at 30 frames a second sine and cosine of twice as much seem alike, three times is 7.65
    paths = [wave(phasors[:1], tone) for phasors in SWUNG]
    for rate, count in ((30.0, 0), (90.0, 2)):
        rest, frames = film(paths, rate=rate)
        found = swings(seen(rest), frames, tone)
        assert found.overtones.shape[1] == count
        assert np.linalg.norm(found.overtones[..., :2], axis=2).max(initial=0) < 0.1 * PER_PIXEL


def test_growth_is_that_of_the_tone_whatever_overtones_there_are() -> None:
    times, tone = 0.4 + np.arange(0, 0.6, 1 / 60), np.array([6.0])
    swung = [
        (1 + 0.8 * times)[:, None] * np.sin(2 * np.pi * 6 * times + phase)[:, None] * [2.0, -1.0] for phase in range(5)
    ]
    found = [_growing(times, _basis(times, tone * np.arange(1, 1 + count)), swung) for count in (1, 3)]
    assert found == pytest.approx([0.8 / (1 + 0.8 * times.mean())] * 2, rel=0.05)


def test_a_large_swing_is_followed_over_many_pixels() -> None:
    tones, truth = np.array([3.3]), np.array([[[18.0, 6.0j]]])
    rest, frames = film([wave(truth[0], tones)])
    assert off(swings(seen(rest, HOMES[:1]), frames, tones), truth).max() < 0.03


def test_a_point_that_is_lost_is_nan_and_the_others_are_not() -> None:
    def gone(t: Array) -> Array:
        return np.where((t - t[0] > 0.3)[:, None], np.nan, wave(SWUNG[0])(t))

    rest, frames = film([gone, wave(SWUNG[1]), wave(SWUNG[2])])
    found = swings(seen(rest), frames, TONES)
    assert np.isnan(found.phasors[0]).all()
    assert np.isnan(found.std[0]).all()
    assert off(found)[1:].max() < 0.02


def test_a_point_that_is_covered_for_a_moment_is_still_measured() -> None:
    def blinking(t: Array) -> Array:
        return np.where((np.arange(len(t)) % 7 == 3)[:, None], np.nan, wave(SWUNG[0])(t))

    rest, frames = film([blinking, wave(SWUNG[1])])
    assert off(swings(seen(rest, HOMES[:2]), frames, TONES), SWUNG[:2]).max() < 0.06


def test_a_point_that_leaves_the_picture_is_nan() -> None:
    tones = np.array([3.3])
    truth = np.array([[[90.0 + 0j, 0.0]]])
    rest, frames = film([wave(truth[0], tones)])
    found = swings(seen(rest, HOMES[:1]), frames, tones)
    assert np.isnan(found.std[0]).all()
    assert np.isnan(found.phasors[0]).all()


@pytest.mark.parametrize("place", [[-4.0, 60.0], [300.0, 60.0], [60.0, 190.0]])
def test_a_point_outside_the_picture_is_not_in_sight(place: list[float]) -> None:
    rest, frames = film([wave(SWUNG[0])])
    at = seen(rest, np.array([HOMES[0], place]))
    assert at.shown.tolist() == [True, False]
    found = swings(at, frames, TONES)
    assert np.isnan(found.std[1]).all()
    assert np.isfinite(found.std[0, :2]).all()


def test_axes_say_how_far_a_point_goes_in_the_picture_and_away() -> None:
    rng, K = np.random.default_rng(1), Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), [0.3, -0.2, 0.1]
    rest = np.array([[-0.1, 0.05, 0.6], [0.12, -0.08, 0.9]])
    points = rest @ T[:3, :3].T + T[:3, 3]
    blank = Frame(0.0, np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32))
    at = sight(blank, K, T, np.zeros((0, 3)), points)
    move = 1e-5 * rng.standard_normal(3)
    seen = move @ T[:3, :3] + rest
    for p, axes in enumerate(at.axes):
        across, down = (K.project(seen) - K.project(rest))[p] * at.per_pixel[p]
        np.testing.assert_allclose(move @ axes, [across, down, (seen - rest)[p, 2]], atol=1e-8)


def test_a_path_is_as_unsure_as_it_is_along_its_noisier_axis() -> None:
    rng, times = np.random.default_rng(2), np.arange(90) / 60
    basis, noise = _basis(times, np.array([5.0])), rng.standard_normal((90, 2))
    quiet, noisy = (_fitted(basis, noise * [1e-3, size], 1e-4) for size in (1e-3, 1e-2))
    assert quiet is not None
    assert noisy is not None
    assert noisy.std == pytest.approx(10 * quiet.std, rel=0.3)


def test_a_point_behind_something_or_behind_the_camera_is_not_in_sight() -> None:
    rest, _ = film([wave(SWUNG[0])])
    rest.depth[40:80, 40:80] = DEPTH - 0.05
    assert not seen(rest, HOMES[:1]).shown[0]
    rest.depth[40:80, 40:80] = 0  # no reading
    assert not seen(rest, HOMES[:1]).shown[0]
    rest.depth[40:80, 40:80] = DEPTH + 0.01
    assert seen(rest, HOMES[:1]).shown[0]
    behind = sight(rest, CAMERA, np.eye(4), np.zeros((0, 3)), np.array([[0.0, 0.0, -0.3], [0.0, 0.0, DEPTH]]))
    assert behind.shown.tolist() == [False, True]


@pytest.mark.parametrize("count", [0, 1, 10])
def test_of_too_few_frames_nothing_is_said(count: int) -> None:
    rest, frames = film([wave(SWUNG[0])])
    found = swings(seen(rest, HOMES[:1]), frames[:count], TONES)
    assert found.phasors.shape == (1, 3, 3)
    assert np.isnan(found.phasors).all()
    assert np.isnan(found.std).all()


def test_a_film_of_noise_is_less_sure() -> None:
    clear, noisy = (film([wave(SWUNG[0])], noise=noise) for noise in (1.0, 60.0))
    sure, unsure = (swings(seen(rest, HOMES[:1]), frames, TONES) for rest, frames in (clear, noisy))
    assert unsure.std[0, 0] > 2 * sure.std[0, 0] or np.isnan(unsure.std[0, 0])


@settings(max_examples=3, deadline=None)
@given(st.floats(0.0, 100.0))
def test_phases_are_on_the_clock_of_the_frames(later: float) -> None:
    rest, frames = film([wave(SWUNG[0])])
    moved = [Frame(f.time + later, f.rgb, f.depth) for f in frames]
    turned = SWUNG[:1] * np.exp(-2j * np.pi * TONES * later)[None, :, None]
    assert off(swings(seen(rest, HOMES[:1]), moved, TONES), turned).max() < 0.02


# Rules that single functions state.

RATED = 3.0 + np.arange(60) / 30
"""Times of frames [s]."""


def test_growth_of_noise_is_told_in_few_films_of_a_hundred_and_a_sure_one_in_most() -> None:
    """It counts from two of its deviations on: about one film in twenty."""
    rng, basis = np.random.default_rng(0), _basis(RATED, np.array([5.0]))
    sine, since = np.sin(10 * np.pi * RATED)[:, None] * [1.0, 0.5], (RATED - RATED.mean())[:, None]
    told = {}
    for rate in (0.0, 0.25):
        films = [[(1 + rate * since) * sine + rng.normal(0, 0.3, sine.shape)] for _ in range(100)]
        told[rate] = sum(_growing(RATED, basis, film) != 0 for film in films)
    assert 1 <= told[0.0] <= 10
    assert told[0.25] > 50


def test_a_path_with_few_frames_to_spare_tells_no_growth() -> None:
    path, basis = np.outer((1 + RATED) * np.sin(10 * np.pi * RATED), [1.0, 0.5]), _basis(RATED, np.array([5.0]))
    numbers = basis.shape[1] + 2
    for count, told in ((numbers + 3, False), (numbers + 5, True)):
        part = path.copy()
        part[np.arange(60) % (60 // count + 1) != 0] = np.nan
        part[:] = np.nan
        part[:count] = path[:count]
        assert (_growing(RATED, basis, [part]) != 0) == told


def test_what_is_fitted_is_sine_cosine_and_polynomials_over_the_film() -> None:
    tones = np.array([2.4, 4.1])
    basis = _basis(RATED, tones)
    assert basis[:, 0] == pytest.approx(np.sin(2 * np.pi * 2.4 * RATED))
    assert basis[:, 3] == pytest.approx(np.cos(2 * np.pi * 4.1 * RATED))
    assert basis[-1, 4:] == pytest.approx(np.ones(SLOW)), "Legendre's are 1 at the end"
    assert basis[0, 4:] == pytest.approx((-1.0) ** np.arange(SLOW))
    assert basis.shape == (60, 4 + SLOW)


def test_phasors_are_of_sine_on_the_clock_of_the_frames() -> None:
    phasors = np.array([[0.3 + 0.4j, -1.0j, 0.2], [0.1, 0.5 + 1j, 0.0]])
    tones = np.array([2.4, 4.1])
    truth = np.imag(np.exp(2j * np.pi * RATED[:, None] * tones) @ phasors)
    assert _swung(_basis(RATED, tones), phasors) == pytest.approx(truth)


def swung_path(noise: float = 0.0, seed: int = 0, count: int = 60) -> Array:
    rng = np.random.default_rng(seed)
    return np.outer(2 * np.sin(10 * np.pi * RATED[:count]), [1.0, -0.5]) + noise * rng.standard_normal((count, 2))


def test_no_place_is_surer_than_a_guess_says() -> None:
    found = _fitted(_basis(RATED, np.array([5.0])), swung_path(), 0.03)
    assert found is not None
    assert found.coefficients[:2] == pytest.approx(np.array([[2.0, -1.0], [0.0, 0.0]]), abs=1e-6)
    assert found.std == pytest.approx(0.03 * np.sqrt(2 / 60), rel=0.05)


@pytest.mark.parametrize("count", [60, 16])
def test_the_deviation_of_a_fit_is_honest_for_many_and_few_frames(count: int) -> None:
    basis = _basis(RATED[:count], np.array([5.0]))
    fits = [_fitted(basis, swung_path(0.5, seed, count), 0.001) for seed in range(150)]
    every = np.array([[fit.coefficients[0, 0], fit.coefficients[1, 1]] for fit in fits if fit is not None])
    told = np.sqrt(np.mean([fit.std**2 for fit in fits if fit is not None]))
    assert len(every) > 100
    assert 0.9 < told / np.std(every, axis=0).max() < 1.5, "of the noisier axis, and of what is told worse"


def test_the_deviation_of_a_fit_is_of_the_tone_that_is_told_worst() -> None:
    easy, hard = (_fitted(_basis(RATED, np.array(tones)), swung_path(), 0.03) for tones in ([5.0], [5.0, 14.9]))
    assert easy is not None
    assert hard is not None
    assert hard.std > 1.5 * easy.std


def test_a_place_of_which_half_is_unknown_does_not_count() -> None:
    path = swung_path(0.0)
    path[10, 0] = path[30, 1] = np.nan
    basis = _basis(RATED, np.array([5.0]))
    found = _fitted(basis, path, 0.03)
    assert found is not None
    assert found.coefficients[:2] == pytest.approx(np.array([[2.0, -1.0], [0.0, 0.0]]), abs=1e-6)
    assert np.isfinite(_growing(RATED, basis, [path]))


@pytest.mark.parametrize(("missing", "known"), [(23, True), (25, False)])
def test_a_path_is_fitted_if_it_was_followed_in_six_of_ten_frames(missing: int, known: bool) -> None:
    path = swung_path(0.1)
    path[np.random.default_rng(0).permutation(60)[:missing]] = np.nan
    assert (_fitted(_basis(RATED, np.array([5.0])), path, 0.03) is not None) == known


def test_a_path_is_fitted_if_there_are_two_frames_to_spare() -> None:
    tones = np.array([2.0, 5.0, 7.0])
    for count, known in ((11, False), (12, True)):
        basis = _basis(RATED[:count], tones)
        assert basis.shape[1] == 10
        assert (_fitted(basis, swung_path(0.0, 0, count), 0.03) is not None) == known


@pytest.mark.parametrize("axis", [0, 1])
def test_places_far_off_a_swing_do_not_count_and_noise_does(axis: int) -> None:
    basis, path = _basis(RATED, np.array([5.0])), swung_path(0.1)
    plain = _fitted(basis, path, 0.03)
    path[[11, 24, 33, 46, 52], axis] += 4.0
    found = _fitted(basis, path, 0.03)
    assert plain is not None
    assert found is not None
    assert found.coefficients[:2] == pytest.approx(plain.coefficients[:2], abs=0.05)
    assert plain.std == pytest.approx(0.1 * np.sqrt(2 / 60), rel=0.3)


def test_a_path_is_rough_by_what_it_leaps_from_frame_to_frame() -> None:
    noise = np.random.default_rng(0).standard_normal((400, 2))
    assert not _rough(0.35 * noise)  # each step is the root of two as far
    assert _rough(0.5 * noise)
    drift = np.cumsum(0.3 * noise, axis=0)
    assert not _rough(drift), "what goes on is not rough, however far"
    gaps = 0.35 * noise.copy()
    gaps[::7] = np.nan
    assert not _rough(gaps)
    gaps[::2] = np.nan
    assert _rough(gaps), "no two frames in a row"


@pytest.mark.parametrize(("hertz", "count"), [(4.0, 2), (7.47, 0), (9.0, 0), (5.03, 1)])
def test_as_many_overtones_of_a_tone_are_fitted_as_frames_tell(hertz: float, count: int) -> None:
    """At 30 frames a second: twice 7.47 Hz is nearly half of that, and so is three times 5.03."""
    every = _with_overtones(RATED[:40], np.array([hertz]))
    assert every == pytest.approx(hertz * np.arange(1, 2 + count))


def test_a_picture_is_made_as_bright_as_another() -> None:
    rgb = np.random.default_rng(0).integers(40, 60, (40, 40, 3)).astype(np.uint8)
    frame = Frame(0.0, rgb, np.zeros((40, 40), np.float32))
    bright = Frame(0.0, 2 * rgb, frame.depth)
    assert _gain(frame) == pytest.approx(100 / 50, rel=0.03)
    assert _gain(bright) == pytest.approx(100 / 100, rel=0.03)
    first, second = (_picture(f, _gain(f)).astype(float) for f in (frame, bright))
    assert np.abs(first - second).max() <= 2
    assert np.median(first) == pytest.approx(100, abs=2)
    black = Frame(0.0, np.zeros_like(rgb), frame.depth)
    assert _gain(black) == 100
    assert _picture(Frame(0.0, np.full_like(rgb, 250), frame.depth), 2.0).min() == 255


def test_a_point_is_in_sight_where_any_reading_within_two_pixels_is_its_own() -> None:
    depth = np.zeros((30, 40), np.float32)
    depth[10:13, 20:23] = 0.5
    depth[14, 22] = 0.9
    where = np.array([[20.0, 10], [18, 10], [17, 10], [22, 8], [22, 7], [24.4, 14.4], [25, 12], [30, 25]])
    expected = [True, True, False, True, False, True, False, False]
    every = np.ones(8, dtype=bool)
    assert _own_depth(depth, where, np.full(8, 0.515), every).tolist() == expected
    assert _own_depth(depth, where, np.full(8, 0.485), every).tolist() == expected
    assert not _own_depth(depth, where, np.full(8, 0.525), every).any()
    assert not _own_depth(depth, where, np.full(8, 0.475), every).any()
    assert not _own_depth(depth, where, np.full(8, 0.5), ~every).any(), "outside of the picture nothing is"


@pytest.mark.parametrize("corner", [[0, 0], [39, 0], [0, 29], [39, 29], [1, 1]])
def test_a_point_may_be_in_sight_at_the_edge_of_the_picture(corner: list[int]) -> None:
    depth = np.full((30, 40), 0.5, np.float32)
    assert _own_depth(depth, np.array([corner], dtype=float), np.array([0.5]), np.array([True])).all()


def blobs(*steps: list[float]) -> tuple[Sight, list[np.ndarray], Array]:
    """Return the sight, pictures and places (T, P, 2) of blobs that go across by `steps` [px] from frame to frame."""
    rng, homes = np.random.default_rng(5), HOMES[: len(steps)]
    depth = np.full((CAMERA.height, CAMERA.width), DEPTH, np.float32)
    ways = np.cumsum(np.array(steps).T, axis=0)
    places = homes + ways[..., None] * [1.0, 0.0]
    frames = [Frame(0.0, drawn(p, 1.0, rng, 1.0), depth) for p in places]
    rest = Frame(0.0, drawn(homes, 1.0, rng, 1.0), depth)
    return seen(rest, homes), [_picture(f, _gain(f)) for f in frames], places


@pytest.mark.parametrize("steps", [[0, 3, 6, 9, 12, 15, 18, 18], [0, 3, 6, 8, 5, 2, -1, -4], [3] * 6])
def test_what_speeds_up_is_looked_for_where_it_is_going(steps: list[float]) -> None:
    at, pictures, places = blobs(steps)
    assert _paths(at, pictures) == pytest.approx(places, abs=0.15)


def test_each_point_is_looked_for_where_it_is_going_or_at_home_or_where_it_was() -> None:
    """The first goes on, the second is at home, the third stops at once."""
    at, pictures, places = blobs([0, 4, 8, 10, 10, 10], [0] * 6, [0, 4, 8, 11, 0, 0])
    assert _paths(at, pictures) == pytest.approx(places, abs=0.15)


def test_a_place_from_which_a_point_does_not_come_home_is_lost() -> None:
    at, pictures, _ = blobs([0, 0, 0])
    pictures[1] = np.roll(pictures[1][::-1], 50, axis=1)
    path = _paths(at, pictures)
    assert np.isnan(path[1]).all()
    assert path[[0, 2], 0] == pytest.approx(np.tile(HOMES[0], (2, 1)), abs=0.15)


# Flowers: small, of their own colour, before leaves that stand still or go another way.


def flower_film(path: Path, *, seconds: float = 1.2, rate: float = RATE) -> tuple[Frame, list[Frame]]:
    """Return the picture at rest and a film of one yellow flower at HOMES[0], 9 px across, before leaves."""
    rng = np.random.default_rng(8)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    leaves = (
        60 + 25 * np.sin(0.31 * u + 0.17 * v) * np.cos(0.23 * v - 0.11 * u) + 15 * np.sin(0.9 * u) * np.sin(0.8 * v)
    )
    behind = leaves[..., None] * [0.7, 1.2, 0.5]

    def frame(time: float, centre: Array) -> Frame:
        away = np.hypot(u - centre[0], v - centre[1])
        cover = (1 / (1 + np.exp(3 * (away - 4.5))))[..., None]
        petals = (1 - 0.03 * away)[..., None].clip(0.5) * [235.0, 215.0, 60.0]
        rgb = behind + cover * (petals - behind) + 2 * rng.normal(size=behind.shape)
        depth = np.where(away < 4.5, DEPTH, DEPTH + 0.015).astype(np.float32)
        return Frame(time, np.clip(np.rint(rgb), 0, 255).astype(np.uint8), depth)

    times = 3.1 + np.arange(0, seconds, 1 / rate)
    return frame(0.0, HOMES[0]), [frame(float(t), HOMES[0] + way) for t, way in zip(times, path(times), strict=True)]


@pytest.mark.parametrize("wrong", [None, 1.0, 1.5, 0.7])
@pytest.mark.parametrize("size", [1.5, 6.0])
def test_a_flower_is_followed_though_its_background_stands_still(size: float, wrong: float | None) -> None:
    tones = np.array([4.1])
    truth = size * np.array([[[1.0 + 0j, 0.4j]]])
    rest, frames = flower_film(wave(truth[0], tones))
    place = np.append((HOMES[0] - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, DEPTH)
    at = sight(rest, CAMERA, np.eye(4), place[None], np.zeros((0, 3)))
    assert at.shown.tolist() == [True]
    assert at.pixels[0] == pytest.approx(HOMES[0], abs=0.5)
    expected = None if wrong is None else wrong * PER_PIXEL * np.concatenate([truth, 0 * truth[..., :1]], axis=2)
    found = swings(at, frames, tones, expected)
    assert off(found, truth).max() < 0.08
    assert np.isfinite(found.std[0]).all()


@pytest.mark.parametrize("size", [0.5, 4.0, 9.0])
@pytest.mark.parametrize("rate", [30.0, 90.0])
def test_a_flower_found_now_here_now_there_is_not_measured_whatever_is_expected(size: float, rate: float) -> None:
    tones, rng = np.array([7.4]), np.random.default_rng(3)
    rest, frames = flower_film(lambda t: rng.uniform(-5, 5, (len(t), 2)), seconds=0.6, rate=rate)
    place = np.append((HOMES[0] - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, DEPTH)
    at = sight(rest, CAMERA, np.eye(4), place[None], np.zeros((0, 3)))
    expected = size * PER_PIXEL * np.array([[[1.0 + 0j, 0.4j, 0.0]]])
    assert np.isnan(swings(at, frames, tones, expected).std[0]).all()


def test_what_is_lost_is_looked_for_as_far_from_home_as_the_others_have_drifted() -> None:
    rest, _ = film([wave(0 * SWUNG[0])] * 3)
    at = seen(rest)
    drift = np.array([[4.0, -9.0], [6.0, -11.0], [np.nan, np.nan]])
    paths = np.repeat((HOMES + drift)[:, None], 20, axis=1)
    assert _middles(at, paths) - HOMES == pytest.approx(np.array([[4.0, -9.0], [6.0, -11.0], [5.0, -10.0]]))
    paths[0, 5:] = np.nan  # too seldom found to tell
    assert _middles(at, paths)[0] - HOMES[0] == pytest.approx([5.0, -10.0])
    assert _middles(at, np.full_like(paths, np.nan)) == pytest.approx(HOMES)


def test_what_a_flowers_depth_does_at_overtones_is_noise() -> None:
    tone = np.array([4.1])
    rest, frames = flower_film(wave(np.array([[4.0 + 0j, 0.0j]]), tone))
    noise = 0.004 * np.sin(4 * np.pi * tone[0] * np.array([f.time for f in frames]))
    frames = [replace(f, depth=f.depth + np.float32(off)) for f, off in zip(frames, noise, strict=True)]
    place = np.append((HOMES[0] - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, DEPTH)
    found = swings(sight(rest, CAMERA, np.eye(4), place[None], np.zeros((0, 3))), frames, tone)
    assert found.overtones.shape[1] == 2
    assert np.isfinite(found.overtones[..., :2]).all()
    assert np.isnan(found.overtones[..., 2]).all()
    assert np.abs(found.phasors[0, 0, 2]) < 0.001
    assert measure_sharpness(found, slice(0, 1)) == pytest.approx(1.0, abs=0.1)


def test_flowers_come_first_and_one_that_is_hidden_is_not_in_sight() -> None:
    rest, _ = flower_film(wave(np.zeros((1, 2)), np.array([4.1])))
    places = np.column_stack([(HOMES - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, np.full(3, DEPTH)])
    at = sight(rest, CAMERA, np.eye(4), places[:2], places[2:])
    assert at.shown.tolist()[:2] == [True, False]
    assert len(at.flowers) == 2
    assert at.pixels.shape == (3, 2)


def flower_at(rest: Frame) -> Sight:
    place = np.append((HOMES[0] - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, DEPTH)
    return sight(rest, CAMERA, np.eye(4), place[None], np.zeros((0, 3)))


def growing(phasors: ComplexArray, tones: Array) -> Path:
    """Return the way of phasors (K, 2) that grow by 0.5 of what they are in the middle of the film in a second."""
    return lambda t: (1 + 0.5 * (t - t.mean()))[:, None] * wave(phasors, tones)(t)


def test_the_growth_of_a_flowers_one_tone_is_told_and_of_points_or_several_tones_none() -> None:
    one, two = np.array([5.3]), np.array([5.3, 11.0])
    rest, frames = flower_film(growing(np.array([[5.0 + 0j, 2.0j]]), one))
    assert swings(flower_at(rest), frames, one).growing == pytest.approx(0.5, abs=0.1)
    assert swings(flower_at(rest), frames, two).growing == 0.0
    rest, frames = film([growing(np.array([[5.0 + 0j, 2.0j]]), one)])
    assert swings(seen(rest, HOMES[:1]), frames, one).growing == 0.0


def test_a_flower_that_swings_far_is_found_where_it_is_expected_to() -> None:
    """Its surroundings stand still, and it goes farther than it is looked for from there."""
    tones, truth = np.array([4.1]), np.array([[[16.0 + 0j, 8.0j]]])
    rest, frames = flower_film(wave(truth[0], tones))
    expected = PER_PIXEL * np.concatenate([truth, 0 * truth[..., :1]], axis=2)
    assert off(swings(flower_at(rest), frames, tones, expected), truth).max() < 0.05
    assert off(swings(flower_at(rest), frames, tones, expected / 1.6), truth).max() < 0.05, "or half as far again"


@pytest.mark.parametrize("size", [0.004, 0.03])
def test_how_far_a_flower_swings_away_is_read_from_its_depth(size: float) -> None:
    """Of 3 cm the ends are farther from its place at rest than readings are its own, unless they are expected there."""
    tones, truth = np.array([4.1]), np.array([[[3.0 + 0j, 1.0j]]])
    rest, frames = flower_film(wave(truth[0], tones))
    times = np.array([f.time for f in frames])
    away = np.imag(size * 1j * np.exp(2j * np.pi * 4.1 * times))
    frames = [replace(f, depth=f.depth + np.float32(z)) for f, z in zip(frames, away, strict=True)]
    expected = np.concatenate([PER_PIXEL * truth, np.full((1, 1, 1), size * 1j)], axis=2)
    found = swings(flower_at(rest), frames, tones, expected)
    assert found.phasors[0, 0, 2] == pytest.approx(size * 1j, abs=3e-4)
    assert 1e-5 < found.std[0, 2] < 5e-4


def test_a_flowers_path_is_of_its_middle_not_of_the_pixel_about_which_it_was_cut_out() -> None:
    tones = np.array([4.1])
    rest, frames = flower_film(wave(np.array([[3.0 + 0j, 1.0j]]), tones), seconds=0.6)
    at, basis = flower_at(rest), _basis(np.array([f.time for f in frames]), tones)
    images = [smoothed(frame) * _gain(frame) for frame in frames]
    around = np.tile(HOMES[0], (len(frames), 1))
    plain, aside = (
        _flower_path(at._replace(pixels=at.pixels + off), 0, images, around, HOMES[0], basis, None)
        for off in (np.zeros(2), np.array([0.4, -0.3]))
    )
    assert aside - plain == pytest.approx(np.tile([0.4, -0.3], (len(frames), 1)), abs=1e-9)


def test_what_is_near_the_camera_or_behind_it_is_no_flower() -> None:
    rest, _ = flower_film(wave(np.zeros((1, 2)), np.array([4.1])))
    at = sight(rest, CAMERA, np.eye(4), np.array([[0.0, 0.0, 0.05], [0.0, 0.0, DEPTH]]), np.zeros((0, 3)))
    assert at.flowers == ()
    assert at.per_pixel == pytest.approx([0.05 / CAMERA.fx, PER_PIXEL])


def test_a_flower_is_measured_beside_one_that_is_hidden_and_a_point() -> None:
    tones, truth = np.array([4.1]), np.array([[3.0 + 0j, 1.0j]])
    rest, frames = flower_film(wave(truth, tones))
    places = np.column_stack([(HOMES - [CAMERA.cx, CAMERA.cy]) * PER_PIXEL, np.full(3, DEPTH)])
    at = sight(rest, CAMERA, np.eye(4), places[:2], places[2:])
    expected = PER_PIXEL * np.repeat(np.append(truth, [[0]], axis=1)[None], 2, axis=0)
    for known in (None, expected):
        found = swings(at._replace(shown=np.array([True, False, True])), frames, tones, known)
        assert off(found, truth[None])[0].max() < 0.05
        assert np.isnan(found.std[1]).all()
        assert np.linalg.norm(found.phasors[2, :, :2]) < 0.1 * PER_PIXEL, "which stands still"


def test_of_what_is_not_in_sight_nothing_is_said() -> None:
    rest, frames = film([wave(SWUNG[0])], seconds=0.5)
    at = seen(rest, HOMES[:1])
    found = swings(at._replace(shown=np.zeros(1, dtype=bool)), frames, TONES)
    assert found.phasors.shape == (1, 3, 3)
    assert np.isnan(found.phasors).all()


@pytest.mark.parametrize("tone", [4.0, 9.3, 22.0])
def test_a_tone_alone_in_a_long_film_is_like_nothing_else(tone: float) -> None:
    assert likeness(60.0, 3.0, np.array([tone])) == pytest.approx(1.0, abs=0.1)
