"""The scene's layers as Foxglove draws them, in the world frame."""

from __future__ import annotations

from collections.abc import Sequence

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
    TriangleListPrimitive,
    Vector3,
)
from foxglove.messages import PackedElementFieldNumericType as Kind
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.show.scene import Layer
from anther.show.style import rgb


def update(name: str, layers: Sequence[Layer], when: Timestamp, frame: str) -> SceneUpdate:
    """Return the message that draws layers under one name, in place of what had it before."""
    parts = {
        "lines": [line for layer in layers if (line := _lines(layer)) is not None],
        "spheres": [_ball(ball, _colour(layer)) for layer in layers if layer.balls is not None for ball in layer.balls],
        "arrows": [_arrow(ends[0], ends[1], _colour(x)) for x in layers if x.arrows is not None for ends in x.arrows],
        "triangles": [_triangles(solid, _colour(layer, 0.3)) for layer in layers for solid in layer.solids],
    }
    return SceneUpdate(entities=[SceneEntity(timestamp=when, frame_id=frame, id=name, **parts)])


def points(layer: Layer, when: Timestamp, frame: str) -> PointCloud:
    """Return a layer's points in their colours, at most 20 000 of them."""
    assert layer.points is not None
    most = 20_000
    rows = np.linspace(0, len(layer.points) - 1, min(len(layer.points), most)).astype(int)
    packed = np.zeros(len(rows), [("at", "<f4", 3), ("colour", "u1", 4)])
    packed["at"], packed["colour"] = layer.points[rows], (*rgb(layer.colour), 255)
    if layer.colours is not None:
        packed["colour"][:, :3] = layer.colours[rows]
    fields = [PackedElementField(name=n, offset=4 * i, type=Kind.Float32) for i, n in enumerate("xyz")]
    names = ("red", "green", "blue", "alpha")
    fields += [PackedElementField(name=n, offset=12 + i, type=Kind.Uint8) for i, n in enumerate(names)]
    at, size = pose(np.zeros(3)), packed.itemsize
    return PointCloud(timestamp=when, frame_id=frame, pose=at, point_stride=size, fields=fields, data=packed.tobytes())


def _colour(layer: Layer, opacity: float = 1.0) -> Color:
    r, g, b = (value / 255 for value in rgb(layer.colour))
    return Color(r=r, g=g, b=b, a=opacity)


def _lines(layer: Layer) -> LinePrimitive | None:
    if layer.lines is None or not len(layer.lines):
        return None
    return LinePrimitive(
        type=LinePrimitiveLineType.LineList,
        pose=pose(np.zeros(3)),
        thickness=layer.width,
        points=_corners(layer.lines),
        color=_colour(layer),
    )


def _corners(corners: Array) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in corners.reshape(-1, 3).tolist()]


def _ball(ball: Array, colour: Color) -> SpherePrimitive:
    *centre, radius = ball.tolist()
    size = Vector3(x=2 * radius, y=2 * radius, z=2 * radius)
    return SpherePrimitive(pose=pose(centre), size=size, color=colour)


def _arrow(start: Array, end: Array, colour: Color) -> ArrowPrimitive:
    """Return an arrow from one point to another [m]."""
    length = float(np.linalg.norm(end - start))
    direction = (end - start) / max(length, 1e-9)
    turn = Rotation.align_vectors([direction], [[1.0, 0.0, 0.0]])[0].as_quat().tolist()
    return ArrowPrimitive(
        pose=pose(start, turn),
        shaft_length=0.7 * length,
        shaft_diameter=0.006,
        head_length=0.3 * length,
        head_diameter=0.015,
        color=colour,
    )


def _triangles(solid: object, colour: Color) -> TriangleListPrimitive:
    corners = _corners(np.asarray(solid.triangles))  # type: ignore[attr-defined]
    return TriangleListPrimitive(pose=pose(np.zeros(3)), points=corners, color=colour)


def pose(place: ArrayLike, turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    """Return a pose of a place [m] and a quaternion (x, y, z, w)."""
    x, y, z = (float(v) for v in np.asarray(place))
    qx, qy, qz, qw = turn
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
