"""The experiment on the response: its numbers from rows whose answer is known."""

from __future__ import annotations

import pytest

from evaluation.prediction import response as response_experiment  # pyright: ignore[reportMissingImports]


def measured(true: float, amplitude: float | None, *, in_sight: bool = True) -> response_experiment.Measured:
    seen = amplitude is not None
    return response_experiment.Measured(
        true, true, in_sight, True, amplitude, amplitude, 1e-4 if seen else None, 5.02 if seen else None, 5.0, 60.0
    )


def test_a_measurement_is_right_within_a_tenth_or_three_tenths_of_a_millimetre() -> None:
    rows = [measured(1e-3, 1.25e-3), measured(1e-2, 1.2e-2), measured(1e-3, None), measured(1e-3, 3e-3, in_sight=False)]
    found = response_experiment.metrics(rows, [measured(1e-3, None)])
    assert found["in_sight"] == 3
    assert found["measured"] == pytest.approx(2 / 3)
    assert found["within"] == 0.5
    assert found["frequency_within"] == 1.0
    assert found["honest"] == 0.0
    assert found["hidden_but_measured"] == 1
    assert (found["blind_flowers"], found["blind_refused"]) == (1, 1)
    assert found["12mm_in_sight"] == 1
