"""What a trial found and plans, drawn in the world frame as Foxglove's scene entities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    PackedElementField,
    Point3,
    PointCloud,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    Vector3,
)
from foxglove.messages import PackedElementFieldNumericType as Kind
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.pollination.grasp import Grasp
from anther.pollination.shake import ShakePlan
from anther.robot.devices import JointTrajectory

GREEN, BROWN, YELLOW, RED, GREY, BLUE = (
    Color(r=r, g=g, b=b, a=a)
    for r, g, b, a in (
        (0.2, 0.6, 0.3, 1.0), (0.55, 0.35, 0.15, 1.0), (0.95, 0.8, 0.1, 1.0),
        (0.8, 0.2, 0.1, 1.0), (0.6, 0.6, 0.65, 0.5), (0.2, 0.4, 0.9, 1.0),
    )
)  # fmt: skip
FLOWER = 0.02
"""Diameter that a flower is drawn with [m]."""
MOST = 20_000
"""So many points of a cloud are shown."""
ARM_THINNED = 3
"""Of the balls of the arm's outline, which overlap, every third is drawn."""
PATH = 50
"""A motion is drawn in so many pieces."""
EXAGGERATION = 20.0
"""A shake's amplitude is drawn so much longer than it is."""
PAIRS = LinePrimitiveLineType.LineList


Entity = dict[str, Any]
"""What is drawn under one name: its lines, spheres and arrows."""


def update(name: str, entity: Entity, when: Timestamp, frame: str) -> SceneUpdate:
    """Return the message that draws an entity, in place of what had its name before."""
    return SceneUpdate(entities=[SceneEntity(timestamp=when, frame_id=frame, id=name, **entity)])


def found(what: str, value: Any) -> Entity | None:
    """Return what shows flowers or grasps; None of anything else."""
    match value:
        case Flowers():
            return {"spheres": [ball(p, FLOWER, YELLOW) for p in value.positions]}
        case [Grasp(), *_] if what == "grasp":
            return {"arrows": [grasp(one, RED if one is value[0] else GREY) for one in value]}
    return None


def skeleton(tree: Skeleton) -> Entity:
    """Return a tree as lines between its nodes."""
    return {"lines": [line(tree.nodes[tree.edges].reshape(-1, 3), 0.002, GREEN, PAIRS)]}


def stem(nodes: Array) -> Entity:
    """Return the main stem through nodes (S, 3)."""
    return {"lines": [line(nodes, 0.005, BROWN)]}


def shake(plan: ShakePlan) -> Entity:
    """Return an arrow along the shake, longer than its amplitude, at the grasp."""
    return {"arrows": [arrow(plan.grasp.point, plan.direction, EXAGGERATION * plan.amplitude, BLUE)]}


def motion(trajectory: JointTrajectory, forward: Callable[[Array], Array]) -> Entity:
    """Return the way of the flange in a motion that is asked for."""
    rows = np.unique(np.linspace(0, len(trajectory.times) - 1, PATH).astype(int))
    return {"lines": [line(forward(trajectory.positions[rows])[:, :3, 3], 0.003, BLUE)]}


def arm(balls: Array) -> Entity:
    """Return some balls of the arm's outline (S, 4), centre and radius [m]; points without a radius are left out."""
    solid = balls[balls[:, 3] > 0]
    return {"spheres": [ball(b[:3], 2 * b[3], GREY) for b in solid[::ARM_THINNED]]}


def grasp(one: Grasp, colour: Color) -> ArrowPrimitive:
    """Return an arrow along the approach that ends at the stem."""
    return arrow(one.point - 0.1 * one.approach, one.approach, 0.1, colour)


def points(cloud: Cloud, when: Timestamp, frame: str) -> PointCloud:
    """Return a cloud's points in their colours, at most `MOST` of them."""
    rows = np.linspace(0, len(cloud.points) - 1, min(len(cloud.points), MOST)).astype(int)
    packed = np.zeros(len(rows), [("at", "<f4", 3), ("colour", "u1", 4)])
    packed["at"], packed["colour"] = cloud.points[rows], (90, 150, 90, 255)
    if cloud.colors is not None:
        packed["colour"][:, :3] = cloud.colors[rows]
    fields = [PackedElementField(name=n, offset=4 * i, type=Kind.Float32) for i, n in enumerate("xyz")]
    names = ("red", "green", "blue", "alpha")
    fields += [PackedElementField(name=n, offset=12 + i, type=Kind.Uint8) for i, n in enumerate(names)]
    at, size = pose(np.zeros(3)), packed.itemsize
    return PointCloud(timestamp=when, frame_id=frame, pose=at, point_stride=size, fields=fields, data=packed.tobytes())


def line(
    points: Array, thickness: float, colour: Color, kind: LinePrimitiveLineType = LinePrimitiveLineType.LineStrip
) -> LinePrimitive:
    """Return a line through points (N, 3) [m]."""
    at = [Point3(x=x, y=y, z=z) for x, y, z in points.tolist()]
    return LinePrimitive(type=kind, pose=pose(np.zeros(3)), thickness=thickness, points=at, color=colour)


def ball(centre: ArrayLike, diameter: float, colour: Color) -> SpherePrimitive:
    """Return a ball [m]."""
    size = Vector3(x=diameter, y=diameter, z=diameter)
    return SpherePrimitive(pose=pose(centre), size=size, color=colour)


def arrow(start: Array, direction: Array, length: float, colour: Color) -> ArrowPrimitive:
    """Return an arrow of a length [m]."""
    return ArrowPrimitive(
        pose=pose(start, turned(direction)),
        shaft_length=0.7 * length,
        shaft_diameter=0.006,
        head_length=0.3 * length,
        head_diameter=0.015,
        color=colour,
    )


def turned(direction: Array) -> Sequence[float]:
    """Return the quaternion (x, y, z, w) that turns +x to a direction (3,)."""
    return Rotation.align_vectors([direction], [[1.0, 0.0, 0.0]])[0].as_quat().tolist()


def pose(place: ArrayLike, turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    """Return a pose of a place [m] and a quaternion (x, y, z, w)."""
    x, y, z = (float(v) for v in np.asarray(place))
    qx, qy, qz, qw = turn
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
