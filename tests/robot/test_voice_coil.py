"""The voice coil's driver on a simulated port: what it commands, and what it makes of a bad line."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm
from fake_shaker import FakeClock, FakeShaker

from anther.core.errors import MissingExtra, StageFailure
from anther.robot.devices import ArmSample, DeviceError, Motor
from anther.robot.drivers.voice_coil import VoiceCoil, open_port, seal, unseal
from anther.robot.safety import GuardedMotor
from anther.robot.swing import Swing

FIRST = Swing.first([30.0, 12.0], [0.8e-3, 0.1e-3], 0.6, 0.2)
SECOND = FIRST.then([0.9e-3, 0.0], 0.8, 0.1)
LAST = SECOND.then([0.0, 0.0], 0.2, 0.2)


def coil(shaker: type[FakeShaker] = FakeShaker) -> tuple[VoiceCoil, FakeShaker, FakeClock]:
    clock = FakeClock()
    machine = shaker(clock)
    return VoiceCoil(machine, FakeArm(), clock=clock, sleep=clock.sleep), machine, clock


def thinks(clock: FakeClock, until: float) -> None:
    """Wait in another thread until the clock is there, or nobody moves it any more."""
    real = time.monotonic() + 2
    while clock() < until and time.monotonic() < real:
        time.sleep(1e-3)


def then(*pieces: Swing) -> Callable[[], Swing | None]:
    left = iter(pieces)
    return lambda: next(left, None)


def test_the_motor_tells_what_it_has() -> None:
    motor, _, _ = coil()
    conforms: Motor = motor
    assert conforms.amplitude() == 0
    assert (motor.stroke, motor.acceleration) == pytest.approx((1.5e-3, 50.0))
    assert (motor.lowest, motor.highest) == (10.0, 50.0)


def test_pieces_arrive_as_they_were_and_join() -> None:
    motor, machine, clock = coil()
    seen, begin = list[ArmSample](), clock()
    record = motor.swing(FIRST, seen.append, then(SECOND, LAST))
    assert clock() - begin == pytest.approx(1.6, abs=0.1)
    for sent, taken in zip((FIRST, SECOND, LAST), machine.pieces, strict=True):
        assert taken.begin == pytest.approx(sent.begin)
        assert taken.motion(np.linspace(0, sent.seconds, 50))[0] == pytest.approx(
            sent.motion(np.linspace(0, sent.seconds, 50))[0], abs=2e-9
        )
    assert machine.state == "rest"
    assert np.diff([s.time for s in seen]).max() <= 0.02 + 1e-9
    assert len(record.times) == len(seen)
    assert np.isnan(seen[0].force)


def test_more_is_asked_for_in_time_and_the_motor_is_heard_while_it_thinks() -> None:
    """A decision of 0.25 s is longer than the motor's watchdog: heartbeats go on meanwhile."""
    motor, machine, clock = coil()
    asked, left = list[float](), then(SECOND, LAST)

    def more() -> Swing | None:
        asked.append(begin := clock())
        thinks(clock, begin + 0.25)
        return left()

    start = clock()
    motor.swing(FIRST, None, more)
    assert machine.state == "rest"
    assert np.subtract(asked, start) == pytest.approx([0.3, 1.1, 1.4], abs=0.08)


def test_what_comes_too_late_is_not_joined() -> None:
    motor, machine, clock = coil()

    def more() -> Swing:
        thinks(clock, clock() + 0.5)
        return SECOND

    with pytest.raises(DeviceError, match="too late"):
        motor.swing(FIRST, None, more)
    assert machine.place == 0


@pytest.mark.parametrize(
    ("piece", "message"),
    [
        (Swing.first([10.0], [1.6e-3], 0.5, 0.2), "motor amplitude: got 0.0016 m; it has 0.0015"),
        (Swing.first([40.0], [1.2e-3], 0.5, 0.2), "motor acceleration"),
        (Swing.first([5.0], [1e-3], 0.5, 0.2), r"motor frequency: got \[5.\] Hz; it has 10 to 50 Hz"),
    ],
)
def test_what_the_motor_has_not_is_refused_before_it_moves(piece: Swing, message: str) -> None:
    motor, machine, _ = coil()
    with pytest.raises(DeviceError, match=message):
        motor.swing(piece)
    assert machine.pieces == []


def test_a_refusal_of_the_motor_is_told() -> None:
    class Shy(FakeShaker):
        def _take(self, number: int, *rest: object) -> str:
            return f"NO {number} too hot"

    with pytest.raises(DeviceError, match="refuses: too hot"):
        coil(Shy)[0].swing(FIRST)


def test_ctrl_c_and_every_error_of_the_watcher_stop_the_motor() -> None:
    for error in (KeyboardInterrupt(), StageFailure("collision", "ouch")):
        motor, machine, clock = coil()

        def watch(_: ArmSample, error: BaseException = error, clock: FakeClock = clock) -> None:
            if clock() > 100.3:
                raise error

        with pytest.raises(type(error)):
            motor.swing(FIRST, watch, then(SECOND, LAST))
        assert machine.state == "rest"
        assert machine.place == 0
        assert clock() < 100.5


def test_an_error_while_deciding_stops_the_motor() -> None:
    motor, machine, _ = coil()

    def more() -> Swing:
        raise StageFailure("device_fault", "the camera is gone")

    with pytest.raises(StageFailure, match="camera is gone"):
        motor.swing(FIRST, None, more)
    assert machine.state == "rest"


