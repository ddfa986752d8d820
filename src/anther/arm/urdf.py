"""An arm's description from a URDF file: links, limits and masses as they stand there, capsules fitted to its shapes.

What a URDF does not tell is given: accelerations, tool, postures. Links that are fixed to each other become one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.cluster.vq import kmeans2
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from anther.arm.model import ARM_MARGIN, BASE, CAMERA, GRIPPER, ArmModel, Capsule, Link, Tool, of_capsule, of_solid, rpy
from anther.arm.sawyer import TOOL
from anther.errors import bad_input
from anther.files import read_lines
from anther.geometry import Array, inverse, transform

SURFACE = 3000  # points on a link's shapes, beside their corners
ROTOR = 1 / 150  # kg m^2 of rotor inertia for each N m of effort: a guess, half of Sawyer's
SPRING = 20.0  # N m/rad of a joint's spring for each N m of effort, as of Sawyer: a guess
LESS = 1e-6  # rad


def from_urdf(
    name: str,
    path: Path,
    *,
    base: str,
    tip: str,
    acceleration: ArrayLike,
    ready: ArrayLike,
    T_tip_flange: ArrayLike | None = None,
    widest: float = np.pi,
    packages: Path | None = None,
    floor: float = 0.0,
    tool: Tool = TOOL,
) -> ArmModel:
    """Return the arm between two links of a URDF file.

    Args:
        name: of the arm.
        path: of the file, or of one that defines it as a xacro macro; its arguments are then left empty.
        base: link whose frame is the world.
        tip: link whose frame is the flange, or nearly so. If it is fixed to the last link that turns, it and all that
            hangs on it have no mass and no shape here: the tool takes their place.
        acceleration: (J,) or one for all [rad/s^2].
        ready: (J,) drawn back from the plant, and near most grasps [rad]. There the arm also waits.
        T_tip_flange: (4, 4) the flange in the tip's frame, None where they are one; the tool approaches along its +z.
        widest: joints that turn further than twice this are kept within +- this, so that none has two turns [rad].
        packages: folder in which the folders of `package://` lie; None: meshes lie beside the file.
        floor: height of the floor [m].
        tool: on the flange.

    Raises:
        InputError: no such file, no XML, no chain between the links, a joint that slides, or a link without a shape.
    """
    text = re.sub(r"\s(?!xmlns:)[a-z]+:(?=\w+=\")", " ", "\n".join(read_lines(path)))  # prefixes that nothing declares
    try:
        tree = ElementTree.fromstring(re.sub(r"\$\{\w+\}", "", text))
    except ElementTree.ParseError as error:
        raise bad_input(str(path), given=f"no XML ({error})", allowed="a URDF file", do="Export it again.") from error
    robot = next((part for part in tree.iter() if part.find("link") is not None), tree)
    chain, turning, flange = _chain(robot, base, tip)
    frames, links, names = [np.eye(4)], list[Link](), [joint.get("name", "") for joint in turning]
    stuck = _stuck(robot, base, chain, tip)
    for joint, fixed in zip(turning, _between(chain, turning), strict=True):
        turn = transform(_onto(_axis(joint)), [0, 0, 0])
        T = inverse(frames[-1]) @ fixed @ _origin(joint) @ turn
        frames.append(turn)
        links.append(_link(robot, joint, stuck, T, inverse(turn), path, packages))
    lower, upper, velocity, effort = np.array([_limits(joint, widest) for joint in turning]).T
    ground = [shape for link, T in stuck[base] for shape in _points(link, T, path, packages)]
    arm = ArmModel(
        name=name,
        joints=tuple(names),
        lower=lower,
        upper=upper,
        velocity=velocity,
        acceleration=np.full(len(lower), acceleration) if np.ndim(acceleration) == 0 else np.asarray(acceleration),
        effort=effort,
        rotor_inertia=ROTOR * effort,
        stiffness=SPRING * effort,
        links=tuple(links),
        T_last_flange=inverse(frames[-1]) @ flange @ (np.eye(4) if T_tip_flange is None else np.asarray(T_tip_flange)),
        tool=tool,
        neutral=np.asarray(ready, dtype=float),
        ready=np.asarray(ready, dtype=float),
        waiting=np.asarray(ready, dtype=float),
        neighbours=(),
        shoulder=np.zeros(3),
        reach=np.inf,
        floor=floor,
        base_capsules=capsules_around(np.concatenate(ground)) if ground else (),
    )
    return completed(arm)


def completed(arm: ArmModel) -> ArmModel:
    """Return an arm with the shoulder, reach and neighbours that follow from its links."""
    at, q = arm.link_poses(np.zeros(arm.count)), qmc.Sobol(arm.count, scramble=False).random_base2(12)
    shoulder = np.array([0.0, 0.0, at[1, 2, 3]])
    far = np.linalg.norm(arm.forward(qmc.scale(q, arm.lower, arm.upper))[:, :3, 3] - shoulder, axis=1).max()
    return replace(arm, shoulder=shoulder, reach=1.01 * float(far), neighbours=neighbours(arm, ARM_MARGIN))


def _chain(robot: Any, base: str, tip: str) -> tuple[list[Any], list[Any], Array]:
    """Return the joints from base to tip, those of them that turn, and the tip in the last one's link (4, 4)."""
    above = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    chain, link = list[Any](), tip
    while link != base:
        if link not in above:
            do = "Name two links of one chain."
            raise bad_input("tip", given=f"{tip!r}", allowed=f"a link that hangs on {base!r}", do=do)
        chain.insert(0, above[link])
        link = above[link].find("parent").get("link")
    turning = [joint for joint in chain if joint.get("type") != "fixed"]
    slides = [joint.get("name") for joint in turning if joint.get("type") not in ("revolute", "continuous")]
    if slides or not turning:
        raise bad_input("arm", given=f"joints that do not turn: {slides}", allowed="revolute", do="Choose other links.")
    flange = np.eye(4)
    for joint in chain[chain.index(turning[-1]) + 1 :]:
        flange = flange @ _origin(joint)
    return chain, turning, flange


