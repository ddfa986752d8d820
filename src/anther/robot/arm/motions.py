"""When the arm is where: timed joint paths within the limits of speed, acceleration and torque. N waypoints, T samples.

Torques are those of rigid bodies (recursive Newton-Euler, pinocchio) with the URDF's inertias, the tool's mass and
rotor inertia. A motion that needs more than `USABLE` of the URDF's efforts is refused: the arm could not follow it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import ArrayLike
from roboplan.core import JointPath, Scene
from roboplan.toppra import PathParameterizerTOPPRA, SplineFittingMode, TOPPRAOptions
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.core.libraries import silent_stdout
from anther.robot.arm._collision import GROUP, urdf
from anther.robot.arm.model import ArmModel
from anther.robot.devices import JointTrajectory

pin: Any = pinocchio  # its names come from C++ at run time; type checkers do not see them

PERIOD = 0.004  # s between samples


def straight(
    arm: ArmModel, start: Array, goal: Array, velocity_share: float, acceleration_share: float, flange_limit: float
) -> JointTrajectory:
    """Return the time-optimal motion from rest to rest along the straight line between two joint vectors (J,).

    On a straight line the joints' limits are one bound on the speed s' and one on s''; what the flange's limit [m/s]
    leaves of s' changes along the line. The highest speed everywhere below it, rising and falling no faster than s''
    lets it, is optimal (Bobrow, Dubowsky and Gibson 1985): one pass from either end.

    Args:
        arm: its description.
        start, goal: joints [rad], not the same.
        velocity_share, acceleration_share: of the joints' limits.
        flange_limit: [m/s].
    """
    way, s = goal - start, np.linspace(0, 1, 401)  # within each piece the acceleration is constant
    rate = np.linalg.norm(np.gradient(arm.forward(start + s[:, None] * way)[:, :3, 3], s, axis=0), axis=1)
    room = velocity_share * (arm.velocity / np.maximum(np.abs(way), 1e-12)).min()
    gain = 2 * acceleration_share * (arm.acceleration / np.maximum(np.abs(way), 1e-12)).min() * s
    square = np.minimum(room, flange_limit / np.maximum(rate, 1e-12)) ** 2
    square[[0, -1]] = 0
    square = np.minimum.accumulate(square - gain) + gain
    square = (np.minimum.accumulate((square + gain)[::-1]) - gain[::-1])[::-1]
    speed = np.sqrt(np.maximum(square, 0))
    passed = np.append(0, np.cumsum(2 * np.diff(s) / (speed[:-1] + speed[1:])))
    times = np.linspace(0, passed[-1], max(int(np.ceil(passed[-1] / PERIOD)), 4) + 1)
    rates = np.interp(times, passed, speed)
    at = np.append(0, np.cumsum((rates[:-1] + rates[1:]) / 2)) * times[1]  # so a cubic between samples is a parabola
    return JointTrajectory(times, start + (at / at[-1])[:, None] * way, (rates / at[-1])[:, None] * way)


def fastest(
    arm: ArmModel, scene: Scene, path: Array, velocity_share: float, acceleration_share: float, blend: float = 0.01
) -> JointTrajectory:
    """Return the time-optimal motion along joints (N, J) by TOPP-RA, corners rounded by at most `blend` [rad].

    The caller checks it against limits and obstacles: a corner that cannot be rounded is left sharp.

    Args:
        arm: its description.
        scene: knows the limits.
        path: waypoints [rad].
        velocity_share, acceleration_share: of the joints' limits.
    """
    options = TOPPRAOptions(
        dt=PERIOD,
        mode=SplineFittingMode.LinearBlend,
        velocity_scale=velocity_share,
        acceleration_scale=acceleration_share,
        max_blend_deviation=blend,
    )
    waypoints = JointPath()
    waypoints.joint_names = list(arm.joints)
    waypoints.positions = list(path)
    with silent_stdout():  # a linear program that fails prints itself, and is raised
        timed = PathParameterizerTOPPRA(scene, GROUP).generate(waypoints, options)
    return JointTrajectory(np.array(timed.times), np.array(timed.positions), np.array(timed.velocities))


def stopping(
    arm: ArmModel, path: Array, velocity_share: float, acceleration_share: float, flange_limit: float
) -> JointTrajectory:
    """Return the motion that follows joints (N, J) exactly, stops at every waypoint; arguments as of `straight`."""
    legs = [leg for leg in zip(path, path[1:], strict=False) if np.abs(leg[1] - leg[0]).max() > 1e-9]
    return join([straight(arm, *leg, velocity_share, acceleration_share, flange_limit) for leg in legs])


def along_line(arm: ArmModel, path: Array, length: float, speed: float) -> JointTrajectory:
    """Return the motion along joints (N, J), evenly spaced on a line of the flange, smooth at both ends.

    The speed rises and falls as a quintic; all is slowed down evenly where a joint would be too fast.

    Args:
        arm: its description.
        path: joints [rad].
        length: of the line, or any measure of its size [m].
        speed: of the flange between the ramps [m/s].
    """
    joints = CubicSpline(np.linspace(0, 1, len(path)), path)
    ramp = min(0.15, length / speed)  # [s]: a third of the joints' acceleration at 0.12 m/s
    duration = length / speed + ramp
    slow = max(1.0, _excess(arm, *_ramp(joints, duration, ramp)))
    times, positions, velocities = _ramp(joints, duration * slow, ramp * slow)
    return JointTrajectory(times, positions, velocities)


def limit_share(arm: ArmModel, trajectory: JointTrajectory) -> float:
    """Return the largest share of any joint's velocity or acceleration limit that the motion needs."""
    acceleration = np.diff(trajectory.velocities, axis=0) / np.diff(trajectory.times)[:, None]
    return float(max(np.abs(trajectory.velocities / arm.velocity).max(), np.abs(acceleration / arm.acceleration).max()))


