"""The simulated cell: what the robot may know goes into `robot.Cell`; the truth stays with the judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from anther.core.choices import ActuatorName, Crop
from anther.core.geometry import Array, Box, Intrinsics, look_at
from anther.core.runs import Advance
from anther.perception.capture import Capture, Keep, no_keep
from anther.perception.cloud import Cloud
from anther.robot.arm.model import ArmModel, outline
from anther.robot.arm.planner import Params as MotionParams
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.views import Params as ViewParams
from anther.robot.arm.views import Views, capture_time, plan_views
from anther.robot.cell import Cell
from anther.robot.devices import SafetyLimits, Tap, no_tap
from anther.robot.safety import guard
from anther.sim import arm_model
from anther.sim import cell as world
from anther.sim.capture import CaptureTruth, Sight, camera_errors, capture_views, in_poses, perturbed_hand_eye
from anther.sim.pepper import grow_pepper
from anther.sim.plant import SimPlant
from anther.sim.render import Scene
from anther.sim.robot import robot_of
from anther.sim.sway import swaying
from anther.sim.tomato import grow_tomato
from anther.sim.true_plant import as_true
from anther.sim.truth import NOMINAL, Truth

Place = tuple[float, float, float]

USUAL_DISTANCE = 0.72
"""Of the pot's axis in front of the Sawyer [m]: where facts: sawyer 6 tabulates what the arm can shake."""

PRESETS = {"full": ViewParams(), "fast": ViewParams(count=10, widest=75.0, first=(-52.5, -5.0))}
"""How the views are sought. `fast` takes a third of the time: docs/reports/views.md measures what that costs. Of the 80
directions it can have, its spread begins at the one with the shortest tour of those that leave the smallest gaps."""


