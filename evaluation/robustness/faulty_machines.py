"""Machines that fail on purpose: wrappers round arm, gripper and camera, one seeded fault at a time."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from anther.core import Array
from anther.robot import (
    Arm,
    ArmRecord,
    ArmSample,
    Camera,
    DeviceError,
    Frame,
    Gripper,
    GripperState,
    JointTrajectory,
    Robot,
)
from anther.robot.devices import More, Proxy, Watch, wrap

Kind = Literal[
    "command rejected",
    "arm stops",
    "stale joints",
    "stale with noise",
    "one joint stale",
    "pushed",
    "gripper jam",
    "gripper force stuck",
    "gripper force missing",
    "gripper holds nothing",
    "arm force lost",
    "frames lost",
    "frozen picture",
    "ctrl-c",
    "kill -9",
]
"""What can go wrong. "pushed" is a hand, or anything else the arm runs into. Joints freeze to the bit, with
the noise of their encoders, or only that one which moves most. A gripper's force is stuck at 0 or at `STUCK`; one that
holds nothing says that it holds something with `STUCK`. An arm's is lost as NaN, a negative number or the last one
felt; which of them the fault's share tells."""

PUSH = 60.0  # N, a firm push by hand, our choice
STUCK = 8.0  # N, about what a stem is held with
NOISE = 1e-6  # rad, of encoders: 22 bits a turn
STALE = ("stale joints", "stale with noise", "one joint stale")
"""Kinds of joint readings that freeze while the arm moves on."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        kind: what goes wrong.
        at: in which command of the device it is for, counted from 0 (recordings and reads for a camera).
        share: how far that motion has come, or how much of a recording is kept, 0 to 1.
        lasting: whether it stays; otherwise the next command works again.
        piece: of motions that go on without a stop, in which; of a recording that is looked at meanwhile, in which
            look.
    """

    kind: Kind
    at: int = 0
    share: float = 0.5
    lasting: bool = False
    piece: int = 0

    def strikes(self, count: int) -> bool:
        """Return whether command number `count` is struck."""
        return count == self.at or (self.lasting and count > self.at)


def with_faults(robot: Robot, fault: Fault) -> Robot:
    """Return the machines, of which one has the fault. Put the guard round the result, not inside."""
    match fault.kind:
        case "gripper jam" | "gripper force stuck" | "gripper force missing" | "gripper holds nothing":
            return wrap(robot, gripper=partial(FaultyGripper, fault=fault))
        case "frames lost":
            camera = partial(FaultyCamera, fault=fault)
            return wrap(robot, wrist_camera=camera, side_camera=camera)
        case "frozen picture":
            return wrap(robot, side_camera=partial(FaultyCamera, fault=fault))
        case _:
            return wrap(robot, arm=partial(FaultyArm, fault=fault))


