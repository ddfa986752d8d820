"""The sinusoid fit: swings of known amplitude, phase, offset and overtones, and what samples cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.core.geometry import Array
from anther.core.oscillation import (
    _slow_terms,
    alias,
    choose_rate,
    find_frequency,
    fit_swing,
    peak,
    swing_basis,
)

RATES = (15.0, 30.0, 60.0, 90.0)
"""Of a camera [1/s]."""
TIMES = 40.0 + np.arange(90) / 60
"""Of samples that do not begin at 0 [s]."""


def wave(amplitude: complex, frequency: float, times: Array = TIMES) -> Array:
    """Return Im(amplitude exp(2 pi i f t)) (T,)."""
    return np.imag(amplitude * np.exp(2j * np.pi * frequency * times))


@settings(max_examples=40)
@given(
    amplitude=st.floats(1e-4, 0.05),
    frequency=st.floats(0.7, 35),
    phase=st.floats(0, 6.28),
    drift=st.floats(-0.01, 0.01),
)
def test_the_fit_is_exact_on_a_sinusoid(amplitude: float, frequency: float, phase: float, drift: float) -> None:
    rate = choose_rate(frequency, RATES)
    times = np.arange(90) / rate
    direction = np.array([0.6, 0.0, 0.8])
    path = np.outer(amplitude * np.sin(2 * np.pi * frequency * times + phase), direction) + drift * times[:, None]
    swing = fit_swing(times, path, frequency)
    assert swing.amplitude == pytest.approx(amplitude, rel=1e-6)
    assert abs(swing.direction @ direction) == pytest.approx(1, abs=1e-6)
    assert swing.at(times) == pytest.approx(path, abs=1e-9)


@pytest.mark.parametrize("second", [0.0, 0.3, -0.8])
def test_overtones_are_told_from_the_tone_as_far_as_the_samples_tell_them(second: float) -> None:
    for rate, told in ((60.0, 2), (10.03, 0)):
        times = np.arange(90) / rate
        phase = 2 * np.pi * 5 * times
        path = 0.002 * np.outer(np.sin(phase) + (second if told else 0) * np.sin(2 * phase + 1), [0.6, 0.0, 0.8])
        swing, plain = fit_swing(times, path, 5.0, overtones=2), fit_swing(times, path, 5.0)
        assert (swing.overtones, plain.overtones) == (told, 0)
        assert swing.amplitude == pytest.approx(0.002, rel=1e-6)
        assert swing.at(times) == pytest.approx(path, abs=1e-9)
        turn = np.linspace(0, 2 * np.pi, 1000)
        sharper = np.abs(np.sin(turn) + 4 * (second if told else 0) * np.sin(2 * turn + 1)).max()
        assert swing.acceleration() == pytest.approx(sharper * 0.002 * (10 * np.pi) ** 2, rel=1e-2)
        assert plain.acceleration() == pytest.approx(plain.amplitude * (10 * np.pi) ** 2)


def test_overtones_along_axes_that_do_not_count_sharpen_nothing() -> None:
    times = np.arange(90) / 60
    deep = 0.002 * np.outer(np.sin(10 * np.pi * times) + 0.5 * np.sin(20 * np.pi * times), [0, 0, 1.0])
    swing = fit_swing(times, deep, 5.0, overtones=2)
    assert swing.acceleration(axes=2) == pytest.approx(0.002 * (10 * np.pi) ** 2, rel=0.01)
    assert swing.acceleration() > 1.5 * swing.acceleration(axes=2)


@given(begin=st.floats(-100, 100), phase=st.floats(0, 6.28))
def test_the_phase_is_on_the_clock_of_the_samples_wherever_it_begins(begin: float, phase: float) -> None:
    times = begin + np.arange(90) / 60
    path = np.outer(0.002 * np.sin(2 * np.pi * 5 * times + phase), [1.0, 0, 0])
    assert np.exp(1j * fit_swing(times, path, 5.0).phase) == pytest.approx(np.exp(1j * phase), abs=1e-6)


def test_a_rate_of_twice_the_frequency_is_refused_not_guessed() -> None:
    times = np.arange(60) / 60
    with pytest.raises(InputError, match="frame rate"):
        fit_swing(times, np.zeros((60, 3)), 30.0)


def test_the_stated_deviation_is_honest() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(90) / 60
    clean = np.outer(0.002 * np.sin(2 * np.pi * 5 * times), [1.0, 0, 0])
    swings = [fit_swing(times, clean + rng.normal(0, 0.0005, clean.shape), 5.0) for _ in range(200)]
    assert np.std([s.amplitude for s in swings]) == pytest.approx(np.mean([s.amplitude_std for s in swings]), rel=0.2)


def test_the_stated_deviation_is_of_that_phase_which_the_frames_tell_worse() -> None:
    """At nearly half the frame rate they tell the cosine well and the sine hardly, or the other way about."""
    rng, times = np.random.default_rng(1), np.arange(40) / 60
    swings = [fit_swing(times, rng.normal(0, 1e-4, (40, 3)), 29.8) for _ in range(300)]
    cosine, sine = np.std([s.coefficients[:2, 0] for s in swings], axis=0)
    assert max(cosine, sine) > 1.5 * min(cosine, sine)
    assert np.mean([s.axis_std[0] for s in swings]) == pytest.approx(max(cosine, sine), rel=0.15)


@given(st.integers(8, 200), st.floats(0.5, 100), st.floats(5, 120))
def test_slow_terms_are_at_most_a_quarter_of_the_frames_and_two(count: int, frequency: float, rate: float) -> None:
    assert 2 <= _slow_terms(np.arange(count) / rate, frequency) <= 2 + count / 4


@pytest.mark.parametrize(("frequency", "terms"), [(0.5, 2), (3.0, 5), (57.0, 5), (20.0, 2 + 61 // 4)])
def test_slow_terms_are_slower_than_what_the_frames_show(frequency: float, terms: int) -> None:
    """57 Hz at 60 frames a second look like 3."""
    assert _slow_terms(np.arange(61) / 60, frequency) == terms


def test_frequency_is_found_near_the_hint() -> None:
    times = np.arange(120) / 60
    path = np.outer(np.sin(2 * np.pi * 4.83 * times), [0.001, 0.0005, 0])
    assert find_frequency(times, path, 5.0) == pytest.approx(4.83, rel=1e-3)


def test_a_swing_on_a_line_points_along_its_largest_component_whichever_way_it_went() -> None:
    for way in ([-0.6, 0.0, -0.8], [0.6, 0.0, 0.8], [-0.8, 0.6, 0.0], [0.6, -0.8, 0.0]):
        swing = fit_swing(TIMES, np.outer(wave(0.002, 5.0), way), 5.0)
        largest = np.argmax(np.abs(way))
        assert swing.direction[largest] == pytest.approx(0.8)
        turned = np.pi if way[largest] < 0 else 0.0
        assert np.exp(1j * swing.phase) == pytest.approx(np.exp(1j * turned), abs=1e-6)


def test_of_an_ellipse_the_long_half_axis_is_the_amplitude() -> None:
    path = np.column_stack([wave(0.001, 5.0), 0 * TIMES, wave(0.003j, 5.0)])
    swing = fit_swing(TIMES, path, 5.0)
    assert swing.amplitude == pytest.approx(0.003)
    assert swing.direction == pytest.approx([0, 0, 1], abs=1e-6)
    assert swing.acceleration() == pytest.approx(0.003 * (10 * np.pi) ** 2)


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_path_may_have_any_number_of_axes(axes: int) -> None:
    swing = fit_swing(TIMES, wave(0.002, 5.0)[:, None] * np.ones(axes), 5.0)
    assert swing.amplitude == pytest.approx(0.002 * np.sqrt(axes))
    assert swing.at(TIMES).shape == (90, axes)
    assert swing.direction == pytest.approx(np.full(axes, 1 / np.sqrt(axes)))


def test_samples_that_are_missing_are_left_out_and_seven_are_too_few() -> None:
    path = np.outer(wave(0.002, 5.0), [0.6, 0.0, 0.8])
    path[10:20, 1] = np.nan
    assert fit_swing(TIMES, path, 5.0).amplitude == pytest.approx(0.002)
    assert fit_swing(TIMES[:8], path[:8], 5.0).amplitude == pytest.approx(0.002)
    with pytest.raises(InputError, match="7 samples"):
        fit_swing(TIMES[:7], path[:7], 5.0)
    path[2:, 0] = np.nan
    with pytest.raises(InputError, match="2 samples"):
        fit_swing(TIMES, path, 5.0)


def test_a_fit_between_its_samples_and_about_an_offset_goes_on_as_the_swing_does() -> None:
    between = TIMES[:-1] + 1 / 120
    path = [0.5, -0.2] + np.outer(wave(0.002j, 5.0), [0.6, 0.8]) + 0.01 * (TIMES - 40)[:, None]
    truth = [0.5, -0.2] + np.outer(wave(0.002j, 5.0, between), [0.6, 0.8]) + 0.01 * (between - 40)[:, None]
    assert fit_swing(TIMES, path, 5.0).at(between) == pytest.approx(truth, abs=1e-9)


def test_the_deviation_of_few_samples_is_honest_too() -> None:
    """20 samples and 8 numbers that are fitted to them: taken for 20 spare ones, the noise would be told too small."""
    rng, times = np.random.default_rng(2), TIMES[:20]
    clean = np.outer(wave(0.01, 7.0, times), [1.0, 0.0])
    swings = [fit_swing(times, clean + rng.normal(0, 0.0005, clean.shape), 7.0) for _ in range(400)]
    assert len(swings[0].coefficients) >= 6
    noise = np.sqrt(np.mean([s.axis_std**2 for s in swings]))
    true = np.sqrt(np.mean([np.sum((s.coefficients[:2, 1]) ** 2) for s in swings]) / 2)
    assert noise == pytest.approx(true, rel=0.12)


def test_noise_across_a_swing_does_not_make_its_amplitude_unsure() -> None:
    rng = np.random.default_rng(3)
    swing = fit_swing(TIMES, np.column_stack([wave(0.01, 5.0), rng.normal(0, 1e-4, 90)]), 5.0)
    assert swing.amplitude_std < 0.05 * swing.axis_std[1]
    assert swing.axis_std[0] < 0.01 * swing.axis_std[1]


@pytest.mark.parametrize(("count", "told"), [(12, 0), (40, 2)])
def test_overtones_want_twice_as_many_samples_as_numbers_that_are_fitted(count: int, told: int) -> None:
    times = TIMES[:count]
    swing = fit_swing(times, wave(0.001, 8.0, times)[:, None], 8.0, overtones=2)
    assert swing.overtones == told
    assert told == 0 or count > 2 * len(swing.coefficients)


def test_as_many_overtones_are_fitted_as_few_samples_allow() -> None:
    """Each overtone is two more numbers."""
    swings = [fit_swing(TIMES[:n], wave(1e-3, 8.0)[:n, None], 8.0, overtones=2) for n in range(8, 60)]
    for count, swing in enumerate(swings, start=8):
        numbers = len(swing.coefficients)
        assert swing.overtones == 0 or count > 2 * numbers
        assert swing.overtones == 2 or count <= 2 * (numbers + 2)
    assert {swing.overtones for swing in swings} == {0, 1, 2}


def test_a_tone_that_is_told_badly_but_told_is_fitted_without_overtones() -> None:
    times = np.arange(40) / 60
    swing = fit_swing(times, wave(0.002, 29.5, times)[:, None], 29.5, overtones=2)
    assert swing.overtones == 0
    assert swing.amplitude == pytest.approx(0.002)


def test_overtones_below_what_can_be_told_do_not_sharpen_a_swing() -> None:
    path = np.column_stack([wave(2e-3, 5.0) + wave(1e-3, 10.0) + wave(1e-4, 15.0), 0 * TIMES])
    swing = fit_swing(TIMES, path, 5.0, overtones=2)
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    omega2 = (10 * np.pi) ** 2
    two = np.abs(2e-3 * np.sin(turn) + 4e-3 * np.sin(2 * turn)).max()
    three = np.abs(2e-3 * np.sin(turn) + 4e-3 * np.sin(2 * turn) + 9e-4 * np.sin(3 * turn)).max()
    assert swing.acceleration() == pytest.approx(omega2 * three)
    assert swing.acceleration(least=5e-4) == pytest.approx(omega2 * two)
    assert swing.acceleration(least=1.5e-3) == pytest.approx(omega2 * 2e-3)
    assert swing.acceleration(least=1.0) == pytest.approx(omega2 * 2e-3), "the tone itself always counts"


def test_the_peak_of_tones_counts_each_by_the_square_of_its_order() -> None:
    def of(*phasors: complex) -> float:
        return float(peak(np.array(phasors)[:, None] * [0.6, 0.0, 0.8]))

    assert of(1.0) == pytest.approx(1.0)
    assert of(2j) == pytest.approx(2.0)
    assert of(0.0, 1.0) == pytest.approx(4.0)
    assert of(0.0, 0.0, 1.0) == pytest.approx(9.0)
    assert of(1j, 0.5j) == pytest.approx(3.0), "both reach their tops at once"
    assert peak(np.ones((4, 2, 3))).shape == (4,)


def test_what_is_fitted_is_cosine_sine_their_overtones_and_polynomials_over_the_record() -> None:
    times = 7.0 + np.arange(61) / 60
    basis = swing_basis(times, 5.0, 1)
    phase = 2 * np.pi * 5 * (times - 7)
    expected = [np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)]
    assert basis[:, :4] == pytest.approx(np.column_stack(expected), abs=1e-9)
    slow = basis[:, 4:]
    assert slow.shape[1] == _slow_terms(times, 5.0)
    assert slow[-1] == pytest.approx(np.ones(slow.shape[1])), "Legendre's are 1 at the end"
    assert slow[0] == pytest.approx((-1.0) ** np.arange(slow.shape[1])), "and 1 or -1 where they begin"
    assert slow[:, 1] == pytest.approx(np.linspace(-1, 1, 61))


@pytest.mark.parametrize("true", [4.52, 4.83, 5.0, 5.2, 5.48])
@pytest.mark.parametrize("seconds", [0.5, 2.0, 12.0])
def test_a_frequency_within_a_tenth_of_the_hint_is_found_in_short_and_long_records(true: float, seconds: float) -> None:
    times = TIMES[0] + np.arange(int(60 * seconds)) / 60
    path = np.outer(wave(0.001j, true, times), [1.0, -0.5]) + 0.1
    path[3, 1] = np.nan
    assert find_frequency(times, path, 5.0) == pytest.approx(true, rel=1e-3)


@pytest.mark.parametrize(("hint", "seconds"), [(5.0, 0.2), (5.0, 3.0), (0.5, 2.5)])
def test_a_frequency_far_from_the_hint_is_not_found(hint: float, seconds: float) -> None:
    times = TIMES[0] + np.arange(int(60 * seconds)) / 60
    for true in (0.6 * hint, 1.6 * hint):
        found = find_frequency(times, wave(0.001, true, times)[:, None], hint)
        assert 0.84 * hint < found < 1.16 * hint


@pytest.mark.parametrize(
    ("frequency", "rate", "seen"),
    [(5, 60, 5), (30, 60, 30), (57, 60, 3), (61, 60, 1), (60, 60, 0), (150, 60, 30), (27, 30, 3), (44, 30, 14)],
)
def test_a_frequency_shows_up_as_its_distance_from_the_nearest_multiple_of_the_rate(frequency, rate, seen) -> None:
    assert alias(frequency, rate) == pytest.approx(seen)


@pytest.mark.parametrize(
    ("frequency", "rate"), [(1.0, 15), (1.9, 30), (3.75, 30), (5.0, 60), (12.0, 15), (14.0, 60), (20.0, 90)]
)
def test_the_slowest_rate_of_eight_frames_a_period_is_chosen_else_the_one_that_tells_the_phase(frequency, rate) -> None:
    assert choose_rate(frequency, (90, 15, 60, 30)) == rate


@given(st.floats(0.5, 40))
def test_the_rate_that_is_chosen_tells_the_phase(frequency) -> None:
    rate = choose_rate(frequency, (15.0, 30.0, 60.0, 90.0))
    assert rate >= 8 * frequency or 0.05 < alias(frequency, rate) / rate < 0.45


def test_frames_that_tell_one_of_sine_and_cosine_do_not_tell_the_phase() -> None:
    times = np.arange(60) / 60
    with pytest.raises(InputError, match="frame rate"):
        fit_swing(times, np.zeros((60, 3)), 29.98)
    slow = np.arange(40) / 30  # twice 7.47 Hz is nearly half the rate
    assert fit_swing(slow, wave(1e-3, 7.47, slow)[:, None], 7.47, overtones=1).overtones == 0
    assert fit_swing(slow, wave(1e-3, 6.4, slow)[:, None], 6.4, overtones=1).overtones == 1
