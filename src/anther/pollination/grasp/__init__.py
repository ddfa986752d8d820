"""Grasp: where and how the gripper takes the main stem. C candidates, K stations along the stem."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array, pose7, transform, transform_points
from anther.core.records import Range, Record, Shape, Share, Stored
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.pollination.grasp._candidates import Candidates, candidates_along, hidden_share, place_confidence
from anther.pollination.grasp._clearance import (
    BRANCH,
    FLOWER_POINT,
    LEAF,
    OBSTACLE,
    RIGID,
    STEM,
    STRING,
    Clearance,
    clearance,
    surroundings_of,
)
from anther.robot.arm.gripper_shape import GripperShape

__all__ = [
    "STAND_OFF", "Grasp", "Params", "Reach", "load_grasps", "plan_grasps",
    "save_grasps", "still_reached",
]  # fmt: skip

STAND_OFF = 0.12
"""The straight way in begins this far back along the approach axis [m]."""


@dataclass(frozen=True, slots=True)
class Params:
    """How grasps are searched and weighed.

    Attributes:
        gripper: its geometry.
        fit_gripper: True refuses what this gripper cannot do. False gives the best place on the stem whatever its size:
            the plant is looked at as if shrunk until its stem fits, and a collision only lowers the score.
    """

    gripper: GripperShape = field(default_factory=GripperShape)
    fit_gripper: bool = True


OFF_BY = 0.002
"""How far a closing gripper may pull the stem aside [m]: what is left of calibration and registration errors."""

DOUBT = 0.003
"""How far skeleton and cloud may lie beside the truth [m]: of petioles 1.8 to 3.2 mm in 90 of 100 places (measured on
peppers); what comes this near the closing pads counts as between them."""

ASKED = 150
"""So often is the arm asked before what it has confirmed is enough; four times as often while that is nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Grasp(Record):
    """A grasp of the main stem. The gripper approaches along the flange's +z; its fingers close along +-y.

    Attributes:
        T_world_flange: (4, 4) flange (`right_hand`) pose with the stem between the finger pads.
        point: (3,) grasped point on the stem's centreline, world [m].
        tangent: (3,) unit stem direction there, root to tip.
        approach: (3,) unit approach direction n, world (the flange's +z).
        arc_length: distance from the root along the stem [m].
        stem_diameter: [m], as measured by perception.
        clearance: smallest distance between the open gripper on its way in and plant, pot or bench [m], at most 0.03;
            negative when it brushes leaves.
        score: higher is better; comparable within one ranked list only.
        reason: why it ranks where it does, for people.
        joints: (J,) arm joints at the grasp [rad], or None when no arm was asked.
        confidence: probability that it is the main stem that closes between the fingers (pepper: below the first fork;
            docs/confidence.md), or None when the skeleton's confidence is unknown.
        opening: between the pads on the way in and out [m].
        squeezed: petioles between the closing pads reach so far beyond the stem's surface [m]; None if unknown.
    """

    CALLED = "grasp"
    T_world_flange: Annotated[Array, Shape(4, 4, rigid=True)]
    point: Annotated[Array, Shape(3), Range(unit="m")]
    tangent: Annotated[Array, Shape(3)]
    approach: Annotated[Array, Shape(3)]
    arc_length: Annotated[float, Range(0, 20, "m")]
    stem_diameter: Annotated[float, Range(unit="m")]
    clearance: Annotated[float, Range(unit="m")]
    score: float
    reason: str
    joints: Annotated[Array, Shape("J"), Range(unit="rad")] | None = None
    confidence: Share | None = None
    opening: Annotated[float, Range(unit="m")] = GripperShape().stroke
    squeezed: Annotated[float, Range(unit="m")] | None = None

    @property
    def pose7(self) -> Array:
        """The flange pose as x, y, z [m], qx, qy, qz, qw."""
        return pose7(self.T_world_flange)

    def moved(self, T: Array) -> Grasp:
        """Return it moved by T (4, 4); no arm was asked there."""
        return replace(
            self,
            T_world_flange=T @ self.T_world_flange,
            point=transform_points(T, self.point),
            tangent=T[:3, :3] @ self.tangent,
            approach=T[:3, :3] @ self.approach,
            joints=None,
        )

    def pregrasp(self, distance: float) -> Array:
        """Return T_world_flange `distance` [m] back along the approach."""
        return self.T_world_flange @ transform(np.eye(3), [0, 0, -distance])


Reach = Callable[[Array, Array], Array | None]
"""What grasp planning asks of an arm: T_world_flange (4, 4) before the grasp and at it -> joints (J,) at the grasp if
both, and the line between them, can be reached, else None."""


