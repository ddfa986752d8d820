"""The whole way through the house: views -> masks -> cloud -> skeleton -> stem -> grasp -> shake -> response."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from anther.core.choices import ActuatorName, Crop, MaskSource
from anther.core.errors import FailureKind, InputError, StageFailure, bad_input
from anther.core.geometry import Array, Box
from anther.core.runs import Advance, Run
from anther.perception import cloud, flowers, masks, skeleton, stem
from anther.perception.capture import Capture, CaptureWriter, View
from anther.perception.cloud import Cloud, likely_cause
from anther.perception.flowers import Flowers
from anther.perception.hanging import HangingStem, find_hanging_stem
from anther.perception.incoming import FirstLook, IncomingViews
from anther.perception.masks import Masks, by_words, without_ground
from anther.perception.skeleton import Plants, Skeleton
from anther.perception.stem import Stem
from anther.perception.supports import find_supports, notes_beside
from anther.plant import model as plant
from anther.plant.belief import EarlierShake
from anther.plant.model import Material, PlantModel
from anther.pollination import escalation, execution, grasp, shake
from anther.pollination.escalation import SHORTEST, Escalation, JointBelief, foresee, watch_points
from anther.pollination.execution import Arrive, Trial, early_reach
from anther.pollination.grasp import Grasp
from anther.pollination.learning import NOT_MEASURED, ObservedShake, measure_grip, refine
from anther.pollination.response import Response, measure_response, stem_near
from anther.pollination.response.thresholds import FEWEST_FRAMES
from anther.pollination.shake import Pads, ShakePlan
from anther.robot.cell import Cell, GripMotion, MotionPlanner
from anther.robot.devices import Camera, DeviceError, Frame
from anther.robot.safety import shake_amplitude

TRY_THE_NEXT: tuple[FailureKind, ...] = (
    "nothing_grasped", "branch_or_leaf_grasped", "unreachable", "collision", "limits_exceeded",
)  # fmt: skip
"""How one grasp can fail so that another may still succeed, if nothing was shaken yet."""


@dataclass(frozen=True)
class Params:
    """Every stage's parameters; each stage documents its own."""

    masks: masks.Params = field(default_factory=masks.Params)
    by_words: by_words.Params = field(default_factory=by_words.Params)
    cloud: cloud.Params = field(default_factory=cloud.Params)
    skeleton: skeleton.Params = field(default_factory=skeleton.Params)
    stem: stem.Params = field(default_factory=stem.Params)
    grasp: grasp.Params = field(default_factory=grasp.Params)
    plant: plant.Params = field(default_factory=plant.Params)
    shake: shake.Params = field(default_factory=shake.Params)
    escalation: escalation.Params = field(default_factory=escalation.Params)
    actuator: ActuatorName = "arm"
    """What shakes the closed pads: the arm, or a motor in the gripper, which is always watched."""
    escalate: bool = True
    """Whether the shake is raised by what the side camera sees, or done as planned."""
    crop: Crop | None = None
    """Which it is, where that is known: it tells flowers from clips."""


FindMasks = Callable[[Capture, Box | None, Advance], Masks]
"""Another way to masks than `masks.segment`: (capture, workspace, progress) -> Masks."""


