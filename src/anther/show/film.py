"""The film of a shake's end: what the side camera saw, in simulation with the robot that it does not render."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from anther.core.files import written
from anther.core.geometry import Array, interpolate
from anther.pollination.execution import Trial
from anther.robot.arm.model import ArmModel
from anther.robot.devices import Frame, Robot
from anther.show.scene import hand, limbs
from anther.show.style import GRIPPER_COLOR, ROBOT_COLOR, rgb


def save_film(path: Path, frames: Sequence[Frame], *, seconds: float = 1.5) -> None:
    """Write the end of a recording as an animated WebP that plays at half the speed; nothing of fewer than two frames.

    Args:
        path: of the file.
        frames: in order of time.
        seconds: of the recording's end.

    Raises:
        InputError: the file cannot be written.
    """
    last = [frame for frame in frames if frame.time >= frames[-1].time - seconds]
    if len(last) < 2:
        return
    width = 420  # px, as wide as the report shows it
    height = round(width * last[0].rgb.shape[0] / last[0].rgb.shape[1])
    pictures = [Image.fromarray(frame.rgb).resize((width, height), Image.Resampling.LANCZOS) for frame in last]
    apart = round(1000 * 2.0 * (last[-1].time - last[0].time) / (len(last) - 1))
    style: dict[str, Any] = {"save_all": True, "append_images": pictures[1:], "duration": apart, "loop": 0}
    with written(path, "a folder that can be written"):
        pictures[0].save(path, "WEBP", quality=80, method=4, **style)


def with_robot(frames: Sequence[Frame], trial: Trial, robot: Robot, arm: ArmModel) -> list[Frame]:
    """Return the last frames of a simulated side camera with arm and gripper drawn where they are in front.

    That camera sees the plant alone; the arm stands in a frame as it read itself then. Motions keep their size.
    """
    from anther.sim.render import Scene  # noqa: PLC0415 - the simulator is an extra

    camera, pose = robot.side_camera, robot.T_world_side_camera
    if camera is None or pose is None or not len(trial.shake_times):
        return list(frames)
    opening = float(trial.gripper[0, 0]) if len(trial.gripper) else 0.0
    parts = [*((solids, ROBOT_COLOR) for solids in limbs(arm)), (hand(arm.tool, opening), GRIPPER_COLOR)]
    parts: list[Any] = [([trimesh.util.concatenate(solids)] if solids else [], colour) for solids, colour in parts]
    meshes = [(i, mesh, colour) for i, (solids, colour) in enumerate(parts) for mesh in solids]
    starts = np.cumsum([0, *(len(mesh.vertices) for _, mesh, _ in meshes)])
    faces = np.concatenate([mesh.faces + at for (_, mesh, _), at in zip(meshes, starts, strict=False)])
    colours = np.concatenate([np.tile(rgb(colour), (len(mesh.vertices), 1)) for _, mesh, colour in meshes])

    def posed(time: float) -> Array:
        joints = interpolate(time, trial.shake_times, trial.measured)
        at = [np.eye(4), *arm.link_poses(joints)]
        return np.concatenate([mesh.vertices @ at[i][:3, :3].T + at[i][:3, 3] for i, mesh, _ in meshes])

    bright = np.ones((len(colours), 2))
    scene = Scene(posed(frames[0].time), faces, np.zeros(len(faces), np.uint8), colours, ambient=bright)
    shown = []
    for frame in frames:
        seen = scene.moved(posed(frame.time)).render(camera.intrinsics, pose)
        behind = np.where(frame.depth > 0, frame.depth, np.inf)
        before = (seen.depth > 0) & (seen.depth < behind)
        shown.append(replace(frame, rgb=np.where(before[..., None], seen.rgb, frame.rgb)))
    return shown
