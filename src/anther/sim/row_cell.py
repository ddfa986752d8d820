"""An arm on a cart before a simulated row: the plant that is asked for moves, the rest of the row stands still.

The cart stands where the flowers of that plant are at the arm's best height; the arm's base is in the path. What the
robot may know goes into `robot.Cell`: not which plant this is, nor where its hook hangs.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from anther.core.geometry import Array, Box, look_at
from anther.core.runs import Advance
from anther.perception.capture import Capture, Keep
from anther.robot.arm.model import ArmModel
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.waiting import waiting_joints
from anther.robot.devices import Tap, no_tap
from anther.sim import cell as world
from anther.sim.capture import Sight, camera_errors, capture_from_poses, in_poses, perturbed_hand_eye
from anther.sim.render import Scene
from anther.sim.row import Row, row_scene
from anther.sim.row_drive import BETWEEN_VIEWS, STEM_TO_STEM, look_ahead
from anther.sim.row_plants import STRINGS, held_by_string
from anther.sim.simulated_cell import Layout, SimulatedCell, around, usual_distance
from anther.sim.sway import calm_time
from anther.sim.true_plant import as_true
from anther.sim.truth import NOMINAL, Truth

FLOWERS_Z = 0.15
"""Height of the flowers over the arm's base [m]: as in the cell of a plant in a pot."""


def before_arm(row: Row, arm: ArmModel = SAWYER) -> Row:
    """Return the row in the frame of an arm whose cart stands before the plant that is asked for.

    The base is as far from the stems as the pot of a cell is, as far as the path is wide enough for its 0.15 m.
    """
    m, plant = row.measures, row.worked
    x = max(m.near - usual_distance(arm), -m.corridor / 2 + 0.15)
    stem = plant.end[plant.stem_segments()]
    beside = stem[np.argmin(np.abs(stem[:, 2] - row.flowers[2]))]
    return row.at([-x, -beside[1], FLOWERS_Z - row.flowers[2]])


ODOMETRY = 0.01
"""What is believed of the cart's odometry (`robot.Cell`), a guess: its wheels slip on the pipes [m]."""
HOOK_ERROR = 0.02
"""Of the place of a hook or a foot along and across the row in a map, standard deviation [m]: a guess."""


def mapped_string(row: Row, arm: ArmModel = SAWYER) -> tuple[Array, Array | None]:
    """Return where the map says that the asked stem's string hangs and the stem rises, (3,) each.

    In the arm's frame (`before_arm`) [m]. Peppers' strings slant from the middle of the holder to their line of hooks;
    where a tomato rises changes with each lowering, so that no map knows it.
    """
    hooks, feet = _mapped_strings(before_arm(row, arm))
    return hooks[row.asked], feet[row.asked] if row.crop == "pepper" else None


def mapped_others(row: Row, arm: ArmModel = SAWYER) -> list[tuple[Array, Array | None]]:
    """Return hook and foot (3,) of every other string of the near line, as `mapped_string` does of the asked one."""
    row = before_arm(row, arm)
    (_, feet), found = _mapped_strings(row), list[tuple[Array, Array | None]]()
    error = np.random.default_rng([row.seed, 20]).normal(0, HOOK_ERROR, (row.near, max(STRINGS.values()), 2))
    for plant in range(row.near):
        for string, twine in enumerate(row.plants[plant].twines):
            if (plant, string) != (row.asked, 0):
                hook = twine.hook + np.append(error[plant, string], 0.0)
                found.append((hook, feet[plant] if row.crop == "pepper" else None))
    return found