class Noisy(FakeShaker):
    """Of its lines a fifth come with a bit flipped, a tenth after some noise, and a fifth twice."""

    rng = np.random.default_rng(1)

    def readline(self) -> bytes:
        line, luck = super().readline(), self.rng.random()
        if luck < 0.2 and line:
            at = int(self.rng.integers(len(line) - 1))
            return line[:at] + bytes([line[at] ^ 4]) + line[at + 1 :]
        if luck < 0.3:
            return b"\xfe" + line
        if luck < 0.5 and line:
            self._replies.insert(0, line)
        return line


def test_garbage_on_the_line_is_passed_over() -> None:
    motor, machine, _ = coil(Noisy)
    motor.swing(FIRST, None, then(SECOND, LAST))
    assert machine.state == "rest"
    assert len(machine.pieces) == 3


def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    class Late(FakeShaker):
        def readline(self) -> bytes:
            line = super().readline()
            if line and not getattr(self, "kept", b""):
                self.kept = line
                return b""
            kept, self.kept = getattr(self, "kept", b""), line
            return kept

    motor, machine, _ = coil(Late)
    motor.swing(FIRST, None, then(SECOND, LAST))
    assert machine.state == "rest"


@pytest.mark.parametrize(
    ("name", "message"),
    [("anther-shaker 2", "got anther-shaker 2; allowed: anther-shaker 1"), ("grbl 1", "got grbl 1")],
)
def test_another_device_is_not_a_motor(name: str, message: str) -> None:
    class Other(FakeShaker):
        def _answer(self, words: list[str]) -> str:
            return super()._answer(words).replace("anther-shaker 1", name)

    with pytest.raises(DeviceError, match=message):
        coil(Other)


def test_a_device_that_says_nothing_or_only_garbage_is_told_apart() -> None:
    class Silent(FakeShaker):
        def write(self, data: bytes) -> None:
            pass

    class Babbling(Silent):
        def readline(self) -> bytes:
            super().readline()
            return b"ok T:21.3\n"

    with pytest.raises(DeviceError, match="no answer to ID; it says nothing"):
        coil(Silent)
    with pytest.raises(DeviceError, match=r"ok T:21\.3"):
        coil(Babbling)


def test_a_device_that_falls_silent_or_is_unplugged_on_the_way_ends_the_swing_and_stops_itself() -> None:
    class Dying(FakeShaker):
        mute = gone = np.inf

        def write(self, data: bytes) -> None:
            if self.clock() > self.gone:
                raise OSError("write failed: no such device")
            if self.clock() < self.mute:
                super().write(data)

        def readline(self) -> bytes:
            return super().readline()

    for fault, message in (("mute", "no answer to BEAT"), ("gone", "the port is gone")):
        motor, machine, clock = coil(Dying)
        setattr(machine, fault, 100.3)
        with pytest.raises(DeviceError, match=message):
            motor.swing(FIRST, None, then(SECOND, LAST))
        clock.now += 0.1
        assert machine.place == 0
        assert machine.state == "watchdog"


@pytest.mark.parametrize("fault", ["watchdog", "overcurrent"])
def test_a_motor_that_stops_by_itself_ends_the_swing(fault: str) -> None:
    motor, machine, clock = coil()

    def watch(_: ArmSample) -> None:
        machine.fault = fault if clock() > 100.3 else ""

    with pytest.raises(DeviceError, match=f"it says: {fault}"):
        motor.swing(FIRST, watch, then(SECOND, LAST))


def test_a_stalled_motor_is_noticed() -> None:
    motor, machine, _ = coil()
    machine.gain = 0.3
    steady = Swing.first([30.0], [1e-3], 1.0, 0.2)
    with pytest.raises(DeviceError, match=r"moves 0.3 of 1 mm"):
        motor.swing(steady, None, then(steady.then([0.0], 0.2, 0.2)))
    machine.gain = 0.88
    motor.swing(steady, None, then(steady.then([0.0], 0.2, 0.2)))


def test_behind_the_guard_it_is_a_motor() -> None:
    motor, machine, _ = coil()
    guarded = GuardedMotor(motor, LIMITS)
    guarded.swing(FIRST, None, then(SECOND, LAST))
    assert len(machine.pieces) == 3
    with pytest.raises(StageFailure, match="end in motion"):
        guarded.swing(FIRST, None, None)
    assert machine.state == "rest"
    with pytest.raises(StageFailure, match="does not join"):
        guarded.swing(FIRST, None, then(replace(SECOND, begin=0.7)))
    assert machine.state == "rest"


def test_lines_with_a_wrong_sum_are_no_lines() -> None:
    assert unseal(seal("7 BEAT")) == ["7", "BEAT"]
    assert seal("7 BEAT") == b"7 BEAT*05\n"
    for line in (b"", b"7 BEAT\n", b"7 BEAT*06\n", b"*\n", b"7 BEAT*6\n", b"\xff\xfe*00\n", b"7 BEAT*0G\n"):
        assert unseal(line) == []


@pytest.mark.skipif(importlib.util.find_spec("serial") is not None, reason="pyserial is installed")
def test_without_pyserial_one_is_told_what_to_install() -> None:
    with pytest.raises(MissingExtra, match=r"pip install 'anther\[motor\]'"):
        open_port("loop://")


@pytest.mark.skipif(importlib.util.find_spec("serial") is None, reason="pyserial is not installed")
def test_a_real_pyserial_port_carries_the_lines() -> None:
    port = open_port("loop://")
    port.write(seal("7 BEAT"))
    assert unseal(port.readline()) == ["7", "BEAT"]
    assert port.readline() == b""
    with pytest.raises(DeviceError, match="no serial port"):
        open_port("/dev/there-is-none")
