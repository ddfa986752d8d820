"""One flower's track and what is said of it, to the rules: made tracks and pictures whose right answer is known."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from anther.core.geometry import Array, Intrinsics
from anther.plant.limits import MOVED, moved
from anther.pollination.response import SIGNIFICANCE, _Motion, _motion, _named, _notes, _without_noisy_depth
from anther.pollination.response._following import (
    FLOWER_RADIUS,
    Followed,
    _begin,
    _depth,
    _lifted,
    _overlapping,
    _path,
    follow_flowers,
    placed,
    without_outliers,
)
from anther.pollination.response._petals import Patch
from anther.pollination.response.thresholds import LEAST_SPREAD, OUTLIER, SPREAD
from anther.robot.devices import Frame

F, PIXEL = 9.5, 1e-3
TIMES = 11.0 + np.arange(120) / 60
PLACE = np.array([0.1, -0.05, 0.5])


def track(
    across: float, away: float = 0.0, *, noise: float = 1e-5, deep_noise: float = 1e-5, hertz: float = F, seed: int = 0
) -> Array:
    """Return a flower's track (T, 3): a swing of sizes across and away from the camera [m] with noise."""
    rng, sine = np.random.default_rng(seed), np.sin(2 * np.pi * hertz * TIMES + 0.6)
    size = rng.standard_normal((len(TIMES), 3)) * [noise, noise, deep_noise]
    return PLACE + np.outer(sine, [across, 0.0, away]) + size


def one(path: Array, *, deep: bool = True, mixed: bool = False, pixel: float = PIXEL) -> Followed:
    return Followed(0, path, pixel, deep, mixed)


def measured(path: Array, *, deep: bool = True, mixed: bool = False, pixel: float = PIXEL) -> _Motion:
    found = _motion(TIMES, one(path, deep=deep, mixed=mixed, pixel=pixel), F)
    assert not isinstance(found, str), found
    return found


def reason(path: Array, pixel: float = PIXEL) -> str:
    found = _motion(TIMES, one(path, pixel=pixel), F)
    assert isinstance(found, str)
    return found


def test_a_swings_size_way_phase_and_acceleration_are_those_of_the_track() -> None:
    found = measured(track(0.003, 0.004))
    assert found.amplitude == pytest.approx(0.005, rel=0.01)
    assert found.direction == pytest.approx([0.6, 0, 0.8], abs=0.01)
    assert found.phase == pytest.approx(0.6, abs=0.01)
    assert found.frequency == pytest.approx(F, rel=1e-3)
    assert found.acceleration_peak == pytest.approx(0.005 * (2 * np.pi * F) ** 2, rel=0.02)
    assert np.isnan(found.at_most)


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_the_acceleration_is_of_the_frequency_that_is_found(share: float) -> None:
    times = TIMES[:40]
    sine = np.sin(2 * np.pi * share * F * times)
    path = PLACE + np.outer(sine, [0.003, 0, 0]) + 1e-5 * np.random.default_rng(0).standard_normal((40, 3))
    found = cast(_Motion, _motion(times, one(path), F))
    assert found.frequency == pytest.approx(share * F, rel=3e-3)
    assert found.acceleration_peak / found.amplitude == pytest.approx((2 * np.pi * share * F) ** 2, rel=6e-3)


def test_a_quiet_swings_deviation_is_that_share_of_it_which_a_turning_flower_shows() -> None:
    assert measured(track(0.003, 0.004)).amplitude_std == pytest.approx(
        np.hypot(SPREAD * 0.005, LEAST_SPREAD), rel=0.02
    )
    mixed = measured(track(0.003, 0.004), mixed=True)
    assert mixed.amplitude_std == pytest.approx(np.hypot(0.15 * 0.005, LEAST_SPREAD), rel=0.02)


def test_where_depth_is_not_sure_the_whole_swing_may_be_larger_by_a_share() -> None:
    found = measured(track(0.005), deep=False)
    every = [SPREAD * 0.005, LEAST_SPREAD, 0.2 * 0.005]
    assert found.amplitude_std == pytest.approx(np.linalg.norm(every), rel=0.02)
    assert found.direction == pytest.approx([1, 0, 0], abs=0.05)