def _between(chain: list[Any], turning: list[Any]) -> Iterator[Array]:
    """Yield for each joint that turns the product (4, 4) of the fixed ones just before it."""
    fixed = np.eye(4)
    for joint in chain:
        if joint in turning:
            yield fixed
            fixed = np.eye(4)
        else:
            fixed = fixed @ _origin(joint)


def _stuck(robot: Any, base: str, chain: list[Any], tip: str) -> dict[str, list[tuple[Any, Array]]]:
    """Return for the base and each link that a joint of the chain turns all links fixed to it, with poses (4, 4)."""
    links, joints = {link.get("name"): link for link in robot.findall("link")}, robot.findall("joint")
    roots = [base, *(j.find("child").get("link") for j in chain if j.get("type") != "fixed")]
    out: dict[str, list[tuple[Any, Array]]] = {}
    for root in roots:
        open_ = [(root, np.eye(4))]
        out[root] = []
        while open_:
            name, T = open_.pop()
            out[root].append((links[name], T))
            for joint in joints:
                child = joint.find("child").get("link")
                held = joint.get("type") == "fixed" and joint.find("parent").get("link") == name
                if held and (child != tip or tip in roots):
                    open_.append((child, T @ _origin(joint)))
    return out


def _link(
    robot: Any, joint: Any, stuck: dict[str, list[tuple[Any, Array]]], T: Array, unturn: Array, path: Path,
    packages: Path | None,
) -> Link:  # fmt: skip
    """Return the link that a joint turns: T (4, 4) in the link before; `unturn` takes the URDF's frame to ours."""
    name = joint.find("child").get("link")
    parts = [(link, unturn @ at) for link, at in stuck[name]]
    points = [shape for link, at in parts for shape in _points(link, at, path, packages)]
    if not points:
        raise bad_input(f"link {name}", given="no collision shape", allowed="at least one", do="Add one to the URDF.")
    mass, com, inertia = _inertial(parts)
    place = tuple(map(float, T[:3, 3])), tuple(map(float, rpy(Rotation.from_matrix(T[:3, :3]))))
    return Link(name, *place, mass, com, inertia, capsules_around(np.concatenate(points)))  # type: ignore[arg-type]


def _points(link: Any, T: Array, path: Path, packages: Path | None) -> list[Array]:
    """Return points (P, 3) on each of a link's collision shapes, T (4, 4) its pose."""
    out = []
    for collision in link.findall("collision"):
        mesh = _mesh(collision.find("geometry")[0], path, packages)
        surface = trimesh.sample.sample_surface(mesh, SURFACE, seed=0)[0]
        points = np.concatenate([mesh.vertices, surface])
        at = T @ _origin(collision)
        out.append(points @ at[:3, :3].T + at[:3, 3])
    return out


