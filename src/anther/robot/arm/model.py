"""Any arm by its description: joints, links, limits, shapes and tool, and the kinematics that follow. J joints.

Frames: base = world, z up, origin at the arm's mount. Link i turns about its own +z by joint i. The tool approaches
along the flange's +z, and its fingers close along the flange's +-y.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from typing import ClassVar

import numpy as np
import scipy  # loads `scipy.stats`, which takes long, where it is used
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from anther.core.checks import check_array, check_transform
from anther.core.errors import bad_input
from anther.core.geometry import Array, transform
from anther.robot.arm.plausible import check_acceleration, check_extent, check_joint

GRIPPER, CAMERA = "gripper", "camera"
BASE, FLANGE = "base", "flange"


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder with round ends: axis from `start` to `end` (3,) [m] in its link's frame, `radius` [m]."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, slots=True)
class Solid:
    """A box aligned with its frame: `center` and `half` extents (3,) [m]."""

    name: str
    center: tuple[float, float, float]
    half: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Link:
    """A moving link, or one that rides on it.

    Attributes:
        name: as in the URDF; link i turns about its +z by joint i.
        xyz, rpy: its frame in the parent link's frame at zero angle [m], [rad], R = Rz(y) Ry(p) Rx(r).
        mass: [kg].
        com: centre of mass in the link frame [m].
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass [kg m^2].
        capsules, solids: collision shape in the link frame.
    """

    name: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    capsules: tuple[Capsule, ...]
    solids: tuple[Solid, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """A parallel gripper and a camera on the flange, in its frame.

    Attributes:
        mass, com: of the whole gripper [kg], [m].
        stroke: largest opening between the pads [m].
        finger: where the fingers leave the body, along z [m].
        tip: where they end [m].
        pad: width along x, thickness along y, length along z, ending at the tip [m].
        thickness: of a finger behind its pad, along y [m].
        speed: of the pads [m/s].
        body: outline of the gripper without fingers.
        camera_mass: with its bracket [kg].
        T_flange_cam: (4, 4) where the camera is meant to be.
        camera: outline of camera and bracket; the camera itself first.
    """

    mass: float
    com: tuple[float, float, float]
    stroke: float
    finger: float
    tip: float
    pad: tuple[float, float, float]
    thickness: float
    speed: float
    body: Solid
    camera_mass: float
    T_flange_cam: Array
    camera: tuple[Solid, ...]

    @property
    def T_flange_grasp(self) -> Array:
        """(4, 4) the centre between the pads."""
        return transform(np.eye(3), [0, 0, self.tip - self.pad[2] / 2])

    def fingers(self, opening: float) -> tuple[Solid, ...]:
        """Return the two fingers, each a box of finger and pad together, in the flange frame.

        Args:
            opening: distance between the pads' faces [m].
        """
        half = (self.pad[1] + self.thickness) / 2
        y, z, half_z = opening / 2 + half, (self.finger + self.tip) / 2, (self.tip - self.finger) / 2
        return tuple(
            Solid(f"{side}_finger", (0, sign * y, z), (self.pad[0] / 2, half, half_z))
            for side, sign in (("left", 1), ("right", -1))
        )

    def solids(self, opening: float) -> tuple[Solid, ...]:
        """Return gripper, fingers and camera; see `fingers`."""
        return (self.body, *self.fingers(opening), *self.camera)


@dataclass(frozen=True, slots=True, eq=False)
class ArmModel:
    """An arm of J joints with its tool.

    Attributes:
        name: of the arm.
        joints: J names.
        lower, upper: (J,) range [rad].
        velocity, acceleration: (J,) [rad/s], [rad/s^2].
        effort: (J,) torque of the motors at the joints [N m].
        rotor_inertia: (J,) seen at the joints [kg m^2].
        stiffness: (J,) of the joints' springs, in the simulator [N m/rad].
        links: J, from the base outwards.
        T_last_flange: (4, 4) the flange in the last link's frame.
        tool: on the flange.
        neutral: (J,) where servos are tuned [rad].
        ready: (J,) drawn back from the plant; views begin there [rad].
        waiting: (J,) near most grasps; the arm waits there for what the views tell [rad].
        neighbours: pairs of links, riders, "base", "gripper" and "camera" that are never checked against each other.
        shoulder: (3,) a point, and
        reach: the farthest that the flange gets from it [m].
        floor: height of the floor [m].
        base_capsules, base_solids: what never moves against the base.
        riders: what sits on links and never moves against them: number of the link, and what it is.
        wrist: of the link before the last, what lies on the flange's axis whatever the joints, in the flange's frame;
            None where there is no such thing. It saves planning time.
        slows: (J, 2) where the robot allows less speed near the ends of its range, else None: by how much less
            [rad/s], and the deceleration to stop there with [rad/s^2].
        local: (J, 4, 4) pose of each link in the one before, at joint angle 0; follows from `links`.
        margin: added around every arm link in planning [m]; the gripper has its true size.
    """

    name: str
    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array
    rotor_inertia: Array
    stiffness: Array
    links: tuple[Link, ...]
    T_last_flange: Array
    tool: Tool
    neutral: Array
    ready: Array
    waiting: Array
    neighbours: tuple[tuple[str, str], ...]
    shoulder: Array
    reach: float
    floor: float
    base_capsules: tuple[Capsule, ...] = ()
    base_solids: tuple[Solid, ...] = ()
    riders: tuple[tuple[int, Link], ...] = ()
    wrist: Capsule | None = None
    slows: Array | None = None
    local: Array = field(init=False)
    margin: ClassVar[float] = 0.01

    def __post_init__(self) -> None:
        count, fewest = len(self.joints), 6  # with so many a flange can be put anywhere in any orientation
        if count < fewest or len(self.links) != count:
            given = f"{count} joints, {len(self.links)} links"
            raise bad_input(f"arm {self.name}", given=given, allowed=f">= {fewest}, as many links", do="List them all.")
        per_joint = ("lower", "upper", "velocity", "acceleration", "effort", "rotor_inertia", "stiffness")
        for name in (*per_joint, "neutral", "ready", "waiting"):
            object.__setattr__(self, name, check_array(f"{self.name}'s {name}", getattr(self, name), (count,)))
        for i, joint in enumerate(self.joints):
            lower, upper, velocity, effort = (float(x[i]) for x in (self.lower, self.upper, self.velocity, self.effort))
            check_joint(f"{self.name}'s joint {joint}", lower, upper, velocity, effort)
            check_acceleration(f"{self.name}'s joint {joint}", float(self.acceleration[i]))
        for name in ("neutral", "ready", "waiting"):
            q = getattr(self, name)
            if np.any((q < self.lower) | (q > self.upper)):
                raise bad_input(
                    f"{self.name}'s {name}", given=f"{q}", allowed="joints within its range", do="Move them."
                )
        object.__setattr__(self, "T_last_flange", check_transform("flange", self.T_last_flange))
        turned = [transform(Rotation.from_euler("xyz", link.rpy).as_matrix(), link.xyz) for link in self.links]
        object.__setattr__(self, "local", np.stack(turned))

    def on_mount(self, height: float) -> ArmModel:
        """Return the same arm on a mount so much higher [m]."""

        def up(place: tuple[float, float, float]) -> tuple[float, float, float]:
            return place[0], place[1], place[2] + height

        return replace(
            self,
            links=(replace(self.links[0], xyz=up(self.links[0].xyz)), *self.links[1:]),
            base_capsules=tuple(replace(c, start=up(c.start), end=up(c.end)) for c in self.base_capsules),
            base_solids=tuple(replace(s, center=up(s.center)) for s in self.base_solids),
            shoulder=self.shoulder + np.array([0, 0, height]),
        )

    def with_tool(self, tool: Tool) -> ArmModel:
        """Return the same arm with another tool; what of it touches where the arm is ready or waits is not checked."""
        if tool is self.tool:
            return self
        other = replace(self, tool=tool)
        return replace(other, neighbours=tuple(sorted({*self.neighbours, *_tool_neighbours(other)})))

    def speed_limit(self, q: ArrayLike, *, down: bool = False) -> Array:
        """Return the greatest speeds (..., J) [rad/s] with which joints (..., J) [rad] may turn up, or down."""
        q = np.asarray(q, dtype=np.float64)
        if self.slows is None:
            return np.broadcast_to(self.velocity, q.shape)
        left = np.maximum(q - self.lower if down else self.upper - q, 0.0)
        offset, deceleration = self.slows.T
        return np.clip(np.sqrt(2 * deceleration * left) - offset, 0.0, self.velocity)

    @property
    def count(self) -> int:
        """How many joints, J."""
        return len(self.joints)

    def link_poses(self, q: ArrayLike) -> Array:
        """Return the (..., J + 1, 4, 4) base-frame poses of all links and the flange for joints (..., J) [rad]."""
        q = np.asarray(q, dtype=np.float64)
        local = self.local * np.ones((*q.shape, 1, 1))
        c, s = np.cos(q)[..., None], np.sin(q)[..., None]
        local[..., :, 0] = self.local[..., :, 0] * c + self.local[..., :, 1] * s
        local[..., :, 1] = self.local[..., :, 1] * c - self.local[..., :, 0] * s
        count = self.count
        poses = np.empty((*q.shape[:-1], count + 1, 4, 4))
        poses[..., 0, :, :] = local[..., 0, :, :]
        for i in range(1, count):
            poses[..., i, :, :] = poses[..., i - 1, :, :] @ local[..., i, :, :]
        poses[..., count, :, :] = poses[..., count - 1, :, :] @ self.T_last_flange
        return poses

    def forward(self, q: ArrayLike) -> Array:
        """Return T_world_flange (..., 4, 4) for joints (..., J) [rad]."""
        return self.link_poses(q)[..., self.count, :, :]

    def jacobian(self, q: ArrayLike) -> Array:
        """Return the (..., 6, J) Jacobian of the flange: linear [m/rad] above angular [rad/rad], in the base frame."""
        poses = self.link_poses(q)
        axes = poses[..., :-1, :3, 2]
        arms = poses[..., -1:, :3, 3] - poses[..., :-1, :3, 3]
        x, y, z = np.moveaxis(axes, -1, 0)
        a, b, c = np.moveaxis(arms, -1, 0)
        return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, x, y, z], axis=-2)  # numpy's cross is slow


def rpy(turn: Rotation) -> Array:
    """Return roll, pitch and yaw (3,) as a URDF writes them. At a pitch of 90 degrees any roll and yaw will do."""
    with warnings.catch_warnings(action="ignore"):
        return turn.as_euler("xyz")


SPACING = 0.02  # m between balls, so that a box larger than that cannot slip between them


def outline(arm: ArmModel, q: ArrayLike) -> Array:
    """Return balls (..., S, 4) for joints (..., J) [rad]: centre in the base frame and radius [m].

    A link is its capsules' axes in balls of their radius; gripper, open fingers and camera are points on their boxes.
    They fill the shapes that `collision` plans with and never stand out of them. Base and riders are left out.
    """
    poses, shapes = arm.link_poses(q), _balls(arm)
    return np.concatenate([_place(poses[..., i, :, :], balls) for i, balls in enumerate(shapes)], axis=-2)


def touches(arm: ArmModel, q: ArrayLike, points: Array, within: float) -> NDArray[np.bool_]:
    """Return (N,) which points (N, 3) [m] lie `within` [m] of links, gripper and camera at joints (J,)."""
    poses, found = arm.link_poses(q), np.zeros(len(points), dtype=bool)
    for T, link in zip(poses, arm.links, strict=False):  # the last pose is the flange's
        own = (points - T[:3, 3]) @ T[:3, :3]
        for capsule in link.capsules:
            start, axis = np.array(capsule.start), np.subtract(capsule.end, capsule.start)
            share = np.clip((own - start) @ axis / max(float(axis @ axis), 1e-12), 0, 1)
            found |= np.linalg.norm(own - start - share[:, None] * axis, axis=1) <= capsule.radius + within
    own = (points - poses[-1, :3, 3]) @ poses[-1, :3, :3]
    for solid in arm.tool.solids(arm.tool.stroke):
        found |= (np.abs(own - solid.center) <= np.add(solid.half, within)).all(axis=1)
    return found


def _place(T: Array, balls: Array) -> Array:
    """Return balls (S, 4) of a frame, centre and radius, at its poses (..., 4, 4): (..., S, 4)."""
    centres = balls[:, :3] @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
    return np.concatenate([centres, np.broadcast_to(balls[:, 3:], (*centres.shape[:-1], 1))], axis=-1)


def _of_capsule(capsule: Capsule) -> Array:
    """Return balls (S, 4) of its radius along a capsule's axis: centre and radius [m]."""
    start, end = np.array(capsule.start), np.array(capsule.end)
    count = int(np.ceil(np.linalg.norm(end - start) / SPACING)) + 1
    centres = start + np.linspace(0, 1, count)[:, None] * (end - start)
    return np.column_stack([centres, np.full(count, capsule.radius)])


