"""What summary and report say of a watched shake, and of one whose plan alone was carried out."""

from __future__ import annotations

import json
from dataclasses import replace
from html import escape
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from anther.cli.args.trial import Args
from anther.cli.trial import _params
from anther.core.errors import InputError
from anther.plant import ShakeRecord, Visit
from anther.pollination.execution import Step, Trial
from anther.pollination.pipeline import Params
from anther.show.pictures.report import draw_steps
from anther.show.report import write_report
from anther.show.results import RunResults, watched_words
from anther.show.summary import _camera_results

NAN = float("nan")
PROBE = Step(
    10.5,
    11.9,
    (8.0, 3.0),
    (2e-4, 5e-4),
    (0.0, 1.0, 0.0),
    (4.0, NAN, 6.0),
    {"the bending of pedicels": 0.3, "slip": 0.2},
    "At 8 Hz.",
    0.2,
)
RAISED = Step(
    12.5,
    13.0,
    (8.0,),
    (1e-3,),
    (0.0, 1.0, 0.0),
    (9.0, 7.0, 20.0),
    {"the bending of pedicels": 0.4, "slip": 0.8},
    "Held: slip.",
    0.1,
)
LAST = replace(RAISED, begin=14.0, end=16.0, flowers=(8.0, NAN, NAN), decided="Held long enough.")
STEPS = (PROBE, RAISED, LAST)


def trial_of(*steps: Step, shaken: bool = True) -> Trial:
    times = np.linspace(10, 16.5, 5) if shaken else np.zeros(0)
    joints = np.zeros((len(times), 7))
    none = np.zeros((0, 2))
    return Trial((), none, times, joints, joints, np.zeros((0, 3)), np.zeros(0), "finished", steps=steps)


def told(trial: Trial, alone: str | None = None) -> Visit:
    """A visit of which only the shake is known."""
    watched = _camera_results(cast(Any, SimpleNamespace(trial=trial, alone=alone)))
    times = trial.shake_times
    return Visit(
        "tomato", "1", True, shake=ShakeRecord(8.0, 1e-3, float(np.ptp(times)) if len(times) else 0.0), **watched
    )


def test_trial_json_has_every_step_and_what_was_reached(tmp_path: Path) -> None:
    told(trial_of(*STEPS)).save(tmp_path / "trial.json")
    said = json.loads((tmp_path / "trial.json").read_text())
    assert (said["shake_steps"], said["shake_duration_s"], said["plan_alone_because"]) == (3, 6.5, None)
    assert (said["step_share_of_limit"], said["step_closest_limit"]) == (0.8, "slip")
    assert said["step_flower_acceleration_median_ms2"] == 8.0, "of the flowers that were measured in the last step"
    assert said["shake_ended_by"] == "Held: slip. Held long enough."
    first, second, _ = said["steps"]
    assert (first["begin_s"], first["end_s"]) == pytest.approx((0.5, 1.9)), "since the shake began"
    assert first["flower_acceleration_ms2"] == [4.0, None, 6.0]
    assert (first["flower_acceleration_median_ms2"], first["flower_acceleration_most_ms2"]) == (5.0, 6.0)
    assert (second["frequencies_hz"], second["amplitudes_m"]) == ([8.0], [1e-3])
    assert second["share_of_limits"] == RAISED.loads


def test_the_line_says_steps_flowers_limit_and_end() -> None:
    words = watched_words(told(trial_of(*STEPS)))
    for part in ("3 steps in 6.5 s", "8.0 m/s² (median)", "80% of the closest limit (slip)", "Held: slip."):
        assert part in words
    unseen = replace(LAST, flowers=(NAN, NAN, NAN))
    assert "no flower was measured" in watched_words(Visit.of(told(trial_of(PROBE, unseen)).flat()))


NOTHING = replace(PROBE, flowers=(NAN,) * 3, decided="Nothing is in sight: the plan alone is carried out.")


@pytest.mark.parametrize(
    ("steps", "alone", "why"),
    [
        ((), "there is no side camera", "no side camera"),
        ((), None, "ended before anything was seen"),
        ((NOTHING, LAST), None, "nothing was in the side camera's sight"),
    ],
)
def test_the_plan_alone_is_said_with_its_reason(steps: tuple[Step, ...], alone: str | None, why: str) -> None:
    said = told(trial_of(*steps), alone)
    assert why in (said.plan_alone_because or "")
    assert "the plan alone was carried out" in watched_words(said)


def test_a_trial_that_never_shook_says_nothing_of_steps() -> None:
    never = told(trial_of(shaken=False))
    assert (never.shaken, never.flat()["shake_steps"], never.ended_by, never.steps) == (False, None, None, ())


def test_the_flags_change_what_is_watched_and_kept() -> None:
    assert _params(Args(), None) == Params()
    assert not _params(Args(watch=False), None).escalate
    paper, bold = _params(Args(shake="paper"), None), _params(Args(shake="bold"), None)
    assert not paper.escalate, "the paper's shake is not raised"
    assert not paper.shake.keeps_limits
    assert bold.escalate
    assert bold.shake.price < Params().shake.price


@pytest.mark.parametrize("words", [{"watch": False}, {"shake": "paper"}])
def test_a_motor_is_always_watched(words: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="A motor is always watched"):
        _params(Args(actuator="gripper", **words), None)
    assert _params(Args(actuator="gripper"), None).escalate


def test_the_report_draws_each_step_and_what_was_decided(tmp_path: Path) -> None:
    trial = trial_of(*STEPS)
    results = RunResults(folder=tmp_path, visit=told(trial), trial=trial)
    write_report(tmp_path / "report.html", results)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    section = page[page.index("The shake, step by step") :]
    section = section[: section.index("</section>")]
    assert section.count("<img") == 1
    for step in STEPS:
        assert escape(step.decided) in section
    assert "0.20 mm at 8 Hz, 0.50 mm at 3 Hz" in section
    assert "2 of 3" in section, "flowers that were measured"
    assert "80%, slip" in section
    alone = RunResults(folder=tmp_path, visit=told(trial_of(), "it was not to be watched"))
    write_report(tmp_path / "report.html", alone)
    assert escape("the plan alone was carried out: it was not to be watched") in (tmp_path / "report.html").read_text()


def test_the_picture_has_a_line_for_each_tone_and_a_bar_for_each_step() -> None:
    tones, flowers, limits = draw_steps(STEPS, 10.0).axes
    assert tones.get_legend_handles_labels()[1] == ["3 Hz", "8 Hz"]
    bars: list[Any] = list(limits.patches)
    assert [(bar.get_x(), bar.get_height()) for bar in bars] == [(0.5, pytest.approx(30)), (2.5, 80), (4.0, 80)]
    assert limits.get_legend_handles_labels()[1] == ["the bending of pedicels", "slip"]
    medians = next(line for line in flowers.lines if "median" in str(line.get_label()))
    assert list(medians.get_ydata()) == [5.0, 9.0, 8.0]  # type: ignore[arg-type]
    fast = next(line for line in tones.lines if line.get_label() == "8 Hz")
    assert np.nanmax(fast.get_ydata()) == pytest.approx(1.0), "millimetres"  # type: ignore[arg-type]
