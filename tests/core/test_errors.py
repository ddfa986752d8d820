"""Errors keep what they say on their way between processes."""

from __future__ import annotations

import pickle

import pytest

from anther.core.checks import check_array
from anther.core.errors import InputError, StageFailure, bad_input
from anther.robot.devices import DeviceError


def test_errors_survive_pickling() -> None:
    failure = pickle.loads(pickle.dumps(StageFailure("no_stem_found", "no stem. Look again.")))
    assert (type(failure), failure.kind, str(failure)) == (StageFailure, "no_stem_found", "no stem. Look again.")
    refused = pickle.loads(pickle.dumps(DeviceError("the arm stopped")))
    assert (type(refused), refused.kind, str(refused)) == (DeviceError, "device_fault", "the arm stopped")
    wrong = pickle.loads(pickle.dumps(bad_input("radius", given="-1 m", allowed="> 0", do="Check the unit.")))
    assert isinstance(wrong, InputError)
    assert str(wrong) == "radius: got -1 m; allowed: > 0. Check the unit."


@pytest.mark.parametrize(
    ("value", "dtype"), [([1 + 2j], "float64"), ([1.0, float("nan")], "int64"), ([float("inf")], "uint8")]
)
def test_numbers_that_numpy_would_change_are_refused(value: list[complex], dtype: str) -> None:
    with pytest.raises(InputError, match="allowed: numbers"):
        check_array("parents", value, (None,), dtype=dtype)
