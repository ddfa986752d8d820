"""What a D455 makes of an exact depth image: noise, quantisation, range, fat stems, lost twigs, ragged edges.

The sensor measures disparity d = f B / z [px], so everything is modelled there. Sources, facts: perception, "Depth
sensors": sigma_z = z^2 s / (f B), s about 0.08 px (librealsense #3904); Z_min = f B / 126 (realsense-ros #2367); thin
stems look fat because of the matching window; correlated noise, 1/32 px quantisation, flying and dropped edge pixels,
loss of thin structures. The sizes of the edge effects are estimates. H x W pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array, check_range
from anther.geometry import Intrinsics

FAR = 1000.0  # stands for "no surface" while filtering [m]


@dataclass(frozen=True, slots=True)
class DepthNoise:
    """Parameters of the depth sensor; the defaults are a D455.

    Attributes:
        baseline: between the two imagers [m].
        subpixel: standard deviation of the disparity error, s [px]; 0.08 typical, 0.032 at best.
        correlation: standard deviation of the Gaussian that correlates the error between neighbours [px].
        quantum: disparity step [px].
        max_disparity: largest disparity searched [px]; sets the minimum range.
        max_range: readings beyond are dropped [m].
        fattening: how far the matching window lets a nearer surface spread over a farther one [px]: 1 to this.
        thin: structures narrower than this are lost [px]; up to twice this they are lost in patches.
        edge: disparity step that makes an edge [px].
        edge_dropped: share of edge pixels without a reading.
        edge_flying: share of edge pixels that float between the two surfaces.
        stereo_shadow: whether surfaces that only one imager sees are dropped, as is what lies left of its view.
    """

    baseline: float = 0.095
    subpixel: float = 0.08
    correlation: float = 1.5
    quantum: float = 1 / 32
    max_disparity: float = 126.0
    max_range: float = 6.0
    fattening: int = 2
    thin: int = 3
    edge: float = 2.0
    edge_dropped: float = 0.35
    edge_flying: float = 0.1
    stereo_shadow: bool = True

    def __post_init__(self) -> None:
        check_range("depth noise baseline", self.baseline, 1e-3, 1.0, "m")
        check_range("depth noise subpixel", self.subpixel, 0.0, 2.0, "px")
        check_range("depth noise edge_dropped + edge_flying", self.edge_dropped + self.edge_flying, 0.0, 1.0)
        check_range("depth noise fattening", self.fattening, 0, 15, "px")
        check_range("depth noise thin", self.thin, 0, 15, "px")


def noisy_depth(
    depth: NDArray[Any], intrinsics: Intrinsics, rng: np.random.Generator, params: DepthNoise | None = None
) -> NDArray[np.float32]:
    """Return what the sensor reads (H, W) [m], 0 = no reading.

    Args:
        depth: (H, W) exact z-depth [m], 0 = no surface.
        intrinsics: of the image.
        rng: source of the noise; the same state gives the same reading.
        params: of the sensor; None is a D455.
    """
    params = params or DepthNoise()
    exact = check_array("exact depth", depth, (intrinsics.height, intrinsics.width), dtype=np.float32)
    focal = np.float32(intrinsics.fx * params.baseline)
    z = np.where(exact > 0, exact, np.float32(FAR))
    patches = _field(exact.shape, 4.0, rng)
    z = _fattened(_without_twigs(z, patches, params), patches, params)
    disparity = focal / z
    seen = z < params.max_range
    if params.stereo_shadow:
        seen &= ~_shadowed(disparity)
    disparity, dropped = _ragged_edges(disparity, rng, params)
    disparity += np.float32(params.subpixel) * _field(exact.shape, params.correlation, rng)
    if params.quantum > 0:
        disparity = np.round(disparity / np.float32(params.quantum)) * np.float32(params.quantum)
    seen &= ~dropped & (disparity >= focal / params.max_range) & (disparity <= params.max_disparity)
    return np.where(seen, focal / np.maximum(disparity, np.float32(1e-3)), np.float32(0))


def _field(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """A random field of mean 0, standard deviation 1 and Gaussian correlation [px]."""
    white = rng.standard_normal(shape, dtype=np.float32)
    if correlation <= 0:
        return white
    size = 2 * int(np.ceil(3 * correlation)) + 1
    kernel = cv2.getGaussianKernel(size, correlation)
    smooth = cv2.sepFilter2D(white, -1, kernel, kernel)
    return (smooth / np.float32((kernel**2).sum())).astype(np.float32)


def _ellipse(size: int) -> NDArray[Any]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))


def _without_twigs(z: NDArray[Any], patches: NDArray[Any], params: DepthNoise) -> NDArray[Any]:
    """Replace near structures narrower than `thin` by what is behind them; those up to twice as wide in patches."""
    if params.thin < 2:
        return z
    narrow = cv2.morphologyEx(z, cv2.MORPH_CLOSE, _ellipse(params.thin))
    wider = cv2.morphologyEx(z, cv2.MORPH_CLOSE, _ellipse(2 * params.thin - 1))
    return np.where(patches > 1.0, wider, narrow)


def _fattened(z: NDArray[Any], patches: NDArray[Any], params: DepthNoise) -> NDArray[Any]:
    """Let nearer surfaces spread by 1 to `fattening` px, patch by patch."""
    if params.fattening < 1:
        return z
    little = cv2.erode(z, _ellipse(3))
    much = cv2.erode(z, _ellipse(2 * params.fattening + 1))
    return np.where(patches > 0, little, much)


def _ragged_edges(
    disparity: NDArray[Any], rng: np.random.Generator, params: DepthNoise
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the disparity with flying pixels at its edges, and (H, W) which edge pixels have no reading."""
    window = np.ones((3, 3), np.uint8)
    near, far = cv2.dilate(disparity, window), cv2.erode(disparity, window)
    edge = near - far > params.edge
    chance = rng.random(disparity.shape, dtype=np.float32)
    flying = edge & (chance < params.edge_flying)
    between = far + (near - far) * rng.random(disparity.shape, dtype=np.float32)
    dropped = edge & (chance >= params.edge_flying) & (chance < params.edge_flying + params.edge_dropped)
    return np.where(flying, between, disparity), dropped


@numba.njit(cache=True, nogil=True)
def _shadowed(disparity: NDArray[Any]) -> NDArray[Any]:
    """(H, W) whether the second imager, on the right, sees another surface there or is not pointed there."""
    height, width = disparity.shape
    out = np.zeros((height, width), np.bool_)
    nearest = np.empty(width, disparity.dtype)
    for row in range(height):
        nearest[:] = 0
        for column in range(width):
            x = int(column - disparity[row, column] + 0.5)
            if x >= 0 and disparity[row, column] > nearest[x]:
                nearest[x] = disparity[row, column]
        for column in range(width):
            x = int(column - disparity[row, column] + 0.5)
            if x < 0 or nearest[x] > disparity[row, column] + 1.5:
                out[row, column] = True
    return out
