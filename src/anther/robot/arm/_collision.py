"""What the arm must not touch: itself, the plant, and pot, soil, bench and floor. N plant points, M obstacle points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from itertools import pairwise

import numpy as np
from roboplan.core import Box as SceneBox
from roboplan.core import OcTree, Scene, hasCollisionsAlongPath, loadUrdfSceneDescriptionFromXml
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array, Box, occupied_cells, transform
from anther.robot.arm.model import BASE, CAMERA, FLANGE, GRIPPER, ArmModel, Capsule, Link, rpy

GROUP = "arm"
VOXEL = 0.008  # m, edge of the octree's cubes (facts: libraries, pin + coal: 20 us a check)


class CollisionWorld:
    """The arm among obstacles; answers whether joints, or the straight way between two, are free.

    Args:
        arm: its description.
        plant: (N, 3) plant points, world [m].
        obstacles: (M, 3) points of pot, soil and bench [m].
        boxes: solid boxes, world; the floor is always there.
    """

    free_step = 0.0015
    """Spacing of the last check along a path [rad] (facts: libraries, gotchas)."""

    def __init__(self, arm: ArmModel, plant: Array, obstacles: Array, boxes: Iterable[Box] = ()) -> None:
        self.arm, self._boxes = arm, tuple(boxes)
        self._points = {name: _cubes(points) for name, points in (("plant", plant), ("obstacles", obstacles))}
        self.scene = self._scene()

    def free(self, q: Array) -> bool:
        """Return whether joints (J,) are within limits and touch nothing."""
        inside = bool(np.all((q >= self.arm.lower) & (q <= self.arm.upper)))
        return inside and not self.scene.hasCollisions(q)

    def path_free(self, path: Array, step: float = free_step) -> bool:
        """Return whether joints (N, J), and the straight ways between them, are free at every `step` [rad]."""
        return self.free(path[0]) and not any(
            hasCollisionsAlongPath(self.scene, a, b, step, bisection=True) for a, b in zip(path, path[1:], strict=False)
        )

    @contextmanager
    def touching_plant(self) -> Iterator[None]:
        """Let gripper and camera touch the plant within the block, as they do when they take it or brush a leaf."""
        usual, self.scene = self.scene, self._brushing
        try:
            yield
        finally:
            self.scene = usual

    @cached_property
    def _brushing(self) -> Scene:
        """The scene in which they may: to build it once takes less time than to tell the other each time."""
        scene = self._scene()
        if self._points["plant"] is not None:
            tools = (GRIPPER, CAMERA, self.arm.links[-1].name)
            scene.setCollisions([("plant", tool) for tool in tools], False)
        return scene

    def _scene(self) -> Scene:
        scene, still = Scene("anther", loadUrdfSceneDescriptionFromXml(urdf(self.arm))), [BASE]
        scene.addGroup(GROUP, list(self.arm.joints))
        scene.setCollisions(self.arm.neighbours, False)

        def stands(name: str) -> None:
            scene.setCollisions([(name, other) for other in still], False)
            still.append(name)

        for name, cubes in self._points.items():
            if cubes is not None:
                scene.addOcTreeGeometry(name, "universe", cubes, _pose(np.zeros(3)), np.full(4, 0.5))
                stands(name)
        floor = Box(np.array([-3.0, -3.0, self.arm.floor - 0.1]), np.array([3.0, 3.0, self.arm.floor]))
        for i, box in enumerate((floor, *self._boxes)):
            shape, middle = SceneBox(*(box.upper - box.lower)), _pose((box.lower + box.upper) / 2)
            scene.addBoxGeometry(f"box{i}", "universe", shape, middle, np.full(4, 0.5))
            stands(f"box{i}")
        return scene


def _cubes(points: Array) -> OcTree | None:
    """Return the octree's cubes about points (N, 3) [m]; None of none."""
    if len(points) == 0:
        return None
    centers = cube_centres(points)
    rows = np.column_stack([centers, np.full(len(centers), VOXEL), np.ones(len(centers)), np.full(len(centers), 0.5)])
    return OcTree(list(rows), VOXEL)


