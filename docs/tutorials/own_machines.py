# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # My own arm and camera
#
# `anther.robot.devices` is the seam: an arm, a gripper and a camera are Protocols of three to five methods. Whatever
# has these methods can be driven, whoever wrote it. This page writes an arm of six joints, puts Anther's guard
# before it, and sees the guard refuse and stop. The arm is a program here; in yours, `_send` and `_read` talk to
# the controller.

# %%
import numpy as np

from anther.core import Box, StageFailure
from anther.robot import LEAD, ArmRecord, ArmSample, DeviceError, GuardedArm, JointTrajectory, SafetyLimits

# %% [markdown]
# ## An arm
#
# `follow` returns when the motion has ended. `watch` sees every reading on the way and stops the arm by raising:
# so does Ctrl-C. `more` is asked, `LEAD` seconds before the end, for what is to follow without a stop; a shake
# that is raised while it lasts comes that way.


# %%
class MyArm:
    """Six joints, streamed at 100 Hz."""

    def __init__(self, joints):
        self._now, self._clock = np.array(joints, dtype=float), 0.0

    def joints(self):
        return self._now.copy()

    def follow(self, trajectory, watch=None, more=None):
        samples, piece = [], trajectory
        try:
            while piece is not None:
                following, asked, begin = None, more is None, self._clock
                for t in np.minimum(np.arange(0.01, piece.duration + 0.01, 0.01), piece.duration):
                    command = [np.interp(t, piece.times, q) for q in piece.positions.T]
                    self._send(command)
                    self._clock = begin + t
                    samples.append(ArmSample(self._clock, np.array(command), self._read()))
                    if watch is not None:
                        watch(samples[-1])
                    if not asked and t >= piece.duration - LEAD:
                        asked, following = True, more()
                piece = following
        except BaseException:
            self.hold()
            raise
        return ArmRecord.of(samples)

    def hold(self):
        self._send(self._now)

    def _send(self, command):
        self._now = np.array(command, dtype=float)

    def _read(self):
        return self._now.copy()


# %% [markdown]
# ## What it may do
#
# Limits come from the arm's own description. `forward` and `outline` say where flange and links are; here a
# gantry, whose first three joints are its place, stands for your kinematics. The guard then refuses whatever
# breaks a limit before anything moves, and listens to every reading on the way.


# %%
def forward(q):
    q = np.atleast_2d(q)
    T = np.tile(np.eye(4), (len(q), 1, 1))
    T[:, :3, 3] = q[:, :3]
    return T


def outline(q):
    return np.concatenate([np.atleast_2d(q)[:, None, :3], np.full((len(np.atleast_2d(q)), 1, 1), 0.05)], axis=-1)


limits = SafetyLimits(
    forward=forward,
    outline=outline,
    joint_lower=np.full(6, -2.0),
    joint_upper=np.full(6, 2.0),
    joint_speed=np.full(6, 1.0),
    joint_acceleration=np.full(6, 5.0),
    workspace=Box(np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.5])),
)
arm = GuardedArm(MyArm([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]), limits)


# %%
def line(start, goal, seconds):
    s = np.linspace(0, 1, 100)[:, None]
    rise, rate = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / seconds
    return JointTrajectory(seconds * s[:, 0], start + rise * (goal - start), rate * (goal - start))


start = arm.joints()
goal = start + np.array([0.3, 0.1, 0.2, 0.5, 0.0, 0.0])
record = arm.follow(line(start, goal, 3.0))
print(
    f"went there in {record.times[-1]:.1f} s with {len(record.times)} readings,",
    f"off by {abs(arm.joints() - goal).max():.1e} rad",
)

# %% [markdown]
# ## What is refused, and what stops it

# %%
for what, path in {
    "too fast": line(goal, start, 0.2),
    "outside the workspace": line(goal, goal + np.array([0.9, 0, 0, 0, 0, 0]), 5.0),
    "from somewhere else": line(start, goal, 3.0),
    "of another arm": line(np.zeros(7), np.ones(7), 5.0),
}.items():
    try:
        arm.follow(path)
    except StageFailure as refused:
        print(f"{what}: {refused}")


def until_half_way(sample):
    if sample.measured[0] < 0.15:
        raise DeviceError("enough")


try:
    arm.follow(line(goal, start, 3.0), watch=until_half_way)
except DeviceError:
    print(f"stopped at {arm.joints()[0]:.2f} m and holds")

# %% [markdown]
# Gripper and cameras are as small: [the Protocols](../api/robot.md). What the guard promises is on
# [safety](../safety.md).
#
# ## Check your driver
#
# `anther.robot.testing` checks what the Protocols promise, behind a stand-in for your machine and never on metal: stale
# and missing readings refused, braking without a jump, no motion after a pause. With pytest:
#
# ```python
# import time, numpy as np, pytest
# from anther.robot.testing import ARM_CHECKS, ARM_FAULT_CHECKS, ArmRig
#
# @pytest.mark.parametrize("check", [*ARM_CHECKS, *ARM_FAULT_CHECKS])
# def test_my_arm(check):
#     machine = MySimulator()
#     faults = {"silence": machine.go_silent, "not a number": machine.tell_nan}
#     check(ArmRig(lambda: MyArm(machine.address), time.monotonic, time.sleep, np.full(6, 5.0),
#                  history=machine.history, commands=machine.count_commands, faults=faults))
# ```
#
# Without `history` and `faults` the checks that need them are skipped. Here the arm of this page, on its own clock:

# %%
from anther.robot.testing import ArmRig, check_hold_at_rest, check_joined_motions, check_motion, check_watcher_error  # noqa: E402

rig = ArmRig(lambda: MyArm(np.zeros(6)), clock=lambda: 0.0, sleep=lambda seconds: None, acceleration=np.full(6, 5.0))
for check in (check_motion, check_watcher_error, check_hold_at_rest, check_joined_motions):
    check(rig)
    print(f"{check.__name__}: kept")