def _mesh(shape: Any, path: Path, packages: Path | None) -> Any:
    match shape.tag:
        case "box":
            return trimesh.creation.box(_numbers(shape.get("size")))
        case "sphere":
            return trimesh.creation.icosphere(subdivisions=3, radius=float(shape.get("radius")))
        case "cylinder":
            return trimesh.creation.cylinder(radius=float(shape.get("radius")), height=float(shape.get("length")))
        case _:
            where = shape.get("filename").removeprefix("file://")
            inside = where.startswith("package://") and packages is not None
            file = packages / where.removeprefix("package://") if inside and packages else path.parent / where
            mesh: Any = trimesh.load_mesh(file, process=False)
            return mesh.apply_scale(_numbers(shape.get("scale", "1 1 1")))


def _inertial(parts: Sequence[tuple[Any, Array]]) -> tuple[float, Any, Any]:
    """Return mass, centre of mass and inertia about it of links that are one body."""
    rows = []
    for link, T in parts:
        tag = link.find("inertial")
        if tag is not None and float(tag.find("mass").get("value")) > 0:
            at, i = T @ _origin(tag), {k: float(v) for k, v in tag.find("inertia").attrib.items()}
            own = np.array([[i[f"i{min(a, b)}{max(a, b)}"] for b in "xyz"] for a in "xyz"])
            rows.append((float(tag.find("mass").get("value")), at[:3, 3], at[:3, :3] @ own @ at[:3, :3].T))
    mass = sum(row[0] for row in rows)
    com = sum((m * at for m, at, _ in rows), np.zeros(3)) / max(mass, 1e-9)
    total = np.zeros((3, 3))
    for m, at, own in rows:
        d = at - com
        total += own + m * (d @ d * np.eye(3) - np.outer(d, d))
    x, y, z = total
    moments = (x[0], y[1], z[2], x[1], x[2], y[2])
    return float(mass), tuple(map(float, com)), tuple(map(float, moments))


def _limits(joint: Any, widest: float) -> tuple[float, float, float, float]:
    """Return lower, upper, velocity and effort of a joint."""
    tag = joint.find("limit").attrib
    lower, upper = (float(tag.get(name, np.inf * sign)) for name, sign in (("lower", -1), ("upper", 1)))
    if joint.get("type") == "continuous" or upper - lower > 2 * widest:
        lower, upper = max(lower, -widest), min(upper, widest)
    return lower, upper, float(tag["velocity"]), float(tag["effort"])


def _axis(joint: Any) -> Array:
    tag = joint.find("axis")
    return _numbers("1 0 0" if tag is None else tag.get("xyz"))


def _onto(axis: Array) -> Array:
    """Return a rotation (3, 3) that takes +z onto the axis."""
    axis = axis / np.linalg.norm(axis)
    if axis[2] > 1 - LESS:
        return np.eye(3)
    if axis[2] < LESS - 1:
        return np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(np.arccos(axis[2]) * np.cross([0, 0, 1], axis) / np.hypot(*axis[:2])).as_matrix()


def _origin(tag: Any) -> Array:
    """Return the pose (4, 4) that a tag's <origin> tells."""
    origin = tag.find("origin")
    if origin is None:
        return np.eye(4)
    turn = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0"))).as_matrix()
    return transform(turn, _numbers(origin.get("xyz", "0 0 0")))


def _numbers(text: str) -> Array:
    return np.array(text.split(), dtype=float)


MOST = 3  # capsules a link
GAIN = 0.8  # share of the volume before, below which one more capsule is worth it
SHORTEST = 0.002  # m, axis of a capsule
ROUNDS = 80  # of moving a circle's centre towards the farthest point: it is then within some percent of the smallest
POSTURES = 256  # looked at for links that touch
OFTEN = 0.3  # share of the postures in which links one apart touch, from which on that says nothing


def capsules_around(points: Array) -> tuple[Capsule, ...]:
    """Return one to `MOST` capsules that together hold all points (P, 3) [m], all in the same frame."""
    best = (_capsule(points),)
    for count in range(2, MOST + 1):
        which = kmeans2(points, count, minit="++", rng=np.random.default_rng(0))[1]
        parts = [points[which == k] for k in range(count)]
        if min(map(len, parts)) < 4:
            break
        tried = tuple(map(_capsule, parts))
        if _volume(tried) < GAIN * _volume(best):
            best = tried
    return best