def test_noise_counts_in_the_deviations_of_amplitude_and_phase() -> None:
    quiet, noisy = measured(track(0.005, noise=1e-5)), measured(track(0.005, noise=1e-3, deep_noise=1e-3), pixel=5e-3)
    assert quiet.phase_std == pytest.approx(0.05, rel=0.01)
    error = 1e-3 * np.sqrt(2 / 120)
    assert noisy.phase_std == pytest.approx(np.hypot(error / 0.005, 0.05), rel=0.1)
    assert noisy.phase_std > 1.08 * 0.05
    assert noisy.amplitude_std > quiet.amplitude_std


def test_the_frequencys_deviation_is_honest() -> None:
    runs = [measured(track(0.01, noise=1.2e-3, deep_noise=1e-5, seed=seed), pixel=3e-3) for seed in range(60)]
    told = np.mean([run.frequency_std for run in runs])
    assert np.std([run.frequency for run in runs]) == pytest.approx(told, rel=0.35)


def test_the_surer_an_axis_the_more_it_tells_the_frequency() -> None:
    """The depth swings too, and is ten times as noisy; what has no noise at all is not trusted without end."""
    off = []
    for seed in range(12):
        path = track(0.006, 0.012, noise=1e-4, deep_noise=3e-3, seed=seed)
        path[:, 1] = PLACE[1]
        off.append(measured(path).frequency - F)
    assert np.sqrt(np.mean(np.square(off))) < 0.004


def test_a_swing_below_a_share_of_a_pixel_is_not_told() -> None:
    least = 0.2 * PIXEL
    assert measured(track(1.05 * least, noise=1e-6)).amplitude == pytest.approx(1.05 * least, rel=0.02)
    faint = measured(track(0.95 * least, noise=1e-6))
    assert faint.at_most == pytest.approx(least)
    assert np.isnan([faint.amplitude, faint.amplitude_std, faint.frequency, faint.phase, faint.acceleration_peak]).all()


def test_nor_is_one_that_noise_hides() -> None:
    """In 40 frames with half a pixel of noise an amplitude's deviation is a tenth of a pixel."""
    times, noise = TIMES[:40], 0.45e-3
    error = noise * np.sqrt(2 / 40)
    clear, faint = (_motion(times, one(track(size, noise=noise)[:40]), F) for size in (8 * error, 0.0))
    assert cast(_Motion, clear).amplitude > SIGNIFICANCE * error
    assert cast(_Motion, faint).at_most == pytest.approx(SIGNIFICANCE * error, rel=0.35)
    assert cast(_Motion, faint).at_most > 1.1 * 0.2 * PIXEL


def test_a_track_off_its_swing_by_three_quarters_of_a_pixel_jumps_from_petal_to_petal() -> None:
    assert "did not swing" in reason(track(0.002, noise=0.65e-3))  # 0.9 of a pixel, both ways together
    assert measured(track(0.002, noise=0.4e-3))
    assert measured(track(0.02, noise=2e-3), pixel=2e-3), "or by a fifth of a large swing"
    assert "did not swing" in reason(track(0.02, noise=4e-3))


def test_an_amplitude_less_sure_than_a_third_of_a_millimetre_and_a_tenth_of_itself_is_not_measured() -> None:
    """Of the frames half are enough to tell that it swings, not how far."""
    coarse = 0.02
    assert "did not swing" in reason(track(0.002, noise=4e-3), pixel=coarse)
    assert measured(track(0.002, noise=1.5e-3), pixel=5e-3)
    assert measured(track(0.01, noise=4e-3), pixel=coarse), "0.5 mm of 10"


@pytest.mark.parametrize(("missing", "known"), [(35, True), (37, False)])
def test_a_flower_is_measured_if_it_was_seen_in_seven_of_ten_frames(missing: int, known: bool) -> None:
    path = track(0.003)
    path[np.random.default_rng(0).permutation(120)[:missing]] = np.nan
    found = _motion(TIMES, one(path), F)
    assert isinstance(found, _Motion) == known
    assert known or "lost in more than 30%" in str(found)


def test_what_leaps_too_often_is_lost() -> None:
    path = track(0.003, noise=1e-4)
    assert measured(path)
    path[np.arange(12, 48)] += [0.05, 0, 0]
    path[np.arange(60, 64)] += [0.05, 0, 0]
    assert isinstance(_motion(TIMES, one(path), F), str)