def usual_distance(arm: ArmModel) -> float:
    """Return how far in front of an arm the pot's axis stands [m]: as far as its reach goes, by the Sawyer's."""
    return round(USUAL_DISTANCE * arm.reach / SAWYER.reach, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What the cell's builder knows of it, all in the arm's base frame; nothing of the plant itself.

    Attributes:
        workspace: box the plant stands in.
        region: what the views look at.
        solids: bench, and the side camera's body and arm: where nothing may ever go.
        pot: a box well within any pot of the crop, from the bench to just under the rim. Planners see the true pot.
        arm_space: where the flange may be.
        T_world_side_camera: a second camera beside the bench, where flowers usually are; put there by hand, calibrated.
    """

    workspace: Box
    region: Box
    solids: tuple[Box, ...]
    pot: Box
    arm_space: Box
    T_world_side_camera: Array


def layout(distance: float, *, beyond: bool = False) -> Layout:
    """Return the layout for a pot that stands `distance` [m] in front of the arm.

    The side camera looks across the arm's approach, or with `beyond` against it: a motor in the gripper shakes across.
    """
    axis = np.array([distance, 0.0, 0.0])

    def box(lower: Place, upper: Place) -> Box:
        return Box(axis + lower, axis + upper)

    bench = box((-0.30, -0.55, -0.60), (0.50, 0.55, -0.48))
    side_camera, eye = box((-0.06, -0.60, 0.13), (0.10, -0.50, 0.21)), np.array([0.02, -0.52, 0.17])
    if beyond:
        side_camera, eye = box((0.50, -0.10, 0.13), (0.60, 0.06, 0.21)), np.array([0.52, -0.02, 0.17])
    return Layout(
        workspace=box((-0.40, -0.40, -0.48), (0.40, 0.40, 0.52)),
        region=box((-0.25, -0.25, -0.30), (0.25, 0.25, 0.45)),
        solids=(bench, side_camera),
        pot=box((-0.06, -0.06, -0.48), (0.06, 0.06, -0.32)),
        arm_space=Box(np.array([-0.6, -1.1, -0.47]), np.array([1.2, 1.1, 1.4])),
        T_world_side_camera=look_at(axis + eye, axis + np.array([0.0, 0.0, 0.15])),
    )


def safety_limits(place: Layout, arm: ArmModel = SAWYER) -> SafetyLimits:
    """Return what no command of an arm in this cell may exceed."""
    return SafetyLimits(
        forward=arm.forward,
        outline=partial(outline, arm),
        joint_lower=arm.lower,
        joint_upper=arm.upper,
        joint_speed=arm.velocity,
        joint_acceleration=arm.acceleration,
        workspace=place.arm_space,
        keep_out=(*place.solids, place.pot),
    )


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedCell:
    """A plant (ground truth), MuJoCo's world, whose log the judge reads, and what the pipeline is given.

    `views` are the arm's; None where a camera on the cart takes them on its way. `notes` say what was supposed of a
    cell file's cell.
    """

    plant: SimPlant
    world: world.Cell
    robot_side: Cell
    views: Views | None = None
    notes: tuple[str, ...] = ()

    @property
    def capture_seconds(self) -> float:
        """How long a real arm needs for the views, by its time-parameterised motions [s]; 0 without any."""
        return 0.0 if self.views is None else capture_time(self.views)


def grow(species: Crop, seed: int, viewpoint: float, distance: float, truth: Truth = NOMINAL) -> SimPlant:
    """Grow a plant in a pot `distance` [m] in front of the arm; `viewpoint` [deg] turns it about the pot's axis."""
    grown = {"tomato": grow_tomato, "pepper": grow_pepper}[species]
    return as_true(grown(seed, viewpoint=viewpoint, axis=(distance, 0.0)), truth)


def in_wind(plant: SimPlant, scene: Scene, views: Views, truth: Truth) -> Sight:
    """Return what each of the views finds of a plant that sways in the truth's wind while they are taken."""
    if truth.wind == 0:
        return scene
    poses = swaying(plant, truth.wind, np.linspace(0, capture_time(views), len(views.joints)))
    return in_poses(plant, scene, poses)


@cache
def views_at(distance: float, views: ViewParams, arm: ArmModel = SAWYER) -> Views:
    """Return the views of a pot `distance` [m] in front of the arm: the same for every plant."""
    place = layout(distance)
    return plan_views(place.region, place.solids, views, arm=arm)


def build(
    species: Crop,
    seed: int,
    viewpoint: float,
    views: ViewParams,
    *,
    distance: float | None = None,
    truth: Truth = NOMINAL,
    actuator: ActuatorName = "arm",
    visit: int = 0,
    tap: Tap = no_tap,
    arm: ArmModel = SAWYER,
) -> SimulatedCell:
    """Build a cell around one plant. All randomness comes from `seed`, but for what `truth` says.

    Another `visit` is to the same plant, with other errors of arm and cameras. `tap` listens to the bare machines.

    With the actuator "gripper" there is a motor in the gripper (`sim.arm_model`), and `Robot.motor` to command it. The
    views are rendered, not driven to: the arm stands where it waits after the last of them.

    Raises:
        StageFailure: "unreachable" when the arm reaches fewer than three views.
    """
    distance = usual_distance(arm) if distance is None else distance
    place = layout(distance, beyond=actuator == "gripper")
    planned = views_at(distance, views, arm)
    plant = grow(species, seed, viewpoint, distance, truth)
    noise = int(np.random.default_rng([seed, int(viewpoint), 2 + 10 * visit]).integers(1 << 31))
    coil = arm_model.COIL.force if actuator == "gripper" else 0.0
    mujoco = world.Cell(plant, arm.waiting, world.Params(coil_force=coil), truth, arm)
    scene = Scene.of_plant(plant)

    def take_views(advance: Advance, keep: Keep) -> Capture:
        sight, seen = in_wind(plant, scene, planned, truth), (seed, viewpoint, visit)
        return photograph(sight, planned.joints, *seen, progress=advance, keep=keep, truth=truth, arm=arm)[0]

    return around(mujoco, scene, take_views, place, noise, tap, planned)


def around(
    mujoco: world.Cell,
    scene: Scene,
    take_views: Callable[[Advance, Keep], Capture],
    place: Layout,
    noise: int,
    tap: Tap,
    views: Views | None = None,
) -> SimulatedCell:
    """Return the cell of an arm and a plant: what takes views, plans motions and moves, and what that is judged by.

    Args:
        mujoco: the arm, where it waits, and the plant.
        scene: what cameras see.
        take_views: see `robot.Cell`.
        place: where things are.
        noise: seed of the errors of machines and side camera.
        tap: listens to the bare machines.
        views: of the arm, if it takes them.
    """
    truth, arm = mujoco.truth, mujoco.arm
    seen_from, limits = place.T_world_side_camera, safety_limits(place, arm)
    robot = robot_of(mujoco, errors=camera_errors(truth), T_world_side_camera=seen_from, seed=noise, scene=scene)

    home = mujoco.joints

    def plan_around(cloud: Cloud) -> Planner:
        # between sawyer_moveit's "medium" and "fast" (facts: sawyer 1), which passes the safety limits in places
        params = MotionParams(velocity_share=0.9, acceleration_share=0.7, approach_speed=0.1, home=tuple(home.tolist()))
        return Planner(cloud.yielding, cloud.rigid, place.solids, space=place.arm_space, params=params, arm=arm)

    robot = guard(tap(robot, limits, arm.tool.T_flange_cam, lambda: mujoco.time), limits)
    given = Cell(take_views, plan_around, robot, place.workspace, limits)
    return SimulatedCell(mujoco.plant, mujoco, given, views)


def photograph(
    plant: Sight,
    joints: Array,
    seed: int,
    viewpoint: float = 0.0,
    visit: int = 0,
    *,
    progress: Advance | None = None,
    keep: Keep = no_keep,
    truth: Truth = NOMINAL,
    arm: ArmModel = SAWYER,
    intrinsics: Intrinsics | None = None,
) -> tuple[Capture, CaptureTruth]:
    """Return what the wrist camera sees of a plant from joints (V, J) [rad], and the truth, which is for judges.

    Its errors come from `seed`, `viewpoint` [deg] and `visit`; `truth` says how large they are. Without `intrinsics` it
    is a D455.
    """
    sight, camera = (np.random.default_rng([seed, int(viewpoint), k + 10 * visit]) for k in range(2))
    T_flange_cam_true = perturbed_hand_eye(arm.tool.T_flange_cam, camera, factor=truth.hand_eye_error)
    believed, errors = arm.tool.T_flange_cam, camera_errors(truth)
    poses = (joints, arm.forward, T_flange_cam_true, believed)
    return capture_views(plant, *poses, rng=sight, errors=errors, progress=progress, keep=keep, intrinsics=intrinsics)
