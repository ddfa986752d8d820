"""The whole way through the house: views -> masks -> cloud -> skeleton -> stem -> grasp -> shake -> response."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Protocol

from anther import cloud, escalation, execution, flowers, grasp, masks, plant, shake, skeleton, stem
from anther.capture import Capture
from anther.cloud import Cloud, likely_cause
from anther.devices import Robot, SafetyLimits
from anther.errors import FailureKind, InputError, StageFailure
from anther.escalation import SHORTEST, Escalation, foresee, watch_points
from anther.execution import Arrive, Trial, early_reach
from anther.flowers import Flowers
from anther.geometry import Array, Box
from anther.grasp import Grasp
from anther.identification import ObservedShake, feel, refine
from anther.masks import Masks, by_words
from anther.plant import Material, PlantModel
from anther.response import Response, measure_response, stem_near
from anther.response.thresholds import FEWEST_FRAMES
from anther.runs import Advance, Run
from anther.shake import ActuatorName, EarlierShake, Pads, ShakePlan
from anther.skeleton import Skeleton
from anther.stem import Stem

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
    flowers: flowers.Params = field(default_factory=flowers.Params)
    grasp: grasp.Params = field(default_factory=grasp.Params)
    plant: plant.Params = field(default_factory=plant.Params)
    shake: shake.Params = field(default_factory=shake.Params)
    escalation: escalation.Params = field(default_factory=escalation.Params)
    actuator: ActuatorName = "arm"
    """What shakes the closed pads: the arm, or a motor in the gripper, which is always watched."""
    escalate: bool = True
    """Whether the shake is raised by what the side camera sees, or done as planned."""


FindMasks = Callable[[Capture, Box | None, Advance], Masks]
"""Another way to masks than `masks.segment`: (capture, workspace, progress) -> Masks."""


class MotionPlanner(execution.TrajectoryPlanner, Protocol):
    """What a trial asks of an arm's planner, beyond the motions that execution asks for."""

    def reach(self, T_world_pregrasp: Array, T_world_grasp: Array) -> Array | None:
        """See `grasp.Reach`."""
        ...

    def shake_limit(self, q: Array, direction: Array, frequencies: Array) -> Array:
        """Return the largest amplitude (Q,) [m] the arm manages about joints (J,) [rad]."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class RobotSide:
    """One robot before one plant, simulated or real.

    Attributes:
        take_views: moves the wrist camera around the plant and returns the views.
        plan_around: Cloud -> a motion planner that keeps clear of what the cloud shows.
        robot: arm, gripper and cameras.
        workspace: box the plant stands in, world [m].
        limits: what no command may exceed.
    """

    take_views: Callable[[Advance], Capture]
    plan_around: Callable[[Cloud], MotionPlanner]
    robot: Robot
    workspace: Box
    limits: SafetyLimits


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What perception made of the views."""

    masks: Masks
    cloud: Cloud
    skeleton: Skeleton
    stem: Stem
    flowers: Flowers


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """What a trial did: the shake, its execution, how the flowers answered, and what that taught of the material.

    Attributes:
        material: what is believed of the plant afterwards.
        believed: what the shake was planned with; None if unknown.
        pads: what is believed of the gripper's pads afterwards; None if unknown.
    """

    shake: ShakePlan
    trial: Trial
    response: Response | None
    material: Material
    believed: Material | None = None
    pads: Pads | None = None


def perceive(
    capture: Capture, workspace: Box | None, run: Run, params: Params, find_masks: FindMasks | None = None
) -> Seen:
    """Turn views into a labelled cloud, a rooted skeleton, its main stem and its flowers.

    Args:
        capture: the views.
        workspace: where the plant may stand, world [m]; None: about where the cameras look.
        run: where every stage's result is kept.
        params: of every stage.
        find_masks: finds plant and flowers instead of `masks.segment`, which needs no weights.

    Raises:
        StageFailure: no plant or no stem was found.
    """
    find_masks = find_masks or (lambda views, box, _: masks.segment(views, box, params.masks))
    with _cause_named(capture):
        labels = run.stage("masks", Masks.load, lambda advance: find_masks(capture, workspace, advance))
        fused = run.stage(
            "cloud", Cloud.load, lambda advance: cloud.fuse(capture, labels, workspace, params.cloud, progress=advance)
        )
    tree = run.stage("skeleton", Skeleton.load, lambda _: skeleton.skeletonize(fused, params.skeleton))
    centres = flowers.flower_centres(fused, params.flowers)
    main = run.stage("stem", Stem.load, lambda _: stem.find_stem(tree, params.stem, flowers_at=centres))
    found = run.stage(
        "flowers",
        Flowers.load,
        lambda _: flowers.find_flowers(fused, tree, main, params.flowers, centres=centres),
    )
    return Seen(labels, fused, tree, main, found)


