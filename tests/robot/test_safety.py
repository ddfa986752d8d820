"""The guard: every limit refuses what breaks it, nothing gets past, and readings that are wrong stop the arm."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeCamera, FakeGripper, fake_robot, horizontal_grasp
from hypothesis import given, settings
from hypothesis import strategies as st
from small_planner import SmallPlanner, solve
from test_execution import Plan

from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, Intrinsics
from anther.pollination.execution import execute
from anther.robot.arm.model import outline
from anther.robot.arm.planner import SHAKE_CAP
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.devices import ArmSample, DeviceError, Frame, GripperState, JointTrajectory, SafetyLimits
from anther.robot.pressing import Pressing
from anther.robot.safety import (
    AT_REST,
    GuardedArm,
    GuardedCamera,
    GuardedGripper,
    check_pieces,
    check_shake,
    check_trajectory,
    guard,
    shake_amplitude,
    stem_stress,
)
from anther.robot.safety._motion import find_hidden_swings
from anther.robot.swing import Swing


def path(goal: Array, *, seconds: float = 5.0, start: Array = SAWYER.neutral, samples: int = 100) -> JointTrajectory:
    """Return a joint line with a quintic time law, at rest at both ends."""
    s = np.linspace(0, 1, samples)[:, None]
    rise, rate = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / seconds
    return JointTrajectory(seconds * s[:, 0], start + rise * (goal - start), rate * (goal - start))


def turned(joint: int, angle: float) -> Array:
    return SAWYER.neutral + angle * np.eye(7)[joint]


def in_place(amplitude: float, frequency: float) -> JointTrajectory:
    """Return a trajectory whose samples stand still while the curve between them does not."""
    t = np.linspace(0, 2, int(2 * frequency) + 1)
    v = np.zeros((len(t), 7))
    v[1:-1, 6] = amplitude * frequency
    return JointTrajectory(t, np.tile(SAWYER.neutral, (len(t), 1)), v)


def around(*corners: float) -> Box:
    """Return a box by its lower and its upper corner, both counted from the flange at neutral [m]."""
    return Box(HERE + corners[:3], HERE + corners[3:])


HERE = SAWYER.forward(SAWYER.neutral)[:3, 3]
ELBOW_BOX = Box(np.array([0.25, -0.15, 0.25]), np.array([0.45, 0.25, 0.6]))
SOUND = path(turned(0, 0.4))
BAD: dict[str, tuple[JointTrajectory, SafetyLimits]] = {
    "start of the path": (path(SAWYER.neutral, start=SAWYER.neutral + 0.2), LIMITS),
    "joint 1: .* beyond its range": (path(turned(1, 4.0), seconds=30), LIMITS),
    "joint 3: .* beyond its range": (path(turned(3, SAWYER.upper[3] - 0.01 - SAWYER.neutral[3])), LIMITS),
    "joint 5: .* beyond its range": (path(turned(5, SAWYER.lower[5] + 0.01 - SAWYER.neutral[5]), seconds=30), LIMITS),
    "speed of joint 0": (path(turned(0, 1.0), seconds=0.6), replace(LIMITS, joint_acceleration=np.full(7, 1e3))),
    "acceleration of joint 6": (path(turned(6, 0.15), seconds=0.2), LIMITS),
    "speed of joint 6": (in_place(2.0, 20.0), LIMITS),
    "speed at the ends": (replace(SOUND, velocities=SOUND.velocities + 0.1), LIMITS),
    "length of the motion": (path(turned(0, 0.1), seconds=130.0), LIMITS),
    "workspace": (path(turned(0, 1.1)), replace(LIMITS, workspace=Box(HERE - 0.3, HERE + 0.3))),
    "keep-out": (path(turned(0, 0.5)), replace(LIMITS, keep_out=(around(-0.1, 0.15, -0.1, 0.3, 0.3, 0.3),))),
    "keep-out box": (path(turned(0, 0.5)), replace(LIMITS, keep_out=(ELBOW_BOX,))),
    "flange speed": (path(turned(0, 0.8), seconds=1.5), replace(LIMITS, flange_speed=0.3)),
}


@pytest.mark.parametrize("message", BAD)
def test_each_limit_refuses_and_the_arm_holds(message: str) -> None:
    trajectory, limits = BAD[message]
    arm = FakeArm()
    with pytest.raises(StageFailure, match=message) as failure:
        GuardedArm(arm, limits).follow(trajectory)
    assert failure.value.kind == "limits_exceeded"
    assert (arm.done, arm.held) == (0, 1)
    assert np.array_equal(arm.now, SAWYER.neutral)


def test_a_sound_path_passes_and_returns() -> None:
    arm = FakeArm()
    guarded = GuardedArm(arm, LIMITS)
    guarded.follow(SOUND)
    guarded.follow(SOUND.backwards())
    guarded.follow(JointTrajectory.standstill(guarded.joints(), 0.5))
    assert (arm.done, arm.held) == (3, 0)
    assert arm.now == pytest.approx(SAWYER.neutral)


def test_the_elbow_is_kept_out_though_the_flange_is_far_away() -> None:
    flange = SAWYER.forward(path(turned(0, 0.5)).positions)[:, :3, 3]
    assert not ELBOW_BOX.contains(flange).any()


def test_outline_balls_are_the_planner_s_shapes() -> None:
    q = np.random.default_rng(0).uniform(SAWYER.lower, SAWYER.upper, (5, 7))
    balls = outline(SAWYER, q)
    assert balls.shape == (5, balls.shape[1], 4)
    tip = SAWYER.forward(q) @ [0, TOOL.stroke / 2, TOOL.tip, 1]
    to_tip = np.linalg.norm(balls[..., :3] - tip[:, None, :3], axis=-1) - balls[..., 3]
    assert np.all(to_tip.min(axis=1) < 0.012)
    elbow = SAWYER.link_poses(q)[:, 3, :3, 3]
    assert np.all((np.linalg.norm(balls[..., :3] - elbow[:, None], axis=-1) < balls[..., 3]).any(axis=1))
    assert np.linalg.norm(balls[..., :3], axis=-1).max() < 1.5


# Random trajectories. Most are wild; some are a sound one with one number changed.

NUMBERS = st.one_of(st.floats(-6, 6), st.floats(allow_nan=True, allow_infinity=True), st.floats(-0.02, 0.02))


@st.composite
def spoilt(draw: st.DrawFn) -> tuple[str, JointTrajectory]:
    """Return the sound path with one of its arrays changed at one place after it was made, behind its back."""
    arrays = {name: np.array(getattr(SOUND, name)) for name in ("times", "positions", "velocities")}
    trajectory = JointTrajectory(**arrays)
    name = draw(st.sampled_from(sorted(arrays)))
    row = draw(st.integers(0, len(SOUND.times) - 1))
    where = (row,) if name == "times" else (row, draw(st.integers(0, 6)))
    arrays[name][where] = draw(NUMBERS)
    return name, trajectory


def broken(trajectory: JointTrajectory, present: Array, limits: SafetyLimits) -> bool:
    """Return whether any sample breaks a limit: an oracle without interpolation, sample by sample."""
    t, q, v = trajectory.times, trajectory.positions, trajectory.velocities
    if not (np.isfinite(t).all() and np.isfinite(q).all() and np.isfinite(v).all()) or np.any(np.diff(t) <= 0):
        return True
    place = SAWYER.forward(q)[:, :3, 3]
    return bool(
        np.abs(q[0] - present).max() > limits.start_tolerance
        or np.abs(v[[0, -1]]).max() > AT_REST
        or np.any(q < limits.joint_lower + limits.joint_margin)
        or np.any(q > limits.joint_upper - limits.joint_margin)
        or np.any(np.abs(v) > limits.joint_speed)
        or np.any(np.abs(np.diff(q, axis=0)) > limits.joint_speed * np.diff(t)[:, None] * (1 + 1e-9) + 1e-12)
        or not limits.workspace.contains(place).all()
        or any((box.contains(place)).any() for box in limits.keep_out)
    )


NARROW = replace(
    LIMITS,
    workspace=around(-0.15, -0.05, -0.1, 0.05, 0.4, 0.1),
    keep_out=(around(-0.05, 0.2, 0.02, 0.05, 0.4, 0.3),),
)


@settings(max_examples=60)
@given(case=spoilt())
def test_no_spoilt_trajectory_gets_through(case: tuple[str, JointTrajectory]) -> None:
    arm = FakeArm()
    must_refuse = broken(case[1], SAWYER.neutral, LIMITS)
    try:
        GuardedArm(arm, LIMITS).follow(case[1])
    except StageFailure:
        assert (arm.done, arm.held) == (0, 1)
    else:
        assert not must_refuse


@settings(max_examples=60)
@given(
    goal=st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7),
    offset=st.floats(-0.1, 0.1),
    seconds=st.floats(0.2, 6),
    samples=st.integers(2, 60),
)
def test_no_random_trajectory_that_breaks_a_limit_gets_through(
    goal: list[float], offset: float, seconds: float, samples: int
) -> None:
    start = SAWYER.neutral + offset
    trajectory = path(start + np.array(goal), start=start, seconds=seconds, samples=samples)
    arm = FakeArm()
    must_refuse = broken(trajectory, SAWYER.neutral, NARROW)
    try:
        GuardedArm(arm, NARROW).follow(trajectory)
    except StageFailure:
        assert arm.done == 0
    else:
        assert not must_refuse


def test_what_was_checked_is_what_is_commanded() -> None:
    positions = np.array(SOUND.positions)
    trajectory = JointTrajectory(SOUND.times, positions, SOUND.velocities)

    def spoil(_: int) -> None:  # between check and command, as another thread might
        positions[50] += 1.0

    arm = FakeArm(fault=spoil)
    record = GuardedArm(arm, LIMITS).follow(trajectory)
    assert np.array_equal(record.commanded, SOUND.positions)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((0.05, 10.0, 1.0), "amplitude x 2 pi frequency"),
        ((0.002, 20.0, 1.0), r"amplitude x \(2 pi frequency\)\^2"),
        ((0.005, 5.0, LIMITS.shake_duration + 0.01), "shake duration"),
        ((-0.001, 5.0, 1.0), "allowed: a number > 0"),
        ((0.001, float("nan"), 1.0), "allowed: a number > 0"),
        ((0.001, 5.0, float("inf")), "allowed: a number > 0"),
    ],
)
def test_a_shake_over_the_limits_is_refused(numbers: tuple[float, float, float], message: str) -> None:
    with pytest.raises(StageFailure, match=message):
        check_shake(*numbers, LIMITS)


@given(amplitude=st.floats(1e-5, 0.2), frequency=st.floats(0.1, 60), duration=st.floats(0.1, 20))
def test_no_shake_passes_that_breaks_a_limit(amplitude: float, frequency: float, duration: float) -> None:
    omega = 2 * np.pi * frequency
    too_much = max(
        amplitude * omega / LIMITS.shake_speed,
        amplitude * omega**2 / LIMITS.shake_acceleration,
        duration / LIMITS.shake_duration,
    )
    try:
        check_shake(amplitude, frequency, duration, LIMITS)
    except StageFailure:
        assert too_much > 1
    else:
        assert too_much <= 1 + 1e-6


ACROSS = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])


@given(
    frequencies=st.lists(st.floats(1, 30), min_size=2, max_size=4),
    shares=st.lists(st.floats(0.05, 1), min_size=4, max_size=4),
    of_limit=st.floats(0.3, 1.5),
)
def test_tones_are_checked_as_the_path_of_their_sum(
    frequencies: list[float], shares: list[float], of_limit: float
) -> None:
    """Against the curve itself, ten times as fine: of each line every second tone."""
    amplitudes = of_limit * np.array(shares[: len(frequencies)]) * shake_amplitude(np.array(frequencies), LIMITS)
    piece = Swing.first(frequencies, amplitudes, 1.5, 0.5)
    parts = [(line, piece.only(np.arange(len(frequencies)) % 2 == d)) for d, line in enumerate(ACROSS)]
    t = np.linspace(0, piece.seconds, 60_001)
    rates = np.asarray(sum(part.motion(t)[1][:, None] * line for line, part in parts))
    most = float(np.linalg.norm(rates, axis=1).max()) / LIMITS.shake_speed
    most = max(most, float(np.linalg.norm(np.gradient(rates, t, axis=0), axis=1).max()) / LIMITS.shake_acceleration)
    if abs(most - 1) < 2e-3:
        return
    with pytest.raises(StageFailure, match="of the shake") if most > 1 else nullcontext():
        check_pieces(parts, LIMITS)


def test_tones_that_pass_alone_do_not_pass_together() -> None:
    tones = np.array([6.0, 7.0, 8.0])
    piece = Swing.first(tones, shake_amplitude(tones, LIMITS), 3.0, 0.5)
    for k in range(3):
        check_pieces([(ACROSS[0], piece.only(np.arange(3) == k))], LIMITS)
    with pytest.raises(StageFailure, match=r"acceleration of the shake: got 3\d.* allowed: <= 12"):
        check_pieces([(ACROSS[0], piece)], replace(LIMITS, shake_speed=2.0))
    slow = Swing.first([1.0, 1.1], shake_amplitude(np.array([1.0, 1.1]), LIMITS), 8.0, 0.5)
    with pytest.raises(StageFailure, match="speed of the shake"):
        check_pieces([(ACROSS[0], slow)], LIMITS)


@given(
    frequencies=st.lists(st.floats(1, 40), min_size=1, max_size=4, unique=True),
    shares=st.lists(st.floats(0.01, 1), min_size=8, max_size=8),
)
def test_mixtures_that_share_what_one_tone_may_pass_with_their_ramps(
    frequencies: list[float], shares: list[float]
) -> None:
    """So may one mixture turn into another: what is planned by `shake_amplitude` is not refused."""
    tones, ramp = np.array(frequencies), max(0.5, 0.5 / min(frequencies))
    before, after = (np.array(part[: len(tones)]) for part in (shares[:4], shares[4:]))
    limit = np.minimum(shake_amplitude(tones, LIMITS), SHAKE_CAP)
    first = Swing.first(tones, limit * before / before.sum(), ramp + 1.0, ramp)
    second = first.then(limit * after / after.sum(), ramp + 1.0, ramp)
    for piece in (first, second, second.then(0.0, ramp, ramp)):
        check_pieces([(ACROSS[0], piece)], LIMITS)


def test_coming_to_rest_counts_as_shaking() -> None:
    last = replace(Swing.first(5.0, 0.001, 0.6, 0.5), begin=LIMITS.shake_duration - 0.6).then(0.0, 0.5, 0.5)
    with pytest.raises(StageFailure, match=r"shake duration: got 30\.5 s"):
        check_pieces([(ACROSS[0], last)], LIMITS)


def test_a_box_beside_the_arm_is_no_reason_to_refuse_and_one_that_a_ball_touches_is() -> None:
    """Against all balls and boxes, one by one."""
    rng = np.random.default_rng(0)
    balls = LIMITS.outline(SOUND.positions).reshape(-1, 4)
    refused = []
    for _ in range(60):
        lower = rng.uniform(balls[:, :3].min(axis=0) - 0.1, balls[:, :3].max(axis=0) + 0.1)
        box = Box(lower, lower + rng.uniform(0.02, 0.2, 3))
        gap = np.linalg.norm(np.maximum(np.maximum(box.lower - balls[:, :3], balls[:, :3] - box.upper), 0), axis=1)
        gap = float((gap - balls[:, 3]).min())
        if abs(gap) < 0.01:  # between two samples of the path the guard looks closer than this test
            continue
        refused.append(gap < 0)
        with pytest.raises(StageFailure, match="keep-out") if refused[-1] else nullcontext():
            check_trajectory(SOUND, SAWYER.neutral, replace(LIMITS, keep_out=(box,)))
    assert 3 < sum(refused) < len(refused) - 3, "both happened"


def test_a_path_of_two_samples_is_checked_all_the_way() -> None:
    """Both ends are free, what lies half-way is not; nor is a workspace that ends there."""
    coarse = path(turned(0, 0.8), samples=2)
    tip = (SAWYER.forward(turned(0, 0.4)) @ [0, 0, TOOL.tip, 1])[:3]
    here = replace(LIMITS, keep_out=(Box(tip - 0.02, tip + 0.02),))
    for end in (coarse.positions[0], coarse.positions[-1]):
        check_trajectory(JointTrajectory.standstill(end, 1.0), end, here)
    with pytest.raises(StageFailure, match="keep-out"):
        check_trajectory(coarse, SAWYER.neutral, here)
    out = JointTrajectory(
        np.array([0.0, 4.0]), np.tile(SAWYER.neutral, (2, 1)), 0.04 * np.array([[1.0], [-1.0]]) * np.ones(7)
    )
    there = replace(LIMITS, workspace=Box(HERE - 0.01, HERE + 0.01))
    check_trajectory(JointTrajectory.standstill(SAWYER.neutral, 1.0), SAWYER.neutral, there)
    with pytest.raises(StageFailure, match="workspace"):
        check_trajectory(out, SAWYER.neutral, there)


def test_the_arm_is_as_thick_as_its_balls() -> None:
    """A grain just inside any of them is touched."""
    rng, still = np.random.default_rng(0), JointTrajectory.standstill(SAWYER.neutral, 1.0)
    balls = LIMITS.outline(SAWYER.neutral[None])[0]
    for ball in balls[balls[:, 3] > 0.03][::4]:
        away = rng.normal(size=3)
        grain = ball[:3] + 0.97 * ball[3] * away / np.linalg.norm(away)
        with pytest.raises(StageFailure, match="keep-out"):
            check_trajectory(still, SAWYER.neutral, replace(LIMITS, keep_out=(Box(grain - 1e-4, grain + 1e-4),)))


@pytest.mark.parametrize("reached", [True, False])
def test_a_shake_is_held_against_the_boxes_in_few_poses_and_as_far_as_it_goes(reached: bool) -> None:
    """The arm asks for the next piece of a shake in motion: the check is what it waits for."""
    t = np.linspace(0, 2, 1001)[:, None]
    swing, omega = turned(0, 0.01) - SAWYER.neutral, 2 * np.pi * 5
    shake = JointTrajectory(t[:, 0], SAWYER.neutral + swing * np.sin(omega * t), swing * omega * np.cos(omega * t))
    balls = LIMITS.outline(shake.positions)
    ends = (balls[..., 1] + balls[..., 3]).max(axis=0)  # of every ball, as far as it goes to the left
    ball = int(ends.argmax())
    lower = balls[0, ball, :3] - 0.005
    lower[1] = ends[ball] + (-0.004 if reached else 0.001)  # rests leave it free, and so does half the way
    box, seen = Box(lower, lower + 0.01), list[int]()

    def outline(q: Array) -> Array:
        seen.append(len(q))
        return LIMITS.outline(q)

    with pytest.raises(StageFailure, match="keep-out") if reached else nullcontext():
        check_trajectory(
            shake,
            SAWYER.neutral,
            replace(LIMITS, keep_out=(box,), outline=outline, joint_acceleration=np.full(7, 1e3)),
            joined=True,
            goes_on=True,
        )
    assert sum(seen) < 50 < len(t)


# What the arm says on its way.


def readings(change: Callable[[int, ArmSample], ArmSample]) -> FakeArm:
    """Return an arm whose n-th reading is changed."""

    class Changed(FakeArm):
        count = 0

        def follow(self, trajectory, watch=None, more=None):
            def changed(sample: ArmSample) -> None:
                self.count += 1
                watch(change(self.count, sample))

            return super().follow(trajectory, changed, more)

    return Changed()


FROZEN = ArmSample(0.0, SAWYER.neutral, SAWYER.neutral)
READINGS: dict[str, Callable[[int, ArmSample], ArmSample]] = {
    "contact force": lambda n, s: replace(s, force=LIMITS.contact_force + 1 if n > 40 else s.force),
    "arm force: got -60 N": lambda n, s: replace(s, force=-60.0 if n > 40 else s.force),
    "arm force: got none": lambda n, s: replace(s, force=np.nan if n > 40 else s.force),
    "arm force: got 0 N, the same": lambda n, s: replace(s, force=0.0 if n > 5 else s.force),
    "arm force: got 3 N, the same": lambda n, s: replace(s, force=3.0),
    "does not follow": lambda n, s: replace(s, measured=s.measured + (0.25 if n > 40 else 0.0)),
    "does not follow: nan": lambda n, s: replace(s, measured=s.measured * (np.nan if n > 40 else 1)),
    "stale: joint 0 reads the same": lambda n, s: replace(s, measured=FROZEN.measured if n > 5 else s.measured),
    "stale: the clock": lambda n, s: replace(s, time=min(s.time, 1.0)),
    "stale: the clock of the readings stands at -0.": lambda n, s: replace(s, time=s.time - (2.0 if n > 30 else 0.0)),
}


@pytest.mark.parametrize("message", READINGS)
def test_a_bad_reading_stops_the_arm_on_its_way(message: str) -> None:
    arm = readings(READINGS[message])
    guarded = GuardedArm(arm, replace(LIMITS, tracking=0.2))
    with pytest.raises(StageFailure, match=message) as failure:
        guarded.follow(SOUND)
    assert failure.value.kind == ("collision" if message == "contact force" else "device_fault")
    assert (arm.done, arm.held) == (0, 1)
    travelled = float(np.abs(arm.now - SAWYER.neutral).max())
    assert travelled < 0.35
    if "stale" in message:
        with pytest.raises(DeviceError, match="stale"):
            guarded.follow(JointTrajectory.standstill(arm.now, 0.1))


NOISE = 1e-6 * np.random.default_rng(0).normal(size=(2000, len(SAWYER.neutral)))
HIDDEN: dict[str, Callable[[int, ArmSample], Array]] = {
    "all with noise": lambda n, s: SAWYER.neutral + NOISE[n],
    "one to the bit, the others with noise": lambda n, s: np.r_[SAWYER.neutral[0], (s.measured + NOISE[n])[1:]],
}


def swinging(amplitude: float, frequency: float) -> JointTrajectory:
    """Return a swing of the first joint [rad] at [Hz] that begins and ends softly."""
    t = np.arange(0, 3, 0.004)
    ends = np.clip(np.minimum(t, t[-1] - t) / 0.5, 0, 1)
    x = amplitude * ends**2 * (3 - 2 * ends) * np.sin(2 * np.pi * frequency * t)
    rate = np.gradient(x, t)
    rate[[0, -1]] = 0.0
    along = np.eye(len(SAWYER.neutral))[0]
    return JointTrajectory(t, SAWYER.neutral + x[:, None] * along, rate[:, None] * along)


@pytest.mark.parametrize("how", HIDDEN)
@pytest.mark.parametrize(("amplitude", "frequency"), [(0.05, 2.0), (5e-3, 4.0), (2e-4, 18.0)])
def test_a_joint_that_freezes_is_noticed_whatever_noise_and_other_joints_tell(
    how: str, amplitude: float, frequency: float
) -> None:
    arm = readings(lambda n, s: replace(s, measured=HIDDEN[how](n, s)))
    with pytest.raises(DeviceError, match="joint 0 reads the same"):
        GuardedArm(arm, LIMITS).follow(swinging(amplitude, frequency))
    assert arm.clock < 0.7  # of it a part passes until the swing is large enough


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.15])
@pytest.mark.parametrize(("amplitude", "frequency"), [(0.05, 1.0), (5e-4, 4.0), (5e-3, 4.0), (2e-3, 8.0), (2e-4, 18.0)])
def test_an_arm_that_lags_is_not_taken_for_stale(lag: float, amplitude: float, frequency: float) -> None:
    seen: list[ArmSample] = []

    def late(n: int, sample: ArmSample) -> ArmSample:
        seen.append(sample)
        then = next(s for s in reversed(seen) if s.time <= sample.time - lag or s is seen[0])
        return replace(sample, measured=then.commanded + NOISE[n])

    arm = readings(late)
    GuardedArm(arm, LIMITS).follow(swinging(amplitude, frequency))
    assert arm.done == 1


@pytest.mark.parametrize(("follows", "noise"), [(0.3, 1.0), (0.06, 0.3), (1.0, 100.0), (0.0, 3000.0)])
def test_a_small_swing_that_is_soft_or_lost_in_noise_is_not_taken_for_stale(follows: float, noise: float) -> None:
    arm = readings(
        lambda n, s: replace(s, measured=SAWYER.neutral + follows * (s.commanded - SAWYER.neutral) + noise * NOISE[n])
    )
    GuardedArm(arm, LIMITS).follow(swinging(2e-4, 18.0))
    assert arm.done == 1


@pytest.mark.parametrize("frequency", [6.5, 8.0, 9.8])
def test_a_weak_servo_near_an_antiresonance_is_not_taken_for_stale(frequency: float) -> None:
    """A simulated Sawyer's first joint followed 8 % of 2.2 mrad at 9.8 Hz; one that freezes there is noticed."""

    def told(follows: float) -> FakeArm:
        return readings(
            lambda n, s: replace(s, measured=SAWYER.neutral + follows * (s.commanded - SAWYER.neutral) + NOISE[n])
        )

    weak = told(0.08)
    GuardedArm(weak, LIMITS).follow(swinging(2.2e-3, frequency))
    assert weak.done == 1
    with pytest.raises(DeviceError, match="joint 0 reads the same"):
        GuardedArm(told(0.0), LIMITS).follow(swinging(2.2e-3, frequency))