def _mapped_strings(row: Row) -> tuple[Array, Array]:
    """Return where the map says that every plant's string hangs and its stem rises (P, 3), in the row's frame [m]."""
    rng = np.random.default_rng([row.seed, 16])
    plants = len(row.hooks)
    hooks = row.hooks + np.pad(rng.normal(0, HOOK_ERROR, (plants, 2)), ((0, 0), (0, 1)))
    feet = np.array([plant.pot.centre for plant in row.plants])
    feet = feet + np.pad(rng.normal(0, HOOK_ERROR, (plants, 2)), ((0, 0), (0, 1)))
    if row.crop == "tomato":
        feet = np.column_stack([hooks[:, :2], feet[:, 2]])
    return hooks, feet


def _hung_kept(row: Row) -> list[Box]:
    """Return what the map keeps clear: hooks with their spools, and columns about the strings of other stems."""
    # m from the line of its string that a neighbour's stem is looked for; peppers part in two: guesses
    beside = {"tomato": 0.06, "pepper": 0.12}[row.crop]
    spool = np.array([0.06, 0.15, 0.05])  # m: as far from its hook as `row_house` has it, and 0.04 more
    hooks, feet = _mapped_strings(row)
    around, found = np.array([beside, beside, 0.0]), [Box(hook - spool, hook + spool) for hook in hooks]
    for plant in np.delete(np.arange(len(hooks)), row.asked):
        line = np.linspace(hooks[plant], feet[plant], 2 if row.crop == "tomato" else 6)
        for upper, lower in pairwise(line):
            found.append(Box(np.minimum(lower, upper) - around, np.maximum(lower, upper) + around))
    return found


def _fixed_kept(row: Row) -> list[Box]:
    """Return boxes about what is fixed in a row: posts, pipes, wires, gutters and what stands on them."""
    return [part.box for part in row.parts if part.name not in ("hook", "spool")]


def row_layout(row: Row, arm: ArmModel = SAWYER) -> Layout:
    """Return where things are around an arm before a row (`before_arm`), all in its base frame.

    The other side of the path is kept clear of, and so are posts, pipes, wires and gutters within reach, and hooks and
    other stems where the map has them: no camera looks at all of them. Nor does one look at the leaves above and
    below the workspace: the flange stays out of there. The side camera is on the cart.
    """
    stems = row.origin[0] + row.measures.near
    other = row.origin[0] - row.measures.corridor / 2
    far = Box(np.array([other - 1.0, -2.0, -1.5]), np.array([other, 2.0, 2.0]))
    reach = arm.reach + arm.tool.tip
    solids = [box for box in (*_hung_kept(row), *_fixed_kept(row)) if _gap(box, arm.shoulder) < reach]

    def box(lower: tuple[float, float, float], upper: tuple[float, float, float]) -> Box:
        return Box(np.array([stems, 0, 0]) + lower, np.array([stems, 0, 0]) + upper)

    workspace = box((-0.30, -0.30, -0.35), (0.25, 0.30, 0.60))
    eye = np.array([stems - 0.45, -0.30, FLOWERS_Z + 0.05])
    return Layout(
        workspace=workspace,
        region=box((-0.12, -0.15, -0.25), (0.12, 0.15, 0.35)),
        solids=(far, *solids[:-1]),
        pot=solids[-1] if solids else far,
        arm_space=Box(np.array([other, -0.8, workspace.lower[2]]), np.array([stems + 0.1, 0.8, workspace.upper[2]])),
        T_world_side_camera=look_at(eye, np.array([stems, 0.0, FLOWERS_Z])),
    )


def _gap(box: Box, place: Array) -> float:
    """Return how far a place (3,) is from a box [m]."""
    return float(np.linalg.norm(np.clip(place, box.lower, box.upper) - place))