def mask_finder(source: MaskSource, models: Path, params: Params, cache: Path | None) -> FindMasks | None:
    """Return what finds the masks by networks, whose weights are in `models` and whose masks are kept in `cache`.

    None for colour and geometry, which is the pipeline's own way.

    Raises:
        MissingExtra: torch or transformers is not installed.
        InputError: weights are missing. Both are said before any other work is done.
    """
    if source == "colour":
        return None
    by_words.find_models(models, source)

    def find(capture: Capture, workspace: Box | None, progress: Advance) -> Masks:
        seen = by_words.segment(capture, models, params.by_words, method=source, cache=cache, progress=progress)
        return without_ground(seen, capture, workspace, params.masks)

    return find


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What perception made of the views."""

    masks: Masks
    cloud: Cloud
    skeleton: Skeleton
    stem: Stem
    flowers: Flowers

    @property
    def plants(self) -> Plants:
        """The plants in view, of which the asked one is that of the skeleton."""
        return skeleton.find_plants(self.cloud.points, self.skeleton.nodes[0])

    def moved(self, T: Array) -> Seen:
        """Return all of it moved by T (4, 4)."""
        return Seen(self.masks, self.cloud.moved(T), self.skeleton.moved(T), self.stem, self.flowers.moved(T))


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """What a trial did: the shake, its execution, how the flowers answered, and what that taught of the material.

    Attributes:
        material: what is believed of the plant afterwards.
        believed: what the shake was planned with; None if unknown.
        pads: what is believed of the gripper's pads afterwards; None if unknown.
        alone: why the plan alone was to be carried out; None where the shake was to be raised.
        planned: the shake before it was raised or lowered; None if unknown.
    """

    shake: ShakePlan
    trial: Trial
    response: Response | None
    material: Material
    believed: Material | None = None
    pads: Pads | None = None
    alone: str | None = None
    planned: ShakePlan | None = None


def perceive(
    capture: Capture,
    workspace: Box | None,
    run: Run,
    params: Params,
    find_masks: FindMasks | None = None,
    look: FirstLook | None = None,
) -> Seen:
    """Turn views into a labelled cloud, a rooted skeleton, its main stem and its flowers.

    The workspace is where the plant may stand, world [m]; None: about where the cameras look. `look` is what was found
    there of each view as it came.

    Raises:
        StageFailure: no plant or no stem was found.
    """
    look = look or FirstLook()
    find_masks = find_masks or (lambda views, box, _: masks.segment(views, box, params.masks, look.observations))
    string = None if params.plant.string is None else params.plant.string.line
    with cause_named(capture):
        labels = run.stage("masks", Masks.load, lambda advance: find_masks(capture, workspace, advance))
        fused = run.stage(
            "cloud",
            Cloud.load,
            lambda advance: find_supports(
                cloud.fuse(capture, labels, workspace, params.cloud, advance, look.surfaces), string
            ),
        )
        middle = None if workspace is None else (workspace.lower + workspace.upper) / 2
        hung, named = _hung(fused, params)
        tree = run.stage("skeleton", Skeleton.load, lambda _: _tree(fused, hung, named, middle))
        if params.stem.tip is None:
            named = _topped(tree, named)
        centres = flowers.flower_centres(fused)
        main = run.stage("stem", Stem.load, lambda _: _main_stem(fused, tree, centres, named))
    found = run.stage(
        "flowers",
        Flowers.load,
        lambda _: flowers.find_flowers(fused, tree, main, centres=centres, string=string, crop=params.crop),
    )
    return Seen(labels, fused, tree, main, found)


def _hung(fused: Cloud, params: Params) -> tuple[HangingStem | None, Params]:
    """Return the stem on a string, and the parameters with which it becomes a skeleton, if its hook is known.

    Raises:
        StageFailure: no stem hangs there.
    """
    if params.plant.string is None or params.skeleton.root is not None or params.skeleton.plant is not None:
        return None, params
    hung = find_hanging_stem(fused, params.plant.string.line)
    root, tip = (tuple(hung.axis[end].tolist()) for end in (0, -1))
    own = params.stem if params.stem.tip is not None else replace(params.stem, tip=tip)
    return hung, replace(params, skeleton=replace(params.skeleton, root=root), stem=own)


def _tree(fused: Cloud, hung: HangingStem | None, params: Params, middle: Array | None) -> Skeleton:
    """Return the skeleton, of a stem on a string with the pieces that are hidden."""
    if hung is None:
        return skeleton.skeletonize(fused, params.skeleton, middle)
    tree = skeleton.skeletonize(hung.completed(fused), params.skeleton, middle)
    if hung.is_followed(tree.nodes, tree.parent):
        return tree
    return skeleton.skeletonize(hung.completed(fused, whole=True), params.skeleton, middle)


def _topped(tree: Skeleton, params: Params) -> Params:
    """Return the parameters with the hanging stem's tip on the tree: its top may be seen, and yet be no part of it."""
    string, tip = params.plant.string, params.stem.tip
    if string is None or tip is None:
        return params
    part = 0.03  # m: nearer, the tree has it, as thick as leaves hang about it
    if np.linalg.norm(tree.nodes - tip, axis=1).min() < part:
        return params
    height, bend = tree.nodes[:, 2], 0.05  # m by which a stem leaves the line through its tip, along its string
    beside = tip[:2] - string.line.at(np.array([tip[2]]))
    along = np.linalg.norm(tree.nodes[:, :2] - string.line.at(height) - beside, axis=1) < bend
    top = tree.nodes[along][height[along].argmax()] if along.any() else tree.nodes[0]
    return replace(params, stem=replace(params.stem, tip=tuple(top.tolist())))