def test_a_joint_that_the_others_still_is_not_taken_for_stale() -> None:
    two, still = np.eye(len(SAWYER.neutral))[:2].sum(axis=0), np.eye(len(SAWYER.neutral))[0]
    alone = swinging(2e-4, 18.0)
    both = JointTrajectory(
        alone.times,
        *(
            start + (x - start)[:, :1] * two
            for x, start in ((alone.positions, SAWYER.neutral), (alone.velocities, 0.0))
        ),
    )
    arm = readings(
        lambda n, s: replace(s, measured=s.commanded - 0.99 * (s.commanded - SAWYER.neutral) * still + NOISE[n])
    )
    GuardedArm(arm, LIMITS).follow(both)
    assert arm.done == 1


@pytest.mark.parametrize(("creeps", "stale"), [(5e-3, False), (2e-2, True)])
def test_a_joint_that_another_turns_back_while_it_creeps_is_not_taken_for_stale(creeps: float, stale: bool) -> None:
    """Its command travels a hundredth of the fast joint's, whose acceleration turns it by as much."""
    far = swinging(0.2, 0.8)
    share = np.array([1.0, creeps / 0.4, *np.zeros(len(SAWYER.neutral) - 2)])
    both = JointTrajectory(
        far.times, SAWYER.neutral + (far.positions - SAWYER.neutral)[:, :1] * share, far.velocities[:, :1] * share
    )
    arm = readings(lambda n, s: replace(s, measured=np.r_[s.commanded[0], SAWYER.neutral[1:]] + NOISE[n]))
    with pytest.raises(DeviceError, match="joint 1 reads the same") if stale else nullcontext():
        GuardedArm(arm, LIMITS).follow(both)


