"""The way of the camera around the plant: time, limits, torques, distances at 1 kHz, and the arm driven along it.

No image is taken here. Each preset's views and motions are planned as for a trial. They are then judged every
millisecond by `path_judge` (another collision engine than the planner's): joint range, speed, acceleration,
torque, and the distance of arm, gripper and camera to themselves, bench, pot, side camera, and the upright cylinder
(0.5 m wide, 0.75 m high) that is kept for the plant. Then the simulated arm, with its servos, drives them before a
grown plant, which it must not touch. Around each view the span is measured in which a frame shows the plant sharp and
the arm's readings tell where it was taken (`anther.robot.arm.views`): a camera that runs freely needs 38 ms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anther.core import Array, Box
from anther.plant import Crop
from anther.robot import JointTrajectory
from anther.robot.arm import motions
from anther.robot.arm.motions import USABLE
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.arm.views import Params, Views, capture_time, cylinder_points, is_sharp
from anther.sim import grow, layout, views_at
from anther.sim.cell import Cell
from anther.sim.robot import SimArm
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE
from evaluation.harness import CROPS, finish, options, progress
from evaluation.robustness.path_judge import SIGHT, Surroundings, judge_path
from evaluation.tables import by_number

LOOK = 0.2  # s to either side of a view
SHOWN = {
    "views": "*_views:.0f",
    "capture, motion and standing, s": "*_capture_s:.3g",
    "motion alone, s": "*_motion_s:.3g",
    "samples that are judged, one a millisecond": "*_samples:.0f",
    "smallest room to a joint's range, rad": "*_joint_room_rad:.3g",
    "largest share of a joint's speed": "*_velocity_share:.3g",
    "largest share of a joint's acceleration": "*_acceleration_share:.3g",
    "largest share of a motor's torque, of what is planned": "*_effort_share:.3g",
    "nearest to the bench, mm": "*_clearance_bench_mm:.0f",
    "nearest to the pot, mm": "*_clearance_pot_mm:.0f",
    "nearest to the cylinder that is kept for the plant, mm": "*_clearance_plant_mm:.0f",
    "nearest to the side camera, mm": "*_clearance_side_camera_mm:.0f",
    "nearest to itself, mm": "*_clearance_itself_mm:.0f",
    "driven: a joint's largest lag, mrad": "*_tracking_mrad:.3g",
    "driven: span of sharp pictures that a view needs, ms": "*_sharp_span_needed_ms:.3g",
    "driven: the shortest there is, ms": "*_shortest_sharp_span_ms:.3g",
    "driven: farthest from its view that such a picture is taken, mm": "*_farthest_from_view_mm:.3g",
    "driven: largest share of a motor's torque": "*_driven_effort_share:.3g",
    "driven: contacts": "*_contacts:.0f",
}
"""What the table shows of a preset."""


def judged(views: Views, pot: Box) -> dict[str, float]:
    """Return what the views' motions need and how near they come."""
    place = layout(USUAL_DISTANCE)
    bench, side_camera = place.solids
    around = Surroundings({"bench": bench, "side camera": side_camera}, {"pot": pot, "plant": place.region})
    verdict = judge_path(views.motions, around)
    shares = {name: getattr(verdict, name) for name in ("velocity", "acceleration", "effort")}
    return {
        "views": len(views.joints),
        "capture_s": capture_time(views),
        "motion_s": verdict.seconds,
        "samples": round(1000 * verdict.seconds),
        "joint_room_rad": verdict.room,
        **{f"{name}_share": share for name, share in shares.items()},
        **{f"clearance_{name.replace(' ', '_')}_mm": 1000 * gap for name, gap in verdict.clearance.items()},
    }


