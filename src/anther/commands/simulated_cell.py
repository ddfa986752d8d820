"""The simulated cell as `pipeline.Cell`: what the robot may know goes in; the plant's truth stays with the judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from anther import pipeline
from anther.arm import sawyer
from anther.arm.planner import Planner
from anther.arm.views import Params as ViewParams
from anther.arm.views import Views, capture_time, plan_views
from anther.capture import Capture
from anther.cloud import Cloud
from anther.devices import SafetyLimits
from anther.geometry import Box, look_at
from anther.runs import Advance
from anther.sim import cell as world
from anther.sim.capture import CameraErrors, capture_views, perturbed_hand_eye
from anther.sim.pepper import grow_pepper
from anther.sim.plant import SimPlant
from anther.sim.render import Scene
from anther.sim.robot import robot_of
from anther.sim.tomato import grow_tomato

Species = Literal["tomato", "pepper"]

WORKSPACE = Box(np.array([0.32, -0.40, -0.48]), np.array([1.12, 0.40, 0.52]))
"""Where the cell's builder put the plant [m]: on the bench, about 0.72 m in front of the arm."""
PLANT_REGION = Box(np.array([0.47, -0.25, -0.30]), np.array([0.97, 0.25, 0.45]))
"""What the views look at [m]."""
BENCH = Box(np.array([0.42, -0.55, -0.60]), np.array([1.22, 0.55, -0.48]))
"""Where nothing may ever go [m]."""
ARM_SPACE = Box(np.array([-0.6, -1.1, -0.47]), np.array([1.2, 1.1, 1.4]))
"""Where the flange may be [m]."""
T_WORLD_SIDE_CAMERA = look_at([0.74, -0.52, 0.17], [0.72, 0.0, 0.15])
"""A second camera beside the bench, where flowers usually are; put there by hand and calibrated."""
SIDE_CAMERA = Box(np.array([0.66, -0.60, 0.13]), np.array([0.82, -0.50, 0.21]))
"""Its body and arm [m]."""

SOLIDS = (BENCH, SIDE_CAMERA)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedCell:
    """A plant, its robot, and the world that both live in.

    Attributes:
        plant: ground truth, for the judge.
        world: MuJoCo's world; its log is what the judge reads.
        views: the views the arm takes.
        robot_side: what the pipeline is given.
    """

    plant: SimPlant
    world: world.Cell
    views: Views
    robot_side: pipeline.Cell

    @property
    def capture_seconds(self) -> float:
        """How long a real arm needs for the views, by its time-parameterised motions [s]."""
        return capture_time(self.views)


def grow(species: Species, seed: int, viewpoint: float) -> SimPlant:
    """Grow a plant; `viewpoint` [deg] turns it about the pot's axis."""
    match species:
        case "tomato":
            return grow_tomato(seed, viewpoint=viewpoint)
        case "pepper":
            return grow_pepper(seed, viewpoint=viewpoint)


def build(species: Species, seed: int, viewpoint: float, views: int) -> SimulatedCell:
    """Build a cell around one plant. All randomness comes from `seed`."""
    plant = grow(species, seed, viewpoint)
    planned = plan_views(PLANT_REGION, SOLIDS, ViewParams(count=views))
    sight, camera, noise = (np.random.default_rng([seed, int(viewpoint), k]) for k in range(3))
    scene = Scene.of_plant(plant)
    mujoco = world.Cell(plant, sawyer.READY)
    robot = robot_of(
        mujoco,
        errors=CameraErrors(),
        T_world_side_camera=T_WORLD_SIDE_CAMERA,
        seed=int(noise.integers(1 << 31)),
        scene=scene,
    )
    T_flange_cam_true = perturbed_hand_eye(sawyer.T_FLANGE_CAM, camera)
    return SimulatedCell(
        plant=plant,
        world=mujoco,
        views=planned,
        robot_side=pipeline.Cell(
            take_views=_views_of(scene, planned, T_flange_cam_true, sight),
            plan_around=_plan_around,
            robot=robot,
            workspace=WORKSPACE,
            limits=SafetyLimits(
                forward=sawyer.forward,
                joint_lower=sawyer.LOWER,
                joint_upper=sawyer.UPPER,
                joint_speed=sawyer.VELOCITY,
                workspace=ARM_SPACE,
                keep_out=SOLIDS,
            ),
        ),
    )


def _views_of(
    scene: Scene, views: Views, T_flange_cam_true: np.ndarray, rng: np.random.Generator
) -> Callable[[Advance], Capture]:
    def take(advance: Advance) -> Capture:
        capture, _truth = capture_views(
            scene, views.joints, sawyer.forward, T_flange_cam_true, sawyer.T_FLANGE_CAM, rng=rng, progress=advance
        )
        return capture

    return take


def _plan_around(cloud: Cloud) -> Planner:
    return Planner(cloud.points, cloud.obstacles, SOLIDS)