def test_readings_at_uneven_times_make_no_swing_of_a_steady_motion() -> None:
    times = np.cumsum(0.004 * np.random.default_rng(1).uniform(0.6, 1.4, 700))
    times -= times[0]
    share = times / times[-1]
    x, rate = 0.1 * share**2 * (3 - 2 * share), 0.6 * share * (1 - share) / times[-1]
    along = np.eye(len(SAWYER.neutral))[0]
    arm = readings(lambda n, s: replace(s, measured=s.commanded + NOISE[n]))
    GuardedArm(arm, LIMITS).follow(JointTrajectory(times, SAWYER.neutral + x[:, None] * along, rate[:, None] * along))
    assert arm.done == 1


def test_an_arm_that_feels_nothing_is_not_stopped_for_it() -> None:
    arm = readings(lambda _, s: replace(s, force=float("nan")))
    GuardedArm(arm, LIMITS).follow(SOUND)
    assert arm.done == 1


def test_a_force_that_is_lost_between_two_motions_is_missed() -> None:
    arm = FakeArm()
    guarded = GuardedArm(arm, LIMITS)
    guarded.follow(SOUND)
    arm.force = float("nan")
    with pytest.raises(DeviceError, match="arm force: got none"):
        guarded.follow(JointTrajectory.standstill(arm.now, 0.1))


