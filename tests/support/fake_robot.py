"""A robot without physics: the arm goes where it is told, the gripper meets a stem of a given width or nothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from anther.core.geometry import Array, Box, Intrinsics, transform
from anther.pollination.grasp import Grasp
from anther.robot.arm.model import outline
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.devices import (
    LEAD,
    ArmRecord,
    ArmSample,
    DeviceError,
    Frame,
    GripperState,
    JointTrajectory,
    More,
    Robot,
    SafetyLimits,
    Watch,
)

LIMITS = SafetyLimits(
    forward=SAWYER.forward,
    outline=partial(outline, SAWYER),
    joint_lower=SAWYER.lower,
    joint_upper=SAWYER.upper,
    joint_speed=SAWYER.velocity,
    joint_acceleration=SAWYER.acceleration,
    workspace=Box(np.array([-1.0, -1.2, -0.5]), np.array([1.2, 1.2, 1.5])),
)


class FakeArm:
    """Follows perfectly. `fault` is called before each motion and may raise; `done` counts finished motions.

    A motion that is stopped on the way leaves the arm at the last sample that was seen. `force` is what it feels
    [N], and its sensor has noise, as any.
    """

    force = 0.0

    def __init__(self, joints: Array = SAWYER.neutral, fault: Callable[[int], None] = lambda _: None) -> None:
        self.now, self.clock, self.done, self.held, self.fault = np.array(joints), 0.0, 0, 0, fault
        self.noise = np.random.default_rng(0)

    def joints(self) -> Array:
        return self.now.copy()

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        self.fault(self.done)
        samples, piece = [], trajectory
        while piece is not None:
            asked, following, begin = False, None, self.clock + 0.01
            for time, q in zip(piece.times, piece.positions, strict=True):
                self.now, self.clock = q.copy(), float(begin + time)
                samples.append(ArmSample(self.clock, q, q, self.force + 1e-6 * self.noise.random()))
                if watch:
                    watch(samples[-1])
                if more is not None and not asked and time >= piece.duration - LEAD:
                    asked, following = True, more()
            piece = following
        self.done += 1
        return ArmRecord.of(samples)

    def hold(self) -> None:
        self.held += 1


class FakeGripper:
    """Closes until it meets something `width` wide [m]; 0 is nothing."""

    stroke = TOOL.stroke

    def __init__(self, width: float = 0.008) -> None:
        self.width, self.opening, self.commands = width, TOOL.stroke, []

    def move(self, opening: float) -> GripperState:
        self.commands.append(opening)
        self.opening = max(opening, self.width) if opening < self.opening else opening
        return self.state()

    def state(self) -> GripperState:
        held = self.width > 0 and self.opening <= self.width and self.commands[-1] < self.width
        return GripperState(self.opening, 8.0 if held else 0.0, held)


class FakeCamera:
    """Sees nothing but light that changes, at the rate asked for, for a second."""

    intrinsics = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
    rates = (15.0, 30.0, 60.0, 90.0)

    def __init__(self) -> None:
        self.asked: list[float] = []
        self.reads = 0

    def read(self) -> Frame:
        self.reads += 1
        return self._frame(self.reads / 30)

    def start(self, rate: float) -> None:
        self.asked.append(rate)

    def recorded(self, since: float) -> list[Frame]:
        if not self.asked:
            raise DeviceError("it records nothing")
        return [self._frame(since + i / self.asked[-1]) for i in range(int(self.asked[-1] / 2))]

    def stop(self) -> list[Frame]:
        return [self._frame(i / self.asked[-1]) for i in range(int(self.asked[-1]))] if self.asked else []

    def _frame(self, time: float) -> Frame:
        return Frame(time, np.full((6, 8, 3), round(1e3 * time) % 251, np.uint8), np.zeros((6, 8), np.float32))


def fake_robot(arm: FakeArm | None = None, gripper: FakeGripper | None = None) -> Robot:
    return Robot(arm or FakeArm(), gripper or FakeGripper(), FakeCamera(), FakeCamera(), np.eye(4))


def horizontal_grasp(point: Array, joints: Array, *, diameter: float = 0.008) -> Grasp:
    """Return a grasp of an upright stem, approached along +x, with the flange's +x up."""
    R = np.array([[0, 0, 1.0], [0, -1, 0], [1, 0, 0]])
    T = transform(R, point - R @ TOOL.T_flange_grasp[:3, 3])
    return Grasp(
        T_world_flange=T,
        point=point,
        tangent=np.array([0, 0, 1.0]),
        approach=R[:, 2],
        arc_length=0.2,
        stem_diameter=diameter,
        clearance=0.05,
        score=1.0,
        reason="the test's own",
        joints=joints,
    )