def driven(views: Views, species: Crop, seed: int) -> dict[str, float]:
    """Return how the simulated arm follows the whole motion before a plant of that seed, and how long it is sharp."""
    cell, camera = Cell(grow(species, seed, 0.0, USUAL_DISTANCE), SAWYER.ready), Params()
    motion, arrivals = through_views(views)
    record = SimArm(cell).follow(motion)
    rates = np.gradient(record.measured, record.times, axis=0)
    points = cylinder_points(layout(USUAL_DISTANCE).region, 0.08)  # [m] apart, as `Viewpoints.visit` has them
    spans, off = [], []
    for arrival, dwell, T_world_cam in zip(arrivals, views.dwell, views.T_world_cam, strict=True):
        rows = np.flatnonzero(np.abs(record.times - arrival - dwell / 2) < LOOK)
        q = record.measured[rows]
        sharp = is_sharp(SAWYER, q, rates[rows], TOOL.T_flange_cam, points, camera)
        begin, end = longest(sharp)
        spans.append(float(end - begin) * cell.params.timestep)
        at = SAWYER.forward(q[begin:end]) @ TOOL.T_flange_cam
        off.append(float(np.linalg.norm(at[:, :3, 3] - T_world_cam[:3, 3], axis=1).max()))
    log = cell.log()
    return {
        "driven_s": cell.time,
        "tracking_mrad": 1000 * float(np.abs(record.measured - record.commanded).max()),
        "sharp_span_needed_ms": 1000 * camera.span,
        "shortest_sharp_span_ms": 1000 * min(spans[:-1]),  # after the last view the arm stands
        "farthest_from_view_mm": 1000 * max(off),
        "driven_effort_share": float(np.abs(log.torques / SAWYER.effort).max()),
        "contacts": len(log.contact_other),
    }


def through_views(views: Views) -> tuple[JointTrajectory, Array]:
    """Return one motion through all views, standing still where `Views.dwell` says so, and when it arrives at each.

    Returns:
        The motion, and (V,) times [s].
    """
    parts, arrivals, now = list[JointTrajectory](), [], 0.0
    for motion, dwell in zip(views.motions, views.dwell, strict=True):
        arrivals.append(now + motion.duration)
        parts.append(motion)
        if dwell > 0:
            parts.append(JointTrajectory.standstill(motion.positions[-1], float(dwell)))
        now = arrivals[-1] + float(dwell)
    return motions.join(parts), np.array(arrivals)


def longest(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Return begin and end of the longest run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    runs = edges.reshape(-1, 2)
    begin, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return int(begin), int(end)


def fails(row: dict[str, float]) -> list[str]:
    """Return what of a preset breaks a limit."""
    shares = [name for name in ("velocity_share", "acceleration_share", "driven_effort_share") if row[name] > 1]
    near = [name for name in row if name.startswith("clearance") and row[name] <= 0]
    other = {"joint_room_rad": row["joint_room_rad"] <= 0, "contacts": row["contacts"] > 0}
    other["effort_share"] = row["effort_share"] > USABLE
    short = row["sharp_span_needed_ms"] - row["shortest_sharp_span_ms"]
    other["shortest_sharp_span_ms"] = short > 1  # ms, the simulation's step: a span is known no better
    return shares + near + [name for name, bad in other.items() if bad]


def main() -> None:
    """Plan, judge, drive, print a table, write --json."""
    args = options(__doc__, quick="the fast preset only", seed=(10, "of the plant that stands there"))
    rows = dict[str, dict[str, float]]()
    for name in progress(["fast"] if args.quick else list(PRESETS), "presets"):
        views = views_at(USUAL_DISTANCE, PRESETS[name])
        species = CROPS[len(rows) % 2]
        pot = grow(species, args.seed, 0.0, USUAL_DISTANCE).pot
        width = np.array([pot.radius, pot.radius, 0])
        body = Box(pot.centre - width - [0, 0, pot.height], pot.centre + width)
        rows[name] = judged(views, body) | driven(views, species, args.seed)
    metrics = {f"{name}_{what}": value for name, row in rows.items() for what, value in row.items()}
    metrics["limits_broken"] = sum(len(fails(row)) for row in rows.values())
    words = f"Nothing is looked for beyond {1e3 * SIGHT:.0f} mm. Limits that are broken: {metrics['limits_broken']}."
    presets = {name: f"preset `{name}`" for name in rows}
    finish(args, metrics, by_number(metrics, "", presets, SHOWN), words)


if __name__ == "__main__":
    main()
