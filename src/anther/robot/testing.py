"""Checks for whoever writes a driver: whether an arm, gripper or camera keeps what `anther.robot.devices` promises.

A check takes a rig: the driver's factory, and what a test may do to the stand-in for the machine. It raises an
AssertionError where the driver breaks a promise, and unittest.SkipTest, which pytest reports as skipped, where the rig
lacks what the check needs. Give each check a new rig. Never run them on metal: they move the arm and break its
connection on purpose.
"""

from __future__ import annotations

import unittest
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np

from anther.core.errors import AntherError
from anther.core.geometry import Array
from anther.robot.devices import Arm, ArmRecord, ArmSample, Camera, DeviceError, Gripper, JointTrajectory, Watch

__all__ = [
    "ARM_CHECKS",
    "ARM_FAULT_CHECKS",
    "CAMERA_CHECKS",
    "GRIPPER_CHECKS",
    "ArmRig",
    "CameraRig",
    "GripperRig",
]

WAY = 0.25
"""The checks move every joint so far [rad] in 0.9 s: at most 0.52 rad/s and 1.8 rad/s^2."""

ArmFault = Literal["silence", "not a number", "clock jump", "force lost", "stop"]
"""The machine tells no joints any more, or NaN; its clock goes back by a second; it tells no force any more; it stops
itself and refuses to move, as with a pressed stop button."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class ArmRig:
    """A driver of an arm of J joints, and the stand-in for the machine.

    Attributes:
        connect: returns the connected driver of an arm that is ready to move, each joint by `WAY` or more.
        clock, sleep: the driver's [s].
        acceleration: (J,) with which the arm brakes [rad/s^2].
        history: returns times (T,) [s] on `clock` and joints (T, J) [rad]: where the machine has been.
        commands: returns how many commands of motion the machine has received.
        faults: what a test can do to the machine.
        notice: the driver or machine notices a fault within this [s], and brakes.
    """

    connect: Callable[[], Arm]
    clock: Callable[[], float]
    sleep: Callable[[float], Any]
    acceleration: Array
    history: Callable[[], tuple[Array, Array]] | None = None
    commands: Callable[[], int] | None = None
    faults: Mapping[ArmFault, Callable[[], Any]] = field(default_factory=dict)
    notice: float = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class GripperRig:
    """A driver of a gripper, and the stand-in for the machine.

    Attributes:
        connect: returns the connected driver of a gripper that is ready to move.
        insert: puts something so wide [m] between the pads.
        silence: the machine answers nothing any more.
        lose_force: the machine tells no force any more.
        resolution: of an opening [m].
    """

    connect: Callable[[], Gripper]
    insert: Callable[[float], Any] | None = None
    silence: Callable[[], Any] | None = None
    lose_force: Callable[[], Any] | None = None
    resolution: float = 5e-4


@dataclass(frozen=True, slots=True, eq=False)
class CameraRig:
    """A driver of a camera.

    Attributes:
        connect: returns the connected driver.
        sleep: [s], while which a camera that runs takes frames.
        unplug: takes the camera away; returns once its driver can know.
    """

    connect: Callable[[], Camera]
    sleep: Callable[[float], Any]
    unplug: Callable[[], Any] | None = None


@contextmanager
def _connect(connect: Callable[[], T]) -> Iterator[T]:
    driver = connect()
    try:
        yield driver
    finally:
        getattr(driver, "close", lambda: None)()


def _require(holds: bool | np.bool_, message: str) -> None:
    if not holds:
        raise AssertionError(message)


def _need(what: T | None, name: str) -> T:
    if what is None:
        raise unittest.SkipTest(f"the rig has no {name}")
    return what


@contextmanager
def _raises(kind: type[BaseException], what: str) -> Iterator[list[BaseException]]:
    """Require that the block raises `kind`; the error is in the list afterwards."""
    caught: list[BaseException] = []
    try:
        yield caught
    except kind as error:
        caught.append(error)
    _require(bool(caught), f"{what}: got no error; allowed: {kind.__name__}")


def _motion(start: Array, way: float = WAY) -> JointTrajectory:
    """Return a motion at rest at both ends, from joints (J,) by `way` [rad] each."""
    seconds = 0.9
    s = np.linspace(0, 1, round(200 * seconds))[:, None]
    along = way * np.ones(len(start))
    shape, rate = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / seconds
    return JointTrajectory(seconds * s[:, 0], start + shape * along, rate * along)


def _pieces(start: Array) -> tuple[JointTrajectory, JointTrajectory]:
    """Return two motions from joints (J,) that join at 0.3 rad/s; the second ends at rest."""
    t, along = np.linspace(0, 0.6, 120)[:, None], np.ones(len(start))
    first = JointTrajectory(t[:, 0], start + 0.25 * t**2 * along, 0.5 * t * along)
    rest = first.positions[-1] + (0.3 * t - 0.25 * t**2) * along
    return first, JointTrajectory(t[:, 0], rest, (0.3 - 0.5 * t) * along)


def _once_beyond(start: Array, do: Callable[[], Any]) -> Watch:
    """Return a watcher that does something once, when the arm has moved 0.08 rad from joints (J,)."""
    done: list[bool] = []

    def watch(sample: ArmSample) -> None:
        if not done and np.abs(sample.measured - start).max() > 0.08:
            done.append(True)
            do()

    return watch


def _stops(
    arm: Arm, start: Array, do: Callable[[], Any], what: str, kind: type[BaseException] = DeviceError
) -> BaseException:
    """Require that what is done in midst of a motion ends it with an error of `kind`, and return that.

    Raises:
        kind: as the driver raised it, where the motion ended before anything was done.
    """
    done: list[bool] = []

    def strike() -> None:
        done.append(True)
        do()

    try:
        arm.follow(_motion(start), _once_beyond(start, strike))
    except kind as error:
        if not done:
            raise
        return error
    raise AssertionError(f"follow, where {what}: got no error; allowed: {kind.__name__}")


def _check_smooth(rig: ArmRig) -> None:
    """Check that the arm never jumped nor went back, and is at rest."""
    rig.sleep(0.2)
    times, joints = _need(rig.history, "history")()
    seconds = np.diff(times)[:, None]
    rate = np.diff(joints, axis=0) / seconds
    beyond = np.abs(np.diff(rate, axis=0)) - rig.acceleration * (seconds[1:] + seconds[:-1]) / 2
    jump = float((beyond * seconds[1:]).max())
    allowed = 2e-3  # an arm further than this from where its acceleration lets it go on has jumped [rad]
    _require(jump < allowed, f"the arm jumped by {jump:.2g} rad; allowed: {allowed:g}")
    _require(np.diff(joints, axis=0).min() > -1e-3, "the arm went back")
    _require(np.ptp(joints[-10:], axis=0).max() < 1e-4, "the arm does not come to rest")


def _check_stopped(rig: ArmRig, since: float) -> None:
    """Check that the arm came to rest in time after `since` [s]."""
    rig.sleep(0.4)
    times, joints = _need(rig.history, "history")()
    speed = np.abs(np.diff(joints, axis=0)).max(axis=1) / np.diff(times)
    _require(speed[-10:].max() < 1e-3, f"the arm still moves at {speed[-10:].max():.2g} rad/s")
    after = float(times[1:][speed > 5e-3].max(initial=since)) - since
    longest = rig.notice + 0.52 / float(rig.acceleration.min()) + 0.05
    _require(after < longest, f"the arm moved for {after:.2f} s after the fault; allowed: {longest:.2f} s")


def check_motion(rig: ArmRig) -> None:
    """A motion reaches its end, and every reading is recorded and shown to the watcher."""
    with _connect(rig.connect) as arm:
        start, samples = arm.joints(), list[ArmSample]()
        record = arm.follow(_motion(start), samples.append)
        np.testing.assert_allclose(record.commanded[-1], start + WAY, atol=2e-3, err_msg="last command")
        np.testing.assert_allclose(arm.joints(), start + WAY, atol=3e-3, err_msg="joints at the end")
        _check_record(record, samples)
        back = arm.follow(_motion(arm.joints(), -WAY))
        _require(back.times[0] >= record.times[-1], "the second motion begins before the first one ended")


def _check_record(record: ArmRecord, samples: list[ArmSample]) -> None:
    times = np.array([sample.time for sample in samples])
    _require(bool(np.all(np.diff(times) > 0)), "the times of readings do not increase")
    rate = len(samples) / (times[-1] - times[0])
    _require(rate > 50, f"the watcher saw {rate:.0f} readings a second; allowed: 50 or more")
    _require(record.commanded.shape == record.measured.shape, "commanded and measured differ in shape")
    _require(bool(np.all(np.diff(record.times) > 0)), "the record's times do not increase")
    off = max(float(np.abs(s.measured - s.commanded).max()) for s in samples)
    _require(off < 0.02, f"measured joints are {off:.2g} rad off the command of their time; allowed: 0.02")
    forces = np.array([sample.force for sample in samples])
    _require(bool(np.all(np.isnan(forces) | (forces >= 0))), "a force is negative; allowed: a size, or NaN")


def check_watcher_error(rig: ArmRig) -> None:
    """An error of the watcher, or Ctrl-C, stops the arm, reaches the caller, and the arm can move again."""
    for error in (DeviceError("enough"), KeyboardInterrupt("enough")):
        with _connect(rig.connect) as arm:
            start = arm.joints()

            def fail(error: BaseException = error) -> None:
                raise error

            caught = _stops(arm, start, fail, "its watcher raises", type(error))
            _require(str(caught) == str(error), f"follow raised {caught!r}; allowed: the watcher's {error!r}")
            rig.sleep(0.15)
            there = arm.joints()
            gone = float(np.abs(there - start).max())
            _require(0.07 < gone < 0.24, f"the arm stopped after {gone:.3f} rad; the watcher raised at 0.08 rad")
            arm.hold()
            rig.sleep(0.1)
            np.testing.assert_allclose(arm.joints(), there, atol=2e-3, err_msg="joints after hold")
            arm.follow(_motion(there, -0.07))


def check_hold_at_rest(rig: ArmRig) -> None:
    """Connecting and holding move nothing."""
    with _connect(rig.connect) as arm:
        before = arm.joints()
        arm.hold()
        rig.sleep(0.1)
        np.testing.assert_allclose(arm.joints(), before, atol=1e-3, err_msg="joints after hold")


def check_joined_motions(rig: ArmRig) -> None:
    """`more` joins motions: the arm goes on from one to the next, and ends where the last one does."""
    with _connect(rig.connect) as arm:
        first, second = _pieces(arm.joints())
        following = iter([second, None])

        def more() -> JointTrajectory | None:
            rig.sleep(0.05)
            return next(following)

        record = arm.follow(first, None, more)
        np.testing.assert_allclose(record.commanded[-1], second.positions[-1], atol=2e-3, err_msg="last command")
    if rig.history is not None:
        times, joints = rig.history()
        speed = np.abs(np.diff(joints, axis=0)).max(axis=1) / np.diff(times)
        moving = times[1:][speed > 0.01]
        inside = (times[1:] > moving[0] + 0.4) & (times[1:] < moving[-1] - 0.4)
        _require(speed[inside].min() > 0.05, "the arm stopped between two motions")


def check_close(rig: ArmRig) -> None:
    """`close` releases the machine: it may be repeated, and another driver connects and moves the arm."""
    arm: Any = rig.connect()
    if not hasattr(arm, "close"):
        raise unittest.SkipTest("the driver has no close")
    arm.close()
    arm.close()
    with _connect(rig.connect) as again:
        again.follow(_motion(again.joints(), 0.05))


def check_late_next_motion(rig: ArmRig) -> None:
    """A next motion that comes too late ends in a braked stop and a DeviceError."""
    with _connect(rig.connect) as arm:
        first, _ = _pieces(arm.joints())
        with _raises(DeviceError, "follow, where the next motion comes too late"):
            arm.follow(first, None, lambda: rig.sleep(0.8))
        _check_smooth(rig)


def check_pause(rig: ArmRig) -> None:
    """After a pause beyond every time-out a DeviceError ends the motion, and the arm stays where it stands."""
    with _connect(rig.connect) as arm:
        start, woke = arm.joints(), list[float]()
        seconds = 0.3  # longer than any time-out of a robot or driver, and the braking after it

        def pause() -> None:
            rig.sleep(seconds)
            woke.append(rig.clock())

        _stops(arm, start, pause, f"nothing runs for {seconds:g} s")
        _check_smooth(rig)
        times, joints = _need(rig.history, "history")()
        moved = float(np.ptp(joints[times >= woke[0]], axis=0).max())
        _require(moved < 1e-3, f"the arm moved by {moved:.2g} rad after the pause; allowed: 0.001")


def check_delayed_stop(rig: ArmRig) -> None:
    """After a delay shorter than the time-outs the arm is braked without a jump."""
    with _connect(rig.connect) as arm:
        start = arm.joints()

        def fail() -> None:
            rig.sleep(0.02)
            raise DeviceError("enough")

        _stops(arm, start, fail, "its watcher raises")
        _check_smooth(rig)


def check_clock_jump(rig: ArmRig) -> None:
    """Where the machine's clock jumps, its readings are refused, and the arm is braked without a jump."""
    jump = _need(rig.faults.get("clock jump"), "fault 'clock jump'")
    with _connect(rig.connect) as arm:
        start = arm.joints()
        _stops(arm, start, jump, "the machine's clock jumps")
        _check_smooth(rig)