@contextmanager
def _cause_named(capture: Capture) -> Iterator[None]:
    """Add to a failure to find the plant what is probably wrong with the views."""
    try:
        yield
    except StageFailure as failure:
        if failure.kind == "no_plant_found" and (cause := likely_cause(capture)):
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
    return run.stage(
        "grasp",
        grasp.load_grasps,
        lambda _: grasp.plan_grasps(seen.stem, seen.skeleton, seen.cloud, params.grasp, reach=reach),
        save=lambda ranked, path: grasp.save_grasps(path, ranked),
    )


def model_plant(seen: Seen, material: Material, params: Params) -> PlantModel:
    """Return the plant as rods with the flowers that were seen, or else with those supposed; a note says so."""
    return plant.plant_with_flowers(seen.skeleton, seen.stem, seen.flowers, seen.cloud, material, params=params.plant)


def pollinate(
    cell: RobotSide,
    material: Material,
    run: Run,
    params: Params,
    find_masks: FindMasks | None = None,
    earlier: EarlierShake | None = None,
) -> Done:
    """See, grasp and shake one plant, and measure how its flowers answer.

    The shake is chosen among the grasps about as good as the best. When the gripper holds nothing or the wrong thing,
    or a motion is refused, another place on the stem is tried.

    Args:
        cell: robot and plant.
        material: what is believed of the plant's stiffness, density and damping.
        run: where every stage's result is kept.
        params: of every stage.
        find_masks: see `perceive`.
        earlier: see `plan_shake`.

    Raises:
        StageFailure: a stage before the execution cannot go on; its kind says why.
    """
    capture = run.stage("capture", Capture.load, cell.take_views)
    seen = perceive(capture, cell.workspace, run, params, find_masks)
    planner = cell.plan_around(seen.cloud)
    grasps = rank_grasps(seen, planner.reach, run, params)
    with ThreadPoolExecutor(1) as beside:  # the plant is modelled while the early reach is planned
        modelled = beside.submit(model_plant, seen, material, params)
        with early_reach(planner, grasps[0], cell.robot, cell.limits) as arrive:
            rods = run.stage("plant model", PlantModel.load, lambda _: modelled.result())
            shake, trial = _shaken(cell, planner, rods, grasps, seen, run, arrive, params=params, earlier=earlier)
    answer = _watched(cell, trial, shake, seen, run, params=params)
    if answer is None:
        return Done(shake, trial, answer, rods.material, rods.material, params.shake.pads)
    felt = feel(trial, shake, cell.limits.forward)
    told = [ObservedShake.of(shake, answer, felt)]
    learned = run.timed("learning", lambda _: refine(rods, told, pads=params.shake.pads))
    return Done(shake, trial, answer, learned.material, rods.material, learned.pads)


def _watched(
    cell: RobotSide, trial: Trial, shake: ShakePlan, seen: Seen, run: Run, *, params: Params
) -> Response | None:
    """Measure the motion of flowers and stem in the side camera's frames; None when there are too few."""
    camera, pose = cell.robot.side_camera, cell.robot.T_world_side_camera
    if camera is None or pose is None or not trial.frames or not len(seen.flowers.positions):
        return None
    begin, end = trial.steady
    frames = [f for f in trial.frames if not trial.steps or begin <= f.time <= end] or trial.frames
    if len(frames) < FEWEST_FRAMES:  # a shake that was cut short
        return None
    ids = seen.stem.node_ids
    beside = stem_near(
        seen.skeleton.nodes[ids], seen.stem.arc_length, seen.skeleton.radius[ids], shake.grasp.arc_length
    )
    return run.stage(
        "response",
        Response.load,
        lambda _: measure_response(
            frames,
            camera.intrinsics,
            pose,
            seen.flowers,
            shake.frequency,
            stem=beside,
        ),
    )


