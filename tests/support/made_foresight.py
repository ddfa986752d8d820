"""A made-up plant of which it is known what any shake does: foresight of it, a plan, and a world that shakes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from fake_robot import horizontal_grasp
from numpy.typing import NDArray

from anther.core.geometry import Array, ComplexArray, Intrinsics, look_at
from anther.plant.limits import GRAVITY, PEAKS, stalk_strain
from anther.pollination.escalation import Escalation, Params
from anther.pollination.escalation._foresight import Foresight
from anther.pollination.response.points import Swings
from anther.pollination.shake import Params as Limits
from anther.pollination.shake import ResponseMap, ShakePlan
from anther.pollination.shake._plan import CandidateShakes
from anther.pollination.shake.observables import semi_major
from anther.robot.devices import LEAD, ArmSample, Frame, ImuReadings
from anther.robot.swing import Swing

TONES = np.array([2.5, 4.0, 6.3])
FLOWERS, POINTS, MEMBERS = 6, 20, 32
KINDS = (*PEAKS, "grip_force")
"""Of load."""
ROWS = {"flowers": FLOWERS, "points": POINTS, **dict.fromkeys(KINDS, 2), "grip_force": 3}
SIZES = {"flowers": 1.5, "points": 1.0, "stem_strain": 0.2, "joint_strain": 0.3, "base_strain": 0.2, "leaf_load": 300.0}
T_WORLD_CAM = look_at(np.array([0.3, -0.5, 0.2]), np.array([0.0, 0.0, 0.1]))
AXES = (
    T_WORLD_CAM[:3, :3]
    - np.random.default_rng(7).uniform(-0.4, 0.4, (FLOWERS + POINTS, 1, 3)) * [1, 1, 0] * (T_WORLD_CAM[:3, 2:3])
)
"""Of flowers and points all over the picture, as `response.points.Sight` has them."""
ALONG = np.array([0.6, 0.8, 0.0])


def lines_across(count: int) -> Array:
    """Return (count, 3) horizontal lines in turn over half a circle, `ALONG` first."""
    angle = np.arange(count)[:, None] * np.pi / count
    return np.cos(angle) * ALONG + np.sin(angle) * np.array([-ALONG[1], ALONG[0], 0.0])


def made_foresight(seed: int = 0, *, unsure: float = 0.5, gains: Sequence[float] = (1.0, 1.0, 1.0)) -> Foresight:
    """Return what members of one family do: two numbers that are not known change all vectors, by a share `unsure`.

    Args:
        seed: of them.
        unsure: 0: all members are alike.
        gains: of flowers and points, by tone.
    """
    rng = np.random.default_rng(seed)
    ends = np.cumsum([0, *ROWS.values()])
    where = {kind: slice(int(a), int(b)) for kind, a, b in zip(ROWS, ends, ends[1:], strict=False)}
    shape = (len(TONES), 3, ends[-1], 3)
    usual, *ways = (rng.normal(size=shape) + 1j * rng.normal(size=shape) for _ in range(3))
    scale = np.ones((len(TONES), 1, ends[-1], 1))
    for kind, size in SIZES.items():
        scale[:, :, where[kind]] = size / 2
    scale[:, :, where["grip_force"]] = np.array([100.0, 0.2, 0.2])[:, None]
    for kind in ("flowers", "points"):
        scale[:, :, where[kind]] *= np.asarray(gains)[:, None, None, None]
    z = rng.normal(size=(MEMBERS, 2))
    z[0] = 0
    vectors = scale * (usual + unsure * np.einsum("md,dkasx->mkasx", z, np.array(ways)))
    return Foresight(TONES, vectors, where, 4e-3, 0.016)


def made_plan(
    amplitudes: Sequence[float] = (0.002, 0.002, 0.002), reach: Sequence[float] = (0.02, 0.015, 0.01), lines: int = 1
) -> ShakePlan:
    """Return a plan whose tones may be shaken along any of so many lines, as far along each."""
    size = np.full(FLOWERS, 0.003)
    alike = [np.repeat(np.array(values)[:, None], lines, axis=1) for values in (amplitudes, reach)]
    return ShakePlan(
        grasp_index=0,
        grasp=horizontal_grasp(np.zeros(3), np.zeros(7)),
        direction=ALONG,
        amplitude=amplitudes[0],
        frequency=float(TONES[0]),
        duration=3.0,
        press=8.0,
        predicted_amplitude=size,
        predicted_amplitude_interval=np.column_stack([size / 2, 2 * size]),
        predicted_acceleration=size,
        predicted_acceleration_interval=np.column_stack([size / 2, 2 * size]),
        score=1.0,
        limits=(),
        runner_up=None,
        regret=(),
        reason="The test's own.",
        response_map=ResponseMap(TONES, np.zeros(1), *np.ones((3, 1, len(TONES)))),
        tones=CandidateShakes(TONES, lines_across(lines), *alike),
    )


@dataclass
class World:
    """A plant that does to any shake what `truth` says, an arm that shakes it, and a camera that sees it.

    Attributes:
        foresight: what is believed.
        truth: (K, 3, S, 3) of the plant, by axis of the gripper's motion.
        shown: (F + P,) what the camera follows, by number of the look; the last one stays.
        late: of the camera's clock [s].
        noise: of what is seen [m].
        arm: (3, 3) what the gripper does of what it is told.
        soft: how much more an arm does whose joints are a standard deviation softer, ln of that.
        springs: how stiff its joints are, in standard deviations off what is believed (`grip`).
        depth: whether the camera reads how far away things are.
        imu: what an inertial sensor on the hand makes of what it reads; None: there is none.
        plan, params, limits: of the shake.
        pieces: that were asked for.
    """

    foresight: Foresight
    truth: ComplexArray
    shown: Sequence[NDArray[Any]] = field(default_factory=lambda: [np.ones(FLOWERS + POINTS, bool)])
    late: float = 0.0
    noise: float = 1e-6
    arm: Array = field(default_factory=lambda: np.eye(3))
    soft: float = 0.0
    springs: float = 0.0
    depth: bool = False
    imu: Callable[[ImuReadings], ImuReadings] | None = None
    plan: ShakePlan = field(default_factory=made_plan)
    params: Params = field(default_factory=Params)
    limits: Limits = field(default_factory=lambda: Limits(price=3.0))
    begin: float = 17.43
    pieces: list[Swing] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(1)
        self.looks = 0

    def swings(self, _: Any, frames: Sequence[Frame], tones: Array, expected: Any = None) -> Swings:
        """Return what is seen of the present piece."""
        shown = self.shown[min(self.looks, len(self.shown) - 1)] & bool(frames)
        self.looks += 1
        piece = self.pieces[-1]
        active = np.flatnonzero(piece.amplitudes)
        (direction,) = np.unique(self.directions[active], axis=0)
        now = [int(np.abs(TONES - tone).argmin()) for tone in tones]
        turned = piece.amplitudes[active] * np.exp(-2j * np.pi * tones * (self.begin + self.late))
        moved = np.array([self.answer(tone, direction)[: FLOWERS + POINTS] for tone in now])
        seen = np.einsum("kpx,pxa->kpa", moved, AXES) * turned[:, None, None]
        error = self._rng.normal(size=(2, *seen.shape))
        seen = np.swapaxes(seen + self.noise * (error[0] + 1j * error[1]), 0, 1)
        told = shown[:, None] & np.array([True, True, self.depth])
        return Swings(np.where(told[:, None], seen, np.nan), np.where(told, self.noise, np.nan), AXES)

    def escalation(self) -> Escalation:
        return Escalation(
            self.plan,
            self.foresight,
            np.zeros((FLOWERS, 3)),
            np.zeros((POINTS, 3)),
            camera=(Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5), T_WORLD_CAM),
            grip=self.grip,
            T_world_imu=None if self.imu is None else np.eye(4),
            limits=self.limits,
            params=self.params,
        )

    def grip(self, motors: ComplexArray, tones: Array, deviates: Array) -> ComplexArray:
        """Return (A, K, 3) what an arm of three straight joints does, the more the softer they are."""
        stiffer = deviates.reshape(len(deviates), -1).mean(axis=1)[:, None, None]
        return np.asarray(np.exp(-self.soft * stiffer) * motors[None, :, :3])

    def answer(self, tone: int, direction: Array = ALONG) -> ComplexArray:
        """Return (S, 3) what a shake along a direction does in truth, per metre."""
        return np.exp(-self.soft * self.springs) * np.einsum("asx,a->sx", self.truth[tone], self.arm @ direction)

    def shaken(self, watched: Escalation) -> Escalation:
        """Shake until the last piece."""
        self.directions = sum(np.outer(line.active, line.direction) for line in watched.directions)
        frame = Frame(self.begin, np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.float32))
        self.pieces, samples = [watched.begin(frame)], list[ArmSample]()
        while not self.pieces[-1].stops:
            piece = self.pieces[-1]
            for t in np.arange(0.0 if not samples else 0.01, piece.seconds + 1e-9, 0.01):
                q = np.concatenate([self.place(piece, t), np.zeros(4)])
                samples.append(ArmSample(self.begin + piece.begin + t, q, q, 0.0))
            told = [s for s in samples if s.time <= self.begin + piece.begin + piece.seconds - LEAD]
            assert samples[0].time + watched.steady_from(piece) <= told[-1].time, "there is something to look at"
            self.pieces.append(watched.next_piece(piece, [frame], told, self.readings(piece, told[-1].time)))
            assert len(self.pieces) < 40, "it ends"
        return watched

    def readings(self, piece: Swing, until: float) -> ImuReadings | None:
        """Return what the hand's sensor reads of a piece up to a time [s], without any turn."""
        if self.imu is None:
            return None
        step, begin = 1e-3, self.begin + piece.begin
        times = np.arange(begin + step, until, 0.004)
        before, now, after = (np.array([self.place(piece, t - begin + k * step) for t in times]) for k in (-1, 0, 1))
        moved = np.exp(-self.soft * self.springs) * (before - 2 * now + after) / step**2
        noise = 0.01 * np.random.default_rng(len(self.pieces)).normal(size=(2, len(times), 3))
        return self.imu(ImuReadings(times, moved + [0.0, 0.0, GRAVITY] + noise[0], noise[1]))

    def place(self, piece: Swing, time: float) -> Array:
        """Return (3,) where the pads are, some time after a piece began [m]."""
        lines = np.unique(self.directions, axis=0)
        told = sum(
            (piece.only(np.all(self.directions == line, axis=1)).motion([time])[0] * line for line in lines),
            np.zeros(3),
        )
        return self.arm @ told

    def loads(self, tone: int, direction: Array = ALONG) -> dict[str, float]:
        """Return each kind's load in truth, per metre; of pedicels what the flower that feels most bends its own by."""
        truth = self.answer(tone, direction)[None]
        loads = {kind: float(self.foresight.load(kind, truth)[0]) for kind in KINDS}
        return loads | {"joint_strain": float(stalk_strain(TONES[tone]) * self.flowers(tone, direction).max())}

    def flowers(self, tone: int, direction: Array = ALONG) -> Array:
        """Return (F,) accelerations in truth, per metre [1/s2]."""
        return (2 * np.pi * TONES[tone]) ** 2 * semi_major(self.answer(tone, direction)[:FLOWERS])