def _of_solid(solid: Solid) -> Array:
    """Return points (S, 4) of radius 0 all over the surface of a box."""
    centre, half = np.array(solid.center), np.array(solid.half)
    axes = [np.linspace(-h, h, int(np.ceil(2 * h / SPACING)) + 1) for h in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_surface = np.isclose(np.abs(grid), half).any(axis=1)
    return np.column_stack([centre + grid[on_surface], np.zeros(on_surface.sum())])


@cache
def _balls(arm: ArmModel) -> tuple[Array, ...]:
    """Return the balls (S, 4) of each link and the tool, in their own frames."""
    tool = np.concatenate([_of_solid(s) for s in arm.tool.solids(arm.tool.stroke)])
    return (*(np.concatenate([_of_capsule(c) for c in link.capsules]) for link in arm.links), tool)


def complete(arm: ArmModel) -> ArmModel:
    """Return an arm with the shoulder, reach and neighbours that follow from its links."""
    at, q = arm.link_poses(np.zeros(arm.count)), scipy.stats.qmc.Sobol(arm.count, scramble=False).random_base2(12)
    shoulder = np.array([0.0, 0.0, at[1, 2, 3]])
    far = float(
        np.linalg.norm(arm.forward(scipy.stats.qmc.scale(q, arm.lower, arm.upper))[:, :3, 3] - shoulder, axis=1).max()
    )
    links = [(f"link {link.name}", link.capsules) for link in arm.links]
    check_extent(arm.name, far, arm.floor - float(shoulder[2]), links, arm.base_capsules)
    return replace(arm, shoulder=shoulder, reach=1.01 * far, neighbours=_neighbours(arm))


def _neighbours(arm: ArmModel) -> tuple[tuple[str, str], ...]:
    """Return the pairs of parts that are not to be checked: joined ones, and those whose shapes say nothing.

    The latter touch where the arm is ready or waits, or, links one apart, in more than 30 % of all postures.
    """
    names = _part_names(arm)
    tool = len(names) - 2
    joined = {*zip(names[:tool], names[1:tool], strict=False), (GRIPPER, CAMERA)}
    joined |= {(names[i], part) for i in (tool - 2, tool - 1) for part in (GRIPPER, CAMERA)}
    samples = scipy.stats.qmc.scale(scipy.stats.qmc.Sobol(arm.count, scramble=False).random(256), arm.lower, arm.upper)
    q = np.concatenate([[arm.ready, arm.waiting], samples])
    balls = _parts_at(arm, q)
    for i, j in combinations(range(len(names)), 2):
        pair = names[i], names[j]
        if pair not in joined:
            touch = np.array([_touch(a, b) for a, b in zip(balls[i], balls[j], strict=True)])
            if touch[:2].any() or (min(j, tool) - i == 2 and touch.mean() > 0.3):
                joined.add(pair)
    return tuple(sorted(joined))


def _tool_neighbours(arm: ArmModel) -> set[tuple[str, str]]:
    """Return the pairs of base or link and gripper or camera that touch where the arm is ready or waits."""
    names, balls = _part_names(arm), _parts_at(arm, np.stack([arm.ready, arm.waiting]))
    tool = len(names) - 2
    pairs = ((i, j) for i in range(tool) for j in (tool, tool + 1))
    return {(names[i], names[j]) for i, j in pairs if any(map(_touch, balls[i], balls[j]))}


def _part_names(arm: ArmModel) -> list[str]:
    return [BASE, *(link.name for link in arm.links), GRIPPER, CAMERA]


def _parts_at(arm: ArmModel, q: Array) -> list[Array]:
    """Return balls (Q, S, 4) of base, links, gripper and camera at joints (Q, J): centre and radius [m]."""
    base = [_of_capsule(c) for c in arm.base_capsules] + [_of_solid(s) for s in arm.base_solids]
    wider = np.array([0, 0, 0, arm.margin])
    links = [np.concatenate([_of_capsule(c) for c in link.capsules]) + wider for link in arm.links]
    gripper, camera = (arm.tool.body, *arm.tool.fingers(arm.tool.stroke)), arm.tool.camera
    tools = [np.concatenate([_of_solid(s) for s in solids]) for solids in (gripper, camera)]
    poses = arm.link_poses(q)
    ground = np.concatenate(base) if base else np.zeros((0, 4))
    moving = [_place(poses[:, min(i, arm.count)], shape) for i, shape in enumerate([*links, *tools])]
    return [np.tile(ground, (len(q), 1, 1)), *moving]


def _touch(a: Array, b: Array) -> bool:
    """Return whether any of balls (S, 4) touches any of others; boxes around them tell most that do not."""
    if not len(a) or not len(b):
        return False
    if np.any((a[:, :3] - a[:, 3:]).min(axis=0) > (b[:, :3] + b[:, 3:]).max(axis=0)):
        return False
    if np.any((b[:, :3] - b[:, 3:]).min(axis=0) > (a[:, :3] + a[:, 3:]).max(axis=0)):
        return False
    gap = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=2) - a[:, None, 3] - b[None, :, 3]
    return bool((gap < 0).any())
