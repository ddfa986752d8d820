"""The guard of motions that go on without a stop: each of them keeps every limit, and they join."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm
from test_safety import HERE, around, path, turned

from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory, More, SafetyLimits
from anther.robot.safety import GuardedArm
from anther.robot.safety._motion import JUMP, LONGEST

CUTS = (0, 90, 200, 300)


def cut(whole: JointTrajectory, cuts: tuple[int, ...] = CUTS) -> list[JointTrajectory]:
    """Return the pieces of a motion, which is at full speed where it is cut."""
    return [
        JointTrajectory(
            whole.times[a : b + 1] - whole.times[a], whole.positions[a : b + 1], whole.velocities[a : b + 1]
        )
        for a, b in zip(cuts, cuts[1:], strict=False)
    ]


def following(motions: list[JointTrajectory]) -> More:
    rest = iter(motions)
    return lambda: next(rest, None)


def moved(motion: JointTrajectory, *, by: Array | float = 0.0, faster: Array | float = 0.0) -> JointTrajectory:
    return JointTrajectory(motion.times, motion.positions + by, motion.velocities + faster)


WHOLE = path(turned(0, 0.4), samples=301)
ONE = np.eye(7)[2]
Change = Callable[[list[JointTrajectory]], list[JointTrajectory]]


def test_a_chain_that_joins_passes_whole() -> None:
    arm = FakeArm()
    guarded, pieces = GuardedArm(arm, LIMITS), cut(WHOLE)
    record = guarded.follow(pieces[0], None, following(pieces[1:]))
    assert (arm.done, arm.held) == (1, 0)
    assert arm.now == pytest.approx(WHOLE.positions[-1])
    assert len(record.times) == sum(len(piece.times) for piece in pieces)
    guarded.follow(WHOLE.backwards())  # it knows where the last of them ended
    assert arm.now == pytest.approx(SAWYER.neutral)


def test_a_motion_that_nothing_follows_may_not_end_at_speed_and_one_that_follows_nothing_not_begin_so() -> None:
    pieces = cut(WHOLE)
    for first in (pieces[0], moved(pieces[1], by=SAWYER.neutral - pieces[1].positions[0])):
        arm = FakeArm()
        with pytest.raises(StageFailure, match="speed at the ends"):
            GuardedArm(arm, LIMITS).follow(first)
        assert (arm.done, arm.held) == (0, 1)
    arm = FakeArm()
    with pytest.raises(StageFailure, match="speed at the ends"):
        GuardedArm(arm, LIMITS).follow(moved(pieces[1], by=SAWYER.neutral - pieces[1].positions[0]), None, lambda: None)
    assert np.array_equal(arm.now, SAWYER.neutral), "nothing was commanded"


BAD: dict[str, tuple[str, Change]] = {
    "jumps ahead": ("start of the path", lambda p: [p[0], moved(p[1], by=2 * JUMP * ONE), p[2]]),
    "jumps later": ("start of the path", lambda p: [p[0], p[1], moved(p[2], by=-2 * JUMP * ONE)]),
    "a kink": ("jump in speed", lambda p: [p[0], moved(p[1], faster=2 * JUMP * ONE), p[2]]),
    "a later kink": ("jump in speed", lambda p: [p[0], p[1], moved(p[2], faster=-2 * JUMP * ONE)]),
    "begins anew": ("jump in speed", lambda p: [p[0], path(turned(0, 0.4), start=p[0].positions[-1])]),
    "ends while moving": ("speed at the ends", lambda p: [p[0], p[1]]),
    "stops while moving": ("speed at the ends", lambda p: [p[0]]),
    "not a number": ("finite", lambda p: [p[0], _spoilt(p[1])]),
}


def _spoilt(motion: JointTrajectory) -> JointTrajectory:
    """Return a motion of which one number is changed behind its back."""
    places = motion.positions.copy()
    broken = JointTrajectory(motion.times, places, motion.velocities)
    places[5, 3] = np.nan
    return broken


@pytest.mark.parametrize("name", BAD)
def test_a_chain_that_does_not_join_is_refused_and_the_arm_holds(name: str) -> None:
    message, change = BAD[name]
    arm, pieces = FakeArm(), change(cut(WHOLE))
    with pytest.raises(StageFailure, match=message) as failure:
        GuardedArm(arm, LIMITS).follow(pieces[0], None, following(pieces[1:]))
    assert failure.value.kind == "limits_exceeded"
    assert (arm.done, arm.held) == (0, 1)


def test_joins_within_the_tolerance_pass() -> None:
    pieces = cut(WHOLE)
    off = [pieces[0], moved(pieces[1], by=0.5 * JUMP * ONE, faster=0.5 * JUMP * ONE), pieces[2]]
    arm = FakeArm()
    GuardedArm(arm, LIMITS).follow(off[0], None, following(off[1:]))
    assert (arm.done, arm.held) == (1, 0)


LATER: dict[str, tuple[str, JointTrajectory, SafetyLimits]] = {
    "range": ("beyond its range", path(turned(0, 0.4), samples=301), replace(LIMITS, joint_upper=SAWYER.neutral + 0.3)),
    "joint speed": (
        "speed of joint 0",
        path(turned(0, 1.0), seconds=2.0, samples=301),
        replace(LIMITS, joint_speed=np.full(7, 0.9), joint_acceleration=np.full(7, 1e3)),
    ),
    "acceleration": ("acceleration of joint 0", WHOLE, replace(LIMITS, joint_acceleration=np.full(7, 0.085))),
    "flange speed": ("flange speed", path(turned(0, 0.8), seconds=3, samples=301), replace(LIMITS, flange_speed=0.2)),
    "workspace": (
        "workspace",
        path(turned(0, 0.5), samples=301),
        replace(LIMITS, workspace=Box(HERE - 0.1, HERE + 0.1)),
    ),
    "keep-out": (
        "keep-out box",
        path(turned(0, 0.5), samples=301),
        replace(LIMITS, keep_out=(around(-0.1, 0.15, -0.1, 0.3, 0.3, 0.3),)),
    ),
}


@pytest.mark.parametrize("name", LATER)
def test_every_limit_holds_for_later_motions_too(name: str) -> None:
    message, whole, limits = LATER[name]
    pieces = cut(whole, (0, 20, 40, *range(60, 301, 20)))
    arm, given = FakeArm(), [pieces[0]]

    def more() -> JointTrajectory | None:
        given.append(pieces[len(given)])
        return given[-1]

    with pytest.raises(StageFailure, match=message) as failure:
        GuardedArm(arm, limits).follow(pieces[0], None, more)
    assert failure.value.kind == "limits_exceeded"
    assert 2 <= len(given) < len(pieces) or name == "acceleration"
    assert (arm.done, arm.held) == (0, 1)
    reached = np.abs(arm.now - given[-2].positions[-1]).max()
    assert reached < np.abs(np.diff(given[-2].positions[[0, -1]], axis=0)).max() + 1e-9, "the refused one never began"


def test_a_chain_is_no_longer_than_the_longest_motion() -> None:
    swing = path(turned(0, 0.1), seconds=10.0)
    there_and_back, count = [swing, swing.backwards()], int(LONGEST / 10)
    good = [there_and_back[i % 2] for i in range(count)]
    GuardedArm(FakeArm(), LIMITS).follow(good[0], None, following(good[1:]))
    arm = FakeArm()
    with pytest.raises(StageFailure, match="length of the motion") as failure:
        GuardedArm(arm, LIMITS).follow(good[0], None, following([*good[1:], there_and_back[count % 2]]))
    assert failure.value.kind == "limits_exceeded"
    assert (arm.done, arm.held) == (0, 1)


def test_what_is_commanded_is_a_copy_that_nobody_can_change() -> None:
    pieces, commanded = cut(WHOLE), list[JointTrajectory]()

    class Noting(FakeArm):
        def follow(self, trajectory, watch=None, more=None):  # type: ignore[no-untyped-def]
            def noted() -> JointTrajectory | None:
                assert more is not None
                motion = more()
                commanded.extend([] if motion is None else [motion])
                return motion

            return super().follow(trajectory, watch, noted)

    GuardedArm(Noting(), LIMITS).follow(pieces[0], None, following(pieces[1:]))
    for given, told in zip(pieces[1:], commanded, strict=False):
        assert np.array_equal(given.positions, told.positions)
        assert not np.shares_memory(given.positions, told.positions)
        assert not np.shares_memory(given.velocities, told.velocities)


@pytest.mark.parametrize("error", [RuntimeError("bug"), KeyboardInterrupt()])
def test_one_who_fails_to_say_what_follows_leaves_the_arm_holding(error: BaseException) -> None:
    def more() -> JointTrajectory | None:
        raise error

    arm = FakeArm()
    with pytest.raises(type(error)):
        GuardedArm(arm, LIMITS).follow(cut(WHOLE)[0], None, more)
    assert (arm.done, arm.held) == (0, 1)
