"""What follows a piece of a watched shake is decided while it goes on, and the shake waits for no slow decision."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from anther.pollination.execution._concurrent import DecisionThread
from anther.robot.devices import LEAD, ArmSample
from anther.robot.swing import Swing, motion

FIRST = Swing.first([5.0, 9.0], [2e-3, 1e-3], 2.0, 0.5)
NEXT = FIRST.then([4e-3, 0.0], 1.5, 0.5)


class Clock(list[ArmSample]):
    """Readings of an arm whose time goes on whenever they are looked at."""

    def __init__(self, step: float) -> None:
        super().__init__([ArmSample(10.0, np.zeros(7), np.zeros(7))])
        self.step = step

    def __getitem__(self, index):
        super().__setitem__(0, ArmSample(super().__getitem__(0).time + self.step, np.zeros(7), np.zeros(7)))
        return super().__getitem__(index)


@pytest.fixture
def decided() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


def test_a_decision_in_time_follows_at_once() -> None:
    assert_same(DecisionThread(Clock(0.05)).wait_for_next(FIRST, lambda: NEXT), NEXT)


def test_an_arm_whose_time_stands_still_waits_for_every_decision(decided: threading.Event) -> None:
    threading.Timer(0.3, decided.set).start()
    assert_same(DecisionThread(Clock(0.0)).wait_for_next(FIRST, lambda: (decided.wait(20) and NEXT) or FIRST), NEXT)


def test_until_a_late_decision_is_there_the_pads_swing_on_as_they_do(decided: threading.Event) -> None:
    deciding, asked = DecisionThread(Clock(0.05)), []

    def decide() -> Swing:
        asked.append(1)
        decided.wait(20)
        return NEXT

    longer = deciding.wait_for_next(FIRST, decide)
    assert deciding.pending
    again = deciding.wait_for_next(longer, decide)
    decided.set()
    after = deciding.wait_for_next(again, decide)
    assert len(asked) == 1, "what was seen is decided of once"
    assert not deciding.pending
    assert list(after.amplitudes) == list(NEXT.amplitudes)
    pieces = [FIRST, longer, again, after]
    assert [piece.begin for piece in pieces] == pytest.approx(
        [0.0, 2.0, 2.0 + DecisionThread.extension, 2.0 + 2 * DecisionThread.extension]
    )
    times = np.arange(0.5, 2.0 + 2 * DecisionThread.extension, 1e-3)
    steady = sum(a * np.sin(2 * np.pi * f * times) for a, f in zip(FIRST.amplitudes, FIRST.frequencies, strict=True))
    assert motion(pieces, times)[0] == pytest.approx(steady, abs=1e-9)
    before, behind = (motion(pieces, [after.begin + dt]) for dt in (-1e-6, 1e-6))
    assert behind[0] == pytest.approx(before[0], abs=1e-6)
    assert behind[1] == pytest.approx(before[1], abs=1e-4)


def test_what_a_decision_raises_is_raised() -> None:
    def fails() -> Swing:
        raise ValueError("nothing is known")

    with pytest.raises(ValueError, match="nothing is known"):
        DecisionThread(Clock(0.05)).wait_for_next(FIRST, fails)


def test_a_piece_that_goes_on_is_long_enough_to_be_asked_about_and_the_answer_leaves_time_to_check_it() -> None:
    assert DecisionThread.extension > LEAD
    assert DecisionThread.patience < LEAD / 2


def assert_same(one: Swing, other: Swing) -> None:
    assert (one.begin, one.seconds, one.ramp) == (other.begin, other.seconds, other.ramp)
    assert list(one.amplitudes) == list(other.amplitudes)
    assert list(one.before) == list(other.before)