def neighbours(arm: ArmModel, margin: float) -> tuple[tuple[str, str], ...]:
    """Return the pairs of parts that are not to be checked: joined ones, and those whose shapes say nothing.

    The latter touch where the arm is ready or waits, or, links one apart, in more than `OFTEN` of all postures.

    Args:
        arm: its own `neighbours` are not looked at.
        margin: that planning adds around links [m].
    """
    names = [BASE, *(link.name for link in arm.links), GRIPPER, CAMERA]
    tool = len(names) - 2
    joined = {*zip(names[:tool], names[1:tool], strict=False), (GRIPPER, CAMERA)}
    joined |= {(names[i], part) for i in (tool - 2, tool - 1) for part in (GRIPPER, CAMERA)}
    samples = qmc.scale(qmc.Sobol(arm.count, scramble=False).random(POSTURES), arm.lower, arm.upper)
    q = np.concatenate([[arm.ready, arm.waiting], samples])
    balls = _balls(arm, q, margin)
    for i, j in combinations(range(len(names)), 2):
        pair = names[i], names[j]
        if pair not in joined:
            touch = np.array([_touch(a, b) for a, b in zip(balls[i], balls[j], strict=True)])
            if touch[:2].any() or (min(j, tool) - i == 2 and touch.mean() > OFTEN):
                joined.add(pair)
    return tuple(sorted(joined))


def _balls(arm: ArmModel, q: Array, margin: float) -> list[Array]:
    """Return balls (Q, S, 4) of base, links, gripper and camera at joints (Q, J): centre and radius [m]."""
    base = [of_capsule(c) for c in arm.base_capsules] + [of_solid(s) for s in arm.base_solids]
    wider = np.array([0, 0, 0, margin])
    links = [np.concatenate([of_capsule(c) for c in link.capsules]) + wider for link in arm.links]
    gripper, camera = (arm.tool.body, *arm.tool.fingers(arm.tool.stroke)), arm.tool.camera
    tools = [np.concatenate([of_solid(s) for s in solids]) for solids in (gripper, camera)]
    poses = arm.link_poses(q)
    out = [np.tile(np.concatenate(base), (len(q), 1, 1)) if base else np.zeros((len(q), 0, 4))]
    for i, shape in enumerate([*links, *tools]):
        T = poses[:, min(i, arm.count)]
        centres = shape[:, :3] @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
        out.append(np.concatenate([centres, np.broadcast_to(shape[:, 3:], (*centres.shape[:2], 1))], axis=2))
    return out


def _touch(a: Array, b: Array) -> bool:
    gap = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=2) - a[:, None, 3] - b[None, :, 3]
    return bool((gap < 0).any())


def _capsule(points: Array) -> Capsule:
    """Return the smallest capsule of those along the points' and the frame's main axes."""
    points = points[ConvexHull(points).vertices]
    axes = np.concatenate([np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2], np.eye(3)])
    return min((_along(points, axis) for axis in axes), key=lambda capsule: _volume([capsule]))


def _along(points: Array, axis: Array) -> Capsule:
    """Return the capsule around the points whose axis has this direction (3,)."""
    flat = points - np.outer(points @ axis, axis)
    centre = (flat.min(axis=0) + flat.max(axis=0)) / 2
    for k in range(ROUNDS):  # Badoiu and Clarkson 2003
        centre = centre + (flat[np.linalg.norm(flat - centre, axis=1).argmax()] - centre) / (k + 2)
    beside = np.linalg.norm(flat - centre, axis=1)
    radius, along = float(beside.max()), points @ axis
    cap = np.sqrt(np.maximum(radius**2 - beside**2, 0))
    low, high = (along + cap).min(), (along - cap).max()  # the other way round where a ball holds them
    middle, half = (low + high) / 2, max(high - low, SHORTEST) / 2
    low, high = middle - half, middle + half
    start, end = (tuple(float(x) for x in centre - (centre @ axis) * axis + t * axis) for t in (low, high))
    return Capsule(start, end, radius)  # type: ignore[arg-type]


def _volume(capsules: Sequence[Capsule]) -> float:
    lengths = [np.linalg.norm(np.subtract(c.end, c.start)) for c in capsules]
    return float(sum(np.pi * c.radius**2 * (4 / 3 * c.radius + n) for c, n in zip(capsules, lengths, strict=True)))
