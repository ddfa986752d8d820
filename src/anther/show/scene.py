"""The layers of a scene, made once from what stages found: viewer, log and pictures draw each in their own way.

World frame, metres. N points, S segments of lines, B balls, A arrows, V cameras.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, Box, Intrinsics
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, LEAF, STEM, TRUSS, Stem
from anther.pollination.grasp import Grasp
from anther.robot.arm.model import ArmModel, Capsule, Tool
from anther.show import style

if TYPE_CHECKING:
    from anther.pollination.shake import ShakePlan
    from anther.robot.devices import JointTrajectory

trimesh: Any = lazy_loader.load("trimesh")  # a third of a second, which a picture of a cloud does not need

ORGANS = {
    STEM: ("main stem", style.STEM_COLOR, 0.005),
    BRANCH: ("branches", style.BRANCH_COLOR, 0.002),
    TRUSS: ("trusses", style.TRUSS_COLOR, 0.002),
    LEAF: ("leaves", style.LEAF_COLOR, 0.001),
}
"""Organ -> its layer's name, colour, and how thick its lines are drawn [m]."""
ORGAN_COLORS = {organ: colour for organ, (_, colour, _) in ORGANS.items()}
FLOWER_RADIUS = 0.008
"""Radius that a flower is drawn with [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One thing that can be shown or hidden.

    Attributes:
        name: for people.
        colour: of all of it that has no other, "#rrggbb".
        points, colours: (N, 3) a cloud, and its own colours, uint8, or None.
        lines: (S, 2, 3) segments.
        edges: (S, 2) the skeleton's nodes that these join; None if they do not follow the skeleton.
        width: of the lines [m].
        balls: (B, 4) centre and radius.
        arrows: (A, 2, 3) from, to.
        solids: convex meshes.
        poses: (V, 4, 4) T_world_cam of cameras with the intrinsics `camera`.
        shown: whether it is to be seen at first.
    """

    name: str
    colour: str
    points: Array | None = None
    colours: NDArray[Any] | None = None
    lines: Array | None = None
    edges: NDArray[Any] | None = None
    width: float = 0.002
    balls: Array | None = None
    arrows: Array | None = None
    solids: Sequence[Any] = ()
    poses: Array | None = None
    camera: Intrinsics | None = None
    shown: bool = True


def cloud(found: Cloud) -> list[Layer]:
    """Return the plant's points, and those of pot and bench, and of supports, if there are any."""
    layers = [Layer("cloud", style.CLOUD_COLOR, points=found.points, colours=found.colors)]
    if len(found.obstacles):
        layers.append(Layer("pot and bench", style.POT_COLOR, points=found.obstacles))
    if found.supports:
        points = np.concatenate([support.points for support in found.supports])
        layers.append(Layer("supports", style.SUPPORT_COLOR, points=points))
    return layers


def views(capture: Capture) -> Layer:
    """Return the cameras that the views were taken with."""
    return Layer("views", style.VIEW_COLOR, poses=capture.T_world_cam, camera=capture.intrinsics, shown=False)


def organs(tree: Skeleton, stem: Stem | None = None) -> list[Layer]:
    """Return the skeleton's edges, a layer for each organ; without a stem one layer."""
    if stem is None:
        return [Layer("skeleton", style.BRANCH_COLOR, lines=tree.nodes[tree.edges], edges=tree.edges)]
    layers = []
    for kind, (name, colour, width) in ORGANS.items():
        edges = tree.edges[stem.organ[1:] == kind]  # edge j - 1 ends at node j
        if len(edges):
            layers.append(Layer(name, colour, lines=tree.nodes[edges], edges=edges, width=width))
    return layers


def main_stem(nodes: Array) -> Layer:
    """Return the main stem alone, along its nodes (S, 3)."""
    name, colour, width = ORGANS[STEM]
    return Layer(name, colour, lines=_chain(nodes), width=width)


def flowers(found: Flowers) -> Layer:
    """Return the flowers at rest."""
    radius = np.full((len(found.positions), 1), FLOWER_RADIUS)
    return Layer("flowers", style.FLOWER_COLOR, balls=np.hstack([found.positions.reshape(-1, 3), radius]))


