"""What overtones do to the peak of a flower's acceleration, and to what is said of its pedicel."""

from __future__ import annotations

import numpy as np
import pytest
from made_foresight import ALONG, FLOWERS, TONES, made_foresight

from anther.pollination.escalation._knowledge import (
    SIGNIFICANCE,
    Answer,
    extrapolate_growth,
    measure_sharpness,
    predict,
)
from anther.pollination.response.points import Swings
from anther.pollination.response.thresholds import overtones

OWN = slice(0, 2)


def seen(second: complex, error: float = 1e-6) -> Swings:
    """Return two flowers that swing by 1 mm across, and by so much of that at twice the frequency [m]; then a point."""
    phasors, over = np.zeros((3, 1, 3), complex), np.zeros((3, 2, 3), complex)
    phasors[:, 0, 0], over[0, 0, 0] = 1e-3, 1e-3 * second
    phasors[1:, 0, 2] = over[1:, :, 2] = np.nan
    return Swings(phasors, np.full((3, 3), error), np.tile(np.eye(3), (3, 1, 1)), 0.0, over)


@pytest.mark.parametrize("second", [0.0, 0.05, 0.5, 0.5j, -1.0 + 0.3j])
def test_the_peak_is_that_of_the_sum_whose_second_part_counts_four_times(second: complex) -> None:
    t = np.linspace(0, 1, 5000)
    path = np.imag(np.exp(2j * np.pi * t)) + 4 * np.imag(second * np.exp(4j * np.pi * t))
    assert measure_sharpness(seen(second), OWN) == pytest.approx([np.abs(path).max(), 1.0], rel=0.01)


def test_an_overtone_within_its_error_does_not_count() -> None:
    error = 0.1e-3
    least = SIGNIFICANCE * np.sqrt(3) * error / 1e-3
    assert measure_sharpness(seen(0.9 * least, error), OWN) == pytest.approx([1.0, 1.0])
    assert measure_sharpness(seen(1.1 * least, error), OWN)[0] > 1.5
    assert measure_sharpness(seen(0.5)._replace(overtones=np.zeros((0, 0, 3), complex)), OWN) == pytest.approx(
        [1.0, 1.0]
    )


def test_a_swing_that_still_grows_keeps_its_shape() -> None:
    grown = extrapolate_growth(seen(0.5)._replace(growing=1.0), 5.0)
    assert np.abs(grown.phasors[0, 0, 0]) > 1e-3
    assert measure_sharpness(grown, OWN) == pytest.approx(measure_sharpness(seen(0.5), OWN))


def test_overtones_are_looked_for_where_swings_are_large_enough() -> None:
    assert [overtones(hertz) for hertz in (0.5, 5.0, 8.0, 8.08, 40.0)] == [2] * 3 + [0] * 2


def test_a_flower_whose_acceleration_is_sharper_feels_more_and_bends_its_pedicel_as_much_more() -> None:
    foresight = made_foresight(1)
    members = foresight.of(0, ALONG)
    shown = np.asarray(members[3, foresight.where["flowers"]])
    axes, std = np.repeat(np.eye(3)[None], FLOWERS, axis=0), np.full((FLOWERS, 3), 1e-6)
    plain, sharp = (
        predict(foresight, float(TONES[0]), Answer(members, shown, std, axes, np.full(FLOWERS, peak)), 0.0)
        for peak in (1.0, 2.5)
    )
    assert sharp.flowers == pytest.approx(2.5 * plain.flowers)
    assert sharp.loads["joint_strain"] == pytest.approx(2.5 * plain.loads["joint_strain"])
    assert {k: v for k, v in sharp.loads.items() if k != "joint_strain"} == pytest.approx(
        {k: v for k, v in plain.loads.items() if k != "joint_strain"}
    )
    assert sharp.answer.flowers == pytest.approx(2.5 * plain.answer.flowers)
    assert sharp.phasors == pytest.approx(plain.phasors), "where it is looked for next is where it swings"
