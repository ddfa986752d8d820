"""A cell's machines: check that all are there (nothing moves), enable them, or move one joint a little."""

from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from anther.cli.args.cell import Args

if TYPE_CHECKING:
    from anther.robot.cells import CellFile
    from anther.robot.devices import Arm, Camera, Imu, JointTrajectory


def run(args: Args) -> int:
    """Do it; return 0, or 1 where a part is missing."""
    from anther.robot.cells import read_cell

    if args.action == "serve-ros":
        return serve_ros(args.file, args.frame)
    file = read_cell(args.file)
    if args.action == "check":
        return check(file)
    return enable(file) if args.action == "enable" else jog(file, args.joint, args.by)


def check(file: CellFile) -> int:
    """Connect to each part by itself and print what it sees, or what is missing; nothing moves."""
    from rich.console import Console
    from rich.table import Table

    from anther.core.errors import AntherError
    from anther.robot.cells import own_cell

    table, missing = Table("part", "driver", "what it sees", title=str(file.source.path), title_justify="left"), 0
    connected: dict[str, Any] = {}
    looks = (
        ("arm", file.arm, partial(_describe_arm, file=file)),
        ("gripper", file.gripper, _describe_gripper),
        ("wrist camera", file.wrist_camera, _describe_camera),
        ("side camera", file.side_camera, _describe_camera),
        ("shaker", file.shaker, lambda motor: [f"stroke {1e3 * motor.stroke:.2f} mm"]),
        ("cart", file.cart, partial(_describe_cart, file=file)),
        ("imu", file.imu, lambda imu: _describe_imu(imu, file, connected.get("arm"))),
    )
    with own_cell(file) as keep:
        for name, part, see in looks:
            if part is None:
                table.add_row(name, "-", "none in the file")
                continue
            try:
                connected[name] = keep(file.connect(part, arm=connected.get("arm")))
                seen = "\n".join(see(connected[name]))
            except AntherError as error:
                missing += 1
                seen = f"MISSING: {error}"
            table.add_row(name, part.driver, seen)
    table.add_row("limits", "", "\n".join(_limits_words(file)))
    Console(markup=False, highlight=False).print(table)
    print(f"{f'{missing} missing' if missing else 'all parts are there'}; nothing was moved")
    return int(missing > 0)


def serve_ros(path: Path, frame: str) -> int:
    """Answer under ROS 2 until Ctrl-C."""
    from contextlib import closing, suppress

    from anther.show.ros import PlantNode
    from anther.sim.cell_file import read_simulated

    file = read_simulated(path)
    if file.supposed:
        print(f"the file lacks {', '.join(file.supposed)}: supposed as for a simulation (docs/sim_cell.md)")
    with closing(PlantNode(file, frame)) as node, suppress(KeyboardInterrupt):
        print(f"{node.words}. Nothing is moved. Ctrl-C ends.", flush=True)
        while True:
            time.sleep(1)
    return 0


def enable(file: CellFile) -> int:
    """Switch the arm's motors on and let the gripper find its ends, each after a yes."""
    from anther.robot.cells import own_cell

    with own_cell(file) as keep:
        arm = keep(file.connect(file.arm))
        if hasattr(arm, "enable") and agreed("Switch the arm's motors on? Nobody in its reach, the stop in your hand."):
            arm.enable()
            print("the arm is enabled and holds where it is")
        gripper = keep(file.connect(file.gripper, arm=arm))
        question = "Open and close the gripper all the way? Nothing between its fingers."
        if hasattr(gripper, "enable") and agreed(question):
            gripper.enable()
            counts = f"; counts = {list(gripper.counts)}" if hasattr(gripper, "counts") else ""
            print(f"the gripper is enabled{counts}")
    return 0


def jog(file: CellFile, joint: int | None, degrees: float) -> int:
    """Move one joint, None is the last, a little and tell where it went, after a yes."""
    from anther.core.checks import check_range
    from anther.robot.cells import own_cell
    from anther.robot.cells.hardware import guarded_arm

    check_range("by", abs(degrees), 0.01, 10.0, "degrees")
    limits = file.safety_limits()
    last = len(limits.joint_lower) - 1
    joint = last if joint is None else joint
    check_range("joint", joint, 0, last)
    with own_cell(file) as keep:
        guarded = guarded_arm(file, keep(file.connect(file.arm)), keep)
        motion = _small_motion(file, guarded, joint, np.deg2rad(degrees))
        if not agreed(f"Move joint {joint} by {degrees:g} degrees in {motion.duration:.1f} s?"):
            return 1
        record = guarded.follow(motion)
        gap = np.rad2deg(np.abs(record.commanded - record.measured).max())
        went = np.rad2deg(guarded.joints() - motion.positions[0])
        print(f"joint {joint} went {went[joint]:.3f} degrees; farthest behind {gap:.3f}; {len(record.times)} readings")
    return 0


def agreed(question: str) -> bool:
    """Return whether a person types yes."""
    try:
        answer = input(f"{question} Type yes: ")
    except EOFError:
        answer = ""
    if answer.strip().lower() != "yes":
        print("not done")
        return False
    return True