def test_a_force_that_stands_is_stuck_however_short_the_motions_and_not_while_the_arm_stands() -> None:
    arm = readings(lambda _, s: replace(s, force=0.0))
    guarded = GuardedArm(arm, LIMITS)
    guarded.follow(JointTrajectory.standstill(arm.now, 5.0))
    short = path(turned(0, 0.01), seconds=0.4)
    guarded.follow(short)
    guarded.follow(JointTrajectory.standstill(arm.now, 5.0))
    guarded.follow(short.backwards())
    with pytest.raises(DeviceError, match="stuck"):
        guarded.follow(short)


def test_a_reading_that_repeats_for_a_moment_is_no_fault_however_long_the_arm_moves() -> None:
    last: list[ArmSample] = []

    def twice(n: int, sample: ArmSample) -> ArmSample:
        last.append(sample if n % 2 else replace(sample, measured=last[-1].measured))
        return last[-1]

    arm = readings(twice)
    GuardedArm(arm, replace(LIMITS, tracking=0.2)).follow(SOUND)
    assert arm.done == 1


def test_a_stale_reading_between_two_motions_is_found() -> None:
    arm = FakeArm()
    guarded = GuardedArm(arm, LIMITS)
    guarded.follow(SOUND)
    arm.joints = lambda: SAWYER.neutral  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="stale or the arm was moved"):
        guarded.follow(SOUND)
    assert arm.done == 1
    arm.joints = lambda: np.full(7, np.nan)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="NaN"):
        guarded.joints()