def check_stale_readings(rig: ArmRig) -> None:
    """Joints that are no longer told are refused, and no motion begins from them."""
    _check_refused(rig, "silence", lambda: rig.sleep(0.2))


def check_nan_readings(rig: ArmRig) -> None:
    """Joints that are not numbers are refused, and no motion begins from them."""
    _check_refused(rig, "not a number", lambda: rig.sleep(0.1))


def _check_refused(rig: ArmRig, fault: ArmFault, wait: Callable[[], Any]) -> None:
    strike, commands = _need(rig.faults.get(fault), f"fault '{fault}'"), _need(rig.commands, "commands")
    with _connect(rig.connect) as arm:
        path, before = _motion(arm.joints()), commands()
        strike()
        wait()
        with _raises(DeviceError, f"joints, after the fault '{fault}'"):
            arm.joints()
        with _raises(DeviceError, f"follow, after the fault '{fault}'"):
            arm.follow(path)
        _require(commands() == before, f"the arm was commanded after the fault '{fault}'")


def check_stale_readings_in_motion(rig: ArmRig) -> None:
    """Joints that are no longer told stop a motion."""
    silence = _need(rig.faults.get("silence"), "fault 'silence'")
    with _connect(rig.connect) as arm:
        start, since = arm.joints(), list[float]()

        def strike() -> None:
            since.append(rig.clock())
            silence()

        _stops(arm, start, strike, "joints are no longer told")
        _check_stopped(rig, since[0])