def test_a_frame_rate_that_hides_the_swing_is_the_reason_that_is_told() -> None:
    times = np.arange(120) / 19
    found = _motion(times, one(track(0.003)), F)
    assert isinstance(found, str)
    assert found.startswith("could not be measured")
    assert "frame rate" in found


@pytest.mark.parametrize("unit", [1e-4, 1e-2])
def test_four_robust_deviations_off_the_swing_is_out_and_noise_is_not(unit: float) -> None:
    rng = np.random.default_rng(1)
    path = np.outer(np.sin(2 * np.pi * F * TIMES), [unit, unit]) + 0.1 * unit * rng.standard_normal((120, 2))
    path[30, 0] += 0.1 * unit * (OUTLIER + 2.5)
    path[60, 1] -= 0.1 * unit * (OUTLIER + 2.5)
    out = np.flatnonzero(np.isnan(without_outliers(TIMES, path, F)).all(axis=1))
    assert {30, 60} <= {*out}
    assert len(out) < 5


def test_a_track_without_noise_has_no_outliers() -> None:
    path = np.outer(np.sin(2 * np.pi * F * TIMES), [1e-3, 0, 0])
    path[7] = np.nan
    assert np.flatnonzero(np.isnan(without_outliers(TIMES, path, F)[:, 0])).tolist() == [7]


def test_overtones_are_no_outliers_where_they_are_looked_for() -> None:
    times = np.arange(120) / 60
    path = np.outer(np.sin(6 * np.pi * times) + 0.5 * np.sin(12 * np.pi * times), [1e-3, 0])
    path += 1e-6 * np.random.default_rng(0).standard_normal(path.shape)
    path[50, 0] += 1e-4
    assert np.flatnonzero(np.isnan(without_outliers(times, path, 3.0, 2)[:, 0])).tolist() == [50]
    assert not np.isnan(without_outliers(times, path, 3.0)[50]).any(), "without them all is rough"


def test_depth_counts_where_it_swings_by_more_than_its_noise() -> None:
    rng, times = np.random.default_rng(5), np.arange(90) / 60.0
    across, noise = 0.004 * np.sin(2 * np.pi * 5 * times), 0.0004 * rng.standard_normal(90)
    deep, shallow = (
        np.column_stack([across, 0 * across, 0.5 + z + noise]) for z in (0.002 * np.sin(2 * np.pi * 5 * times + 1), 0.0)
    )
    same, nothing = _without_noisy_depth(times, deep, 5.0, True)
    assert nothing == 0.0
    np.testing.assert_array_equal(same, deep)
    flat, unseen = _without_noisy_depth(times, shallow, 5.0, True)
    assert np.ptp(flat[:, 2]) < 1e-9
    assert 0 < unseen < SIGNIFICANCE * 0.0004
    flat, unseen = _without_noisy_depth(times, deep, 5.0, False)  # whose depth nothing tells
    assert np.ptp(flat[:, 2]) < 1e-9
    assert unseen > 0.001


@pytest.mark.parametrize(("noise", "sure"), [(2e-3, True), (5e-3, False)])
def test_depth_as_noisy_as_a_third_of_a_millimetre_of_amplitude_is_not_sure(noise: float, sure: bool) -> None:
    """Of 120 frames the deviation of an amplitude is 0.13 of one reading's."""
    path = track(0.001, deep_noise=noise)
    flat, unseen = _without_noisy_depth(TIMES, path, F, True)
    assert np.ptp(flat[:, 2]) < 1e-9
    whole = 0.001 * np.sqrt(1.2**2 - 1)
    assert unseen == pytest.approx(
        SIGNIFICANCE * noise * np.sqrt(2 / 120) if sure else whole, rel=0.25 if sure else 0.06
    )
    assert _without_noisy_depth(TIMES, track(0.02, 0.02, deep_noise=noise), F, True)[1] == 0.0, "a tenth of a swing"


def test_without_depth_a_flower_is_where_its_rays_pass_the_plane_of_its_median_depth() -> None:
    towards = PLACE * (1 + 0.01 * np.sin(2 * np.pi * F * TIMES))[:, None]
    flat, _ = _without_noisy_depth(TIMES, towards, F, False)
    assert np.abs(flat - PLACE).max() < 1e-4, "what comes straight towards the camera does not move across"
    across = track(0.003, noise=0, deep_noise=0)
    assert _without_noisy_depth(TIMES, across, F, False)[0] == pytest.approx(across)