def slow_down(arm: ArmModel, trajectory: JointTrajectory, flange_limit: float) -> JointTrajectory:
    """Return the same motion, evenly slowed down where the flange [m/s] or a joint's acceleration is beyond its limit.

    TOPP-RA's samples keep the joints' limits; between them a cubic, as a controller interpolates, may not.
    """
    curve = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    ends = np.abs([curve(trajectory.times[:-1], 2), curve(np.nextafter(trajectory.times[1:], 0), 2)])
    jolt = np.sqrt((ends / arm.acceleration).max() / 0.98)
    factor = max(1.0, float(jolt), flange_speed(arm, trajectory) / flange_limit)
    return JointTrajectory(trajectory.times * factor, trajectory.positions, trajectory.velocities / factor)


def limit_speed(arm: ArmModel, trajectory: JointTrajectory) -> JointTrajectory:
    """Return the motion, slowed down evenly where it is too fast for an arm that `slows` near the ends of its range."""
    if arm.slows is None:
        return trajectory
    q, v = trajectory.positions, trajectory.velocities
    most = np.where(v > 0, arm.speed_limit(q), arm.speed_limit(q, down=True))
    rest = 1e-3  # no speed [rad/s]
    moves = np.abs(v) > rest
    share = float((np.abs(v[moves]) / np.maximum(most[moves], rest)).max(initial=0.0))
    factor = max(1.0, share / 0.95)  # between two samples the speed allowed changes
    return JointTrajectory(trajectory.times * factor, q, v / factor)


def flange_speed(arm: ArmModel, trajectory: JointTrajectory) -> float:
    """Return the greatest speed of the flange [m/s]."""
    at = arm.forward(trajectory.positions)[:, :3, 3]
    return float((np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(trajectory.times)).max())


def join(parts: list[JointTrajectory]) -> JointTrajectory:
    """Return motions, each starting at rest where the one before ended at rest, one after the other."""
    times, start = [parts[0].times], parts[0].duration
    for part in parts[1:]:
        times.append(part.times[1:] + start)
        start += part.duration
    positions = [parts[0].positions, *(part.positions[1:] for part in parts[1:])]
    velocities = [parts[0].velocities, *(part.velocities[1:] for part in parts[1:])]
    return JointTrajectory(np.concatenate(times), np.concatenate(positions), np.concatenate(velocities))


def _ramp(joints: CubicSpline, duration: float, ramp: float) -> tuple[Array, Array, Array]:
    """Return times, positions and velocities of a motion 0..1 whose speed is flat between two smooth ramps."""
    count = max(int(np.ceil(duration / PERIOD)), 20)  # of fewer samples the acceleration cannot be told
    times = np.linspace(0, duration, count + 1)
    top = 1 / (duration - ramp)

    def rise(t: Array) -> tuple[Array, Array]:
        x = np.clip(t / ramp, 0, 1)
        area = ramp * x**4 * (2.5 - 3 * x + x**2)
        return area + np.maximum(t - ramp, 0), x**3 * (10 - 15 * x + 6 * x**2)

    (up, speed_up), (down, speed_down) = rise(times), rise(times - (duration - ramp))
    s, rate = np.clip(top * (up - down), 0, 1), top * (speed_up - speed_down)
    return times, joints(s), joints(s, 1) * rate[:, None]