def _shaken(
    cell: RobotSide,
    planner: MotionPlanner,
    rods: PlantModel,
    grasps: list[Grasp],
    seen: Seen,
    run: Run,
    arrive: Arrive | None,
    *,
    params: Params,
    earlier: EarlierShake | None,
) -> tuple[ShakePlan, Trial]:
    """Shake at one of the best grasps; where that fails and leaves the plant unharmed, at one of the others.

    `arrive` waits for the arm that has gone before the best.
    """
    while True:
        offered = [g for g in grasps if g.score >= grasps[0].score - grasp.SLACK]
        try:
            shake = _planned(planner, rods, offered, run, cell.limits, params=params, earlier=earlier)
        except StageFailure as failure:
            if failure.kind not in TRY_THE_NEXT or len(offered) == len(grasps):
                raise
            grasps = grasps[len(offered) :]
            continue
        watched = _watching(cell, rods, shake, seen, params)
        if watched is None and params.actuator == "gripper":
            raise StageFailure(
                "limits_exceeded", "a motor shakes only what a side camera watches, and flowers it knows."
            )
        run.told("watched", watched)
        trial = run.stage(
            "execution",
            Trial.load,
            lambda advance, shake=shake, arrive=arrive, watched=watched: execution.execute(
                planner,
                shake if watched is None else watched.plan,
                cell.robot if params.actuator == "gripper" else replace(cell.robot, motor=None),
                cell.limits,
                progress=_phases_told(run, advance),
                arrive=arrive,
                watched=watched,
            ),
        )
        arrive, planned = None, shake.grasp_index
        if watched is not None:
            shake = watched.executed(trial.steps)
        grasps = [g for i, g in enumerate(grasps) if i != planned]
        if trial.failure not in TRY_THE_NEXT or len(trial.shake_times) or not grasps:
            return shake, trial


def _phases_told(run: Run, advance: Advance) -> execution.Progress:
    """Return what shows a trial's progress and says which phase begins."""

    def begins(done: int, phases: int, phase: str) -> None:
        advance(done, phases)
        run.told("phase", phase)

    return begins


def _watching(cell: RobotSide, rods: PlantModel, shake: ShakePlan, seen: Seen, params: Params) -> Escalation | None:
    """Return what raises the shake by what the side camera sees; None where it cannot."""
    camera, pose = cell.robot.side_camera, cell.robot.T_world_side_camera
    wanted = params.escalate or params.actuator == "gripper"
    seconds = min(params.escalation.most_seconds, cell.limits.shake_duration)
    if camera is None or pose is None or not wanted or not len(seen.flowers.positions) or seconds < SHORTEST:
        return None
    points = watch_points(rods)
    tones, pads = shake.tones, params.shake.pads
    pressing = float(cell.limits.pressing.most(shake.grasp.stem_diameter))
    return Escalation(
        replace(shake, press=max(shake.press, pressing)),
        foresee(rods, shake.grasp.point, tones.frequencies, points, pads=pads),
        seen.flowers.positions,
        rods.rods.nodes[points],
        camera=(camera.intrinsics, pose),
        middle=shake.grasp.carried(cell.limits.forward) if params.actuator == "arm" else None,
        limits=params.shake,
        params=replace(params.escalation, most_seconds=seconds),
    )


def _planned(
    planner: MotionPlanner,
    rods: PlantModel,
    grasps: list[Grasp],
    run: Run,
    limits: SafetyLimits,
    *,
    params: Params,
    earlier: EarlierShake | None,
) -> ShakePlan:
    """Choose a shake among the grasps."""

    def arm_limit(at: Grasp, direction: Array, frequencies: Array) -> Array:
        assert at.joints is not None
        return planner.shake_limit(at.joints, direction, frequencies)

    actuator = shake.ArmShaker(arm_limit) if params.actuator == "arm" else shake.VibratingGripper()
    return run.stage(
        "shake plan",
        ShakePlan.load,
        lambda _: shake.plan_shake(rods, grasps, actuator, params.shake, limits.pressing, earlier),
    )
