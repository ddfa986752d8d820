"""How far a flower is from the camera, frame by frame. T frames, N readings of its own pixels in all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anther.core.geometry import Array
from anther.pollination.response._petals import Patch
from anther.robot.devices import Frame


def depth_along(
    frames: Sequence[Frame], patch: Patch, path: Array, swing: Array, depth: Array, gap: float = 0.02
) -> Array:
    """Return a flower's depth (T,) [m] along its path; NaN where fewer than 3 of its own pixels are read.

    All readings of all frames are fitted at once with how a flower may swing and one surface, a cubic in the offset
    from the flower's middle to a fraction of a pixel. So neither the pixels that a frame happens to lack, nor the
    rounding of the path to whole pixels, nor for a few frames the depth of something else look like motion. Readings
    off the fit, mixed with what is beside the flower, lose their weight (Tukey's biweight by iteratively reweighted
    least squares, Beaton & Tukey 1974). A frame's depth is the swing's, plus what its readings miss it by in the mean.

    Args:
        frames: T of them.
        patch: the flower.
        path: (T, 2) its middle [px]; NaN where not seen.
        swing: (T, B) what its depth is a sum of, constant and slow terms among it.
        depth: (T,) or one, about where it is [m].
        gap: readings further from it than this are not the flower's [m].
    """
    rest = float(np.mean(depth))
    number, across, down, z = _readings(frames, patch, path, np.broadcast_to(depth, len(frames)), gap).T
    frame, weight = number.astype(int), np.ones(len(z))
    # of a cubic in the two offsets from a flower's middle; its constant is the flower's own depth
    powers = tuple((i, j) for i in range(4) for j in range(4 - i) if i + j)
    basis = np.column_stack([swing[frame], *(across**i * down**j for i, j in powers)])
    if len(z) < 2 * basis.shape[1]:
        return np.full(len(frames), np.nan)
    fitted, miss = np.zeros(basis.shape[1]), np.zeros(len(z))
    least = 0.001  # m: twice a D455's noise at 0.5 m
    for _ in range(12):  # rounds of reweighting, to convergence on films of simulated plants
        weighted = (basis * weight[:, None]).T
        fitted = np.linalg.solve(weighted @ basis + 1e-6 * np.eye(basis.shape[1]), weighted @ (z - rest))
        miss = z - rest - basis @ fitted
        spread = max(1.4826 * float(np.median(np.abs(miss))), least)
        weight = np.clip(1 - (miss / (2.0 * spread)) ** 2, 1e-6, 1) ** 2
    used, share = (np.bincount(frame, w, len(frames)) for w in (weight > 1e-3, weight))
    more = np.bincount(frame, weight * miss, len(frames)) / np.maximum(share, 1e-9)
    return np.where(used >= 3, rest + swing @ fitted[: swing.shape[1]] + more, np.nan)


def _readings(frames: Sequence[Frame], patch: Patch, path: Array, depth: Array, gap: float) -> Array:
    """Return (N, 4) of each reading: number of the frame, offset from the middle across and down [radii], depth [m]."""
    half, parts = patch.weight.shape[0] // 2, [np.zeros((0, 4))]
    own = np.argwhere(patch.weight > 0) - half
    for i, (frame, place) in enumerate(zip(frames, path, strict=True)):
        middle = np.rint(np.nan_to_num(place, nan=-1.0)).astype(int)
        if np.any(middle < half) or np.any(middle + half >= frame.depth.shape[::-1]):
            continue
        v, u = (own + middle[::-1]).T
        z = frame.depth[v, u]
        offset = (np.column_stack([u, v]) - place) / patch.radius
        here = np.column_stack([np.full(len(z), float(i)), offset, z])[np.abs(z - depth[i]) < gap]
        parts += [here] if len(here) >= 3 else []
    return np.concatenate(parts)