def cube_centres(points: Array) -> Array:
    """Return the centres (M, 3) of the octree's cubes that hold points (N, 3) [m]."""
    return VOXEL * (occupied_cells(points, VOXEL).astype(np.float64) + 0.5) if len(points) else np.zeros((0, 3))


def _pose(center: Array) -> Array:
    return np.asfortranarray(transform(np.eye(3), center))


def urdf(arm: ArmModel) -> str:
    """Return an arm with gripper, open fingers and wrist camera as URDF, every link with its mass and shape."""
    tool, T, still, point = arm.tool, arm.T_last_flange, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    base = Link(BASE, still, still, 0.0, still, point, arm.base_capsules, arm.base_solids)
    flange = Link(FLANGE, tuple(T[:3, 3]), tuple(rpy(Rotation.from_matrix(T[:3, :3]))), 0.0, still, point, ())
    gripper = Link(GRIPPER, still, still, tool.mass, tool.com, point, (), (tool.body, *tool.fingers(tool.stroke)))
    camera = Link(CAMERA, still, still, tool.camera_mass, tool.camera[0].center, point, (), tool.camera)
    parts = [_link(base, 0.0)]
    for i, (parent, link) in enumerate(pairwise((base, *arm.links))):
        parts.append(_link(link, arm.margin))
        turn = (
            f'<axis xyz="0 0 1"/><limit lower="{arm.lower[i]}" upper="{arm.upper[i]}" velocity="{arm.velocity[i]}"'
            f' effort="{arm.effort[i]}" acceleration="{arm.acceleration[i]}"/>'
        )
        parts.append(_joint(arm.joints[i], "revolute", parent.name, link, turn))
    held = [(arm.links[-1], flange), (flange, gripper), (flange, camera)]
    for parent, link in [*((arm.links[i], rider) for i, rider in arm.riders), *held]:
        parts += [_link(link, 0.0), _joint(f"{link.name}_mount", "fixed", parent.name, link)]
    return f'<robot name="{arm.name}" version="1.2">{"".join(parts)}</robot>'


def _link(link: Link, margin: float) -> str:
    """A cylinder whose name stands under collision_checking/capsule is read as a capsule by pinocchio."""
    tags = "".join(f'<capsule name="{link.name}_capsule{i}"/>' for i in range(len(link.capsules)))
    shapes = [(f"{link.name}_capsule{i}", *_capsule(capsule, margin)) for i, capsule in enumerate(link.capsules)]
    shapes += [(s.name, _origin(s.center), f'<box size="{_numbers(2 * np.array(s.half))}"/>') for s in link.solids]
    parts = "".join(f'<collision name="{n}">{at}<geometry>{shape}</geometry></collision>' for n, at, shape in shapes)
    if link.mass:
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        moments = " ".join(f'{name}="{float(value)!r}"' for name, value in zip(names, link.inertia, strict=True))
        weight = f'<mass value="{float(link.mass)!r}"/><inertia {moments}/>'
        parts += f"<inertial>{_origin(link.com)}{weight}</inertial>"
    return f'<link name="{link.name}">{parts}<collision_checking>{tags}</collision_checking></link>'


def _capsule(capsule: Capsule, margin: float) -> tuple[str, str]:
    start, end, radius = np.array(capsule.start), np.array(capsule.end), capsule.radius + margin
    length = float(np.linalg.norm(end - start))
    turn = Rotation.align_vectors([(end - start) / length], [[0, 0, 1]])[0]
    return _origin((start + end) / 2, rpy(turn)), f'<cylinder radius="{radius}" length="{length}"/>'


def _joint(name: str, kind: str, parent: str, link: Link, turn: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{link.name}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{_origin(link.xyz, link.rpy)}{turn}</joint>'


def _origin(xyz: Iterable[float], rpy: Iterable[float] = (0.0, 0.0, 0.0)) -> str:
    return f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/>'


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)
