"""The experiments on learning and on the response: their numbers from rows whose answer is known, and going on."""

from __future__ import annotations

from dataclasses import asdict
from datetime import datetime
from pathlib import Path

import learning  # pyright: ignore[reportMissingImports]
import numpy as np
import pytest
import response as response_experiment  # pyright: ignore[reportMissingImports]
from learning_figure import draw  # pyright: ignore[reportMissingImports]

from anther.history import starting_material
from anther.plant import TOMATO


def visit(arm: str, ratio: float, gain: float = 1.0) -> learning.Visit:
    true = [ratio * 1e-3, ratio * 2e-3]
    after = TOMATO.changed(response_gain=gain, response_spread=0.2)
    return learning.Visit(
        arm, "because", (9.0, 5e-4), [1e-3, 2e-3], [5e-4, 1e-3], [2e-3, 4e-3], true, [true[0], None],
        freed=0.1, acceleration=4.0, strain=0.2, before=asdict(TOMATO), after=asdict(after),
    )  # fmt: skip


def test_errors_bias_and_coverage_are_those_of_the_rows() -> None:
    found = learning.summary([visit("facts", 0.4), visit("facts", 1.0)])
    assert found["bias"] == pytest.approx(np.log(0.4) / 2)
    assert found["error"] == pytest.approx(-np.log(0.4) / 2)
    assert found["within"] == 0.5
    assert found["freed"] == pytest.approx(0.1)
    nothing = learning.Visit("facts", "no", None, [], [], [], [], [], 0.0, 0.0, 0.0, {}, {})
    assert learning.summary([visit("facts", 1.0), nothing])["freed"] == pytest.approx(0.05)


def test_a_crop_s_plants_teach_those_after_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def visits(species: str, seed: int, history: Path, day: datetime, truth: str) -> list[learning.Visit]:
        done = [visit(arm, 0.5, 0.5) for arm in learning.ARMS]
        learning.record(species, seed, done[1], history, day)
        return done

    monkeypatch.setattr(learning, "visits", visits)
    row = learning.one_crop({"species": "tomato", "first": 1, "plants": 3, "truth": "nominal"}, tmp_path)
    rows = [[learning.Visit(**one) for one in plant] for plant in row["visits"]]
    assert [len(plant) for plant in rows] == [3, 3, 3]
    learned = starting_material("tomato", "next", tmp_path / "history.sqlite")
    assert (learned.source, learned.plants) == ("crop", 3)
    assert row["learned"] == asdict(learned.material)
    assert learned.material.response_gain < 0.8
    found = learning.metrics("tomato", rows, learned.material)
    assert found["tomato_plants"] == 3
    assert found["tomato_crop_bias"] == pytest.approx(np.log(0.5))
    assert len(draw({"tomato": rows}).axes) == 3


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
    assert response_experiment.draw(rows).axes
