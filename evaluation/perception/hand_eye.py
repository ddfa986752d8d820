"""Hand-eye calibration against the truth: closed forms and refinement, exact and inexact arm, outliers, intrinsics.

A 7 x 5 ChArUco board of 30 mm squares is seen from 20 places 0.35 to 0.5 m above it by a camera of 1280 x 720 px,
f = 640 px; its corners are projected and given noise. "arm" is the standard deviation of the flange's error per axis.

    python -m evaluation.perception.hand_eye [--quick] [--seed N] [--json FILE] [--figure FILE]
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from rich.table import Table
from scipy.spatial.transform import Rotation

from anther.core import Array, Intrinsics, inverse, transform_points
from anther.core.geometry import look_at, small_transform
from anther.robot import calibrate, estimate_intrinsics
from anther.robot.calibration import BoardCorners, board_views
from anther.robot.calibration._hand_eye import METHODS, closed_form
from anther.robot.calibration._refinement import Noise, Problem, refine
from anther.show.pictures.estimates import draw_calibration
from evaluation.harness import finish, options, progress, save
from evaluation.tables import by_part

CAMERA = Intrinsics(1280, 720, 640.0, 640.0, 639.5, 359.5)
CORNERS = 0.03 * np.array([[column, row, 0] for row in range(1, 5) for column in range(1, 7)])
T_FLANGE_CAM = small_transform([0.1, -0.2, 1.5], [0.03, -0.06, 0.05])
T_BASE_BOARD = small_transform([3.1, 0.02, 0.01], [0.7, 0.1, -0.2])
VIEWS, WRONG = 20, 3
WRONG_BY = 1.0, 10.0  # [deg], [mm], per axis
TARGET = 0.06, 0.6  # [deg], [mm], for 0.2 px and an exact arm


class Case(NamedTuple):
    """Corner noise [px], error of the arm per axis [deg], [mm], wrong views [-], whether intrinsics are estimated."""

    pixel: float
    arm_degrees: float = 0.0
    arm_millimetres: float = 0.0
    wrong: int = 0
    estimated: bool = False

    @property
    def words(self) -> str:
        """What is exact and what is not."""
        arm = f"arm {self.arm_degrees}°, {self.arm_millimetres:g} mm" if self.arm_degrees else "arm exact"
        wrong = f", {self.wrong} views off by {WRONG_BY[0]:g}°, {WRONG_BY[1]:g} mm" if self.wrong else ""
        return f"corners {self.pixel} px, {arm}{wrong}{', intrinsics estimated' if self.estimated else ''}"


CASES = {
    "exact_arm_0.2px": Case(0.2),
    "arm_0.1deg_1mm_0.5px": Case(0.5, 0.1, 1.0),
    "arm_0.3deg_2mm_0.2px": Case(0.2, 0.3, 2.0),
    "outliers_exact_arm_0.2px": Case(0.2, wrong=WRONG),
    "outliers_arm_0.1deg_1mm_0.2px": Case(0.2, 0.1, 1.0, wrong=WRONG),
    "estimated_intrinsics_0.2px": Case(0.2, estimated=True),
}


def flange_poses(rng: np.random.Generator) -> Array:
    """Return (V, 4, 4) flange poses from which the camera looks at the board, rolled by up to 1 rad."""
    middle, poses = (T_BASE_BOARD @ [0.105, 0.075, 0, 1])[:3], []
    for _ in range(VIEWS):
        eye = middle + np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.35, 0.5)])
        aim = middle + np.array([*rng.uniform(-0.04, 0.04, 2), 0])
        roll = small_transform([0, 0, rng.uniform(-1, 1)], [0, 0, 0])
        poses.append(look_at(eye, aim, up=(0.1, 1, 0)) @ roll @ inverse(T_FLANGE_CAM))
    return np.stack(poses)


def shaken(T: Array, rng: np.random.Generator, degrees: float, millimetres: float) -> Array:
    """Return (V, 4, 4) poses with normal errors per axis."""
    turns, shifts = (
        np.deg2rad(degrees) * rng.normal(size=(len(T), 3)),
        1e-3 * millimetres * rng.normal(size=(len(T), 3)),
    )
    return np.stack([M @ small_transform(turn, shift) for M, turn, shift in zip(T, turns, shifts, strict=True)])


def corners_seen(flange: Array, rng: np.random.Generator, noise: float) -> BoardCorners:
    """Return the noisy corners within the image."""
    points, pixels = [], []
    for T in inverse(flange @ T_FLANGE_CAM) @ T_BASE_BOARD:
        exact = CAMERA.project(transform_points(T, CORNERS))
        inside = np.all((exact > 0) & (exact < [CAMERA.width - 1, CAMERA.height - 1]), axis=1)
        points.append(CORNERS[inside])
        pixels.append((exact + noise * rng.normal(size=exact.shape))[inside])
    return BoardCorners(np.arange(len(points)), tuple(points), tuple(pixels))


def error(T: Array) -> tuple[float, float]:
    """Return how far T_flange_cam is from the truth [deg], [mm]."""
    gap = inverse(T_FLANGE_CAM) @ T
    return float(np.rad2deg(Rotation.from_matrix(gap[:3, :3]).magnitude())), float(1e3 * np.linalg.norm(gap[:3, 3]))


def seen(case: Case, rng: np.random.Generator) -> tuple[Array, BoardCorners, Array]:
    """Return the flange poses as the arm reports them, the corners, and (V,) which views are wrong."""
    flange = flange_poses(rng)
    corners = corners_seen(flange, rng, case.pixel)
    flange = shaken(flange, rng, case.arm_degrees, case.arm_millimetres)
    wrong = np.isin(np.arange(VIEWS), rng.choice(VIEWS, case.wrong, replace=False))
    flange[wrong] = shaken(flange[wrong], rng, *WRONG_BY) if wrong.any() else flange[wrong]
    return flange, corners, wrong


def run(case: Case, rng: np.random.Generator) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Return the errors of each method in one calibration, and what became of its views."""
    flange, corners, wrong = seen(case, rng)
    camera = estimate_intrinsics(corners, CAMERA.width, CAMERA.height)[0] if case.estimated else CAMERA
    views = board_views(corners, camera)
    found = calibrate(flange, views, camera, free_intrinsics=case.estimated)
    errors = {"refined": error(found.T_flange_cam)}
    for method in METHODS:
        errors[method] = error(closed_form(flange, views.T_cam_board, method)[0])
    start, exact = closed_form(flange, views.T_cam_board, "park"), Noise(case.pixel, 1e-6, 1e-6)
    if not case.wrong:
        plain = refine(Problem.of(flange, views, camera), *start, exact, np.full(VIEWS, True))
        errors["pixels only"] = error(plain.T_flange_cam)
    judged = {
        "outliers_found": float(np.mean(~found.used[wrong])) if wrong.any() else 1.0,
        "good_views_kept": float(np.mean(found.used[~wrong])),
        "error_over_stated": errors["refined"][1] / (1e3 * found.translation_error),
    }
    return errors, judged


