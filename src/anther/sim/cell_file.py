"""The cell of a cell file, simulated: its arm, gripper, cameras, boxes and limits around a simulated plant.

What the file says is taken as it stands; what it lacks is that of the simulated cell (`simulated_cell.layout`), and a
note says so. No driver is imported and no machine is spoken to.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from anther.core.choices import ActuatorName, Crop
from anther.core.errors import bad_input
from anther.core.geometry import Array, Box, Intrinsics, pose7, transform
from anther.core.runs import Advance
from anther.perception.capture import Capture, Keep
from anther.perception.cloud import Cloud
from anther.robot.arm.model import ArmModel
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.views import Params as ViewParams
from anther.robot.arm.views import plan_views
from anther.robot.cell import Cell
from anther.robot.cells import CellFile, Simulation, read_cell
from anther.robot.cells.hardware import motion_params, planner_around
from anther.robot.devices import Tap, no_tap
from anther.robot.safety import guard
from anther.sim import arm_model
from anther.sim import cell as world
from anther.sim.capture import camera_errors
from anther.sim.plant import SOIL_Z, Pot
from anther.sim.render import Scene, d455
from anther.sim.robot import SIDE, robot_of
from anther.sim.simulated_cell import SimulatedCell, grow, in_wind, layout, photograph, usual_distance
from anther.sim.truth import NOMINAL, Truth

LENS = ("width", "height", "fx", "fy", "cx", "cy")


def read_simulated(path: Path | str) -> CellFile:
    """Read a cell file to simulate its cell; tables that it lacks are supposed, see `CellFile.supposed`.

    Raises:
        InputError: the first thing that is wrong, with its line.
    """
    return read_cell(path, suppose)


def suppose(arm: ArmModel, simulation: Simulation, region: Box | None) -> dict[str, Any]:
    """Return the tables of a cell file with which an arm stands as in the simulated cell, around the plant's foot."""
    foot = foot_of(arm, simulation, region)
    distance, lift = float(np.hypot(*foot[:2])), foot[2] - SOIL_Z
    place = layout(distance)
    turn = transform(Rotation.from_euler("z", np.arctan2(foot[1], foot[0])).as_matrix(), [0, 0, lift])
    turned = partial(_corners, turn)
    moved = partial(_corners, transform(np.eye(3), foot - [distance, 0, SOIL_Z]))  # as wide as they are broad
    boxes = {"bench": turned(place.solids[0]), "side camera": turned(place.solids[1]), "pot": moved(place.pot)}
    if not simulation.side_camera:
        del boxes["side camera"]
    out: dict[str, Any] = {
        "arm": {},
        "gripper": {},
        "wrist_camera": {"T_flange_cam": _numbers(pose7(arm.tool.T_flange_cam))},
        "side_camera": {"T_world_cam": _numbers(pose7(turn @ place.T_world_side_camera))},
        "workspace": moved(place.workspace),
        "region": moved(place.region),
        "arm_space": turned(place.arm_space),
        "keep_out": [{"name": name, **box} for name, box in boxes.items()],
        "limits": {},
    }
    if not simulation.side_camera:
        del out["side_camera"]
    return out


def foot_of(arm: ArmModel, simulation: Simulation, region: Box | None) -> Array:
    """Return (3,) where the stem leaves the soil: as said, below the region's middle, or as in the simulated cell."""
    if simulation.foot is not None:
        return np.array(simulation.foot)
    if region is not None:
        return np.append((region.lower[:2] + region.upper[:2]) / 2, region.lower[2])
    return np.array([usual_distance(arm), 0.0, SOIL_Z + arm.shoulder[2] - SAWYER.shoulder[2]])