def _main_stem(fused: Cloud, tree: Skeleton, flowers_at: Array, params: Params) -> Stem:
    main = stem.find_stem(tree, params.stem, flowers_at=flowers_at)
    if params.plant.string is not None:  # each stem has a string of its own: what joins it beside is another's
        main = replace(main, fork=-1)
    return replace(main, notes=(*main.notes, *notes_beside(fused, tree, main)))


_UNSEEN = ("no_plant_found", "no_stem_found", "no_grasp_found")


@contextmanager
def cause_named(capture: Capture) -> Iterator[None]:
    """Add to a failure to find the plant, its stem or a grasp what is probably wrong with the views."""
    try:
        yield
    except StageFailure as failure:
        cause = likely_cause(capture) if failure.kind in _UNSEEN else ""
        if cause and cause not in str(failure):
            raise StageFailure(failure.kind, f"{failure} {cause}") from failure
        raise
    except InputError as error:
        if cause := likely_cause(capture):
            raise InputError(f"{error} {cause}") from error
        raise


def rank_grasps(seen: Seen, reach: grasp.Reach | None, run: Run, params: Params) -> list[Grasp]:
    """Rank the grasps of the main stem, best first; with `reach`, only those the arm can take.

    Raises:
        StageFailure: there is none.
    """
    return run.stage("grasp", grasp.load_grasps, lambda _: _ranked(seen, reach, params), save=_save_grasps)


def _ranked(seen: Seen, reach: grasp.Reach | None, params: Params, wanted: int = 3) -> list[Grasp]:
    return grasp.plan_grasps(seen.stem, seen.skeleton, seen.cloud, params.grasp, reach=reach, wanted=wanted)


def _save_grasps(ranked: list[Grasp], path: Path) -> None:
    grasp.save_grasps(path, ranked)


def model_plant(seen: Seen, material: Material, params: Params) -> PlantModel:
    """Return the plant as rods with the flowers that were seen, or else with those supposed; a note says so."""
    return plant.plant_with_flowers(seen.skeleton, seen.stem, seen.flowers, seen.cloud, material, params=params.plant)


def pollinate(
    cell: Cell,
    material: Material,
    run: Run,
    params: Params,
    find_masks: FindMasks | None = None,
    earlier: EarlierShake | None = None,
) -> Done:
    """See, grasp and shake one plant, and measure how its flowers answer.

    The shake is chosen among the grasps about as good as the best. When the gripper holds nothing or the wrong thing,
    or a motion is refused, another place on the stem is tried. `material` is what is believed of the plant.

    Raises:
        StageFailure: a stage before the execution cannot go on; its kind says why.
    """
    params = _as_carried(params, cell.odometry)
    looks = IncomingViews(cell.workspace, by_colour=find_masks is None)
    with CaptureWriter(run.path("capture")) as writer, looks as incoming:

        def keep(view: View) -> None:  # it is written and looked at while the arm goes on to the next
            writer.add(view)
            incoming.add(view)

        capture = run.stage(
            "capture",
            Capture.load,
            lambda advance: cell.take_views(advance, keep),
            save=lambda capture, _: writer.finish(capture),
        )
        seen = perceive(capture, cell.workspace, run, params, find_masks, incoming.first_look(capture.views))
    planner = run.timed("planner", lambda _: cell.plan_around(seen.cloud))
    grasps = rank_grasps(seen, planner.reach, run, params)
    ahead = None
    if cell.drive_up is not None:
        ahead = run.timed(
            "plan ahead", lambda _: _planned_ahead(cell, planner, seen, grasps, material, params, earlier)
        )
        seen, planner, grasps, ahead = _driven_up(cell, cell.drive_up, seen, planner, grasps, ahead, run, params)
    with ThreadPoolExecutor(1) as beside:  # the plant is modelled while the early reach is planned
        modelled = beside.submit(model_plant, seen, material, params)
        with early_reach(planner, ahead.grasp if ahead else grasps[0], cell.robot, cell.limits) as arrive:
            rods = run.stage("plant model", PlantModel.load, lambda _: modelled.result())
            shake, trial, alone, planned, joints = _shaken(
                cell, planner, rods, grasps, seen, run, arrive, params, earlier, ahead
            )
    answer = _watched(cell, trial, shake, seen, run)
    if answer is None:
        return Done(shake, trial, answer, rods.material, rods.material, params.shake.pads, alone, planned)
    if params.actuator == "arm":
        joints = joints or JointBelief(_grip_motion(planner, shake.grasp))
    observed = [ObservedShake.of(shake, answer, NOT_MEASURED if joints is None else measure_grip(trial, shake, joints))]
    learned = run.timed("learning", lambda _: refine(rods, observed, pads=params.shake.pads))
    return Done(shake, trial, answer, learned.material, rods.material, learned.pads, alone, planned)


