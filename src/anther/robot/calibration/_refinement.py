"""Least squares on reprojection errors, camera and board pose together, with an arm that is not exact either.

A corner p of the board is seen in view i at

    u = project(X^-1 (T_i exp(d_i))^-1 Z p) + noise,     X = T_flange_cam,  Z = T_base_board,

where T_i is the flange pose the arm reports, d_i its error in view i (rotation and translation of the flange, normal
with standard deviations sigma_r and sigma_t) and the noise normal with standard deviation s per pixel coordinate. The
d_i are integrated out: to first order the 2n residuals of a view have the covariance s^2 I + J Sigma J^T, with J the
derivative after d_i and Sigma = diag(sigma_r^2, sigma_t^2). For an exact arm this is plain least squares of the
reprojection errors (as Tabb and Ahmad Yousef 2017); for a poor one every view counts about the same, however many
corners it has. sigma_r and sigma_t come from the data, by restricted maximum likelihood (Patterson and Thompson 1971);
s from each view's own best pose. Gauss and Newton's method with the derivatives below; V views, N corners in all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics, inverse, transform
from anther.robot.calibration._views import BoardViews

LEAST_PIXEL_NOISE = 0.05  # [px]: blur and perspective shift whole views' corners by about as much


class Noise(NamedTuple):
    """Standard deviations: of a corner's pixel coordinate [px], of the arm's rotation [rad] and translation [m]."""

    pixel: float
    rotation: float
    translation: float


class Fit(NamedTuple):
    """T_flange_cam, T_base_board, the intrinsics, the covariance of their errors, and the board's size over what was
    said.

    The errors are, in this order: rotation [rad] and shift [m] of the camera on the flange, in flange axes; rotation
    and shift of the board, in base axes; if the intrinsics are free, of fx, fy, cx, cy as shares of the focal length;
    if the board's size is free, of that, as a share.
    """

    T_flange_cam: Array
    T_base_board: Array
    intrinsics: Intrinsics
    covariance: Array
    scale: float = 1.0


class _Sums(NamedTuple):
    """Per view: sums of products of residuals r, derivatives F (12 or 16 sought numbers) and J (6, the arm's error)."""

    rr: Array
    Fr: Array
    FF: Array
    Jr: Array
    JJ: Array
    JF: Array


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All corners of all views.

    Attributes:
        T_base_flange: (V, 4, 4).
        view: (N,) which view a corner belongs to, ascending.
        points: (N, 3) in the board frame [m].
        pixels: (N, 2).
        intrinsics: of the camera.
        free_intrinsics: whether they are only a start.
        free_scale: whether the board's size is only a start.
        eye_to_hand: whether the board is on the flange and the camera stands still. `T_base_flange` is then
            T_flange_base, X T_base_cam and Z T_flange_board: the equation is the same, but the arm's error is the
            flange's on the board's side.
    """

    _least_depth = 1e-3
    """A wrong pose may put the board behind the camera [m]."""

    T_base_flange: Array
    view: NDArray[Any]
    points: Array
    pixels: Array
    intrinsics: Intrinsics
    free_intrinsics: bool = False
    free_scale: bool = False
    eye_to_hand: bool = False

    @classmethod
    def of(
        cls,
        T_base_flange: Array,
        views: BoardViews,
        intrinsics: Intrinsics,
        free_intrinsics: bool = False,
        eye_to_hand: bool = False,
    ) -> Problem:
        """Return the problem of some views of a board."""
        view = np.repeat(np.arange(len(T_base_flange)), [len(p) for p in views.corners.points])
        points, pixels = np.concatenate(views.corners.points), np.concatenate(views.corners.pixels)
        return cls(T_base_flange, view, points, pixels, intrinsics, free_intrinsics, eye_to_hand=eye_to_hand)

    def at(self, intrinsics: Intrinsics, scale: float = 1.0) -> Problem:
        """Return the same problem with these intrinsics, and a board so many times as large."""
        return replace(self, intrinsics=intrinsics, points=self.points * scale)

    def residuals(self, X: Array, Z: Array) -> Array:
        """Return (N, 2): where the corners are seen, less where they should be [px]."""
        return self.pixels - self._project(self._in_camera(X, Z)[2])

    def pixel_rms(self, X: Array, Z: Array) -> Array:
        """Return (V,) the RMS distance between corners seen and expected [px]."""
        squares = np.sum(self.residuals(X, Z) ** 2, axis=1)
        return np.sqrt(np.bincount(self.view, squares) / np.bincount(self.view))

    def _in_camera(self, X: Array, Z: Array) -> tuple[Array, Array, Array]:
        """Return the corners relative to the board's origin in base axes, in the flange and in the camera frame."""
        lever = self.points @ Z[:3, :3].T
        T = inverse(self.T_base_flange)[self.view]
        in_flange = np.einsum("nij,nj->ni", T[:, :3, :3], lever + Z[:3, 3]) + T[:, :3, 3]
        return lever, in_flange, (in_flange - X[:3, 3]) @ X[:3, :3]

    def _project(self, p: Array) -> Array:
        c, z = self.intrinsics, np.maximum(p[:, 2], self._least_depth)
        return np.stack([c.fx * p[:, 0] / z + c.cx, c.fy * p[:, 1] / z + c.cy], axis=1)

    def sums(self, X: Array, Z: Array) -> _Sums:
        """Return the sums per view from which a step, a likelihood and the arm's errors follow."""
        lever, in_flange, p = self._in_camera(X, Z)
        c, z = self.intrinsics, np.maximum(p[:, 2], self._least_depth)
        D = np.zeros((len(p), 2, 3))
        D[:, 0, 0], D[:, 0, 2] = c.fx / z, -c.fx * p[:, 0] / z**2
        D[:, 1, 1], D[:, 1, 2] = c.fy / z, -c.fy * p[:, 1] / z**2
        D = D @ X[:3, :3].T  # pixels after a corner in the flange frame
        to_flange = D @ np.swapaxes(self.T_base_flange[:, :3, :3], 1, 2)[self.view]  # pixels after one in the base
        blocks = [D @ _cross(in_flange - X[:3, 3]), -D, -to_flange @ _cross(lever), to_flange]
        if self.free_intrinsics:
            focal = np.array([c.fx, c.fy])
            rays = np.stack([p[:, 0] / z, p[:, 1] / z], axis=1)
            blocks += [np.eye(2) * (focal * rays)[:, :, None], np.broadcast_to(np.diag(focal), (len(p), 2, 2))]
        blocks += [to_flange @ lever[:, :, None]] if self.free_scale else []
        F = np.concatenate(blocks, axis=2)
        moved = [-to_flange @ _cross(lever + Z[:3, 3]), to_flange] if self.eye_to_hand else [D @ _cross(in_flange), -D]
        J = np.concatenate(moved, axis=2)
        r = self.pixels - self._project(p)
        first = np.searchsorted(self.view, np.arange(len(self.T_base_flange)))
        pairs = (("ni,ni->n", r, r), ("nij,ni->nj", F, r), ("nij,nik->njk", F, F))
        more = (("nij,ni->nj", J, r), ("nij,nik->njk", J, J), ("nij,nik->njk", J, F))
        return _Sums(*(np.add.reduceat(np.einsum(how, a, b), first, axis=0) for how, a, b in pairs + more))


def pixel_noise(views: BoardViews) -> Array:
    """Return (V,) the standard deviation of a corner's pixel coordinate in each view [px].

    From the residuals of each view's own best pose, which takes six numbers out of the 2n of n corners.
    """
    counts = np.array([len(points) for points in views.corners.points])
    return np.maximum(views.reprojection * np.sqrt(counts / (2 * counts - 6)), LEAST_PIXEL_NOISE)


def refine(problem: Problem, X: Array, Z: Array, noise: Noise, used: NDArray[Any], sought: slice = slice(None)) -> Fit:
    """Return the least-squares fit to the `used` (V,) views, from a start near it.

    Only the numbers `sought` of those in `Fit` change; the covariance has no other rows.

    Raises:
        InputError: the views do not determine camera and board.
    """
    weights, scale = np.asarray(used, dtype=np.float64), 1.0
    for _ in range(50):
        A, b, _ = _normal_equations(problem.sums(X, Z), noise, weights)
        A, step = A[sought, sought], np.zeros(len(b))
        step[sought] = np.linalg.lstsq(A, b[sought], rcond=1e-14)[0]
        length = float(np.abs(step).max())
        step *= min(1.0, 0.5 / (length + 1e-300))
        X, Z = _apply_step(X, step[:6]), _apply_step(Z, step[6:12])
        if problem.free_intrinsics:
            problem = problem.at(_adjust_intrinsics(problem.intrinsics, step[12:16]))
        if problem.free_scale:
            grown = float(np.exp(step[-1]))
            problem, scale = problem.at(problem.intrinsics, grown), scale * grown
        if length < 1e-8:
            covariance = np.asarray(np.linalg.pinv(A, rcond=1e-14, hermitian=True), dtype=np.float64)
            return Fit(X, Z, problem.intrinsics, covariance, scale)
    raise InputError("hand-eye calibration: the refinement does not settle. Take more views, tilted more.")


def misfit(problem: Problem, X: Array, Z: Array, noise: Noise) -> float:
    """Return the squared residuals of all views in units of their covariance [-]: chi-square distributed, with two
    degrees of freedom a corner less one for each number that was sought."""
    return _normal_equations(problem.sums(X, Z), noise, np.ones(len(problem.T_base_flange)))[2]


def estimate_noise(problem: Problem, fit: Fit, pixel: float, used: NDArray[Any]) -> Noise:
    """Return the noise with the arm's errors for which the `used` (V,) views are most likely (REML)."""
    sums, weights = (
        problem.at(fit.intrinsics, fit.scale).sums(fit.T_flange_cam, fit.T_base_board),
        np.asarray(used, dtype=np.float64),
    )

    def unlikely(logs: Array) -> float:
        noise = Noise(pixel, *np.exp(logs))
        A, b, fixed = _normal_equations(sums, noise, weights)
        determinants = np.linalg.slogdet(np.eye(6) + _scale(sums.JJ, noise) / pixel**2)[1]
        return float(weights @ determinants + np.linalg.slogdet(A)[1] + fixed - b @ np.linalg.solve(A, b))

    bounds = [(np.log(1e-6), np.log(0.1))] * 2  # [rad], [m]
    start = np.log([1e-3, 5e-4])
    found = minimize(unlikely, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 0.02, "fatol": 0.01})
    return Noise(pixel, *(float(sigma) for sigma in np.exp(found.x)))