# Gripper and camera.


@pytest.mark.parametrize("opening", [-0.001, 0.06, float("nan"), float("inf")])
def test_the_gripper_is_not_sent_beyond_its_stroke(opening: float) -> None:
    gripper = FakeGripper()
    with pytest.raises(StageFailure, match="gripper opening") as failure:
        GuardedGripper(gripper, LIMITS).move(opening)
    assert failure.value.kind == "limits_exceeded"
    assert gripper.commands == []


def test_a_gripper_that_would_crush_opens() -> None:
    gripper = FakeGripper(0.008)
    with pytest.raises(StageFailure, match="grip force: got 8 N; the pads were opened"):
        GuardedGripper(gripper, replace(LIMITS, grip_force=5.0)).move(0.006)
    assert gripper.opening == TOOL.stroke


def test_a_hard_pad_on_a_thin_stem_opens_before_it_cuts() -> None:
    """The same grip: harmless with soft pads, refused with hard ones, whose pressure is in the message."""
    gripper = FakeGripper(0.005)
    soft = replace(LIMITS, pressing=Pressing(pad_modulus=1e6))
    state = GuardedGripper(gripper, soft).move(0.004)
    assert stem_stress(state, soft) == pytest.approx(291e3, rel=0.01)  # by hand: 8 N, 16 mm, 2.5 mm, 1.33 MPa
    with pytest.raises(StageFailure, match="stem stress: got") as failure:
        GuardedGripper(gripper, replace(LIMITS, pressing=Pressing(pad_modulus=2e7))).move(0.004)
    assert failure.value.kind == "limits_exceeded"
    assert gripper.opening == TOOL.stroke
    assert stem_stress(gripper.state(), soft) == 0