def grasps(name: str, ranked: Sequence[Grasp], colour: str = style.GRASP_COLOR) -> Layer:
    """Return an arrow along the approach of each grasp, which ends at the stem, and the line on which pads close."""
    arrows = np.array([[g.point - 0.1 * g.approach, g.point] for g in ranked])
    across = np.array([g.T_world_flange[:3, 1] for g in ranked]) * np.array([[g.opening / 2] for g in ranked])
    ends = np.stack([arrows[:, 1] - across, arrows[:, 1] + across], axis=1)
    return Layer(name, colour, arrows=arrows, lines=ends, width=0.004, shown=name == "grasp")


def shaking(plan: ShakePlan) -> Layer:
    """Return an arrow along the shake at the grasp, 20 times as long as its amplitude."""
    end = plan.grasp.point + 20 * plan.amplitude * plan.direction
    return Layer("shake, 20 times as long", style.SHAKE_COLOR, arrows=np.array([[plan.grasp.point, end]]))


def motion(trajectory: JointTrajectory, forward: Callable[[Array], Array]) -> Layer:
    """Return the way of the flange in a motion of the arm with these kinematics."""
    rows = np.unique(np.linspace(0, len(trajectory.times) - 1, 50).astype(int))
    way = forward(trajectory.positions[rows])[:, :3, 3]
    return Layer("motion", style.SHAKE_COLOR, lines=_chain(way), width=0.003)


def outline(balls: Array) -> Layer:
    """Return an arm as balls (B, 4) of its outline; points without a radius are left out."""
    return Layer("arm", style.ROBOT_COLOR, balls=balls[balls[:, 3] > 0])


def keep_out(boxes: Sequence[Box]) -> Layer:
    """Return the boxes that no part of the arm may enter."""
    solids = [_box((b.lower + b.upper) / 2, (b.upper - b.lower) / 2) for b in boxes]
    return Layer("keep-out boxes", style.POT_COLOR, solids=solids)


def gripper(tool: Tool, grasp: Grasp, opening: float) -> Layer:
    """Return the gripper at a grasp, its pads so far open [m]."""
    solids = [solid.apply_transform(grasp.T_world_flange) for solid in hand(tool, opening)]
    return Layer("gripper", style.GRIPPER_COLOR, solids=solids)


def arm_at(arm: ArmModel, joints: Array, *, shown: bool = True) -> Layer:
    """Return the arm without its gripper at joints (J,) [rad]."""
    poses = [np.eye(4), *arm.link_poses(joints)]
    shapes = (solid.apply_transform(T) for T, link in zip(poses, limbs(arm), strict=False) for solid in link)
    return Layer("arm", style.ROBOT_COLOR, solids=list(shapes), shown=shown)


def limbs(arm: ArmModel) -> Iterator[list[Any]]:
    """Yield the meshes of the base, then those of each link in its own frame."""
    yield [*map(_capsule, arm.base_capsules), *(_box(s.center, s.half) for s in arm.base_solids)]
    for link in arm.links:
        yield [_capsule(c) for c in link.capsules]


def hand(tool: Tool, opening: float) -> list[Any]:
    """Return the meshes of gripper and camera in the flange's frame, the pads so far open [m]."""
    return [_box(s.center, s.half) for s in tool.solids(opening)]


def _chain(nodes: Array) -> Array:
    """Return the segments (S, 2, 3) of a line through nodes (S + 1, 3)."""
    return np.stack([nodes[:-1], nodes[1:]], axis=1)


def _capsule(capsule: Capsule) -> Any:
    start, end = np.array(capsule.start), np.array(capsule.end)
    height = float(np.linalg.norm(end - start))
    mesh = trimesh.creation.capsule(height=height, radius=capsule.radius, count=(12, 12))
    mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], (end - start) / height))
    mesh.apply_translation((start + end) / 2 - mesh.bounds.mean(axis=0))
    return mesh


def _box(centre: Any, half: Any) -> Any:
    mesh = trimesh.creation.box(2 * np.array(half))
    mesh.apply_translation(centre)
    return mesh