def _excess(arm: ArmModel, times: Array, positions: Array, velocities: Array) -> float:
    """Return the factor by which a motion must be slowed down to keep 90 % of the limits; below 1 if it does."""
    acceleration = np.gradient(velocities, times, axis=0)
    fast = np.abs(velocities / arm.velocity).max() / 0.9
    return float(max(fast, np.sqrt(np.abs(acceleration / arm.acceleration).max() / 0.9)))


USABLE = 0.9
"""Share of each effort limit that weight and inertia may take. The rest is for friction, of which nothing is published
for the robot: the numbers in Rethink's Gazebo model (facts: sawyer 1) calm a simulation, and with them the wrist could
not reach the SDK's own speed limit. An estimate."""


def torques(arm: ArmModel, q: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """Return the motors' torques (T, J) [N m] for joints, rates and accelerations, each (T, J) [rad, s]."""
    model, data = _model(arm)
    rows = (np.atleast_2d(np.asarray(x, dtype=np.float64)) for x in (q, velocity, acceleration))
    return np.array([pin.rnea(model, data, *row) for row in zip(*rows, strict=True)])


def effort_share(arm: ArmModel, trajectory: JointTrajectory) -> Array:
    """Return (J,) the largest share of each joint's effort limit that a motion needs."""
    acceleration = np.gradient(trajectory.velocities, trajectory.times, axis=0)
    needed = torques(arm, trajectory.positions, trajectory.velocities, acceleration)
    return np.abs(needed / arm.effort).max(axis=0)


def check_effort(arm: ArmModel, trajectory: JointTrajectory) -> JointTrajectory:
    """Return the motion if the motors are strong enough for it.

    Raises:
        StageFailure: limits_exceeded.
    """
    share = effort_share(arm, trajectory)
    worst = int(np.argmax(share))
    if share[worst] > USABLE:
        needed, allowed = share[worst] * arm.effort[worst], USABLE * arm.effort[worst]
        given = f"the motion needs {needed:.1f} N m of joint {worst}; allowed: <= {allowed:.1f}"
        raise StageFailure("limits_exceeded", f"{given}. Move slower or shake less.")
    return trajectory


def limit_effort(arm: ArmModel, trajectory: JointTrajectory) -> JointTrajectory:
    """Return the motion, slowed down evenly by up to a fifth where the motors are not strong enough for it."""
    factors = (1.0, 1.02, 1.05, 1.1, 1.2)  # factors of time tried for a motion that needs more
    motions = (JointTrajectory(trajectory.times * k, trajectory.positions, trajectory.velocities / k) for k in factors)
    return next((motion for motion in motions if effort_share(arm, motion).max() <= USABLE), trajectory)


def shake_amplitude(arm: ArmModel, q: Array, rates: Array, frequencies: ArrayLike) -> Array:
    """Return the amplitudes (Q,) [m] of a flange sinusoid at which the first motor gives all that is `USABLE`.

    Args:
        q: (J,) joints [rad].
        rates: (Q, J) joint motion per metre of the flange's [rad/m].
        frequencies: (Q,) [Hz].
    """
    still = np.zeros(arm.count)
    weight = torques(arm, q, still, still)
    basis = torques(arm, np.tile(q, (arm.count, 1)), np.zeros((arm.count, arm.count)), np.eye(arm.count)) - weight
    swung = rates @ basis
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequencies, dtype=np.float64))[:, None]
    room = USABLE * arm.effort - np.abs(weight)
    return np.maximum(room / (np.abs(swung) * omega**2), 0.0).min(axis=1)


def inertia(arm: ArmModel, q: Array) -> Array:
    """Return the (J, J) mass matrix of the links about joints (J,) [kg m^2], without the motors' rotors."""
    model, data = _model(arm)
    upper = np.triu(pin.crba(model, data, np.asarray(q, dtype=np.float64)))
    return upper + np.triu(upper, 1).T - np.diag(arm.rotor_inertia)


@cache
def _model(arm: ArmModel) -> tuple[Any, Any]:
    model = pin.buildModelFromXML(urdf(arm))
    model.armature = arm.rotor_inertia
    return model, model.createData()
