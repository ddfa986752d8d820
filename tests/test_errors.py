"""Errors keep what they say on their way between processes."""

from __future__ import annotations

import pickle

from anther.errors import InputError, StageFailure, bad_input


def test_errors_survive_pickling() -> None:
    failure = pickle.loads(pickle.dumps(StageFailure("no_stem_found", "no stem. Look again.")))
    assert (type(failure), failure.kind, str(failure)) == (StageFailure, "no_stem_found", "no stem. Look again.")
    wrong = pickle.loads(pickle.dumps(bad_input("radius", given="-1 m", allowed="> 0", do="Check the unit.")))
    assert isinstance(wrong, InputError)
    assert str(wrong) == "radius: got -1 m; allowed: > 0. Check the unit."