@pytest.mark.parametrize("opening", [0.006, 0.04])
def test_a_gripper_that_does_not_move_is_jammed(opening: float) -> None:
    class Stuck(FakeGripper):
        def move(self, opening: float) -> GripperState:
            return GripperState(0.02, 0.0, False)

        def state(self) -> GripperState:
            return GripperState(0.02, 0.0, False)

    with pytest.raises(DeviceError, match="jammed"):
        GuardedGripper(Stuck(), LIMITS).move(opening)


def test_pads_that_stop_at_a_stem_are_not_jammed_and_pads_that_do_not_let_it_go_are() -> None:
    class Clamped(FakeGripper):
        def move(self, opening: float) -> GripperState:
            return super().move(min(opening, 0.02))

    gripper = GuardedGripper(Clamped(0.02), LIMITS)
    assert gripper.move(0.004).opening == 0.02
    with pytest.raises(DeviceError, match=r"jammed: sent to 40\.0 mm, the pads stand at 20\.0 mm"):
        gripper.move(0.04)


def test_a_gripper_that_reads_nonsense_is_a_fault() -> None:
    gripper = FakeGripper()
    gripper.state = lambda: GripperState(float("nan"), 0.0, False)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="gripper reads nan"):
        GuardedGripper(gripper, LIMITS).state()