def view_distances(problem: Problem, fit: Fit, noise: Noise, own_noise: Array) -> Array:
    """Return (V,) Mahalanobis distances of the views: by how much each disagrees with the fit, in units of its error.

    Squared, they are chi-square distributed with 6 degrees of freedom for views that are as they should be. A view
    whose corners are found worse than usual, by its `own_noise` (V,) [px], is judged by that.
    """
    sums = problem.at(fit.intrinsics, fit.scale).sums(fit.T_flange_cam, fit.T_base_board)
    variance = np.maximum(own_noise, noise.pixel)[:, None, None] ** 2
    information = sums.JJ / variance
    away = np.linalg.solve(information, sums.Jr[..., None] / variance)
    sigma = np.repeat([noise.rotation**2, noise.translation**2], 3)
    covariance = np.linalg.inv(information) + np.diag(sigma)
    return np.sqrt((away * np.linalg.solve(covariance, away)).sum(axis=(1, 2)))


def _normal_equations(sums: _Sums, noise: Noise, weights: Array) -> tuple[Array, Array, float]:
    """Return A, b of A x = b and the sum of squares at x = 0, by Woodbury's identity with each view's covariance."""
    middle = np.eye(6) * noise.pixel**2 + _scale(sums.JJ, noise)
    L = np.repeat([noise.rotation, noise.translation], 3)
    JF, Jr = L[:, None] * sums.JF, L * sums.Jr
    solved = np.linalg.solve(middle, np.concatenate([JF, Jr[..., None]], axis=2))
    w = weights / noise.pixel**2
    A = np.einsum("v,vij->ij", w, sums.FF - np.swapaxes(JF, 1, 2) @ solved[..., :-1])
    b = np.einsum("v,vi->i", w, sums.Fr - (np.swapaxes(JF, 1, 2) @ solved[..., -1:])[..., 0])
    fixed = float(w @ (sums.rr - np.sum(Jr * solved[..., -1], axis=1)))
    return A, b, fixed


def _scale(JJ: Array, noise: Noise) -> Array:
    L = np.repeat([noise.rotation, noise.translation], 3)
    return L[:, None] * JJ * L


def _apply_step(T: Array, step: Array) -> Array:
    """Return a transform turned and shifted, both in the axes of the frame it leads to."""
    return transform(Rotation.from_rotvec(step[:3]).as_matrix() @ T[:3, :3], T[:3, 3] + step[3:])


def _adjust_intrinsics(camera: Intrinsics, step: Array) -> Intrinsics:
    """Return intrinsics with a step of fx, fy, cx, cy, as shares of the focal length."""
    fx, fy = camera.fx * float(np.exp(step[0])), camera.fy * float(np.exp(step[1]))
    return replace(
        camera, fx=fx, fy=fy, cx=camera.cx + camera.fx * float(step[2]), cy=camera.cy + camera.fy * float(step[3])
    )


def _cross(v: Array) -> Array:
    """Return the (N, 3, 3) matrices of the cross products v x."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - np.swapaxes(out, 1, 2)
