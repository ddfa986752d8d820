"""Where the camera was: poses by time from a topic, from tf, or from a trajectory file. T times."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from anther.checks import check_array
from anther.errors import bad_input
from anther.files import read_lines, understood
from anther.geometry import Array, inverse, transform_from_pose7

Where = Callable[[float], tuple[Array, float]]
"""Time [s] -> (T_world_camera, how far off its stamp is [s])."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseSeries:
    """Poses in the order of time.

    Attributes:
        times: (T,) [s], sorted.
        poses: (T, 4, 4).
    """

    times: Array
    poses: Array

    def at(self, time: float) -> tuple[Array, float]:
        """Return (the pose nearest in time, how far off it is [s])."""
        k = nearest(self.times, time)
        return self.poses[k], abs(float(self.times[k]) - time)


@dataclass(slots=True)
class FrameTree:
    """The frames of tf: parents and transforms by time."""

    parent: dict[str, str] = field(default_factory=dict)
    static: dict[str, Array] = field(default_factory=dict)
    moving: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Add the geometry_msgs/TransformStamped of one tf message."""
        for one in transforms:
            child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            self.parent[child] = parent
            T = pose_matrix(one.transform.translation, one.transform.rotation)
            if static:
                self.static[child] = T
            else:
                self.moving.setdefault(child, []).append((stamp_of(one.header), T))

    def lookup(self, frame: str, world: str | None) -> Where:
        """Return a function: time [s] -> (T_world_frame, how far off the worst link's stamp is [s]).

        Every moving link is taken at its stamp nearest to that time; fixed links are always on time.

        Args:
            frame: the frame wanted.
            world: an ancestor of it; None: the root of its tree.

        Raises:
            InputError: the frame is unknown, or not below `world`.
        """
        chain = self._chain(frame.lstrip("/"), None if world is None else world.lstrip("/"))
        links = {name: sorted_series(self.moving[name]) for name in chain if name in self.moving}

        def where(time: float) -> tuple[Array, float]:
            T, worst = np.eye(4), 0.0
            for name in chain:
                step, off = links[name].at(time) if name in links else (self.static[name], 0.0)
                T, worst = step @ T, max(worst, off)
            return T, worst

        return where

    def between(self, a: str, b: str) -> Array | None:
        """Return T_a_b where both hang together by fixed transforms, else None."""
        ways = [self._fixed_way(name.lstrip("/")) for name in (a, b)]
        shared = [name for name in ways[0] if name in ways[1]]
        return inverse(ways[0][shared[0]]) @ ways[1][shared[0]] if shared else None

    def _fixed_way(self, frame: str) -> dict[str, Array]:
        """Return ancestor -> T_ancestor_frame along fixed transforms, the frame itself first."""
        way, T = {frame: np.eye(4)}, np.eye(4)
        while frame in self.static and self.parent[frame] not in way:
            T = self.static[frame] @ T
            frame = self.parent[frame]
            way[frame] = T
        return way

    def _chain(self, frame: str, world: str | None) -> list[str]:
        chain, at = [], frame
        while at != world and at in self.parent and at not in chain:
            chain.append(at)
            at = self.parent[at]
        if not chain or (world is not None and at != world):
            raise bad_input(
                "tf",
                given=f"no way from '{frame}' up to '{world or 'a parent'}'",
                allowed=f"frames {sorted({*self.parent, *self.parent.values()})}",
                do="Name the frames with --camera-frame and --world-frame, or give a pose topic or file.",
            )
        return chain


def nearest(times: Array, time: float) -> int:
    """Return the index of the entry of sorted (T,) times that is nearest to a time."""
    right = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
    left = right - 1
    return left if right >= len(times) or time - times[left] <= times[right] - time else right


def pose_matrix(position: Any, orientation: Any) -> Array:
    """Return the (4, 4) matrix of a ROS position and quaternion (x, y, z, w)."""
    p, q = position, orientation
    return transform_from_pose7([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


def stamp_of(header: Any) -> float:
    """Return a ROS header's stamp [s]."""
    return header.stamp.sec + header.stamp.nanosec * 1e-9


def read_trajectory(path: Path | str) -> PoseSeries:
    """Return the poses of a text file: rows of time [s], x, y, z [m], qx, qy, qz, qw, in the TUM RGB-D format.

    Format: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats; camera to world.

    Raises:
        InputError: missing, no rows of eight numbers, or a quaternion that is not of unit length.
    """
    with understood(path, _ROWS, "Is it a trajectory?"):
        rows = np.loadtxt(read_lines(path), ndmin=2)
    if not rows.size:
        raise bad_input(str(path), given="no rows", allowed=f"rows of {_ROWS}", do="Is it truncated?")
    rows = check_array(f"{path} (rows of {_ROWS})", rows, (None, 8))
    return sorted_series([(float(row[0]), transform_from_pose7(row[1:])) for row in rows])


def sorted_series(stamped: list[tuple[float, Array]]) -> PoseSeries:
    """Return (time [s], pose) pairs in the order of time."""
    ordered = sorted(stamped, key=lambda pair: pair[0])
    return PoseSeries(np.array([t for t, _ in ordered]), np.stack([T for _, T in ordered]))


_ROWS = "time x y z qx qy qz qw"