def test_flowers_linked_by_gaps_smaller_than_asked_are_a_group() -> None:
    pixels = np.array([[0.0, 0], [8, 0], [8, 9], [50, 50], [58, 50], [200, 0]])
    every = np.arange(6)
    assert [g.tolist() for g in _overlapping(pixels, np.full(6, 10.0), every)] == [[0, 1, 2], [3, 4]]
    assert [g.tolist() for g in _overlapping(pixels, np.full(6, 8.5), every)] == [[0, 1], [3, 4]]
    assert [g.tolist() for g in _overlapping(pixels, np.full(6, 10.0), np.array([0, 2, 4, 5]))] == []
    assert [g.tolist() for g in _overlapping(pixels, np.full(6, 12.5), np.array([0, 2, 3]))] == [[0, 2]]
    assert _overlapping(pixels, np.full(6, 10.0), np.zeros(0, int)) == []


def test_a_lifted_path_projects_to_its_pixels_and_is_nan_where_pixel_or_depth_is() -> None:
    camera = Intrinsics(240, 180, 300.0, 200.0, 119.5, 80.0)
    path = np.array([[10.0, 20.0], [200.0, 150.0], [np.nan, np.nan], [50.0, 60.0]])
    depth = np.array([0.4, 0.9, 0.5, np.nan])
    points = _lifted(camera, path, depth)
    assert camera.project(points[:2]) == pytest.approx(path[:2])
    assert points[:2, 2] == pytest.approx(depth[:2])
    assert np.isnan(points[2:]).all()


def test_half_of_the_flowers_must_feel_as_much_as_a_breeze_gives_for_the_plant_to_count_as_moved() -> None:
    low, high = 0.9 * MOVED, 1.1 * MOVED
    assert moved([high, high, low]) is True
    assert moved([low, low, high, np.nan, np.nan]) is False
    assert moved([MOVED]) is True
    assert moved([np.nan]) is None
    assert moved([]) is None


def test_each_reason_is_one_note_that_names_its_flowers_in_order_from_one() -> None:
    unknown = np.full(5, np.nan)
    assert _notes([], {"hidden": [3, 0], "outside": []}, unknown) == ("Flowers 1, 4: hidden.",)
    assert _notes([], {"hidden": [2]}, unknown) == ("Flower 3: hidden.",)
    assert _notes([], {}, unknown) == ()
    pairs = [np.array([0, 1]), np.array([2, 4])]
    said = _notes(pairs, {"lost": [1]}, unknown)
    assert said == ("Flowers 1, 2; 3, 5 overlap in the view: their motions may be mixed up.", "Flower 2: lost.")
    assert _named([10, 2]) == "3, 11"


def test_of_flowers_that_moved_too_little_to_tell_the_largest_limit_is_told() -> None:
    at_most = np.array([np.nan, 0.0098, 0.0101, np.nan])
    assert _notes([], {}, at_most) == ("Flowers 2, 3: moved less than the camera can tell (about 10.1 mm).",)


# Pictures: yellow discs before dark leaves.

CAMERA = Intrinsics(240, 180, 400.0, 400.0, 119.5, 89.5)
RADIUS = FLOWER_RADIUS * 400 / 0.5  # px


