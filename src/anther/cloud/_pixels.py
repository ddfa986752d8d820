"""From a view's masked depth to surface points: flying pixels dropped, a local plane fitted to each pixel.

In a pinhole image the inverse depth of a plane is linear in the pixel coordinates, so a plane is fitted to each pixel's
neighbours by linear least squares. Dimensions: H x W pixels, N points.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array, Intrinsics

FIT_WINDOW = 3
"""Half-width [px] of the window a plane is fitted in. Measured: 5 x 5 gives normals twice as noisy."""

FIT_RIDGE = 8.0
"""Added to the sums of squared offsets [px^2]; a full window has 196. Across a petiole two pixels wide the slope is not
observable and is drawn to zero (an estimate)."""


def supported_pixels(
    depth: NDArray[Any], mask: NDArray[np.bool_], window: int, support: int, tolerance: float
) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of `mask` whose depth is shared by enough of their neighbours.

    A flying pixel hangs between two surfaces and few neighbours share its depth; a pixel of a petiole has the
    petiole's other pixels. A gradient filter would drop both (facts: perception, a 15 mm edge filter eats petioles).

    Args:
        depth: (H, W) [m].
        mask: (H, W).
        window: half-width of the neighbourhood [px].
        support: least number of pixels in it, itself included, at its depth.
        tolerance: how far their depth may differ at 0.5 m [m]; it grows with z squared, as stereo noise does.
    """
    return _supported(_inverse(depth), mask, window, support, np.float32(tolerance / 0.25))


def pixel_normals(
    depth: NDArray[Any], keep: NDArray[np.bool_], intrinsics: Intrinsics, tolerance: float
) -> NDArray[np.float32]:
    """Return the unit normals (N, 3), towards the camera, of the pixels `keep` (H, W) that have a depth, row by row.

    Args:
        depth: (H, W) [m].
        keep: (H, W).
        intrinsics: of the image.
        tolerance: a neighbour belongs to the surface if its depth differs by at most this at 0.5 m [m].
    """
    rows = np.flatnonzero(keep & (depth > 0))
    camera = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])
    return _fitted_planes(np.pad(_inverse(depth), FIT_WINDOW), rows, camera, np.float32(tolerance / 0.25))


def slant(points: Array, normals: NDArray[Any]) -> Array:
    """Return (N,) how fast the depth of surfaces changes with the viewing angle, relative to it [1/rad].

    A plane n . p = c has the depth z = c / (n . ray), so |dz| / z = |(n_x, n_y)| / |n . ray|; at most 10 (84 deg).
    """
    towards = np.abs(np.einsum("ni,ni->n", normals, points)) / np.maximum(points[:, 2], 1e-9)
    return np.hypot(normals[:, 0], normals[:, 1]) / np.maximum(towards, 0.1)


@numba.njit(nogil=True, cache=True)
def _supported(inverse, mask, window, least, tolerance):
    height, width = inverse.shape
    keep = np.zeros(inverse.shape, dtype=np.bool_)
    for v in range(height):
        for u in range(width):
            if not mask[v, u] or inverse[v, u] <= 0:
                continue
            count = 0
            for j in range(max(0, v - window), min(height, v + window + 1)):
                if count >= least:
                    break
                for i in range(max(0, u - window), min(width, u + window + 1)):
                    count += abs(inverse[j, i] - inverse[v, u]) <= tolerance
            keep[v, u] = count >= least
    return keep


@numba.njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})  # lets the compiler use vector instructions
def _fitted_planes(inverse, rows, camera, tolerance):
    """Return normals (N, 3) of inverse-depth planes through the pixels' neighbours; `inverse` has a margin."""
    width = inverse.shape[1] - 2 * FIT_WINDOW
    normals = np.empty((rows.size, 3), dtype=np.float32)
    for k in range(rows.size):
        v, u = divmod(rows[k], width)
        middle = inverse[v + FIT_WINDOW, u + FIT_WINDOW]
        n = su = sv = suu = suv = svv = sq = suq = svq = np.float32(0)
        for dv in range(-FIT_WINDOW, FIT_WINDOW + 1):
            for du in range(-FIT_WINDOW, FIT_WINDOW + 1):
                q = inverse[v + dv + FIT_WINDOW, u + du + FIT_WINDOW] - middle
                w = np.float32(abs(q) <= tolerance)
                wu, wv = w * np.float32(du), w * np.float32(dv)
                n += w
                su, sv, sq = su + wu, sv + wv, sq + w * q
                suu, suv, svv = suu + wu * np.float32(du), suv + wu * np.float32(dv), svv + wv * np.float32(dv)
                suq, svq = suq + wu * q, svq + wv * q
        a, b, c = suu - su * su / n + FIT_RIDGE, suv - su * sv / n, svv - sv * sv / n + FIT_RIDGE
        e, f = suq - su * sq / n, svq - sv * sq / n
        # 1/z = normal . ray; its derivatives along u and v are the normal's x and y over the focal lengths.
        x = camera[0] * (c * e - b * f) / (a * c - b * b)
        y = camera[1] * (a * f - b * e) / (a * c - b * b)
        w = middle - x * (u - camera[2]) / camera[0] - y * (v - camera[3]) / camera[1]
        length = -np.sqrt(x * x + y * y + w * w)
        normals[k, 0], normals[k, 1], normals[k, 2] = x / length, y / length, w / length
    return normals


def _inverse(depth: NDArray[Any]) -> NDArray[np.float32]:
    """Return 1 / depth [1/m]; 0 without a reading, which is no neighbour of anything.

    Differences dz of depth at z are z^2 times those of its inverse, so one tolerance for these grows as stereo noise.
    """
    return np.divide(1, depth, out=np.zeros(depth.shape, dtype=np.float32), where=depth > 0)