class FaultyArm(Proxy):
    """An arm with a fault in one of its motions."""

    def __init__(self, arm: Arm, fault: Fault) -> None:
        super().__init__(arm)
        self._fault = fault
        self._count = 0
        self._frozen: Array | None = None
        self._moves_most, self._rng = np.zeros(0, bool), np.random.default_rng(0)
        self._first_force: float | None = None

    def joints(self) -> Array:
        """Return the measured joints (J,) [rad]; stale ones are those of the moment they froze."""
        return self._read(self._machine.joints())

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow, unless the fault says otherwise."""
        fault, count = self._fault, self._count
        self._count += 1
        if not fault.strikes(count):
            self._frozen = None
            return self._machine.follow(trajectory, watch, more)
        if fault.kind == "command rejected":
            raise DeviceError("the arm rejected the command: it is not enabled.")
        if count > fault.at and fault.kind == "arm stops":
            raise DeviceError("the arm rejected the command: it stopped and was not reset.")
        most = int(np.ptp(trajectory.positions, axis=0).argmax())
        self._moves_most = np.arange(trajectory.positions.shape[1]) == most
        begun: list[float] = []
        lengths = [trajectory.duration]

        def due(passed: float) -> bool:
            done, piece = sum(lengths[: fault.piece]), lengths[fault.piece : fault.piece + 1]
            return bool(piece) and passed >= done + fault.share * piece[0]

        def disturb(sample: ArmSample) -> None:
            begun.append(sample.time)
            if due(sample.time - begun[0]) or count > fault.at:
                sample = self._strike(sample)
            if watch:
                watch(sample)

        def next_motion() -> JointTrajectory | None:
            assert more is not None
            following = more()
            lengths.extend([] if following is None else [following.duration])
            return following

        return self._machine.follow(trajectory, disturb, more and next_motion)

    def _strike(self, sample: ArmSample) -> ArmSample:
        match self._fault.kind:
            case "arm stops":
                raise DeviceError("the arm stopped on the way: a joint reports an error.")
            case "pushed":
                return replace(sample, force=np.nan_to_num(sample.force) + PUSH)
            case "ctrl-c":
                os.kill(os.getpid(), signal.SIGINT)  # of the process, whichever of its threads moves the arm
            case "kill -9":
                os.kill(os.getpid(), signal.SIGKILL)
            case "arm force lost":
                self._first_force = sample.force if self._first_force is None else self._first_force
                lost = (np.nan, -sample.force, self._first_force)[int(4 * self._fault.share) % 3]
                return replace(sample, force=lost)
            case kind if kind in STALE:
                self._frozen = sample.measured if self._frozen is None else self._frozen
                return replace(sample, measured=self._read(sample.measured))
        return sample

    def _read(self, joints: Array) -> Array:
        """Return what is told of joints (J,) [rad]."""
        if self._frozen is None:
            return joints
        noise = 0.0 if self._fault.kind == "stale joints" else NOISE
        told = self._frozen + noise * self._rng.standard_normal(len(joints))
        return np.where(self._moves_most, told, joints) if self._fault.kind == "one joint stale" else told


class FaultyGripper(Proxy):
    """A gripper whose pads stay where they are in one of its moves, and say nothing of it; or that lies about force."""

    def __init__(self, gripper: Gripper, fault: Fault) -> None:
        super().__init__(gripper)
        self._fault = fault
        self._count = 0

    def move(self, opening: float) -> GripperState:
        """Move, or stay."""
        self._count += 1
        stays = self._fault.kind == "gripper jam" and self._fault.strikes(self._count - 1)
        return self.state() if stays else self._falsify(self._machine.move(opening))

    def state(self) -> GripperState:
        """Return the present state, or what is told of it."""
        return self._falsify(self._machine.state())

    def _falsify(self, state: GripperState) -> GripperState:
        if not self._fault.strikes(self._count - 1):
            return state
        match self._fault.kind:
            case "gripper force stuck":
                return replace(state, force=0.0 if self._fault.share < 0.4 else STUCK)
            case "gripper force missing":
                return replace(state, force=np.nan)
            case "gripper holds nothing":
                return replace(state, force=STUCK, is_gripping=True)
        return state


class FaultyCamera(Proxy):
    """A camera that loses frames: a read fails, and of a recording only a share comes back. Or one whose picture stands
    still from a look on, with new times."""

    def __init__(self, camera: Camera, fault: Fault) -> None:
        super().__init__(camera)
        self._fault = fault
        self._reads = self._recordings = self._looks = 0
        self._still: Frame | None = None

    def read(self) -> Frame:
        """Return a frame, or lose it."""
        self._reads += 1
        if self._fault.kind == "frames lost" and self._fault.strikes(self._reads - 1):
            raise DeviceError("the frame was lost on the cable.")
        return self._freeze(self._machine.read())

    def start(self, rate: float) -> None:
        """Begin to record."""
        self._looks = 0
        self._still = self._still if self._fault.lasting else None
        self._machine.start(rate)

    def recorded(self, since: float) -> list[Frame]:
        """Return what was recorded so far, or lose it."""
        self._looks += 1
        look, wanted = self._looks - 1, self._fault.piece
        struck = self._fault.strikes(self._recordings) and (look == wanted or (self._fault.lasting and look > wanted))
        if struck and self._fault.kind == "frames lost":
            raise DeviceError("the frames were lost on the cable.")
        frames = self._machine.recorded(since)
        self._still = self._still or (frames[0] if struck else None)
        return [self._freeze(frame) for frame in frames]

    def stop(self) -> list[Frame]:
        """Return the recording, or the first share of it."""
        self._recordings += 1
        frames = [self._freeze(frame) for frame in self._machine.stop()]
        struck = self._fault.kind == "frames lost" and self._fault.strikes(self._recordings - 1)
        return frames[: int(self._fault.share * len(frames))] if struck else frames

    def _freeze(self, frame: Frame) -> Frame:
        still = self._still
        return frame if still is None or frame.time < still.time else replace(still, time=frame.time)