def measure(seeds: int, seed: int) -> dict[str, float]:
    """Run all cases and return the metrics."""
    metrics: dict[str, float] = {}
    for name, case in CASES.items():
        errors, judged = defaultdict(list), defaultdict(list)
        for k in progress(range(seeds), name):
            found, views = run(case, np.random.default_rng([seed, k]))
            for method, values in found.items():
                errors[method].append(values)
            for key, value in views.items():
                judged[key].append(value)
        metrics |= _case_metrics(name, errors, judged)
    best = (metrics[f"exact_arm_0.2px_refined_{unit}"] for unit in ("deg", "mm"))
    return metrics | {"rows_failed": float(any(value > most for value, most in zip(best, TARGET, strict=True)))}


def tables(metrics: dict[str, float]) -> tuple[Table, Table]:
    """Return the errors of each method, and what became of the views."""
    shown = {"refined": "refined", "tsai": "Tsai-Lenz", "park": "Park", "daniilidis": "Daniilidis"}
    shown |= {"pixels_only": "arm taken for exact"}
    of_method = "*_{0}_deg:.3f (*_{0}_deg_p95:.3f), *_{0}_mm:.2f (*_{0}_mm_p95:.2f)"
    errors = {f"{words} (°, mm)": of_method.format(method) for method, words in shown.items()}
    views = {
        "wrong views found": "*_outliers_found:.1%",
        "good views kept": "*_good_views_kept:.1%",
        "error over what is stated, RMS": "*_error_over_stated_rms:.2f",
    }
    cases = {name: case.words for name, case in CASES.items()}
    there = {key: value for key, value in metrics.items() if not key.endswith("outliers_found")}
    there |= {key: metrics[key] for name, case in CASES.items() if case.wrong and (key := f"{name}_outliers_found")}
    return by_part(metrics, "case", cases, errors), by_part(there, "case", cases, views)


def _case_metrics(name: str, errors: dict[str, list], judged: dict[str, list]) -> dict[str, float]:
    out = {}
    for method, values in errors.items():
        for k, unit in enumerate(("deg", "mm")):
            column, key = np.array(values)[:, k], f"{name}_{method.replace(' ', '_')}_{unit}"
            out |= {key: float(np.median(column)), f"{key}_p95": float(np.quantile(column, 0.95))}
    out |= {f"{name}_{key}": float(np.mean(judged[key])) for key in ("outliers_found", "good_views_kept")}
    out[f"{name}_error_over_stated_rms"] = float(np.sqrt(np.mean(np.square(judged["error_over_stated"]))))
    return out


def main() -> None:
    """Run, print the table, write --json and the picture that `anther calibrate` makes of one calibration."""
    quick, seed = "5 calibrations a case", (0, "of the cases")
    own = {"--count": (40, "calibrations a case")}
    args = options(__doc__, quick=quick, seed=seed, figure="one calibration with an inexact arm and outliers", own=own)
    seeds = 5 if args.quick else args.count
    metrics = measure(seeds, args.seed)
    words = (
        f"Error of T_flange_cam over {seeds} calibrations a case: median (95th percentile) in degrees and millimetres."
    )
    errors, views = tables(metrics)
    finish(args, metrics, words, errors, "Of the refinement:", views)
    if args.figure:
        flange, corners, _ = seen(CASES["outliers_arm_0.1deg_1mm_0.2px"], np.random.default_rng([args.seed, 0]))
        views = board_views(corners, CAMERA)
        save(draw_calibration(calibrate(flange, views, CAMERA), views, flange), args.figure)


if __name__ == "__main__":
    main()
