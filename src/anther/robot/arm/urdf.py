"""An arm's description from a URDF file: links, limits and masses as they stand there, capsules fitted to its shapes.

What a URDF does not tell is given: accelerations, tool, postures. Links that are fixed to each other become one.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from copy import copy
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.cluster.vq import kmeans2
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from anther.core.errors import bad_input
from anther.core.files import named_file, read_lines, understood
from anther.core.geometry import Array, inverse, transform
from anther.robot.arm.model import ArmModel, Capsule, Link, Tool, complete, rpy
from anther.robot.arm.plausible import check_joint
from anther.robot.arm.sawyer import TOOL

WIDEST = np.pi
"""Joints that turn further than twice this are kept within it to either side, so that none has two turns [rad]."""
ENDLESS = 1e9
"""Limits from here on say that a joint turns on and on, as some exporters write it [rad]."""
LESS = 1e-6  # rad
MESHES = ".stl", ".obj", ".ply", ".off"
"""Formats of meshes whose numbers are metres. Collada's have a unit of their own, which trimesh does not read."""


def from_urdf(
    name: str,
    path: Path,
    *,
    base: str,
    tip: str,
    acceleration: ArrayLike,
    ready: ArrayLike,
    T_tip_flange: ArrayLike | None = None,
    packages: Path | None = None,
    floor: float = 0.0,
    tool: Tool = TOOL,
) -> ArmModel:
    """Return the arm between two links of a URDF file.

    Args:
        name: of the arm.
        path: of the file; of a xacro file, which `xacro` turns into one where it is installed; or of one that only
            defines a xacro macro, whose arguments are left empty.
        base: link whose frame is the world.
        tip: link whose frame is the flange, or nearly so. If it is fixed to the last link that turns, it and all that
            hangs on it have no mass and no shape here: the tool takes their place.
        acceleration: (J,) or one for all [rad/s^2].
        ready: (J,) drawn back from the plant, and near most grasps [rad]. There the arm also waits.
        T_tip_flange: (4, 4) the flange in the tip's frame, None where they are one; the tool approaches along its +z.
        packages: folder in which the folders of `package://` lie; None: meshes lie beside the file.
        floor: height of the floor [m].
        tool: on the flange.

    Raises:
        InputError: no such file, no XML, no chain between the links, a joint that slides, or a link without a shape.
    """
    pin: Any = import_module("pinocchio")  # of the extra `cell`, which arms that are no URDF can be shown without
    tree = _tree_from(_robot(path), base, tip, path)
    model = pin.buildModelFromXML(ElementTree.tostring(tree, encoding="unicode"))
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    end = model.frames[model.getFrameId(tip, pin.FrameType.BODY)]
    chain = model.supports[end.parentJoint].tolist()[1:]
    _check_own(tree, [model.names[j] for j in chain], path)
    slides = [model.names[j] for j in chain if not model.joints[j].shortname().startswith("JointModelR")]
    if slides or not chain:
        raise bad_input("arm", given=f"joints that do not turn: {slides}", allowed="revolute", do="Choose other links.")
    shapes: dict[int, list[Array]] = {j: [] for j in (0, *chain)}
    for link in tree.iter("link"):
        frame = model.frames[model.getFrameId(link.get("name"), pin.FrameType.BODY)]
        if frame.parentJoint in shapes:
            shapes[frame.parentJoint] += _points(link, frame.placement.homogeneous, path, packages)
    turns = [np.eye(4), *(transform(_onto(data.joints[j].S[3:]), np.zeros(3)) for j in chain)]
    bodies = [pin.SE3(inverse(turn)).act(model.inertias[j]) for j, turn in zip(chain, turns[1:], strict=True)]
    links = [_link(model, j, turns[i], turns[i + 1], bodies[i], shapes[j]) for i, j in enumerate(chain)]
    lower, upper, velocity, effort = np.array([_limits(model, j, path) for j in chain]).T
    T_flange = end.placement.homogeneous @ (np.eye(4) if T_tip_flange is None else T_tip_flange)
    rotor_inertia, stiffness = usual_drives(effort)
    arm = ArmModel(
        name=name,
        joints=tuple(model.names[j] for j in chain),
        lower=lower,
        upper=upper,
        velocity=velocity,
        acceleration=np.full(len(lower), acceleration) if np.ndim(acceleration) == 0 else np.asarray(acceleration),
        effort=effort,
        rotor_inertia=rotor_inertia,
        stiffness=stiffness,
        links=tuple(links),
        T_last_flange=inverse(turns[-1]) @ T_flange,
        tool=tool,
        neutral=np.asarray(ready, dtype=float),
        ready=np.asarray(ready, dtype=float),
        waiting=np.asarray(ready, dtype=float),
        neighbours=(),
        shoulder=np.zeros(3),
        reach=np.inf,
        floor=floor,
        base_capsules=fit_capsules(np.concatenate(shapes[0])) if shapes[0] else (),
    )
    return complete(arm)


