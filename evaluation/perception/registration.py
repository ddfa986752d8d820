"""Registration against the truth: the arm's poses, and all views jointly.

Plants and views are those of `skeletons.py` (the ten plants; --development takes ten others). One rendering serves
three errors of the robot: as in facts: perception (pose 0.2 deg and 1.5 mm per axis, hand-eye 0.2 deg and 1 mm), and on
the first plants also poses twice as bad and hand-eye twice as bad. The displacement is the RMS, over all pixels that
truly show the plant, of the distance between where the estimated and where the true pose puts the pixel's true point;
nothing is taken off. Beside it, "shape" is the same after the common rigid motion that fits best is removed: what makes
stems double. "rigid" is that motion's part: of the arm's own poses it is what no view can tell, only a better arm.

Then the pixel filter, on the same views: which pixels within the masks it drops. A pixel flies if no true surface
within 2 px lies within 10 mm of its depth.

Keys of the --json file: <method>_<error>_rms_mm (mean over plants), _worst_mm, _shape_mm, _rigid_mm, _rigid_worst_mm,
_s (median wall seconds);
<error> is usual, poses or hand_eye; reach_px (estimated reach of the matching window, median), accepted;
<filter>_flying_removed, _petioles_kept.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType

from anther.core import Array, inverse, transform_points
from anther.core.geometry import small_transform
from anther.perception import Capture, cloud, masks
from anther.perception.cloud._fusion import surface_pixels
from anther.perception.cloud._registration import Params, register
from anther.robot.arm.sawyer import TOOL
from anther.sim import CaptureTruth, Organ, layout
from anther.sim.capture import perturbed_hand_eye
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import finish, options, progress
from evaluation.perception.simulated import DEVELOPMENT, TEN, take
from evaluation.tables import by_part, written

METHODS = {"kinematics": None, "joint": Params()}

ERRORS = {"usual": (1.0, 1.0), "poses": (2.0, 1.0), "hand_eye": (1.0, 2.0)}
"""Factors on the error of the poses and of the hand-eye calibration."""
WORDS = {"usual": "usual errors", "poses": "poses twice as bad", "hand_eye": "hand-eye twice as bad"}
FILTERS = {"none": "none", "gradient": "a plain edge filter of 15 mm", "support": "Anther's"}

GRADIENT = 0.015
"""Of the plain edge filter [m]: a pixel goes if the depths around it differ by more."""


class Outcome(NamedTuple):
    """RMS displacement [mm], the same without the common rigid motion [mm], wall time [s]; reach [px], accepted."""

    rms: float
    shape: float
    seconds: float
    reach: float = np.nan
    accepted: bool = False


def believed_poses(truth: CaptureTruth, rng: np.random.Generator, poses: float, hand_eye: float) -> Array:
    """Return what a robot with such errors would believe of the poses (V, 4, 4) at which the views were taken."""
    T_true = perturbed_hand_eye(
        TOOL.T_flange_cam, rng, rotation=hand_eye * np.radians(0.2), translation=hand_eye * 0.001
    )
    turn, shift = rng.normal(size=(2, len(truth.T_world_cam), 3))
    errors = np.stack(
        [small_transform(poses * np.radians(0.2) * a, poses * 0.0015 * b) for a, b in zip(turn, shift, strict=True)]
    )
    return truth.T_world_cam @ inverse(T_true) @ inverse(errors) @ TOOL.T_flange_cam


def displacement(found: Array, truth: CaptureTruth, points: list[Array]) -> tuple[float, float]:
    """Return the RMS displacement [mm] of the points, as it is and without the best common rigid motion."""
    at = np.concatenate([transform_points(T, p) for T, p in zip(truth.T_world_cam, points, strict=True)])
    moved = np.concatenate([transform_points(T, p) for T, p in zip(found, points, strict=True)]) - at
    x, y, z = (at - at.mean(axis=0)).T
    zero, one = np.zeros(len(at)), np.ones(len(at))
    turns = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 1, 0)
    motions = np.concatenate([turns, one[:, None, None] * np.eye(3)], axis=2).reshape(-1, 6)
    rest = moved.ravel() - motions @ np.linalg.lstsq(motions, moved.ravel())[0]
    return 1e3 * float(np.sqrt(3 * np.mean(moved**2))), 1e3 * float(np.sqrt(3 * np.mean(rest**2)))


def true_points(capture: Capture, truth: CaptureTruth, step: int = 7) -> list[Array]:
    """Return per view every few of the true plant points in its camera frame [m]."""
    return [
        capture.intrinsics.back_project(d, o <= Organ.FLOWER)[::step]
        for d, o in zip(truth.depth, truth.organ, strict=True)
    ]


def register_all(
    capture: Capture, truth: CaptureTruth, labels: NDArray[Any], errors: Sequence[str], rng: np.random.Generator
) -> dict[tuple[str, str], Outcome]:
    """Return the outcome of every method under the errors named."""
    box, points, outcomes = layout(USUAL_DISTANCE).workspace, true_points(capture, truth), {}
    for error in errors:
        given = believed_poses(truth, rng, *ERRORS[error])
        seen = Capture(capture.depth, capture.intrinsics, given, capture.rgb)
        pixels = [p.points for p in cloud.plant_pixels(seen, labels, box)]
        for method, params in METHODS.items():
            begin = time.perf_counter()
            found = register(pixels, given, params) if params else None
            seconds = time.perf_counter() - begin
            rms, shape = displacement(found.T_world_cam if found else given, truth, points)
            reach = found.reach * capture.intrinsics.fx if found else np.nan
            outcomes[method, error] = Outcome(rms, shape, seconds, reach, bool(found and found.accepted))
    return outcomes


def filter_pixels(capture: Capture, truth: CaptureTruth, labels: NDArray[Any]) -> dict[str, tuple[float, float]]:
    """Return for each filter the share of flying pixels it removes and of petiole pixels it keeps."""
    counts = {name: np.zeros(4) for name in FILTERS}
    for view, depth in enumerate(capture.depth):
        masked = (labels[view] > 0) & (depth > 0)
        flies = masked & ~_on_surface(depth, truth.depth[view])
        petiole = masked & ~flies & np.isin(truth.organ[view], (Organ.PETIOLE, Organ.RACHIS))
        keeps = {
            "none": masked,
            "gradient": masked & (_range(depth) <= GRADIENT),
            "support": surface_pixels(depth, masked, capture.intrinsics)[0],
        }  # fmt: skip
        for name, keep in keeps.items():
            counts[name] += [(flies & ~keep).sum(), flies.sum(), (petiole & keep).sum(), petiole.sum()]
    return {name: (float(a / max(b, 1)), float(c / max(d, 1))) for name, (a, b, c, d) in counts.items()}


def _on_surface(depth: NDArray[Any], exact: NDArray[Any]) -> NDArray[np.bool_]:
    found = np.zeros(depth.shape, dtype=bool)
    for dv in range(-2, 3):
        for du in range(-2, 3):
            found |= np.abs(np.roll(exact, (dv, du), axis=(0, 1)) - depth) < 0.01
    return found


def _range(depth: NDArray[Any]) -> NDArray[Any]:
    """Return (H, W) the greatest difference of depth [m] between a pixel and its eight neighbours that read one."""
    around = [np.roll(depth, (dv, du), axis=(0, 1)) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
    return np.max([np.where(a > 0, np.abs(a - depth), 0) for a in around], axis=0)


def metrics(
    outcomes: list[dict[tuple[str, str], Outcome]], filters: list[dict[str, tuple[float, float]]]
) -> dict[str, float]:
    """Return the flat table."""
    table: dict[str, float] = {}
    for method, error in {key: None for o in outcomes for key in o}:
        rows = [o[method, error] for o in outcomes if (method, error) in o]
        table[f"{method}_{error}_rms_mm"] = float(np.mean([r.rms for r in rows]))
        table[f"{method}_{error}_worst_mm"] = max(r.rms for r in rows)
        table[f"{method}_{error}_shape_mm"] = float(np.mean([r.shape for r in rows]))
        rigid = [np.sqrt(r.rms**2 - r.shape**2) for r in rows]
        table[f"{method}_{error}_rigid_mm"], table[f"{method}_{error}_rigid_worst_mm"] = (
            float(np.mean(rigid)),
            max(rigid),
        )
        table[f"{method}_{error}_s"] = float(np.median([r.seconds for r in rows]))
    joint = [row for o in outcomes for (method, _), row in o.items() if method == "joint"]
    table["reach_px"] = float(np.median([r.reach for r in joint]))
    table["accepted"] = float(np.mean([r.accepted for r in joint]))
    for name in filters[0]:
        table[f"{name}_flying_removed"], table[f"{name}_petioles_kept"] = np.mean([f[name] for f in filters], axis=0)
    return {name: float(value) for name, value in table.items()}


def report(table: dict[str, float], plants: int, noisier: int) -> list[RenderableType]:
    """Return the displacements, what filters do, and how registration went."""
    poses = {"kinematics": "the arm's own poses", "joint": "registered"}
    parts = {f"{method}_{error}": f"{words}: {poses[method]}" for error, words in WORDS.items() for method in METHODS}
    displaced = {
        "displacement, RMS, mm": "*_rms_mm:.2f",
        "worst plant, mm": "*_worst_mm:.2f",
        "shape, mm": "*_shape_mm:.2f",
        "rigid, mm": "*_rigid_mm:.2f",
        "time, median, s": "*_s:.2f",
    }
    kept = {"flying pixels removed": "*_flying_removed:.1%", "petioles' pixels kept": "*_petioles_kept:.1%"}
    said = "Registrations accepted: accepted:.0%. Reach of the matching window: reach_px:.1f pixels."
    return [
        f"{plants} plants; {min(noisier, plants)} of them also with larger errors.",
        by_part(table, "the robot's errors", parts, displaced),
        "What filters of pixels do, on the same views:",
        by_part(table, "filter", FILTERS, kept),
        written(said, table),
    ]


def main() -> None:
    """Run, print, write."""
    quick = "one plant only"
    own = {
        "--development": (False, "other plants, on which parameters were chosen"),
        "--plants": (10, "only the first so many"),
        "--noisier": (2, "how many of them are also tried with doubled errors"),
    }
    args = options(__doc__, quick=quick, seed=(0, "of the robot's errors"), own=own)
    plants = (DEVELOPMENT if args.development else TEN)[: 1 if args.quick else args.plants]
    outcomes, filters = [], []
    for number, which in enumerate(progress(plants, "plants")):
        _, capture, truth = take(*which)
        labels = masks.segment(capture, layout(USUAL_DISTANCE).workspace).labels
        errors = list(ERRORS) if number < args.noisier else ["usual"]
        rng = np.random.default_rng([args.seed, number])
        outcomes.append(register_all(capture, truth, labels, errors, rng))
        filters.append(filter_pixels(capture, truth, labels))
    table = metrics(outcomes, filters)
    finish(args, table, *report(table, len(plants), args.noisier))


if __name__ == "__main__":
    main()