def picture(time: float, centres: Array, depth: float = 0.5, radius: float = RADIUS) -> Frame:
    """Return yellow discs at centres (F, 2), drawn to a fraction of a pixel, with a speckle each to follow."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rgb = np.array([45.0, 100.0, 30.0]) + 12 * np.sin(0.9 * u + 0.4 * v)[..., None]
    z = np.full(u.shape, 0.95)
    for x, y in centres:
        away = np.hypot(u - x, v - y)
        cover = np.clip(radius + 0.5 - away, 0, 1)[..., None]
        petal = np.array([235.0, 210.0, 50.0]) * (1 - 0.3 * np.exp(-0.5 * (away / 1.5) ** 2))[..., None]
        rgb = rgb + cover * (petal - rgb)
        z[away < radius] = depth
    return Frame(time, np.clip(np.rint(rgb), 0, 255).astype(np.uint8), z.astype(np.float32))


def at_rest(pixels: Array, depth: float = 0.5) -> Array:
    """Return where flowers at pixels (F, 2) are, camera frame."""
    return _lifted(CAMERA, pixels, np.full(len(pixels), depth))


HOMES = np.array([[80.3, 70.6], [150.2, 110.4]])


def test_flowers_are_found_shifted_alike_and_then_each_where_its_petals_are() -> None:
    places = HOMES + np.array([[6.4, -3.8], [4.9, -2.7]])
    pixels, own = placed(picture(0.0, places), CAMERA, at_rest(HOMES))
    assert pixels == pytest.approx(places, abs=0.2)
    assert all(patch.cover > 0.9 for patch in own)
    assert [patch.radius for patch in own] == pytest.approx([RADIUS] * 2)


@pytest.mark.parametrize("off", [-0.06, 0.06])
def test_flowers_a_little_nearer_or_farther_than_they_were_are_found(off: float) -> None:
    pixels, _ = placed(picture(0.0, HOMES + 5.0, 0.5 + off), CAMERA, at_rest(HOMES))
    assert pixels == pytest.approx(HOMES + 5, abs=0.3)


@pytest.mark.parametrize("off", [-0.1, 0.12])
def test_yellow_things_far_nearer_or_farther_are_no_flowers(off: float) -> None:
    pixels, own = placed(picture(0.0, HOMES + 5.0, 0.5 + off), CAMERA, at_rest(HOMES))
    assert all(patch.cover == 0 for patch in own)
    assert np.abs(pixels - HOMES - 5).max() > 1


def test_flowers_at_several_depths_are_looked_for_from_before_the_nearest_to_behind_the_farthest() -> None:
    rest = np.concatenate([at_rest(HOMES[:1], 0.45), at_rest(HOMES[1:], 0.62)])
    frame, far = picture(0.0, HOMES[:1] + 3, 0.40), picture(0.0, HOMES[1:] + 3, 0.67)
    both = far.depth > 0.9
    frame.rgb[~both], frame.depth[~both] = far.rgb[~both], far.depth[~both]
    pixels, _ = placed(frame, CAMERA, rest)
    assert pixels == pytest.approx(HOMES + 3, abs=0.3)


def test_in_a_crowd_flowers_are_looked_for_where_they_should_be() -> None:
    """The petals' middle would be that of the crowd; of two farther apart each has its own."""
    for apart, crowded in ((0.8 * 2.0 * RADIUS, True), (1.7 * 2.0 * RADIUS, False)):
        homes = np.array([[90.0, 80.0], [90.0 + apart, 80.0]])
        shown = homes + np.array([[0.0, 0.0], [0.0, 1.6]])
        pixels, _ = placed(picture(0.0, shown), CAMERA, at_rest(homes))
        whole = pixels - homes
        assert (np.abs(whole - np.rint(whole)).max() < 1e-6) == crowded


def swinging(size: float, count: int = 40, hertz: float = F, rate: float = 60.0) -> tuple[Array, list[Frame], Array]:
    """Return times, a film of one flower that swings by `size` [px] across and a third down, and where it is (T, 2)."""
    times = 5.0 + np.arange(count) / rate
    places = HOMES[:1] + np.outer(np.sin(2 * np.pi * hertz * times + 0.5), [size, size / 3])
    return times, [picture(float(t), p[None]) for t, p in zip(times, places, strict=True)], places


def test_following_begins_where_flowers_stand_most_like_at_rest() -> None:
    _, frames, places = swinging(9.0, 12)
    begin = _begin(frames, CAMERA, at_rest(HOMES[:1]))
    assert begin.frame == np.argmin(np.linalg.norm(places - HOMES[0], axis=1))
    assert begin.pixels[0] == pytest.approx(places[begin.frame], abs=0.2)
    assert begin.wide[0].weight.shape[0] > 1.7 * begin.own[0].weight.shape[0], "twice as far around"


def test_a_flower_with_its_surroundings_reaches_twice_as_far_in_depth_too() -> None:
    frame = picture(0.0, HOMES[:1])
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    around = np.hypot(u - HOMES[0, 0], v - HOMES[0, 1]) < 1.4 * RADIUS
    stalk = around & (frame.depth > 0.9)
    frame.rgb[stalk], frame.depth[stalk] = (120, 115, 110), 0.54
    begin = _begin([frame], CAMERA, at_rest(HOMES[:1]))
    assert np.count_nonzero(begin.own[0].weight) < 1.2 * np.pi * RADIUS**2
    assert np.count_nonzero(begin.wide[0].weight) > 1.7 * np.pi * RADIUS**2