def usual_drives(effort: Array) -> tuple[Array, Array]:
    """Return a guess of rotor inertias (J,) [kg m^2] and springs (J,) [N m/rad] of joints with an effort (J,) [N m]."""
    return 1 / 150 * effort, 20.0 * effort  # half of Sawyer's, and as Sawyer's


_XACRO = re.compile(r"<xacro:(?!macro\b)\w|\$\{(?!\w+\})|\$\(")
"""What only xacro understands: its tags but a macro's, expressions and substitutions."""


def _robot(path: Path) -> Any:
    """Return the tag that holds the links, without what only xacro or another program knows."""
    text = "\n".join(read_lines(path))
    if _XACRO.search(re.sub(r"<xacro:macro\b.*?</xacro:macro>", "", text, flags=re.DOTALL)):
        text = _of_xacro(path)
    text = re.sub(r"\s(?!xmlns:)[a-z]+:(?=\w+=\")", " ", text)  # prefixes that nothing declares
    try:
        tree = ElementTree.fromstring(re.sub(r"\$\{\w+\}", "", re.sub(r"^<\?xml[^>]*\?>", "", text)))
    except ElementTree.ParseError as error:
        raise bad_input(str(path), given=f"no XML ({error})", allowed="a URDF file", do="Export it again.") from error
    return next((part for part in tree.iter() if part.find("link") is not None), tree)


def _of_xacro(path: Path) -> str:
    """Return the URDF that xacro makes of a file.

    Raises:
        InputError: xacro is not installed, or does not understand the file.
    """
    places = os.pathsep.join([os.environ.get("PATH", ""), str(Path(sys.executable).parent)])
    program, allowed = shutil.which("xacro", path=places), "a URDF file"
    do = f"Run xacro first, where its packages are found: xacro {path.name} > {path.name.split('.')[0]}_plain.urdf"
    if program is None:
        do += ", or install it: pip install 'anther[cell]'"
        raise bad_input(str(path), given="a xacro file, and xacro is not installed", allowed=allowed, do=f"{do}.")
    try:
        ran = subprocess.run([program, str(path)], capture_output=True, text=True, timeout=60.0, check=True)
    except (subprocess.SubprocessError, OSError) as error:
        said = [line for line in (getattr(error, "stderr", None) or str(error)).splitlines() if line.strip()]
        raise bad_input(
            str(path), given=f"what xacro refuses ({said[0][:200]})", allowed=allowed, do=f"{do}."
        ) from error
    return ran.stdout


def _tree_from(robot: Any, base: str, tip: str, path: Path) -> Any:
    """Return all that hangs on the base as a URDF of its own; of a tip that is fixed only where it is."""
    links = {link.get("name"): link for link in robot.findall("link")}
    tree, open_ = ElementTree.Element("robot", name="arm"), [base] if base in links else []
    while open_:
        name = open_.pop()
        bare = ElementTree.SubElement(tree, "link", name=name)
        bare.extend([part for part in links[name] if part.tag == "collision" or _weighs(part)])
        for joint in robot.findall("joint"):
            if joint.find("parent").get("link") == name:
                tree.append(_only_what_moves(joint, path))
                child = joint.find("child").get("link")
                if child == tip and joint.get("type") == "fixed":
                    tree.append(ElementTree.Element("link", name=tip))
                else:
                    open_.append(child)
    if all(link.get("name") != tip for link in tree.iter("link")):
        do = "Name two links of one chain."
        raise bad_input("tip", given=f"{tip!r}", allowed=f"a link that hangs on {base!r}", do=do)
    return tree