def _planned_ahead(
    cell: Cell,
    planner: MotionPlanner,
    seen: Seen,
    grasps: list[Grasp],
    material: Material,
    params: Params,
    earlier: EarlierShake | None,
) -> ShakePlan | None:
    """Return the shake as it would be where the cart is to stand; None: there is none, which is met again there."""
    try:
        rods = model_plant(seen, material, params)
        actuator = _actuator(cell, planner, params)
        plan = shake.plan_shake(rods, _offered(grasps), actuator, params.shake, cell.limits.pressing, earlier)
    except StageFailure:
        return None
    planner.prepare(_joints(plan.grasp), plan.grasp.pregrasp(grasp.STAND_OFF))
    return plan


def _driven_up(
    cell: Cell,
    drive_up: Callable[[], None],
    seen: Seen,
    planner: MotionPlanner,
    grasps: list[Grasp],
    ahead: ShakePlan | None,
    run: Run,
    params: Params,
) -> tuple[Seen, MotionPlanner, list[Grasp], ShakePlan | None]:
    """Return what was seen on the way, a planner, the grasps in reach and the plan, as the side camera has them after
    the drive; of the plan None where the arm cannot do it from there.

    Raises:
        InputError: there is no side camera.
        DeviceError: it shows what it showed before the drive.
        StageFailure: "no_plant_found": the plant is not there; or there is no grasp any more.
    """
    camera = _side_camera(cell)[0]
    before = camera.read()
    drive_up()
    return _seen_again(cell, before, seen, planner, grasps, ahead, run, params)


def _side_camera(cell: Cell) -> tuple[Camera, Array]:
    camera, pose = cell.robot.side_camera, cell.robot.T_world_side_camera
    if camera is None or pose is None:
        do = "Name one, or take the views from where the cart stands."
        raise bad_input("side camera", given="none, in a cell that looks ahead", allowed="a side camera", do=do)
    return camera, pose


def _seen_again(
    cell: Cell,
    before: Frame,
    seen: Seen,
    planner: MotionPlanner,
    grasps: list[Grasp],
    ahead: ShakePlan | None,
    run: Run,
    params: Params,
) -> tuple[Seen, MotionPlanner, list[Grasp], ShakePlan | None]:
    """Return what `_driven_up` returns, by a frame of now, later than the one of `before`."""
    camera, pose = _side_camera(cell)
    frame = camera.read()
    if frame.time <= before.time or np.array_equal(frame.rgb, before.rgb):
        raise DeviceError(
            f"side camera: got the picture of {before.time:.2f} s again; allowed: one of now. Restart it."
        )
    view = View(frame.depth, frame.rgb, camera.intrinsics, pose)

    def found(_: Advance) -> tuple[Seen, MotionPlanner, list[Grasp], ShakePlan | None]:
        stem_nodes = seen.skeleton.nodes[seen.stem.node_ids]
        T_now_then = cloud.moved_since(seen.cloud, stem_nodes, view, cell.workspace)
        here, around = seen.moved(T_now_then), planner.moved(T_now_then)
        reached = grasp.still_reached([one.moved(T_now_then) for one in grasps], around.reach)
        plan = ahead and shake.moved_plan(ahead, T_now_then, reached, _actuator(cell, around, params))
        return here, around, reached or _ranked(here, around.reach, params, wanted=1), plan  # the arm waits for it

    here, around, reached, plan = run.timed("place", found)
    run.keep("cloud", here.cloud)
    run.keep("skeleton", here.skeleton)
    run.keep("flowers", here.flowers)
    run.keep("grasp", reached, _save_grasps)
    return here, around, reached, plan