def check_missing_force(rig: ArmRig) -> None:
    """A force that is no longer told stops the motion, or is NaN: never 0, nor the last one for ever."""
    lose = _need(rig.faults.get("force lost"), "fault 'force lost'")
    with _connect(rig.connect) as arm:
        start, samples = arm.joints(), list[ArmSample]()
        strike = _once_beyond(start, lose)

        def watch(sample: ArmSample) -> None:
            samples.append(sample)
            strike(sample)

        try:
            arm.follow(_motion(start), watch)
        except DeviceError:
            return
        _require(
            bool(np.isnan(samples[-1].force)), f"force: got {samples[-1].force:g} N after it was lost; allowed: NaN"
        )


def check_refusal(rig: ArmRig) -> None:
    """A stop of the machine's own ends a motion, and the next motion is refused and not commanded."""
    stop, commands = _need(rig.faults.get("stop"), "fault 'stop'"), _need(rig.commands, "commands")
    with _connect(rig.connect) as arm:
        start = arm.joints()
        _stops(arm, start, stop, "the machine stops")
        rig.sleep(0.2)
        before = commands()
        with _raises(DeviceError, "follow, after the machine stopped"):
            arm.follow(_motion(start))
        _require(commands() == before, "the arm was commanded after the stop")


ARM_CHECKS = (check_motion, check_watcher_error, check_hold_at_rest, check_joined_motions, check_close)
"""What every arm keeps."""
ARM_FAULT_CHECKS = (
    check_late_next_motion,
    check_pause,
    check_delayed_stop,
    check_clock_jump,
    check_stale_readings,
    check_stale_readings_in_motion,
    check_nan_readings,
    check_missing_force,
    check_refusal,
)
"""What an arm keeps whose driver streams to it in real time; the rig needs a history."""