def _weighs(tag: Any) -> bool:
    """Return whether a link's tag is an inertial with mass; one that urdfdom would drop with a mere message raises."""
    mass = float(tag.find("mass").get("value")) if tag.tag == "inertial" else 0.0
    if mass < 0:
        raise bad_input("link", given=f"mass {mass:g} kg", allowed=">= 0 kg", do="Correct its <mass value=>.")
    if mass == 0:
        return False
    for pair in ("xx", "xy", "xz", "yy", "yz", "zz"):
        float(tag.find("inertia").attrib[f"i{pair}"])
    origin = tag.find("origin")
    for text in {} if origin is None else origin.attrib.values():
        _numbers(text)
    return True


def _only_what_moves(joint: Any, path: Path) -> Any:
    """Return a joint without what is not read; one that turns on and on keeps limits that it states.

    Soft limits (`safety_controller`) that are narrower take the place of the others.
    """
    name, kind = f"{path}: joint {joint.get('name')}", joint.get("type")
    plain = ElementTree.Element("joint", joint.attrib)
    plain.extend([copy(part) for part in joint if part.tag in ("origin", "parent", "child", "axis", "limit", "mimic")])
    if kind not in ("fixed", "revolute", "continuous", "prismatic", "floating", "planar"):
        given = f"joints that do not turn: {[joint.get('name')]}"
        raise bad_input("arm", given=given, allowed="revolute", do="Choose other links.")
    axis, limit, soft = (joint.find(tag) for tag in ("axis", "limit", "safety_controller"))
    if axis is not None and kind != "fixed" and not np.any(_numbers(axis.get("xyz", "1 0 0"))):
        raise bad_input(name, given="axis 0 0 0", allowed="a direction", do="Correct its <axis xyz=>.")
    origin = joint.find("origin")
    if origin is not None and np.abs(_numbers(origin.get("rpy", "0 0 0"))).max(initial=0) > 2 * np.pi + LESS:
        given, do = f"rpy {origin.get('rpy')}", "Are they degrees? Correct its <origin rpy=>."
        raise bad_input(name, given=given, allowed="angles of at most a turn [rad]", do=do)
    if limit is None and kind == "revolute":
        raise bad_input(name, given="no limit", allowed="<limit lower= upper= velocity= effort=>", do=_LIMIT)
    if kind in ("revolute", "continuous") and limit is not None:
        bounds = {key: _limit(name, key, text) for key, text in limit.attrib.items()}
        bounds = {"lower": -ENDLESS, "upper": ENDLESS} | bounds
        if soft is not None:
            ends = {
                key: _limit(name, f"soft_{key}_limit", soft.get(f"soft_{key}_limit", "0")) for key in ("lower", "upper")
            }
            if ends["lower"] < ends["upper"]:  # else none are stated
                bounds["lower"] = max(bounds["lower"], ends["lower"])
                bounds["upper"] = min(bounds["upper"], ends["upper"])
        plain.set("type", "revolute")
        plain.find("limit").attrib = {key: repr(value) for key, value in bounds.items()}  # type: ignore[union-attr]
    return plain


_LIMIT = "Write <limit lower= upper= velocity= effort=> into the joint, in rad, rad/s and N m."


def _limit(joint: str, key: str, text: str) -> float:
    """Return a number of a joint's limit."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if np.isnan(value) or (key in ("velocity", "effort") and value < 0):
        given, allowed = f"{key} '{text}'", "a number" + (", >= 0" if value < 0 else "")
        raise bad_input(joint, given=given, allowed=allowed, do=_LIMIT)
    return value


def _check_own(tree: Any, chain: Sequence[str], path: Path) -> None:
    """Refuse a joint of the chain that another's motor turns."""
    follows = [part.get("name") for part in tree.iter("joint") if part.find("mimic") is not None]
    for name in set(follows) & set(chain):
        do = "Choose other links, or take its <mimic> out where a motor of its own turns it."
        raise bad_input(f"{path}: joint {name}", given="a joint that mimics another", allowed="a motor each", do=do)