def plan_grasps(
    stem: Stem, skeleton: Skeleton, cloud: Cloud, params: Params = Params(), reach: Reach | None = None, wanted: int = 3
) -> list[Grasp]:
    """Return grasps of the main stem, best first, at different heights.

    Stations along the stem times directions around it are scored by what the open gripper meets on its straight way
    in, what its pads squeeze beside the stem when they close, the stem's thickness and straightness, the distance from
    attachments, and how sure it is that the main stem stands there.

    Args:
        stem, skeleton, cloud: the plant and, in the cloud, pot and bench.
        params: see `Params`.
        reach: the arm, asked down the ranking until it confirms the grasps that are wanted; None asks no arm.
        wanted: how many grasps the arm is to confirm.

    Raises:
        StageFailure: "no_grasp_found" (no candidate is clear of pot, bench and stem) or "unreachable" (the arm
            confirmed none); the message counts what fell by which criterion.
    """
    if len(stem.organ) != len(skeleton.nodes):
        given = f"a stem of {len(stem.organ)} nodes"
        raise bad_input("stem", given=given, allowed=f"of this skeleton ({len(skeleton.nodes)})", do="Find it again.")
    scale = 1.0
    if not params.fit_gripper:  # shrunk until the stem fills no more than half the stroke
        scale = max(1.0, float(2 * np.median(skeleton.radius[stem.node_ids]) / (0.5 * params.gripper.stroke)))
    if scale > 1:
        smaller = 1 / scale
        stem = replace(stem, arc_length=stem.arc_length * smaller)
        lengths = {name: getattr(skeleton, name) * smaller for name in ("nodes", "radius", "neighbours")}
        skeleton = replace(skeleton, **lengths)
        supports = tuple(s.scaled(smaller) for s in cloud.supports)
        lengths = {name: getattr(cloud, name) * smaller for name in ("points", "loose", "obstacles")}
        cloud = replace(cloud, supports=supports, **lengths)
    ranking = _rank(stem, skeleton, cloud, params, toward_base=reach is not None)
    return [_enlarged(grasp, scale) for grasp in _first_reached(ranking, reach, wanted)]


def still_reached(grasps: Sequence[Grasp], reach: Reach) -> list[Grasp]:
    """Return those of grasps that the arm reaches, with its joints there."""
    asked = ((one, reach(one.pregrasp(STAND_OFF), one.T_world_flange)) for one in grasps)
    return [replace(one, joints=joints) for one, joints in asked if joints is not None]


@dataclass(frozen=True, slots=True, eq=False)
class _Grasps(Stored):
    KIND, SCHEMA = "grasps", 5
    grasps: tuple[Grasp, ...]


def save_grasps(path: Path | str, grasps: Sequence[Grasp]) -> None:
    """Write the ranked list as JSON, best first."""
    _Grasps(tuple(grasps)).save(path)


def load_grasps(path: Path | str) -> list[Grasp]:
    """Read a list written by `save_grasps`.

    Raises:
        InputError: missing, truncated, or not a list of grasps of this schema.
    """
    return list(_Grasps.load(path).grasps)


@dataclass(frozen=True, slots=True, eq=False)
class _Ranking:
    """Candidates with what they cost and how sure they are.

    `fell` counts those refused, by criterion; `string` is the thickest string's diameter [m].
    """

    candidates: Candidates
    met: Clearance
    costs: dict[str, NDArray[Any]]
    order: NDArray[Any]
    fell: Counter[str]
    confidence: Array | None
    string: float = 0.0


