"""The arm in a viser scene: each link as its collision shapes, which move with the joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from anther.arm.model import ArmModel, Capsule, Solid
from anther.geometry import Array
from anther.viewer.placed import placed

GREY, DARK = (165, 168, 175), (70, 72, 80)


class Robot:
    """An arm with its gripper, neutral until it is moved.

    Args:
        scene: viser's.
        arm: its description.
        opening: between the pads [m].
    """

    def __init__(self, scene: Any, arm: ArmModel, opening: float) -> None:
        self._arm = arm
        base = [_capsule(c) for c in arm.base_capsules] + [_box(s) for s in arm.base_solids]
        _add(scene, "/robot/base", base, GREY)
        self._frames = []
        parts = [([_capsule(c) for c in link.capsules], GREY) for link in arm.links]
        for i, (shapes, colour) in enumerate([*parts, ([_box(s) for s in arm.tool.solids(opening)], DARK)]):
            self._frames.append(scene.add_frame(f"/robot/{i}", show_axes=False))
            _add(scene, f"/robot/{i}/shape", shapes, colour)
        self.move(arm.neutral)

    def move(self, joints: Array) -> None:
        """Show the arm at joints (J,) [rad]."""
        for frame, T in zip(self._frames, self._arm.link_poses(joints), strict=True):
            frame.position, frame.wxyz = placed(T)


def _add(scene: Any, name: str, shapes: Sequence[Any], colour: tuple[int, int, int]) -> None:
    whole: Any = trimesh.util.concatenate(list(shapes))
    scene.add_mesh_simple(
        name, np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.uint32), color=colour
    )


def _capsule(capsule: Capsule) -> Any:
    start, end = np.array(capsule.start), np.array(capsule.end)
    along = end - start
    height = float(np.linalg.norm(along))
    mesh = trimesh.creation.capsule(height=height, radius=capsule.radius, count=(12, 12))
    mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], along / height))
    low = mesh.bounds.mean(axis=0)
    mesh.apply_translation((start + end) / 2 - low)
    return mesh


def _box(solid: Solid) -> Any:
    mesh = trimesh.creation.box(2 * np.array(solid.half))
    mesh.apply_translation(solid.center)
    return mesh
