"""Ways in which a capture can be worse than planned, for experiments. Each takes and returns a capture. V views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.core import Intrinsics
from anther.core.geometry import small_transform
from anther.perception import Capture

BASELINE = 0.095
"""Of a D455 [m] (facts: perception, depth sensors)."""

Degradation = Callable[[Capture, np.random.Generator], Capture]


def coarse(capture: Capture, _: np.random.Generator, step: int = 4) -> Capture:
    """Return every `step`-th pixel of every `step`-th row."""
    k, depth = capture.intrinsics, capture.depth[:, ::step, ::step]
    small = Intrinsics(depth.shape[2], depth.shape[1], k.fx / step, k.fy / step, k.cx / step, k.cy / step)
    rgb = None if capture.rgb is None else capture.rgb[:, ::step, ::step]
    return Capture(depth, small, capture.T_world_cam, rgb)


def noisy_depth(capture: Capture, rng: np.random.Generator, subpixel: float = 0.8) -> Capture:
    """Return the capture with a disparity error of `subpixel` [px] more, ten times the typical 0.08."""
    noise = np.stack([cv2.GaussianBlur(white, (0, 0), 1.5) for white in _white(capture, rng)])
    noise *= subpixel / noise.std()
    depth = capture.depth + capture.depth**2 * noise / np.float32(capture.intrinsics.fx * BASELINE)
    return replace(capture, depth=np.maximum(depth, 0))


def lost_depth(capture: Capture, rng: np.random.Generator, share: float = 0.7) -> Capture:
    """Return the capture with a share of the readings lost in patches, as in glare."""
    patches = np.stack([cv2.GaussianBlur(white, (0, 0), 6) for white in _white(capture, rng)])
    return replace(capture, depth=np.where(patches < np.quantile(patches[0], share), 0, capture.depth))


def _white(capture: Capture, rng: np.random.Generator) -> NDArray[np.float32]:
    return rng.standard_normal(capture.depth.shape, dtype=np.float32)


def hidden_foot(capture: Capture, _: np.random.Generator, share: float = 0.5) -> Capture:
    """Return the capture with the lower share of every image hidden, as by a neighbour's pot."""
    depth, hidden = capture.depth.copy(), round(share * capture.intrinsics.height)
    depth[:, -hidden:] = 0
    rgb = None if capture.rgb is None else capture.rgb.copy()
    if rgb is not None:
        rgb[:, -hidden:] = 60
    return replace(capture, depth=depth, rgb=rgb)


def loose_poses(capture: Capture, rng: np.random.Generator, angle: float = 0.6, shift: float = 0.005) -> Capture:
    """Return the capture with every pose off by `angle` [deg] and `shift` [m], standard deviations per axis."""
    errors = rng.normal(size=(2, capture.views, 3)) * np.array([np.radians(angle), shift])[:, None, None]
    off = np.stack([small_transform(a, b) for a, b in zip(*errors, strict=True)])
    return replace(capture, T_world_cam=capture.T_world_cam @ off)


def wrong_pose(capture: Capture, rng: np.random.Generator, shift: float = 0.03) -> Capture:
    """Return the capture with one view's pose off by `shift` [m] sideways."""
    poses = capture.T_world_cam.copy()
    way = rng.normal(size=2)
    poses[rng.integers(capture.views)] @= small_transform(np.zeros(3), [*(shift * way / np.linalg.norm(way)), 0.0])
    return replace(capture, T_world_cam=poses)


DEGRADATIONS: dict[str, Degradation] = {
    "four views": lambda capture, _: capture.select(list(range(0, capture.views, 3))),
    "two views": lambda capture, _: capture.select(list(range(2, capture.views, 6))),
    "one side": lambda capture, _: capture.select(list(range(3))),
    "coarse": coarse,
    "noisy depth": noisy_depth,
    "lost depth": lost_depth,
    "hidden foot": hidden_foot,
    "loose poses": loose_poses,
    "wrong pose": wrong_pose,
}
"""Name -> degradation of a capture of twelve views."""