def check_opening(rig: GripperRig) -> None:
    """Pads go where they are sent, and the state says so; beyond the stroke, and NaN, are refused."""
    with _connect(rig.connect) as gripper:
        for opening in (0.75 * gripper.stroke, 0.5 * gripper.stroke):
            state = gripper.move(opening)
            off = abs(state.opening - opening)
            _require(off < rig.resolution, f"the pads are {1e3 * off:.2g} mm off; allowed: {1e3 * rig.resolution:g}")
            _require(not state.is_gripping and abs(state.force) <= 1.0, f"open pads: got {state}; allowed: about 0 N")
        _require(gripper.state() == state, f"state: got {gripper.state()}; allowed: what move returned, {state}")


def check_impossible_opening(rig: GripperRig) -> None:
    """An opening that cannot be is refused."""
    with _connect(rig.connect) as gripper:
        for opening in (1.2 * gripper.stroke, -0.01, float("nan")):
            with _raises(AntherError, f"move to {opening:g} m"):
                gripper.move(opening)


def check_closing(rig: GripperRig) -> None:
    """Pads that meet something stop there and say so; open again, they hold nothing."""
    insert = _need(rig.insert, "insert")
    with _connect(rig.connect) as gripper:
        width = 0.2 * gripper.stroke
        gripper.move(0.8 * gripper.stroke)
        insert(width)
        held = gripper.move(0.1 * gripper.stroke)
        _require(abs(held.opening - width) < rig.resolution, f"held: got {held}; allowed: {width:g} m open")
        _require(held.is_gripping, "the pads met something, but is_gripping is false")
        _require(not held.force <= 1.0, f"force: got {held.force:g} N; allowed: > 1 N where something is held, or NaN")
        _require(not gripper.move(0.8 * gripper.stroke).is_gripping, "open pads are said to grip")