@pytest.mark.parametrize(("losses", "lost"), [(2, False), (3, True)])
def test_a_lost_frame_is_asked_for_again(losses: int, lost: bool) -> None:
    class Losing(FakeCamera):
        def read(self) -> Frame:
            frame = super().read()
            if self.reads <= losses:
                raise DeviceError("no frame")
            return frame

    camera = GuardedCamera(Losing())
    if lost:
        with pytest.raises(DeviceError, match="no frame in 3 tries"):
            camera.read()
    else:
        assert camera.read().time == pytest.approx(0.1)


def test_half_frames_and_frames_from_the_past_are_dropped() -> None:
    camera = FakeCamera()
    whole = camera.read()
    half = [replace(whole, time=0.7, depth=whole.depth[:2]), replace(whole, time=0.8, rgb=whole.rgb[:2])]
    nobody_knows_when = replace(whole, time=float("nan"))
    camera.stop = lambda: [nobody_knows_when, whole, *half, whole, camera._frame(1.0)]  # type: ignore[method-assign]
    assert [f.time for f in GuardedCamera(camera).stop()] == [whole.time, 1.0]


def test_a_recording_of_one_picture_again_and_again_is_a_fault() -> None:
    camera, seen = FakeCamera(), FakeCamera()._frame(0.0)
    live, frozen = [camera._frame(i / 30) for i in range(3)], [replace(seen, time=1 + i / 30) for i in range(9)]
    guarded = GuardedCamera(camera)
    guarded.start(30.0)
    camera.recorded = lambda _: live + frozen  # type: ignore[method-assign]
    assert guarded.recorded(0.0) == [*live, frozen[0]], "one picture counts once"
    camera.recorded = lambda _: frozen  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"9 frames .* same picture"):
        guarded.recorded(0.0)
    camera.stop = lambda: frozen  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"9 frames .* same picture"):
        guarded.stop()


def test_a_camera_that_froze_at_the_end_of_a_recording_is_found_out_by_the_next_reading() -> None:
    camera = FakeCamera()
    live, frozen = [camera._frame(i / 30) for i in range(9)], camera._frame(8 / 30)
    guarded = GuardedCamera(camera)
    guarded.start(30.0)
    camera.stop = lambda: live  # type: ignore[method-assign]
    assert guarded.stop() == live
    camera.read = lambda: replace(frozen, time=2.0)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="last picture of the recording again"):
        guarded.read()
    guarded.start(30.0)
    assert guarded.read().time == 2.0, "another recording, and another scene, begins"


@pytest.mark.parametrize(("pixels", "alive"), [(0, False), (12, True)])
def test_a_picture_of_which_hardly_a_pixel_changes_is_the_same(pixels: int, alive: bool) -> None:
    """Of 48 x 64 pixels every 16th is looked at; 12 of those 192 may be noise, none may be."""

    class Large(FakeCamera):
        intrinsics = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)

        def recorded(self, since: float) -> list[Frame]:
            frames = [Frame(since + i / 30, np.zeros((48, 64, 3), np.uint8), np.zeros((48, 64))) for i in range(3)]
            for i, frame in enumerate(frames):
                frame.rgb[0, : 4 * pixels : 4, 1] = i
            return frames

    if alive:
        assert len(GuardedCamera(Large()).recorded(0.0)) == 3
    else:
        with pytest.raises(DeviceError, match="same picture"):
            GuardedCamera(Large()).recorded(0.0)


# Nothing else can reach the device.


def test_every_command_of_a_trial_comes_through_the_guard() -> None:
    callers: set[str] = set()

    def note() -> None:
        frame = inspect.stack()[2]
        callers.add("/".join(frame.filename.rsplit("/", 2)[-2:]))

    class Arm(FakeArm):
        def follow(self, trajectory, watch=None, more=None):
            note()
            if self.done == 3:
                self.done = 10
                raise DeviceError("stopped")
            return super().follow(trajectory, watch, more)

        def hold(self) -> None:
            note()
            super().hold()

    class Gripper(FakeGripper):
        def move(self, opening: float) -> GripperState:
            note()
            return super().move(opening)

    arm = Arm()
    point = np.array([0.72, 0.0, -0.08])
    grasp = horizontal_grasp(point, np.zeros(7))
    grasp = horizontal_grasp(point, solve(grasp.T_world_flange))
    trial = execute(SmallPlanner(), Plan(grasp=grasp), fake_robot(arm, Gripper()), LIMITS)
    assert trial.failure == "device_fault"
    assert trial.phases[-1] == "retreat"
    assert callers == {"safety/__init__.py"}