def simulate(
    file: CellFile,
    species: Crop,
    seed: int,
    viewpoint: float,
    views: ViewParams,
    *,
    truth: Truth = NOMINAL,
    actuator: ActuatorName = "arm",
    tap: Tap = no_tap,
) -> SimulatedCell:
    """Build the simulated cell of a cell file around one plant; see `simulated_cell.build` for the arguments.

    As on metal, the arm moves by the file's limits and plans around its keep-out boxes, which stand there. The views
    are rendered, not driven to: the arm begins where it took the last of them.

    Raises:
        InputError: the file asks for what cannot be simulated.
        StageFailure: "unreachable" when the arm reaches fewer than three views.
    """
    arm, limits = file.model, file.safety_limits()
    plant = grow(species, seed, viewpoint, 0.0, truth)
    plant = plant.moved(foot_of(arm, file.simulation, file.region) - plant.pot.centre)
    scene = Scene.of_plant(plant)
    motion = motion_params(file.limits.speed_ratio)
    seen = plan_views(file.region, file.keep_out, views, T_flange_cam=file.T_flange_cam, motion=motion, arm=arm)
    params = world.Params(grip_force=_force(file), coil_force=arm_model.COIL.force if actuator == "gripper" else 0.0)
    mujoco = world.Cell(plant, seen.joints[-1], params, truth, arm, file.keep_out)
    noise = np.random.default_rng([seed, int(viewpoint), 2])
    robot = robot_of(
        mujoco,
        errors=camera_errors(truth),
        T_world_side_camera=file.T_world_side_camera,
        seed=int(noise.integers(1 << 31)),
        scene=scene,
        wrist_lens=wrist_lens(file),
        side_lens=None if file.side_camera is None else side_lens(file),
        has_imu=file.imu is not None,
    )

    def take_views(advance: Advance, keep: Keep) -> Capture:
        sight, lens = in_wind(plant, scene, seen, truth), wrist_lens(file)
        told: dict[str, Any] = {"progress": advance, "keep": keep, "truth": truth, "arm": arm, "intrinsics": lens}
        return photograph(sight, seen.joints, seed, viewpoint, **told)[0]

    robot = guard(tap(robot, limits, file.T_flange_cam, lambda: mujoco.time), limits)

    def plan_around(cloud: Cloud) -> Planner:
        return planner_around(file, cloud, robot.arm.joints())

    side = Cell(take_views, plan_around, robot, file.workspace, limits)
    return SimulatedCell(plant, mujoco, side, seen, (*notes(file, actuator), _foot_note(file)))


def _foot_note(file: CellFile) -> str:
    foot, why = foot_of(file.model, file.simulation, file.region), "the middle of the region's lower side"
    if file.simulation.foot is not None:
        why = "as [simulation] says"
    elif "region" in file.supposed:
        why = "before the arm"
    bench = f"its pot stands on a bench at z = {foot[2] - Pot.height:.2f} m"
    return f"plant: its stem leaves the soil at {_words(foot)} m, {why}; {bench}"


def wrist_lens(file: CellFile) -> Intrinsics:
    """Return the wrist camera's intrinsics: the file's, its driver's keys, or a D455's."""
    return file.simulation.lens("wrist_intrinsics") or _driver_lens(file.wrist_camera.table) or d455()


def side_lens(file: CellFile) -> Intrinsics:
    """Return the side camera's intrinsics: the file's, its driver's keys, or the simulated cell's."""
    table = {} if file.side_camera is None else file.side_camera.table
    return file.simulation.lens("side_intrinsics") or _driver_lens(table) or SIDE


def _driver_lens(table: dict[str, Any]) -> Intrinsics | None:
    """Return intrinsics that a driver's keys tell, of a size alone a D455's; None where they do not."""
    if all(key in table for key in LENS):
        return Intrinsics(int(table["width"]), int(table["height"]), *(float(table[key]) for key in LENS[2:]))
    return d455(int(table["width"]), int(table["height"])) if "width" in table and "height" in table else None