@pytest.mark.parametrize("size", [0.5, 3.0, 8.0])
def test_a_flower_is_followed_on_and_back_from_where_it_begins(size: float) -> None:
    _, frames, places = swinging(size)
    rest = at_rest(HOMES[:1])
    begin = _begin(frames, CAMERA, rest)
    path = _path(frames, begin, 0, F) + begin.pixels[0] - begin.own[0].centre
    assert path == pytest.approx(places, abs=0.25)
    found, mixed, remarks = follow_flowers(frames, CAMERA, rest, F)
    assert not mixed
    assert not any(remarks.values())
    assert found[0].track == pytest.approx(_lifted(CAMERA, places, np.full(40, 0.5)), abs=4e-4)
    assert found[0].pixel == pytest.approx(0.5 / 400)
    assert found[0].deep
    assert not found[0].mixed


def test_a_flower_hidden_for_some_frames_is_missing_in_them_only() -> None:
    _, frames, places = swinging(4.0, 60)
    for frame in frames[20:24]:
        frame.rgb[40:100, 50:110], frame.depth[40:100, 50:110] = (40, 90, 30), 0.3
    found, _, _ = follow_flowers(frames, CAMERA, at_rest(HOMES[:1]), F)
    assert np.flatnonzero(np.isnan(found[0].track[:, 0])).tolist() == [20, 21, 22, 23]
    assert CAMERA.project(found[0].track[24:]) == pytest.approx(places[24:], abs=0.3)


def test_who_is_outside_or_hidden_is_said_and_only_the_others_are_followed() -> None:
    _, frames, _ = swinging(1.0, 8)
    homes = np.vstack([HOMES[:1], [[-9.0, 70.0]], [[150.0, 30.0]], [[250.0, 70.0]], [[80.0, 189.0]]])
    found, _, remarks = follow_flowers(frames, CAMERA, at_rest(homes), F)
    assert [f.flower for f in found] == [0]
    assert remarks == {"outside the side camera's picture": [1, 3, 4], "hidden from the side camera": [2]}


def test_flowers_that_may_be_mixed_up_are_marked_and_others_are_not() -> None:
    homes = np.array([[80.0, 70.0], [80.0 + 1.3 * RADIUS, 70.0], [170.0, 110.0]])
    frames = [picture(i / 60, homes) for i in range(8)]
    found, mixed, _ = follow_flowers(frames, CAMERA, at_rest(homes), F)
    assert [group.tolist() for group in mixed] == [[0, 1]]
    assert [f.mixed for f in found] == [True, True, False]


def test_a_flower_at_the_camera_stops_all_following() -> None:
    rest = np.vstack([at_rest(HOMES[:1]), [[0.0, 0.0, 0.05]]])
    assert follow_flowers([], CAMERA, rest, F)[2] == {"not in front of the side camera": [0, 1]}
    assert follow_flowers([], CAMERA, np.zeros((0, 3)), F)[0] == []


def disc() -> NDArray[np.float32]:
    return (np.hypot(*np.mgrid[-6:7, -6:7]) < 5).astype(np.float32)


@pytest.mark.parametrize(("unread", "sure"), [(15, True), (22, False), (120, False)])
def test_depth_is_sure_if_it_is_read_in_four_of_five_frames_in_which_the_flower_is_seen(
    unread: int, sure: bool
) -> None:
    """Of 120 frames it is seen in 90."""
    path = np.tile([24.0, 24.0], (120, 1))
    path[90:] = np.nan
    frames = [Frame(float(t), np.zeros((48, 48, 3), np.uint8), np.full((48, 48), 0.51, np.float32)) for t in TIMES]
    for frame in frames[:unread]:
        frame.depth[:] = 0.0
    patch = Patch(np.zeros((13, 13, 3), np.float32), disc(), np.array([24, 24]), 4.0)
    told, depth = _depth(frames, patch, path, F, 0.5)
    assert told == sure
    assert depth[unread:90] == pytest.approx(0.51 if sure else 0.5, abs=1e-4)
    assert len(depth) == 120
    assert np.isfinite(depth).all() != sure