def _as_carried(params: Params, odometry: float) -> Params:
    """Return the parameters for views whose camera a cart carried with this `Cell.odometry`; 0: an arm did."""
    registration = params.cloud.registration
    if registration is None or not odometry:
        return params
    return replace(params, cloud=replace(params.cloud, registration=replace(registration, walk=odometry)))


def _grip_motion(planner: MotionPlanner, grasp: Grasp) -> GripMotion:
    return partial(planner.grip_motion, _joints(grasp))


def _joints(grasp: Grasp) -> Array:
    assert grasp.joints is not None, "grasps are ranked by what the arm can reach"
    return grasp.joints


def _watched(cell: Cell, trial: Trial, plan: ShakePlan, seen: Seen, run: Run) -> Response | None:
    """Measure the motion of flowers and stem in the side camera's frames; None when there are too few."""
    camera, pose = cell.robot.side_camera, cell.robot.T_world_side_camera
    if camera is None or pose is None or not trial.frames or not len(seen.flowers.positions):
        return None
    begin, end = trial.steady
    frames = [f for f in trial.frames if not trial.steps or begin <= f.time <= end] or trial.frames
    if len(frames) < FEWEST_FRAMES:  # a shake that was cut short
        return None
    ids = seen.stem.node_ids
    nodes, radius = seen.skeleton.nodes[ids], seen.skeleton.radius[ids]
    beside = stem_near(nodes, seen.stem.arc_length, radius, plan.grasp.arc_length)
    return run.stage(
        "response",
        Response.load,
        lambda _: measure_response(frames, camera.intrinsics, pose, seen.flowers, plan.frequency, stem=beside),
    )


SLACK = 0.6
"""A grasp whose score is lower than the best's by more is tried when the better ones failed; a judgement."""


def _offered(grasps: list[Grasp]) -> list[Grasp]:
    """Return the grasps about as good as the best, which comes first."""
    return [g for g in grasps if g.score >= grasps[0].score - SLACK]


def _actuator(cell: Cell, planner: MotionPlanner, params: Params) -> shake.Actuator:
    """Return what is to shake the grip: the arm, at the joints of a grasp, or a motor in the gripper."""

    def arm_limit(at: Grasp, direction: Array, hertz: Array) -> Array:
        return np.minimum(planner.shake_limit(_joints(at), direction, hertz), shake_amplitude(hertz, cell.limits))

    def arm_delivers(at: Grasp, directions: Array, hertz: Array) -> tuple[Array, Array]:
        return planner.delivered(_joints(at), directions, hertz)

    return shake.arm_shaker(arm_limit, arm_delivers) if params.actuator == "arm" else shake.VIBRATING_GRIPPER


def _shaken(
    cell: Cell,
    planner: MotionPlanner,
    rods: PlantModel,
    grasps: list[Grasp],
    seen: Seen,
    run: Run,
    arrive: Arrive | None,
    params: Params,
    earlier: EarlierShake | None,
    ahead: ShakePlan | None,
) -> tuple[ShakePlan, Trial, str | None, ShakePlan, JointBelief | None]:
    """Shake at one of the best grasps; where that fails and leaves the plant unharmed, at one of the others.

    `arrive` waits for the arm that has gone before the best, or before that of the plan made `ahead`. Return the shake
    as carried out, its record, why the plan alone was to be carried out, the shake as planned, and what it told of the
    arm's joints.
    """
    while True:
        offered = _offered(grasps)
        try:
            planned = _planned(cell, planner, rods, offered, run, params, earlier, ahead)
        except StageFailure as failure:
            if failure.kind not in TRY_THE_NEXT or len(offered) == len(grasps):
                raise
            run.note_attempt(f"{len(offered)} grasps left: {failure}")
            grasps = grasps[len(offered) :]
            continue
        plan, trial, alone, joints = _carried_out(cell, planner, rods, planned, seen, run, arrive, params)
        arrive, ahead = None, None
        grasps = [g for i, g in enumerate(grasps) if i != planned.grasp_index]
        if trial.failure not in TRY_THE_NEXT or len(trial.shake_times) or not grasps:
            return plan, trial, alone, planned, joints
        at = f"{100 * planned.grasp.arc_length:.0f} cm up the stem"
        run.note_attempt(f"the grasp {at} is left for the next: {trial.stop_reason}")
        if trial.failure == "nothing_grasped" and cell.drive_up is not None:  # it swayed away
            before = _side_camera(cell)[0].read()
            seen, planner, grasps, _ = _seen_again(cell, before, seen, planner, grasps, None, run, params)
            rods = model_plant(seen, rods.material, params)


