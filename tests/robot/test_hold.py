"""Every streamed arm's `hold`: it begins where the arm is, and after the robot's time-out only what stands is sent."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.geometry import Array
from anther.robot.devices import DeviceError, JointTrajectory
from anther.robot.drivers._readings import Reading
from anther.robot.drivers._streamed import Reference, StreamedArm, braking

PATH = JointTrajectory(np.array([0.0, 2.0]), np.array([[0.0], [1.0]]), np.array([[0.5], [0.5]]))


class Leaping(StreamedArm):
    """An arm of one joint on a clock that leaps by `pause` [s] at 1 s; it stops by its own time-out of 30 ms."""

    def __init__(self, pause: float, *, tells: bool = True) -> None:
        self.now, self.pause, self.tells, self.commands = 0.0, pause, tells, list[tuple[float, Array, Array]]()
        super().__init__(["j"], rate=100, stale=0.05, silence=0.03, clock=lambda: self.now, sleep=self.go)
        self.q, self.reads = np.zeros(1), float("inf")  # no further than this [rad]
        self.hear()

    def hear(self) -> None:
        if self.tells or self.now < 1:
            self.readings.take(Reading(self.now, np.minimum(self.q, self.reads)))

    def go(self, seconds: float) -> None:
        leap = self.pause if self.now < 1 <= self.now + seconds else 0.0
        if self.commands:
            told, _, rate = self.commands[-1]
            self.q = self.q + rate * np.clip(told + 0.03 - self.now, 0, seconds + leap)
        self.now += seconds + leap
        self.hear()

    def cannot(self) -> str:
        return ""

    def _command(self, q: Array, rate: Array) -> None:
        self._send(lambda: self.commands.append((self.now, q, rate)), q, rate)

    def _aim(self, reference: Reference, t: float) -> None:
        self._command(*reference.at(t)[:2])

    def _brake(self, q: Array, rate: Array) -> Array:
        self._command(q, rate)
        return braking(q, rate, np.array([5.0])).positions[-1]

    def _rest(self, q: Array) -> None:
        self.commands.append((self.now, q, np.zeros(1)))
        self._rests(q)


@pytest.mark.parametrize("tells", [True, False])
def test_after_a_pause_only_what_stands_is_sent_or_nothing(tells: bool) -> None:
    arm = Leaping(0.5, tells=tells)
    with pytest.raises(DeviceError, match="after the one before; allowed: 30 ms"):
        arm.follow(PATH)
    after = [(q, rate) for when, q, rate in arm.commands if when > 1.4]
    assert len(after) == (1 if tells else 0)
    assert all(q == pytest.approx(arm.q, abs=1e-9) and rate == 0 for q, rate in after)


@pytest.mark.parametrize("reads", [np.inf, 0.1], ids=["well", "frozen"])
def test_a_stop_without_a_pause_goes_on_from_the_last_command(reads: float) -> None:
    """Also where readings froze: the arm shall not jump back to them."""
    arm = Leaping(0.0)
    arm.reads = reads

    def enough(sample: object) -> None:
        if arm.now > 0.5:
            raise DeviceError("enough")

    with pytest.raises(DeviceError, match="enough"):
        arm.follow(PATH, enough)
    places, rates = (np.array([c[i] for c in arm.commands])[-3:, 0] for i in (1, 2))
    assert rates == pytest.approx([0.5, 0.5, 0.0])
    assert np.abs(np.diff(places)).max() < 0.03


def test_braking_takes_no_more_than_the_acceleration() -> None:
    way = braking(np.zeros(2), np.array([0.6, -0.3]), np.array([5.0, 5.0]))
    assert np.abs(np.diff(way.velocities, axis=0) / np.diff(way.times)[:, None]).max() == pytest.approx(5.0)


def test_an_old_force_is_missing() -> None:
    arm = Leaping(0.0)
    arm._take_force(3.0, 0.0, 4.0)
    assert arm._current_force(arm.now + 0.09) == pytest.approx(5.0)
    assert np.isnan(arm._current_force(arm.now + 0.11))