def test_a_guarded_robot_shows_no_bare_machine() -> None:
    robot = guard(fake_robot(), LIMITS)
    for machine in (robot.arm, robot.gripper, robot.wrist_camera, robot.side_camera):
        public = [getattr(machine, name) for name in dir(machine) if not name.startswith("_")]
        assert not any(isinstance(value, FakeArm | FakeGripper | FakeCamera) for value in public)


def test_a_guard_is_not_laid_twice_with_the_same_limits() -> None:
    once, twice = guard(fake_robot(), LIMITS), guard(guard(fake_robot(), LIMITS), LIMITS)
    assert twice.arm._arm.__class__ is FakeArm  # type: ignore[attr-defined]
    again = guard(once, LIMITS)
    assert all(getattr(again, name) is getattr(once, name) for name in ("arm", "gripper", "wrist_camera"))


@pytest.mark.parametrize("first", [False, True])
def test_of_two_guards_the_stricter_limit_holds_whichever_came_first(first: bool) -> None:
    strict = replace(LIMITS, flange_speed=0.05), replace(LIMITS, contact_force=2.0), replace(LIMITS, grip_force=5.0)
    for limits in strict:
        arm, gripper = readings(lambda _, s: replace(s, force=3.0)), FakeGripper(0.008)
        robot = guard(fake_robot(arm, gripper), limits if first else LIMITS)
        robot = guard(robot, LIMITS if first else limits)
        moves = robot.gripper.move if limits is strict[2] else robot.arm.follow
        with pytest.raises(StageFailure, match=r"flange speed|contact force|grip force"):
            moves(0.006 if limits is strict[2] else SOUND)  # type: ignore[operator]
        assert arm.done == 0


def test_a_bare_machine_beside_a_guarded_arm_is_guarded() -> None:
    robot = replace(
        guard(fake_robot(), LIMITS), gripper=FakeGripper(), wrist_camera=FakeCamera(), side_camera=FakeCamera()
    )
    again = guard(robot, LIMITS)
    assert again.arm is robot.arm
    assert isinstance(again.gripper, GuardedGripper)
    assert isinstance(again.wrist_camera, GuardedCamera)
    assert isinstance(again.side_camera, GuardedCamera)


def test_limits_of_a_trial_hold_for_a_robot_that_was_guarded_with_wider_ones() -> None:
    arm = FakeArm()
    arm.force = 5.0
    trial = execute(SmallPlanner(), Plan(), guard(fake_robot(arm), LIMITS), replace(LIMITS, contact_force=2.0))
    assert trial.failure == "collision"


def test_check_is_the_same_for_whoever_asks() -> None:
    check_trajectory(SOUND, SAWYER.neutral, LIMITS)
    with pytest.raises(StageFailure, match="start of the path"):
        check_trajectory(SOUND, SAWYER.neutral + 0.06, LIMITS)


def test_an_arm_has_as_many_joints_as_its_limits_say() -> None:
    """The seam takes any number of joints; a path of another arm is refused before anything moves."""

    def forward(q: Array) -> Array:
        poses = np.tile(np.eye(4), (len(np.atleast_2d(q)), 1, 1))
        poses[:, :3, 3] = np.atleast_2d(q)[:, :3]
        return poses

    six = SafetyLimits(
        forward=forward,
        outline=lambda q: np.zeros((len(q), 1, 4)),
        joint_lower=np.full(6, -2.0),
        joint_upper=np.full(6, 2.0),
        joint_speed=np.full(6, 1.0),
        joint_acceleration=np.full(6, 5.0),
        workspace=Box(np.full(3, -1.0), np.full(3, 1.0)),
    )
    bare = FakeArm(np.zeros(6))
    arm = GuardedArm(bare, six)
    goal = np.array([0.3, 0.0, 0.1, 0.5, -0.5, 1.0])
    record = arm.follow(path(goal, start=np.zeros(6)))
    assert record.measured.shape[1] == 6
    np.testing.assert_allclose(arm.joints(), goal)
    with pytest.raises(StageFailure, match="got 7 joints; allowed: the arm's 6"):
        arm.follow(path(np.zeros(7), start=np.full(7, 0.3)))
    with pytest.raises(StageFailure, match="joint 5"):
        arm.follow(path(goal + 1.2 * np.eye(6)[5], start=goal))
    np.testing.assert_allclose(bare.joints(), goal)


RAMPING = 1e-5 * np.array(
    [
        [171, 57, -79, -187, -228, -186, -79, 55, 164, 210, 178, 81, -43, -147, -194, -170, -88, 18, 108, 151, 136, 73],
        [16, 4, -7, -15, -16, -11, -3, 5, 11, 13, 12, 10, 8, 5, 1, -3, -9, -13, -14, -9, 0, 13],
    ],
    dtype=float,
)
"""A weak joint of a simulated Sawyer, commanded and read, every 10 ms of a swing of 9.8 Hz that ends [rad]."""


def test_a_weak_joint_whose_swing_settles_is_not_taken_for_frozen() -> None:
    commanded, measured = RAMPING[..., None]
    times, travel, fast = 0.01 * np.arange(len(commanded)), np.ptp(commanded, axis=0), np.array([True])
    assert not find_hidden_swings(times, commanded, measured, travel, fast).any()
    frozen = 1e-6 * np.random.default_rng(0).normal(size=measured.shape)
    for still in (frozen, 0 * frozen):
        assert find_hidden_swings(times, commanded, still, travel, fast).all()