def _rank(stem: Stem, skeleton: Skeleton, cloud: Cloud, params: Params, *, toward_base: bool) -> _Ranking:
    gripper, length = params.gripper, float(stem.arc_length[-1])
    spacing = 0.005  # m between stations along the stem
    straight = 0.014  # m, half of the piece that gives the stem's direction: little more than the pads hold
    root, top = 0.065, 0.05  # m left out at the stem's ends, each at most a quarter of it
    toward_tips = 0.006  # m from the pads' middle to the stem, so that less of them reaches into petioles behind it
    candidates = candidates_along(
        stem,
        skeleton,
        directions=24,
        spacing=max(spacing, length / 60),
        window=min(straight, length / 8),
        ends=(min(root, length / 4), min(top, length / 4)),
        depth=gripper.depth + toward_tips,
    )
    if toward_base:
        few = (candidates.arc_length <= stem.arc_length[stem.fork]) | (candidates.station % 4 == 0)
        candidates = candidates.only(few & (candidates.outward() > 0))
    around, poses = surroundings_of(stem, skeleton, cloud), candidates.T_world_flange
    shares = 1.0, 0.576  # of the stroke on the way in: wide open forgives errors, half open fits between petioles
    openings = tuple(share * gripper.stroke for share in shares)
    open_ = [(gripper.boxes(STAND_OFF, o), gripper.closing(DOUBT, o)) for o in openings]
    with ThreadPoolExecutor() as pool:
        met = Clearance.of(list(pool.map(lambda shape: clearance(poses, around, *shape), open_)))
    candidates = candidates.opened(openings)
    confidence = place_confidence(stem, skeleton, candidates.arc_length)
    if confidence is not None:
        confidence = confidence * (1 - cloud.seen_through)  # it was fitted on views that agree
    string = max((2 * s.radius for s in cloud.supports if s.soft), default=0.0)
    refusals = _refusals(candidates, met, confidence, params, string=string)
    costs = _costs(candidates, met, cloud, params, length)
    below = stem.arc_length[stem.fork] - candidates.arc_length  # above its first fork it is no longer the main stem
    near_fork = 0.025  # m below a fork where the skeleton cuts the corner
    costs["near or above a fork"] = 10.0 * np.clip(1 - below / near_fork, 0, 1)
    if confidence is not None:
        costs["perhaps not the main stem"] = 6.0 * (1 - confidence)
    if toward_base:
        costs["comes from behind the plant"] = 0.25 * (1 - candidates.outward())
    refused = np.any(list(refusals.values()), axis=0)
    if not params.fit_gripper:
        # a place with a support or a stem between the fingers comes last, whatever else speaks for it
        costs |= {name: (30.0 if name == BETWEEN else 3.0) * yes for name, yes in refusals.items()}
        refused[:] = False
    total = np.sum(list(costs.values()), axis=0)
    order = np.argsort(np.where(refused, np.inf, total), kind="stable")[: int((~refused).sum())]
    fell = Counter({name: int(yes.sum()) for name, yes in refusals.items() if yes.any()})
    return _Ranking(candidates, met, costs, order, fell, confidence, string)


STEM_CLEARANCE, OBSTACLE_CLEARANCE = 0.003, 0.015
"""Least distance of the open fingers from the stem's surface, and of the gripper from pot, soil and bench [m]."""
SUPPORT_CLEARANCE = OFF_BY + DOUBT
"""Of the gripper from a string, stake, pole or another stem [m]: these are seen as well as the stem is."""
DOUBTED, BETWEEN = "probably not the main stem", "a support or another stem between the fingers"


def _refusals(
    c: Candidates, met: Clearance, confidence: Array | None, params: Params, *, string: float = 0.0
) -> dict[str, NDArray[np.bool_]]:
    """Return per criterion which candidates (C,) can never be taken; `string` is the thickest string's diameter [m]."""
    doubtful = np.zeros(len(c.station), dtype=bool) if confidence is None else confidence < 0.5
    held = 2 * c.radius + np.where(met.enclosed[:, STRING] > 0, string, 0)
    margin = 0.008  # m by which the stem must be thinner than the stroke
    return {
        DOUBTED: doubtful,
        "thicker than the stroke": held > params.gripper.stroke - margin,
        BETWEEN: met.enclosed[:, RIGID] > 0,
        "would hit a support or another stem": met.distance[:, [RIGID, STRING]].min(axis=1) < SUPPORT_CLEARANCE,
        "would hit pot or bench": met.distance[:, OBSTACLE] < OBSTACLE_CLEARANCE,
        "would hit the stem": met.distance[:, STEM] < STEM_CLEARANCE,
    }


def _costs(c: Candidates, met: Clearance, cloud: Cloud, params: Params, length: float) -> dict[str, NDArray[Any]]:
    """Return what speaks against each candidate (C,), by name; 1 is clearly bad. The weights are our judgement."""
    flowers = cloud.points[cloud.labels == FLOWER] if cloud.labels is not None else np.zeros((0, 3))
    flower_distance = KDTree(flowers).query(c.points)[0] if len(flowers) else np.full(len(c.points), np.inf)
    petiole = 0.3  # chance of one in 25 mm of a stem, pads and petiole: leaves are 8 cm apart (facts: rows D)
    squeezed = met.squeezed(c.radius)
    aside = OFF_BY + np.minimum(squeezed / 2, 0.004)
    pushed = met.push * c.arc_length / (np.pi / 4 * np.maximum(c.radius, 1e-4) ** 3)  # strain at the root, M r / (E I)
    # a stem bears it (facts: pollination 6); pulled aside by d at height L, its root sees 3 r d / L^2
    root_strain = 0.01
    return {
        "brushes leaves": np.minimum(met.touched[:, LEAF] / 60, 1.5),  # they press with 0.5 N at most (measured)
        "brushes a flower": met.touched[:, FLOWER_POINT] / 3,
        "near a petiole": 0.7 * np.clip(1 - met.distance[:, BRANCH] / DOUBT, 0, 1),
        "pushes a petiole": np.minimum(4.0 * pushed / root_strain, 6),
        "a branch between the fingers": np.minimum(squeezed / 0.002, 6),
        "the stem is hidden": 6.0 * petiole * hidden_share(c, cloud.points),
        "crowded with petioles": met.enclosed[:, BRANCH] / 6,  # 18 mm of them, in balls 3 mm apart
        "leaves between the fingers": np.minimum(met.enclosed[:, LEAF] / 10, 1),
        "near a flower": np.exp(-flower_distance / 0.03),
        "near the root": 4.0 * (3 * c.radius * aside / np.maximum(c.arc_length, 1e-3) ** 2) / root_strain,
        "near an attachment": 0.3 * np.exp(-c.attachment_distance / 0.015),
        "bent stem": c.bend / 0.0007,
        "a string between the fingers": 1.0 * (met.enclosed[:, STRING] > 0),
        "half open": 0.3 * (c.opening < params.gripper.stroke),
        "thick for the gripper": 2.5 * np.maximum(2 * c.radius / params.gripper.stroke - 0.6, 0),
        "far from the stem's middle": 0.4 * np.abs(c.arc_length / length - 0.5),
    }