def _link(model: Any, j: int, turn_before: Array, turn: Array, body: Any, shapes: Sequence[Array]) -> Link:
    """Return the link that joint j turns; turns (4, 4) take our frames, of it and of the one before, to the URDF's."""
    name = next(frame.name for frame in model.frames if frame.parentJoint == j and frame.type.name == "BODY")
    if not shapes:
        raise bad_input(f"link {name}", given="no collision shape", allowed="at least one", do="Add one to the URDF.")
    T = inverse(turn_before) @ model.jointPlacements[j].homogeneous @ turn
    points = np.concatenate(shapes) @ turn[:3, :3]
    x, y, z = body.inertia
    moments = (x[0], y[1], z[2], x[1], x[2], y[2])
    parts: Any = [T[:3, 3], rpy(Rotation.from_matrix(T[:3, :3])), body.lever, moments]
    xyz, turned, com, inertia = (tuple(map(float, part)) for part in parts)
    capsules = fit_capsules(points)
    densest = 2e4  # [kg/m^3]: tungsten
    if body.mass > densest * _volume(capsules):
        given, allowed = f"{body.mass:g} kg in {_volume(capsules):.2g} m3", f"<= {densest:g} kg/m3"
        raise bad_input(f"link {name}", given=given, allowed=allowed, do="Masses in a URDF are kilograms.")
    return Link(name, xyz, turned, body.mass, com, inertia, capsules)  # type: ignore[arg-type]


def _points(link: Any, T: Array, path: Path, packages: Path | None) -> list[Array]:
    """Return points (P, 3) on each of a link's collision shapes, T (4, 4) its pose."""
    out = []
    for collision in link.findall("collision"):
        mesh = _mesh(collision.find("geometry")[0], path, packages)
        surface = trimesh.sample.sample_surface(mesh, 3000, seed=0)[0]
        origin = collision.find("origin")
        attributes = {} if origin is None else origin.attrib
        turn = Rotation.from_euler("xyz", _numbers(attributes.get("rpy", "0 0 0"))).as_matrix()
        points = np.concatenate([mesh.vertices, surface]) @ turn.T + _numbers(attributes.get("xyz", "0 0 0"))
        out.append(points @ T[:3, :3].T + T[:3, 3])
    return out


def _mesh(shape: Any, path: Path, packages: Path | None) -> Any:
    match shape.tag:
        case "box":
            return trimesh.creation.box(_numbers(shape.get("size")))
        case "sphere":
            return trimesh.creation.icosphere(subdivisions=3, radius=float(shape.get("radius")))
        case "cylinder":
            return trimesh.creation.cylinder(radius=float(shape.get("radius")), height=float(shape.get("length")))
        case "mesh":
            scale = _numbers(shape.get("scale", "1 1 1"))
            if not (np.isfinite(scale).all() and np.all(scale != 0)):
                given = shape.get("scale")
                raise bad_input(f"{path}: mesh scale", given=given, allowed="three numbers, not 0", do="Correct it.")
            file = _mesh_file(shape.get("filename"), path, packages)
            with understood(file, "a mesh", "Is it whole? Export it again."):
                mesh: Any = trimesh.load_mesh(file, process=False)
                if not np.ptp(mesh.vertices, axis=0).any():
                    raise ValueError("no surface")
            return mesh.apply_scale(scale)
    allowed = "box, sphere, cylinder or mesh"
    raise bad_input(f"{path}: shape", given=f"<{shape.tag}>", allowed=allowed, do="Give the link another collision.")


