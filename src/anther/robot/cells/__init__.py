"""A cell file: which machines stand where, and what they may do. docs/cell_file.md has every key.

One owner for a cell: two processes of this machine cannot command one arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array, Box, Intrinsics, transform_from_pose7
from anther.core.records import Range, Record
from anther.robot.arm.arms import find_arm
from anther.robot.arm.grippers import PRESETS, GripperSize, with_camera
from anther.robot.arm.model import ArmModel, outline
from anther.robot.arm.plausible import FARTHEST
from anther.robot.arm.sawyer import SAWYER
from anther.robot.calibration import HandEye
from anther.robot.cells import _parts
from anther.robot.cells._cart import CartSection
from anther.robot.cells._lock import own_arm
from anther.robot.cells._reading import Keys, Point, Pose, TomlFile, box, build, convert, fit_arguments, read_toml
from anther.robot.devices import CartLimits, JointTrajectory, SafetyLimits
from anther.robot.drivers.apart import ArmApart
from anther.robot.safety import check_trajectory

__all__ = ["CellFile", "Limits", "Part", "Simulation", "ToolSection", "own_arm", "own_cell", "read_cell"]

REQUIRED = "arm", "gripper", "wrist_camera", "workspace", "region", "arm_space"
KNOWN = (*REQUIRED, "side_camera", "shaker", "tool", "keep_out", "limits", "simulation", "cart", "imu")
Lens = tuple[float, float, float, float, float, float]
Suppose = Callable[[ArmModel, "Simulation", Box | None], Mapping[str, Any]]
"""Returns the tables that a simulated cell has where its file has none; of (arm, simulation, region or None)."""


@dataclass(frozen=True, slots=True)
class ToolSection:
    """What was measured on the flange: a check of the gripper that plans are made for. None: not measured.

    Attributes:
        tip: from the flange to the fingertips [m].
        mass: of gripper, camera and bracket [kg].
    """

    tip: float | None = None
    mass: float | None = None


@dataclass(frozen=True, slots=True)
class Simulation(Record):
    """What a simulation of the cell wants to know beyond the machines; on metal it says nothing.

    Attributes:
        foot: where the stem leaves the soil, the middle of the pot [m]; None: the middle of the region's lower side.
        wrist_intrinsics, side_intrinsics: width, height, fx, fy, cx, cy [px]; None: the driver's keys, else a D455's.
        side_camera: whether a cell file without a side camera is simulated with one.
    """

    foot: Annotated[Point | None, Range(-FARTHEST, FARTHEST, "m")] = None
    wrist_intrinsics: Lens | None = None
    side_intrinsics: Lens | None = None
    side_camera: bool = True

    def _check(self) -> None:
        self.lens("wrist_intrinsics")
        self.lens("side_intrinsics")

    def lens(self, name: Literal["wrist_intrinsics", "side_intrinsics"]) -> Intrinsics | None:
        """Return what is said of a camera.

        Raises:
            InputError: no camera is like that.
        """
        numbers = getattr(self, name)
        return None if numbers is None else Intrinsics(int(numbers[0]), int(numbers[1]), *numbers[2:])


@dataclass(frozen=True, slots=True)
class Limits(Record):
    """What no command may exceed: see `devices.SafetyLimits`, whose defaults hold where nothing is said.

    Attributes:
        speed_ratio: of all speeds and accelerations of arm and flange; a shake is so much smaller too. Begin low.
    """

    speed_ratio: Annotated[float, Range(0.01, 1.0)] = 0.1
    flange_speed: float | None = None
    contact_force: float | None = None
    tracking: float | None = None
    joint_margin: float | None = None
    shake_speed: float | None = None
    shake_acceleration: float | None = None
    shake_duration: float | None = None
    grip_force: float | None = None


@dataclass(frozen=True, slots=True)
class Part:
    """One machine: its driver, and what the driver is told.

    Attributes:
        driver: a name that Anther knows, or "package.module:callable" of one's own.
        make: builds it.
        table: the driver's own keys.
        keys: where it stands in the file.
    """

    driver: str
    make: Callable[..., Any]
    table: dict[str, Any]
    keys: Keys


@dataclass(frozen=True, slots=True, eq=False)
class CellFile:
    """A cell file that was read and checked; nothing is connected yet.

    Attributes:
        source: the file.
        arm, gripper, wrist_camera, side_camera, shaker: the machines; the last two may be missing.
        T_flange_cam: hand-eye calibration of the wrist camera.
        T_world_side_camera: where the side camera stands; None without one.
        tool, limits, simulation: see there.
        model: the arm's description, with the gripper and the camera on its flange.
        workspace: where the plant stands.
        region: what the views look at; nothing enters it while they are taken.
        arm_space: where the flange may be.
        keep_out: where no part of arm and tool may be.
        supposed: names of the tables, and of keys in them, that the file lacks; only where it is to be simulated.
        cart, rails: what carries the arm along a row, and where it may go; None: the arm stands on the floor.
        imu: the inertial sensor on the flange; None: there is none.
        T_flange_imu: where it is; None: the wrist camera knows.
    """

    source: TomlFile
    arm: Part
    gripper: Part
    wrist_camera: Part
    T_flange_cam: Array
    workspace: Box
    region: Box
    arm_space: Box
    keep_out: tuple[Box, ...] = ()
    side_camera: Part | None = None
    T_world_side_camera: Array | None = None
    shaker: Part | None = None
    tool: ToolSection = field(default_factory=ToolSection)
    limits: Limits = field(default_factory=Limits)
    model: ArmModel = SAWYER
    simulation: Simulation = field(default_factory=Simulation)
    supposed: tuple[str, ...] = ()
    cart: Part | None = None
    rails: CartSection | None = None
    imu: Part | None = None
    T_flange_imu: Array | None = None

    @property
    def owner_name(self) -> str:
        """What is owned with its arm: its address, so that two drivers cannot have it; its driver where it has none."""
        table = self.arm.table
        place = table.get("master") or table.get("host")
        return str(place or f"{self.arm.driver} {str(table.get('controller', '')).strip('/')}".strip())

    def connect(self, part: Part, **given: Any) -> Any:
        """Return a part's driver, connected; nothing moves.

        Args:
            part: of this cell.
            given: what the driver may want of the rest, such as the `arm`; it takes what it has arguments for.

        Raises:
            InputError: one of its keys is not possible.
            MissingExtra, DeviceError: it cannot be had.
        """
        return build(self.source, part.keys, part.table, part.make, **self._arguments(part, given))

    def arm_apart(self) -> ArmApart:
        """Return the arm, connected in a process of its own, behind a guard of its own.

        Raises:
            AntherError: see `connect`.
        """
        given = self._arguments(self.arm, {})
        options = fit_arguments(self.source, self.arm.keys, self.arm.table, self.arm.make, given) | given
        return ArmApart(self.arm.make, options, self.safety_limits())

    def _arguments(self, part: Part, given: dict[str, Any]) -> dict[str, Any]:
        rest = {
            "speed_ratio": self.limits.speed_ratio,
            "arm_master": self.arm.table.get("master", ""),
            "arm_model": self.model,
            "cart_limits": self.cart_limits(),
            **given,
        }
        return {name: value for name, value in rest.items() if _parts.takes(part.make, name)}

    def safety_limits(self) -> SafetyLimits:
        """Return what no command may exceed.

        Raises:
            InputError: a limit is out of the range it may be set to.
        """
        ratio = self.limits.speed_ratio
        values: dict[str, Any] = {name: value for name, value in asdict(self.limits).items() if value is not None}
        del values["speed_ratio"]
        values.setdefault("flange_speed", ratio * SafetyLimits.__dataclass_fields__["flange_speed"].default)
        with self.source.locate_errors(("limits",)):
            return SafetyLimits(
                forward=self.model.forward,
                outline=partial(outline, self.model),
                joint_lower=self.model.lower,
                joint_upper=self.model.upper,
                joint_speed=ratio * self.model.velocity,
                joint_acceleration=ratio * self.model.acceleration,
                workspace=self.arm_space,
                keep_out=self.keep_out,
                **values,
            )

    def cart_limits(self) -> CartLimits | None:
        """Return what no command to the cart may exceed; None without one."""
        return None if self.rails is None else self.rails.limits(self.model)


def read_cell(path: Path | str, suppose: Suppose | None = None) -> CellFile:
    """Read and check a cell file.

    Args:
        path: of the file.
        suppose: for a simulation: gives the tables that the file lacks. No driver is then looked for, none can be
            connected to, and the keys of drivers of one's own are not checked.

    Raises:
        InputError: the first thing that is wrong, with its line.
    """
    source = read_toml(path)
    for key in source.table:
        if key not in KNOWN:
            raise source.error((key,), given=f"an unknown key '{key}'", allowed=", ".join(KNOWN), do="Remove it.")
    simulation = build(source, ("simulation",), source.table.get("simulation", {}), Simulation)
    source, supposed = (source, ()) if suppose is None else _suppose(source, suppose, simulation)
    table = source.table
    for key in REQUIRED:
        if key not in table:
            do = "docs/cell_file.md has one."
            raise bad_input(str(path), given=f"no [{key}]", allowed="a table of that name", do=do)
    side, imu, of = table.get("side_camera"), table.get("imu"), partial(_part, source, connects=suppose is None)
    cell = CellFile(
        source=source,
        arm=of("arm", _parts.ARMS, besides=("model",)),
        gripper=of("gripper", _parts.GRIPPERS, besides=("shape",)),
        T_flange_cam=_hand_eye(source, table["wrist_camera"]),
        wrist_camera=of("wrist_camera", _parts.CAMERAS, besides=("T_flange_cam", "calibration", "outline")),
        T_world_side_camera=None if side is None else _pose(source, "side_camera", "T_world_cam", side),
        side_camera=None if side is None else of("side_camera", _parts.CAMERAS, besides=("T_world_cam",)),
        shaker=of("shaker", _parts.SHAKERS) if "shaker" in table else None,
        imu=None if imu is None else of("imu", _parts.IMUS, besides=("T_flange_imu",)),
        T_flange_imu=_pose(source, "imu", "T_flange_imu", imu) if imu and "T_flange_imu" in imu else None,
        tool=build(source, ("tool",), table.get("tool", {}), ToolSection),
        limits=build(source, ("limits",), table.get("limits", {}), Limits),
        **{name: convert(source, (name,), table[name], Box) for name in ("workspace", "region", "arm_space")},
        keep_out=_keep_outs(source),
        simulation=simulation,
        supposed=supposed,
    )
    cell = replace(cell, model=_equip(source, _model(source), cell.T_flange_cam))
    if "cart" in table:
        cell = _on_cart(cell, connects=suppose is None)
    _check_tool(cell)
    _check_places(cell)
    return cell


def _on_cart(cell: CellFile, *, connects: bool) -> CellFile:
    """Return the cell with its cart; the row on the other side of the path is kept clear of."""
    source, own = cell.source, tuple(part.name for part in fields(CartSection))
    part = _part(source, "cart", _parts.CARTS, besides=own, connects=connects)
    said = {key: value for key, value in source.table["cart"].items() if key in own}
    rails = build(source, ("cart",), said, CartSection)
    with source.locate_errors(("cart",)):
        stowed = rails.limits(cell.model).stowed
    other = rails.other_side(cell.workspace)
    for name, joints in (("ready", cell.model.ready), ("stowed", stowed)):
        try:
            still = JointTrajectory.standstill(joints, 1.0)
            check_trajectory(still, joints, replace(cell.safety_limits(), keep_out=(other,)))
        except StageFailure as failure:
            given = f"{rails.corridor:g} m, in which the arm may not be where it is {name} ({failure})"
            raise source.error(("cart", "corridor"), given=given, allowed="a wider path", do="Fold it.") from failure
    return replace(cell, cart=part, rails=rails, keep_out=(*cell.keep_out, other))


def _suppose(source: TomlFile, suppose: Suppose, simulation: Simulation) -> tuple[TomlFile, tuple[str, ...]]:
    """Return the file with what it lacks, and the names of that."""
    said = source.table
    region = convert(source, ("region",), said["region"], Box) if "region" in said else None
    usual = suppose(_model(source), simulation, region)
    table, lacks = dict(usual) | said, [name for name in usual if name not in said]
    for name, keys in (("wrist_camera", ("T_flange_cam", "calibration")), ("side_camera", ("T_world_cam",))):
        own = said.get(name)
        if isinstance(own, dict) and name in usual and not any(key in own for key in keys):
            table[name] = {**usual[name], **own}
            lacks.append(f"{name}.{keys[0]}")
    return replace(source, table=table), tuple(lacks)


def _equip(source: TomlFile, model: ArmModel, T_flange_cam: Array) -> ArmModel:
    """Return the arm with the gripper that the file describes, and its camera where it was calibrated."""
    shape, keys, tool = source.table["gripper"].get("shape"), ("gripper", "shape"), model.tool
    if shape is not None:
        rest = dict(shape) if isinstance(shape, dict) else {"preset": shape}
        name, given = rest.pop("preset", None), dict[str, Any]()
        if name is not None:
            if name not in PRESETS:
                allowed = f"{', '.join(PRESETS)}, or a table [gripper.shape] of its measures"
                raise source.error(keys, given=repr(name), allowed=allowed, do="Choose one, or measure yours.")
            given = asdict(PRESETS[name])
            given["palm"] = list(given["palm"])
        tool = build(source, keys, given | rest, GripperSize).on(tool)
    outline, keys = source.table["wrist_camera"].get("outline"), ("wrist_camera", "outline")
    if outline is not None:
        outline = convert(source, keys, outline, Point)
        with source.locate_errors(keys):
            for side in outline:
                check_range("side", side, 0.005, 0.3, "m")
    return model.with_tool(with_camera(tool, T_flange_cam, outline))


def _check_tool(cell: CellFile) -> None:
    """Check that what was measured on the flange is what plans are made for.

    Raises:
        InputError: it is not; describe it under [gripper.shape].
    """
    measured, tool = cell.tool, cell.model.tool
    mass = tool.mass + tool.camera_mass
    with cell.source.locate_errors(("tool",)):
        if measured.tip is not None:
            check_range("tip", measured.tip, tool.tip - 0.005, tool.tip + 0.005, "m")
        if measured.mass is not None:
            check_range("mass", measured.mass, 0.0, mass + 0.1, "kg")


def _check_places(cell: CellFile) -> None:
    """Check that cameras and boxes lie where those of an arm can lie, and that the arm may be where it is ready.

    Raises:
        InputError: one does not, as of a file in millimetres.
    """
    source, arm, limits = cell.source, cell.model, cell.safety_limits()
    keep_out: dict[Keys, Box] = {("keep_out", str(i)): place for i, place in enumerate(cell.keep_out)}
    places: dict[Keys, Box] = {("workspace",): cell.workspace, ("region",): cell.region, ("arm_space",): cell.arm_space}
    for keys, place in (places | keep_out).items():
        with source.locate_errors(keys):
            check_range("farthest coordinate", float(np.abs([place.lower, place.upper]).max()), 0, FARTHEST, "m")
    with source.locate_errors(("wrist_camera",)):
        _check_distance("the flange", cell.T_flange_cam, arm.reach)
    if cell.T_world_side_camera is not None:
        with source.locate_errors(("side_camera", "T_world_cam")):
            _check_distance("the base", cell.T_world_side_camera, FARTHEST)
    still = JointTrajectory.standstill(arm.ready, 1.0)
    boxes: dict[Keys, tuple[Box, ...]] = {("arm_space",): ()} | {keys: (place,) for keys, place in keep_out.items()}
    for keys, some in boxes.items():
        try:
            check_trajectory(still, arm.ready, replace(limits, keep_out=some))
        except StageFailure as failure:
            given = f"a box with which the arm may not be where it is ready ({failure})"
            raise source.error(keys, given=given, allowed="any other, in metres", do="Move it.") from failure
    _check_plant(cell, keep_out)


def _check_distance(what: str, T: Array, most: float) -> None:
    check_range(f"distance of the camera from {what}", float(np.linalg.norm(T[:3, 3])), 0, most, "m")


def _check_plant(cell: CellFile, keep_out: dict[Keys, Box]) -> None:
    """Check that the arm can get to where the plant stands, and may."""
    source, plant, shoulder, tip = cell.source, cell.workspace, cell.model.shoulder, cell.model.tool.tip
    gap = float(np.linalg.norm(np.clip(shoulder, plant.lower, plant.upper) - shoulder))
    with source.locate_errors(("workspace",)):
        check_range("distance from the arm's shoulder", gap, 0, cell.model.reach + tip, "m")
    for name, place, room in (("arm_space", cell.arm_space, tip), ("region", cell.region, 0.0)):
        if np.any((place.lower - room > plant.upper) | (place.upper + room < plant.lower)):
            allowed = f"a box that meets the workspace {plant.lower} .. {plant.upper} m"
            raise source.error((name,), given=_corners(place), allowed=allowed, do="Check signs and units.")
    for keys, place in keep_out.items():
        if place.contains(np.stack([plant.lower, plant.upper])).all():
            allowed = "a box that leaves some of the workspace free"
            raise source.error(keys, given=_corners(place), allowed=allowed, do="Make it smaller.")


def _corners(place: Box) -> str:
    return f"{place.lower} .. {place.upper} m"


def _part(
    source: TomlFile,
    name: str,
    drivers: dict[str, Callable[..., Any]],
    besides: tuple[str, ...] = (),
    *,
    connects: bool = True,
) -> Part:
    table = source.table[name]
    if not isinstance(table, dict) or not isinstance(table.get("driver", None if connects else ""), str):
        choices = ", ".join(f'"{driver}"' for driver in drivers)
        allowed = f'a table with driver = {choices} or "package.module:callable"'
        raise source.error((name,), given="no driver", allowed=allowed, do="docs/cell_file.md has examples.")
    driver, keys = table.get("driver", ""), (name, "driver")
    rest = {key: value for key, value in table.items() if key not in ("driver", *besides)}
    make = drivers.get(driver)
    if make is None and not connects and (not driver or ":" in driver):
        return Part(driver, _parts.none, rest, (name,))
    if make is None:
        if ":" not in driver:
            allowed = ", ".join(f'"{known}"' for known in drivers) + ', "package.module:callable"'
            raise source.error(keys, given=f'"{driver}"', allowed=allowed, do="Choose one.")
        make = _parts.own_driver(driver, source.where(keys), source.path.parent)
    fit_arguments(source, (name,), rest, make, _parts.GIVEN)
    if not connects:
        return Part(driver, _parts.none, _parts.usual(make) | rest, (name,))
    return Part(driver, make, rest, (name,))


def _model(source: TomlFile) -> ArmModel:
    model, keys = source.table["arm"].get("model", "sawyer"), ("arm", "model")
    if isinstance(model, dict):
        return build(source, keys, model, _parts.arm_of_urdf)
    with source.locate_errors(keys):
        return find_arm(str(model))


def _hand_eye(source: TomlFile, table: dict[str, Any]) -> Array:
    """Return T_flange_cam, from the file or from a calibration.json."""
    if ("calibration" in table) == ("T_flange_cam" in table):
        given = "both calibration and T_flange_cam" if "calibration" in table else "no calibration and no T_flange_cam"
        do = "anther calibrate writes a calibration.json."
        raise source.error(("wrist_camera",), given=given, allowed="one of the two", do=do)
    if "T_flange_cam" in table:
        return _pose(source, "wrist_camera", "T_flange_cam", table)
    return HandEye.load(convert(source, ("wrist_camera", "calibration"), table["calibration"], Path)).T_flange_cam


def _pose(source: TomlFile, name: str, key: str, table: dict[str, Any]) -> Array:
    if key not in table:
        raise source.error((name,), given=f"no '{key}'", allowed="7 numbers: x y z [m] qx qy qz qw", do="Add it.")
    numbers = convert(source, (name, key), table[key], Pose)
    with source.locate_errors((name, key)):
        return transform_from_pose7(np.array(numbers))


def _keep_out(lower: Point, upper: Point, name: str = "") -> Box:
    del name  # for who reads the file
    return box(lower, upper)


def _keep_outs(source: TomlFile) -> tuple[Box, ...]:
    tables = source.table.get("keep_out", [])
    if not isinstance(tables, list):
        do = "Write [[keep_out]] above each."
        raise source.error(("keep_out",), given="one table", allowed="a list of tables", do=do)
    return tuple(build(source, ("keep_out", str(i)), table, _keep_out) for i, table in enumerate(tables))


@contextmanager
def own_cell(file: CellFile) -> Iterator[Callable[[Any], Any]]:
    """Own the cell's arm for the block; yield what is told each machine, and closes it at the end."""
    with ExitStack() as stack:
        stack.enter_context(own_arm(file.owner_name))

        def keep(machine: Any) -> Any:
            stack.callback(getattr(machine, "close", lambda: None))
            return machine

        yield keep