def _force(file: CellFile) -> float:
    """Return what the gripper closes with [N]: the file's force, or that of the simulated gripper.

    Raises:
        InputError: no force of a gripper.
    """
    force = file.gripper.table.get("force")
    force = arm_model.GRIP_FORCE if force is None else force
    if not isinstance(force, int | float) or not 0 < force <= file.safety_limits().grip_force:
        allowed = f"0 < force <= {file.safety_limits().grip_force:g} N, the grip_force of [limits]"
        raise bad_input(file.source.where(("gripper", "force")), given=force, allowed=allowed, do="Set it lower.")
    return float(force)


def notes(file: CellFile, actuator: ActuatorName = "arm") -> Iterator[str]:
    """Give a line for each thing that the file lacks and that is simulated all the same."""
    yield "no machine is contacted: arm, gripper and cameras are simulated"
    yield from _machine_notes(file)
    yield from _camera_notes(file)
    for name in ("workspace", "region", "arm_space"):
        if name in file.supposed:
            box: Box = getattr(file, name)
            yield f"{name}: none in the file; {_words(box.lower)} .. {_words(box.upper)} m is supposed"
    if "keep_out" in file.supposed:
        names = ", ".join(table["name"] for table in file.source.table["keep_out"])
        yield f"keep_out: none in the file; boxes are supposed: {names}"
    if "limits" in file.supposed:
        yield f"limits: none in the file; the usual ones, with speed_ratio {file.limits.speed_ratio:g}"
    if actuator == "gripper" and file.shaker is None:
        yield "shaker: none in the file; the voice coil of docs/gripper_motor.md is supposed"


def _machine_notes(file: CellFile) -> Iterator[str]:
    tool, force = file.model.tool, _force(file)
    if "model" not in file.source.table["arm"]:
        yield f"arm: no model in the file; a {file.model.name} is supposed"
    if "shape" not in file.source.table["gripper"]:
        size = f"opens {1e3 * tool.stroke:.0f} mm, tips {1e3 * tool.tip:.0f} mm from the flange"
        yield f"gripper: no shape in the file; Rethink's with narrow fingers is supposed ({size})"
    if file.gripper.table.get("force") is None:
        yield f"gripper: no force in the file; it closes with {force:g} N"


def _camera_notes(file: CellFile) -> Iterator[str]:
    told, supposed, side = file.simulation, set(file.supposed), file.side_camera
    if {"wrist_camera", "wrist_camera.T_flange_cam"} & supposed:
        yield f"wrist camera: no pose in the file; it sits at {_words(file.T_flange_cam[:3, 3])} m from the flange"
    if told.wrist_intrinsics is None and not set(LENS) <= set(file.wrist_camera.table):
        yield f"wrist camera: no intrinsics in the file; {_lens_words(wrist_lens(file))}, as a D455"
    if side is None or file.T_world_side_camera is None:
        yield "side camera: none in the file; none is simulated, so the shake is not raised by what is seen"
        return
    if {"side_camera", "side_camera.T_world_cam"} & supposed:
        where = _words(file.T_world_side_camera[:3, 3])
        without = "side_camera = false under [simulation] leaves it out"
        yield f"side camera: no pose in the file; it stands beside the plant at {where} m; {without}"
    if told.side_intrinsics is None and not set(LENS) <= set(side.table):
        yield f"side camera: no intrinsics in the file; {_lens_words(side_lens(file))}"


def _lens_words(lens: Intrinsics) -> str:
    return f"{lens.width} x {lens.height} px with f = {lens.fx:.0f} px are supposed"


def _words(place: Array) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in place) + ")"


def _numbers(values: Array) -> list[float]:
    return [float(x) for x in np.round(values, 9)]


def _corners(T: Array, box: Box) -> dict[str, list[float]]:
    """Return the corners of the box, along the axes, around a box at pose T (4, 4)."""
    middle, half = (box.lower + box.upper) / 2, (box.upper - box.lower) / 2
    middle, half = T[:3, :3] @ middle + T[:3, 3], np.abs(T[:3, :3]) @ half
    return {"lower": _numbers(middle - half), "upper": _numbers(middle + half)}