def _mesh_file(name: str, path: Path, packages: Path | None) -> Path:
    """Return where a mesh lies that a URDF names.

    Raises:
        InputError: it cannot be read, or there is none.
    """
    where, inside = name.removeprefix("file://"), re.sub("^(?:package|model)://", "", name)
    if packages is None and inside != name:
        do = f'Give packages = "...", the folder in which {inside.split("/")[0]} lies.'
        raise bad_input(f"{path}: mesh", given=name, allowed="a path beside the URDF, or with the key packages", do=do)
    file = named_file(packages, inside) if packages and inside != name else named_file(path.parent, where)
    if file.suffix.lower() not in MESHES:
        do = "Export it as STL in metres, and name that."
        raise bad_input(f"{path}: mesh", given=name, allowed=f"{', '.join(MESHES)}", do=do)
    if not file.is_file():
        raise bad_input(f"{path}: mesh", given=name, allowed="a file that exists", do=f"There is none at {file}.")
    return file


def _limits(model: Any, j: int, path: Path) -> tuple[float, float, float, float]:
    """Return lower, upper, velocity and effort of a joint."""
    at, to = model.idx_qs[j], model.idx_vs[j]
    lower, upper = float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at])
    velocity, effort = float(model.velocityLimit[to]), float(model.effortLimit[to])
    bounds = (-WIDEST, WIDEST) if max(-lower, upper) >= ENDLESS else (lower, upper)
    check_joint(f"{path}: joint {model.names[j]}", *bounds, velocity, effort, _LIMIT)
    if upper - lower > 2 * WIDEST:
        lower, upper = max(lower, -WIDEST), min(upper, WIDEST)
    return lower, upper, velocity, effort


def _onto(axis: Array) -> Array:
    """Return a rotation (3, 3) that takes +z onto the axis."""
    axis = axis / np.linalg.norm(axis)
    if axis[2] > 1 - LESS:
        return np.eye(3)
    if axis[2] < LESS - 1:
        return np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(np.arccos(axis[2]) * np.cross([0, 0, 1], axis) / np.hypot(*axis[:2])).as_matrix()


def _numbers(text: str) -> Array:
    return np.array(text.split(), dtype=float)


def fit_capsules(points: Array) -> tuple[Capsule, ...]:
    """Return one to three capsules that together hold all points (P, 3) [m], all in the same frame."""
    best = (_capsule(points),)
    for count in (2, 3):
        which = kmeans2(points, count, minit="++", rng=np.random.default_rng(0))[1]
        parts = [points[which == k] for k in range(count)]
        if min(map(len, parts)) < 4:
            break
        tried = tuple(map(_capsule, parts))
        if _volume(tried) < 0.8 * _volume(best):  # else one more is not worth it
            best = tried
    return best


def _capsule(points: Array) -> Capsule:
    """Return the smallest capsule of those along the points' and the frame's main axes."""
    points = points[ConvexHull(points).vertices]
    axes = np.concatenate([np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2], np.eye(3)])
    return min((_fit_along(points, axis) for axis in axes), key=lambda capsule: _volume([capsule]))


def _fit_along(points: Array, axis: Array) -> Capsule:
    """Return the capsule around the points whose axis has this direction (3,)."""
    flat = points - np.outer(points @ axis, axis)
    centre = (flat.min(axis=0) + flat.max(axis=0)) / 2
    for k in range(80):  # Badoiu and Clarkson 2003: within some percent of the smallest circle
        centre = centre + (flat[np.linalg.norm(flat - centre, axis=1).argmax()] - centre) / (k + 2)
    radii = np.linalg.norm(flat - centre, axis=1)
    radius, along = float(radii.max()), points @ axis
    cap = np.sqrt(np.maximum(radius**2 - radii**2, 0))
    low, high = (along + cap).min(), (along - cap).max()  # the other way round where a ball holds them
    middle, half = (low + high) / 2, max(high - low, 0.002) / 2
    low, high = middle - half, middle + half
    start, end = (tuple(float(x) for x in centre - (centre @ axis) * axis + t * axis) for t in (low, high))
    return Capsule(start, end, radius)  # type: ignore[arg-type]


def _volume(capsules: Sequence[Capsule]) -> float:
    lengths = [np.linalg.norm(np.subtract(c.end, c.start)) for c in capsules]
    return float(sum(np.pi * c.radius**2 * (4 / 3 * c.radius + n) for c, n in zip(capsules, lengths, strict=True)))