def _first_reached(ranking: _Ranking, reach: Reach | None, wanted: int) -> list[Grasp]:
    """Return the best candidates, 12 mm from each other, that the arm confirms, until enough are found."""
    found, asked, refused = list[Grasp](), 0, set[bytes]()
    along = ranking.candidates.arc_length
    least_apart = 0.012  # m along the stem, so that the next grasp differs when one fails
    apart, near_one = min(least_apart, float(along.max(initial=0)) / 20) - 1e-9, np.zeros(len(along), dtype=bool)
    patience = 4  # times as often is the arm asked while it has confirmed nothing
    for i in ranking.order:
        if reach is not None and (len(found) == wanted or asked >= ASKED * (1 if found else patience)):
            break
        if near_one[i]:
            continue
        pose = ranking.candidates.T_world_flange[i].tobytes()  # the arm reaches it with either opening or with none
        if pose in refused:
            continue
        grasp = _grasp(ranking, int(i))
        if reach is not None:
            asked += 1
            joints = reach(grasp.pregrasp(STAND_OFF), grasp.T_world_flange)
            if joints is None:
                refused.add(pose)
                continue
            grasp = replace(grasp, joints=joints)
        found.append(grasp)
        near_one |= np.abs(along - along[i]) < apart
    if not found:
        raise _nothing(ranking, asked)
    return found


def _nothing(ranking: _Ranking, asked: int) -> StageFailure:
    total = len(ranking.candidates.station)
    fell = ", ".join(f"{count} {name}" for name, count in ranking.fell.items()) or "none refused"
    if asked:
        message = f"the arm reaches none of the {asked} best of {total} grasps ({fell}). Move the plant or the base."
        return StageFailure("unreachable", message)
    do = "Give the gripper more room."
    if ranking.fell[DOUBTED] == total:
        do = "Take more views, or name what is right with --root and --stem-tip."
    return StageFailure("no_grasp_found", f"none of {total} grasps is free: {fell}. {do}")


def _grasp(ranking: _Ranking, i: int) -> Grasp:
    c, free = ranking.candidates, float(ranking.met.distance[i].min())
    cost = {name: float(values[i]) for name, values in ranking.costs.items()}
    against = [name for name, value in sorted(cost.items(), key=lambda item: -item[1]) if value >= 0.15][:3]
    reason = f"stem {2e3 * c.radius[i]:.1f} mm thick, clearance {1e3 * free:.0f} mm"
    if ranking.met.enclosed[i, STRING]:
        reason += f", held together with a string {1e3 * ranking.string:.1f} mm thick"
    return Grasp(
        T_world_flange=c.T_world_flange[i],
        point=c.points[i],
        tangent=c.tangents[i],
        approach=c.approach[i],
        arc_length=float(c.arc_length[i]),
        stem_diameter=float(2 * c.radius[i]),
        clearance=free,
        score=-sum(cost.values()),
        reason="; ".join([reason, *against]),
        confidence=None if ranking.confidence is None else float(ranking.confidence[i]),
        opening=float(c.opening[i]),
        squeezed=float(ranking.met.squeezed(c.radius)[i]),
    )


def _enlarged(grasp: Grasp, scale: float) -> Grasp:
    if scale == 1:
        return grasp
    T = grasp.T_world_flange.copy()
    T[:3, 3] *= scale
    lengths = ("point", "arc_length", "stem_diameter", "clearance", "opening", "squeezed")
    larger = {name: getattr(grasp, name) * scale for name in lengths}
    reason = f"for a gripper {scale:.1f} times as large: {grasp.reason}"
    return replace(grasp, T_world_flange=T, reason=reason, **larger)