def _planned(
    cell: Cell,
    planner: MotionPlanner,
    rods: PlantModel,
    offered: list[Grasp],
    run: Run,
    params: Params,
    earlier: EarlierShake | None,
    ahead: ShakePlan | None,
) -> ShakePlan:
    """Return the shake to be carried out; see `shake.plan_shake`."""
    actuator, pressing = _actuator(cell, planner, params), cell.limits.pressing
    return run.stage(
        "shake plan",
        ShakePlan.load,
        lambda _: ahead or shake.plan_shake(rods, offered, actuator, params.shake, pressing, earlier),
    )


def _carried_out(
    cell: Cell,
    planner: MotionPlanner,
    rods: PlantModel,
    plan: ShakePlan,
    seen: Seen,
    run: Run,
    arrive: Arrive | None,
    params: Params,
) -> tuple[ShakePlan, Trial, str | None, JointBelief | None]:
    """Carry out a plan; return the shake as carried out, its record, why the plan alone was to be carried out, and what
    it told of the arm's joints."""
    by_arm = params.actuator == "arm"
    robot = replace(cell.robot, motor=None) if by_arm else cell.robot
    way = run.timed("prediction", lambda _: _watching(cell, planner, rods, plan, seen, params))
    watched, alone = (None, way) if isinstance(way, str) else (way, None)
    if watched is None and not by_arm:
        why = "a motor shakes only what a side camera watches, and flowers it knows."
        raise StageFailure("limits_exceeded", why)
    run.told("watched", watched)
    commanded = plan if watched is None else watched.plan
    trial = run.stage(
        "execution",
        Trial.load,
        lambda advance: execution.execute(
            planner, commanded, robot, cell.limits, progress=_progress(run, advance), arrive=arrive, watched=watched
        ),
    )
    if watched is None:
        return plan, trial, alone, None
    return watched.executed_plan(trial.steps), trial, alone, watched.joints


def _progress(run: Run, advance: Advance) -> execution.Progress:
    """Return what hears of an execution's phases."""

    def begins(done: int, phases: int, phase: str) -> None:
        advance(done, phases)
        run.told("phase", phase)

    return begins


def _watching(
    cell: Cell, planner: MotionPlanner, rods: PlantModel, plan: ShakePlan, seen: Seen, params: Params
) -> Escalation | str:
    """Return what raises the shake by what the side camera sees; where it cannot, why not."""
    camera, pose = cell.robot.side_camera, cell.robot.T_world_side_camera
    seconds = min(params.escalation.most_seconds, cell.limits.shake_duration)
    if not (params.escalate or params.actuator == "gripper"):
        paper = not params.shake.keeps_limits
        return "the paper's shake is done as it is" if paper else "it was not to be watched, as asked"
    if camera is None or pose is None:
        return "there is no side camera"
    if seconds < SHORTEST:
        return f"the cell's shake_duration is less than the {SHORTEST:g} s that watching takes"
    if not len(seen.flowers.positions):
        return "no flower was found that could be watched"
    points = watch_points(rods, camera=(camera.intrinsics, pose), surface=seen.cloud.points)
    pressing = float(cell.limits.pressing.most(plan.grasp.stem_diameter))
    return Escalation(
        replace(plan, press=max(plan.press, pressing)),
        foresee(rods, plan.grasp.point, plan.tones.frequencies, points, pads=params.shake.pads),
        seen.flowers.positions,
        rods.rods.nodes[points],
        camera=(camera.intrinsics, pose),
        grip=_grip_motion(planner, plan.grasp) if params.actuator == "arm" else None,
        T_world_imu=None if cell.robot.T_flange_imu is None else plan.grasp.T_world_flange @ cell.robot.T_flange_imu,
        limits=params.shake,
        params=replace(params.escalation, most_seconds=seconds),
    )