def row_world(row: Row, truth: Truth = NOMINAL, arm: ArmModel = SAWYER, joints: Array | None = None) -> world.Cell:
    """Return MuJoCo's world of an arm before a row: the plant that is asked for on its string, and what is in reach.

    The arm stands at `joints` (J,) [rad]; None: as before a pot.
    """
    fine_below = 0.55  # m under the flowers: an arm holds it within 0.4 m of them (facts: rows 0)
    cut = replace(world.Params().plant, fine_above=float(row.flowers[2]) - fine_below)
    plant = held_by_string(row.worked, cut)
    if truth != NOMINAL:
        plant = held_by_string(as_true(plant, truth), cut)  # softer or heavier, it must still hang
    reach = arm.reach + arm.tool.tip + 0.2
    near = [part for part in row.obstacles() if _gap(part.box, arm.shoulder) < reach]
    joints = arm.waiting if joints is None else joints
    return world.Cell(plant, joints, world.Params(plant=cut), truth, arm, obstacles=near)


def build_row(
    row: Row, *, truth: Truth = NOMINAL, visit: int = 0, tap: Tap = no_tap, arm: ArmModel = SAWYER
) -> SimulatedCell:
    """Build the cell of an arm on a cart that drives up to the plant that is asked for.

    A camera on the cart takes the views on the way (`row_drive.look_ahead`), before the cart drives up; the calibration
    of the side camera errs as theirs does. See `simulated_cell.build`.

    Raises:
        StageFailure: "unreachable" when there is no place for the arm to wait.
    """
    row = before_arm(row, arm)
    place = row_layout(row, arm)
    mujoco = row_world(row, truth, arm, _waits(place, arm))
    scene, rng = row_scene(row, mujoco.plant), np.random.default_rng([row.seed, 14 + 10 * visit])
    noise = int(np.random.default_rng([row.seed, 15 + 10 * visit]).integers(1 << 31))

    def take_views(advance: Advance, keep: Keep) -> Capture:
        believed, true = look_ahead(row, rng, truth)
        how: dict[str, Any] = {"rng": rng, "errors": camera_errors(truth), "progress": advance, "keep": keep}
        return capture_from_poses(_after_wind(mujoco, scene, len(true)), believed, T_world_cam_true=true, **how)[0]

    def drive_up() -> None:
        calm = 0.1  # s: nothing moves meanwhile
        _blow(mujoco, STEM_TO_STEM if truth.wind else calm)

    calibrated = place.T_world_side_camera
    true = perturbed_hand_eye(calibrated, np.random.default_rng([row.seed, 21]), factor=truth.hand_eye_error)
    cell = around(mujoco, scene, take_views, replace(place, T_world_side_camera=true), noise, tap)
    robot = replace(cell.robot_side.robot, T_world_side_camera=calibrated)
    given = replace(cell.robot_side, robot=robot, odometry=ODOMETRY, drive_up=drive_up)
    return replace(cell, robot_side=given)


def _waits(place: Layout, arm: ArmModel) -> Array:
    """Return joints (J,) [rad] at which the arm waits: out of most leaves, before the stem that is asked for."""
    leaves, way_in = 0.25, 0.12  # m from where the straight way in begins, and its length
    x, y, _ = (place.region.lower + place.region.upper) / 2
    held = [(x, y, FLOWERS_Z - below) for below in (0.0, 0.1, 0.2, 0.3)]  # below the flowers
    return waiting_joints(arm, held, (1.0, 0.0, 0.0), place.solids, before=way_in, back=leaves)


def _after_wind(mujoco: world.Cell, scene: Scene, views: int) -> Sight:
    """Let this world's wind blow while views are taken; return what each finds. The arm finds the plant as they end."""
    if not mujoco.truth.wind:
        return scene
    _blow(mujoco, calm_time(mujoco.plant))
    poses = list[Array]()
    for view in range(views):
        _blow(mujoco, BETWEEN_VIEWS if view else 0.0)
        poses.append(mujoco.segment_poses())
    mujoco.forget()  # of what the wind did the robot is not to blame
    return in_poses(mujoco.plant, scene, poses)


def _blow(mujoco: world.Cell, seconds: float) -> None:
    steps = round(seconds / mujoco.timestep)
    still = np.tile(mujoco.joints, (steps, 1))
    mujoco.run(still, np.zeros_like(still), np.full(steps, mujoco.opening))