def check_silent_gripper(rig: GripperRig) -> None:
    """A gripper that answers no more is a DeviceError."""
    silence = _need(rig.silence, "silence")
    with _connect(rig.connect) as gripper:
        silence()
        with _raises(DeviceError, "move, where the machine answers no more"):
            gripper.move(0.5 * gripper.stroke)


def check_missing_grip_force(rig: GripperRig) -> None:
    """A force that is not told is NaN, never 0."""
    lose = _need(rig.lose_force, "lose_force")
    with _connect(rig.connect) as gripper:
        lose()
        force = gripper.state().force
        _require(bool(np.isnan(force)), f"force: got {force:g} N though none is told; allowed: NaN")


GRIPPER_CHECKS = (
    check_opening,
    check_impossible_opening,
    check_closing,
    check_silent_gripper,
    check_missing_grip_force,
)
"""What every gripper keeps."""


def check_frames(rig: CameraRig) -> None:
    """Frames, read and recorded, have the size of the intrinsics, the right types, and times that increase."""
    with _connect(rig.connect) as camera:
        size = (camera.intrinsics.height, camera.intrinsics.width)
        frame = camera.read()
        _require(frame.rgb.shape == (*size, 3) and frame.rgb.dtype == np.uint8, f"rgb: got {frame.rgb.shape}")
        _require(frame.depth.shape == size and frame.depth.dtype == np.float32, f"depth: got {frame.depth.shape}")
        _require(len(camera.rates) > 0 and min(camera.rates) > 0, f"rates: got {camera.rates}; allowed: > 0")
        camera.start(max(camera.rates))
        rig.sleep(0.3)
        frames = camera.stop()
        _require(all(f.depth.shape == size for f in frames), "frames of a recording differ in size")
        _require(bool(np.all(np.diff([f.time for f in frames]) > 0)), "times of a recording do not increase")


def check_recording(rig: CameraRig) -> None:
    """A recording under way shows the frames since a time, and loses none of them until its end."""
    with _connect(rig.connect) as camera:
        since = camera.read().time
        camera.start(20.0)
        rig.sleep(0.3)
        early = camera.recorded(since)
        _require(bool(np.all(np.diff([f.time for f in early]) > 0)), "times of a recording do not increase")
        late = camera.recorded(early[-1].time)
        _require(all(f.time >= early[-1].time for f in late), "recorded gave frames from before the time asked for")
        _require(len(camera.stop()) >= len(early), "frames were lost at the end of the recording")


def check_unplugged_camera(rig: CameraRig) -> None:
    """A camera that is gone is a DeviceError, reading and recording; what it recorded before is kept."""
    unplug = _need(rig.unplug, "unplug")
    with _connect(rig.connect) as camera:
        camera.start(max(camera.rates))
        rig.sleep(0.3)
        unplug()
        with _raises(DeviceError, "read, where the camera is gone"):
            camera.read()
        _require(len(camera.stop()) > 0, "the frames from before are lost")
        with _raises(DeviceError, "start, where the camera is gone"):
            camera.start(30.0)


CAMERA_CHECKS = (check_frames, check_recording, check_unplugged_camera)
"""What every camera keeps."""