def _small_motion(file: CellFile, arm: Arm, joint: int, way: float) -> JointTrajectory:
    """Return the motion of one joint [rad]; arm and tool touch neither themselves nor a keep-out box."""
    from anther.core.errors import StageFailure
    from anther.robot.arm.planner import Planner
    from anther.robot.cells.hardware import motion_params

    boxes, none = list(file.keep_out), np.zeros((0, 3))
    params = motion_params(file.limits.speed_ratio)
    planner = Planner(none, none, boxes, space=file.arm_space, params=params, arm=file.model)
    here = arm.joints()
    there = here + way * np.eye(len(here))[joint]
    if not planner.world.path_free(np.stack([here, there])):
        raise StageFailure("collision", "the arm would touch itself or a keep-out box. Jog the other way.")
    return planner.move(here, there)


def _describe_arm(arm: Any, file: CellFile) -> list[str]:
    q, limits = arm.joints(), file.safety_limits()
    margin = np.rad2deg(np.minimum(q - limits.joint_lower, limits.joint_upper - q).min())
    flange = file.model.forward(q)[:3, 3]
    joints, place = " ".join(f"{x:.3f}" for x in q), ", ".join(f"{x:.3f}" for x in flange)
    inside = "inside" if limits.workspace.contains(flange) else "OUTSIDE"
    return [
        f"joints {joints} rad; {margin:.0f} degrees from the nearest end",
        f"flange at {place} m, {inside} its space",
        *(arm.describe() if hasattr(arm, "describe") else []),
    ]


def _describe_gripper(gripper: Any) -> list[str]:
    state = gripper.state()
    held = "holds something" if state.is_gripping else "holds nothing"
    told = f"presses with {state.force:.1f} N" if math.isfinite(state.force) else "does not tell its force"
    return [f"{1e3 * state.opening:.1f} of {1e3 * gripper.stroke:.1f} mm open, {held}, {told}"]


def _describe_camera(camera: Camera) -> list[str]:
    from anther.perception.coverage import describe_depth
    from anther.perception.masks import green_pixels

    before = time.monotonic()
    frame, lens = camera.read(), camera.intrinsics
    took, late = time.monotonic() - before, time.monotonic() - frame.time
    camera.start(30.0)
    time.sleep(1.0)
    frames = camera.stop()
    rate = (len(frames) - 1) / (frames[-1].time - frames[0].time) if len(frames) > 1 else float("nan")
    near = frame.depth[frame.depth > 0]
    plant = describe_depth(frame.depth, green_pixels(frame.rgb), lens.fx)
    return [
        f"{lens.width} x {lens.height} px, f {lens.fx:.1f} px; depth in {len(near) / frame.depth.size:.0%} of it",
        f"a frame after {1e3 * took:.0f} ms, {1e3 * late:.0f} ms old by its stamp; {rate:.1f} a second",
        *filter(None, [plant]),
    ]


def _describe_cart(cart: Any, file: CellFile) -> list[str]:
    from anther.core.checks import check_array

    state, limits = cart.state(), file.cart_limits()
    assert limits is not None
    lower, upper = limits.lower, limits.upper
    place = check_array("cart place", state.place, lower.shape)
    ends = ", ".join(f"{a:g} .. {b:g}" for a, b in zip(lower, upper, strict=True))
    between = "between" if np.all((lower <= place) & (place <= upper)) else "NOT between"
    return [
        f"{'MOVES' if state.is_moving else 'stands'} at {', '.join(f'{x:.3f}' for x in place)} m",
        f"{between} its ends {ends} m",
        *(cart.describe() if hasattr(cart, "describe") else []),
    ]


def _describe_imu(imu: Imu, file: CellFile, arm: Arm | None) -> list[str]:
    from anther.robot.cells.hardware import place_of_imu

    T_flange_imu, seconds = place_of_imu(file, imu), 1.0
    imu.start()
    time.sleep(seconds)
    told = imu.recorded(float("-inf"))
    imu.stop()
    if not len(told.times):
        return [f"reads NOTHING in {seconds:g} s"]
    mean = told.acceleration.mean(axis=0)
    words = [f"{len(told.times) / seconds:.0f} readings a second; {np.linalg.norm(mean):.2f} m/s2, at rest 9.81"]
    if arm is not None:
        up = (file.model.forward(arm.joints()) @ T_flange_imu)[:3, :3] @ mean
        tilt = np.degrees(np.arctan2(np.hypot(*up[:2]), up[2]))
        words.append(f"gravity {tilt:.1f} degrees from where the arm's joints have it")
    return words


def _limits_words(file: CellFile) -> list[str]:
    limits, count = file.safety_limits(), len(file.keep_out)
    joints = " ".join(f"{v:.2f}" for v in limits.joint_speed)
    return [
        f"speed ratio {file.limits.speed_ratio:g}: flange {limits.flange_speed:.2f} m/s, joints {joints} rad/s",
        f"contact {limits.contact_force:g} N, tracking {limits.tracking:g} rad, {count} keep-out boxes",
    ]
