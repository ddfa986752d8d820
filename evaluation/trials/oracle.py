"""The best shake of a plant that is known: what every way of shaking falls short of.

Plant, truth and actuator are a trial's, and shakes are judged as a trial is (`anther.sim.judge.net_fruit`): a lost
flower costs one fruit. First every grip, direction, tone and amplitude of a grid is tried in MuJoCo's linear equations
(`prediction.shaken_plant`), of the plant cut as in the robot's cell. The best is then simulated, and made gentler as
long as that is worth more: at such swings the plant is not linear (the best of a motor on tomato 8151 was to lose no
flower of 17, and lost 14).

It is no trial: any place of the stem and any horizontal direction are free, there is no arm, and there are no ramps.
Whether the pads slip and what leaves bear is told by the linear equations alone. Nor is it the best that there is: what
the linear equations value wrongly is not found.
Q tones, D directions, A amplitudes, F flowers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from anther.core import Array, StageFailure
from anther.plant import Crop
from anther.plant.limits import MOVED
from anther.pollination.grasp import Grasp
from anther.pollination.shake import VIBRATING_GRIPPER, Actuator, arm_shaker
from anther.pollination.shake.choice import DIRECTIONS, MOST_SPEED
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import PADS, friction_force
from anther.pollination.shake.params import Params
from anther.robot.pressing import PRESSING
from anther.sim import SimPlant, Truth, cell, grow
from anther.sim.judge import LEAF_BAND, Harm, lost_flowers, net_fruit, pollen_freed, usual_peak
from anther.sim.simulated_cell import USUAL_DISTANCE
from anther.sim.truth import DOSE_MEASURES, tolerances
from evaluation.prediction import shaken_plant
from evaluation.prediction.known_plant import stem_points
from evaluation.prediction.shaken_plant import ShakenPlant

SHARES = tuple(np.linspace(0.15, 0.9, 8))
"""Heights of the grips, of the stem's length."""
TONES, SIZES = 40, 24
"""So many of each, evenly on a logarithmic scale."""
MEASURES: dict[str, str | None] = {**{name: name for name in DOSE_MEASURES}, "drawn": None}
"""Name -> argument of `net_fruit`."""
ACTUATORS = {"oracle": arm_shaker(), "oracle_motor": VIBRATING_GRIPPER}
"""Way of shaking -> the machine. A Sawyer manages what its table says, not what the joints of one grasp do."""
GENTLER = (1.0, 0.8, 0.6, 0.45, 0.3)
CUT = shaken_plant.Params(settle=0.6, measure=0.5, plant=cell.Params().plant)
"""A simulation begins in the steady swing of the linear equations, so that little has to settle."""
ACCELERATIONS = "true_flower_acceleration_peak_ms2"
LOADS = {"stem": "stem_strain", "pedicel": "pedicel_strain", "base": "base_strain", "leaf": "leaf_acceleration_ms2"}


class Shakes(NamedTuple):
    """Shakes from one grip, and what each does.

    Attributes:
        point: (3,) the grip's [m].
        amplitude: (A, Q, D) of the grip [m]; 0 where the machine cannot be trusted with as little as it can.
        hertz: (Q, 1).
        directions: (D, 3).
        felt: (A, Q, D, F) peak acceleration of each flower [m/s2].
        pedicels, peduncles: (A, Q, D, F) peak of their bending strains [-].
        loads: kind of `sim.truth.TOLERANCE` -> (A, Q, D) the largest load.
        slipped: (A, Q, D) whether the pads' friction holds less than the plant pulls.
    """

    point: Array
    amplitude: Array
    hertz: Array
    directions: Array
    felt: Array
    pedicels: Array
    peduncles: Array
    loads: Mapping[str, Array]
    slipped: Array

    def net(self, limits: Mapping[str, float], measure: str | None) -> Array:
        """Return (A, Q, D) what each is worth on a plant that bears these limits."""
        lost = lost_flowers(self.pedicels, self.peduncles, limits).mean(axis=-1) if self.felt.shape[-1] else 0.0
        bent = {kind: load > limits[kind] for kind, load in self.loads.items()}
        return net_fruit(self.felt, self.hertz, lost, bent, self.slipped, measure)

    def outcome(self, at: tuple[Any, ...], limits: Mapping[str, float]) -> Outcome:
        """Return one of them, at its place in (A, Q, D)."""
        loads = {kind: float(load[at]) for kind, load in self.loads.items()}
        harm = Harm(loads, limits, self.pedicels[at], self.peduncles[at])
        hertz, amplitude = float(self.hertz[at[1], 0]), float(self.amplitude[at])
        return Outcome(self.point, self.directions[at[2]], hertz, amplitude, self.felt[at], harm)


class Outcome(NamedTuple):
    """What one shake does, which does not slip.

    Attributes:
        point, direction: (3,) of the grip [m], of its motion.
        hertz: [Hz].
        amplitude: of the grip [m].
        felt: (F,) peak acceleration of each flower [m/s2].
        harm: what the plant bore, and what it bears.
    """

    point: Array
    direction: Array
    hertz: float
    amplitude: float
    felt: Array
    harm: Harm

    def net(self, measure: str | None) -> float:
        """Return what it was worth."""
        bent = {kind: load > self.harm.limits[kind] for kind, load in self.harm.loads.items()}
        lost = self.harm.flowers_lost / max(len(self.felt), 1)
        return float(net_fruit(self.felt, self.hertz, lost, bent, measure=measure))

    @property
    def row(self) -> dict[str, Any]:
        """Its row, with the keys of a trial's."""
        felt, harm = self.felt, self.harm
        freed = dict(zip(("low", "median", "high"), pollen_freed(felt), strict=True))
        return {
            "success": not harm.passed,
            "message": harm.words,
            "harmed": ", ".join(harm.passed),
            "harm_probability": harm.probability,
            "grip_point": self.point.tolist(),
            "direction": self.direction.tolist(),
            "shake_frequency_hz": self.hertz,
            "shake_amplitude_m": self.amplitude,
            ACCELERATIONS: felt.tolist(),
            "true_flower_acceleration_median_ms2": float(np.median(felt)) if len(felt) else None,
            "share_above_5_ms2": float(np.mean(felt > MOVED)) if len(felt) else None,
            "true_pedicel_strains": harm.pedicels.tolist(),
            "true_peduncle_strains": harm.peduncles.tolist(),
            "flowers_lost": harm.flowers_lost,
            **{f"pollen_freed_{which}": value for which, value in freed.items()},
            **{f"true_{name}": harm.loads[kind] for kind, name in LOADS.items()},
            **{f"borne_{name}": harm.limits[kind] for kind, name in LOADS.items()},
        }


def foreseen(species: Crop, seed: int, viewpoint: float, truth: Truth, way: str) -> dict[str, Any]:
    """Return the row of the best shake, with the keys of a trial's.

    Key `best`: measure of motion -> what a shake is worth at most; `promised`: the same by the linear equations.

    Args:
        species, seed, viewpoint: of the plant, as `sim.build` takes them.
        truth: of plant and pads.
        way: of `ACTUATORS`.
    """
    plant, actuator = grow(species, seed, viewpoint, USUAL_DISTANCE, truth), ACTUATORS[way]
    promised = best(tried(plant, truth, actuator), tolerances(species, seed))
    shakes = {(*one.point, *one.direction, one.hertz, one.amplitude): (one, name) for name, one in promised.items()}
    done = [
        outcome
        for shake, name in shakes.values()
        for outcome in gentler(plant, truth, shake, MEASURES[name], actuator.least_amplitude)
    ]
    return told(done) | {"promised": {name: one.net(MEASURES[name]) for name, one in promised.items()}}


def best(grips: Iterable[Shakes], limits: Mapping[str, float]) -> dict[str, Outcome]:
    """Return the best of all shakes by each of `MEASURES`, where one is worth anything."""
    found, most = dict[str, Outcome](), dict.fromkeys(MEASURES, 0.0)
    for shakes in grips:
        for name, measure in MEASURES.items():
            net = shakes.net(limits, measure)
            at = np.unravel_index(int(net.argmax()), net.shape)
            if net[at] > most[name]:
                most[name], found[name] = float(net[at]), shakes.outcome(at, limits)
    return found


def gentler(plant: SimPlant, truth: Truth, shake: Outcome, measure: str | None, least: float) -> Iterator[Outcome]:
    """Yield a shake as it is simulated, then gentler ones of `least` or more [m], until one is worth less."""
    grip, worth = ShakenPlant(plant, shake.point, shake.direction, CUT, truth), -np.inf
    for share in GENTLER:
        if share < 1 and share * shake.amplitude < least:
            return
        try:
            one = simulated(grip, shake, share)
        except StageFailure:  # too far for MuJoCo
            continue
        yield one
        if one.net(measure) < worth:
            return
        worth = one.net(measure)


def simulated(grip: ShakenPlant, shake: Outcome, share: float = 1.0) -> Outcome:
    """Return what a share of a shake does by MuJoCo; the leaves' load is that share of the shake's own.

    Raises:
        StageFailure: "no_convergence": the simulation became unstable.
    """
    done = grip.steady(share * shake.amplitude, shake.hertz)
    step = float(np.median(np.diff(done.times)))
    size = np.linalg.norm(np.diff(done.flowers, 2, axis=0), axis=2) / step**2
    felt = usual_peak(size, 1 / (step * shake.hertz))
    swung = np.max([grip.mechanics.strain(q) for q in done.qpos - done.qpos.mean(axis=0)], axis=0)
    loads = {kind: float(values.max(initial=0.0)) for kind, values in grip.by_kind(swung).items()}
    harm = Harm(loads | {"leaf": share * shake.harm.loads["leaf"]}, shake.harm.limits, *grip.flower_stalks(swung))
    return shake._replace(amplitude=share * shake.amplitude, felt=felt, harm=harm)


def told(done: Sequence[Outcome]) -> dict[str, Any]:
    """Return the row of the best of some shakes, or of leaving the plant alone; `best`: see `foreseen`."""
    most = {name: max([0.0, *(one.net(measure) for one in done)]) for name, measure in MEASURES.items()}
    first = max(done, key=lambda one: one.net("acceleration"), default=None)
    worthy = first is not None and first.net("acceleration") > 0
    row = first.row if first is not None and worthy else {"success": True, "message": "none is worth anything"}
    return row | {"held": True, "failure": None, "best": most}


def tried(plant: SimPlant, truth: Truth, actuator: Actuator, shares: Sequence[float] = SHARES) -> Iterator[Shakes]:
    """Yield the shakes from each grip."""
    tones = np.geomspace(actuator.lowest, actuator.highest, TONES)
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)], axis=1)
    points, radii, _ = plant.stem_centreline()
    for point in stem_points(plant, shares):
        grip = ShakenPlant(plant, point, directions[0], CUT, truth)
        radius = float(radii[np.linalg.norm(points - grip.point, axis=1).argmin()])
        most = reach(actuator, grip.point, directions, tones)
        yield shakes_of(grip, tones, directions, most, actuator.least_amplitude, friction(truth, radius), radius)


def reach(actuator: Actuator, point: Array, directions: Array, tones: Array) -> Array:
    """Return (Q, D) the largest amplitude that an actuator gives a grip at a point (3,), approached from the base [m].

    With what it does over what it is commanded, at the median.
    """
    along = point * [1.0, 1.0, 0.0]
    grasp = cast(Grasp, SimpleNamespace(approach=along / np.linalg.norm(along)))
    most = np.stack([actuator.amplitude(grasp, direction, tones) for direction in directions], axis=1)
    most = np.minimum(most, np.minimum(Params().most_amplitude, MOST_SPEED / (2 * np.pi * tones))[:, None])
    if actuator.closing:
        return most
    # ln of what an arm's grip does over its command: 12 simulated Sawyers that hold nothing
    does = np.interp(np.log(tones), np.log([3.0, 7.0, 12.0, 17.0, 23.5, 31.0]), [0.15, 0.23, 0.13, 0.01, -0.26, -0.58])
    return np.asarray(most * np.exp(does)[:, None])


def friction(truth: Truth, radius: float) -> float:
    """Return the pull that both pads truly hold on a stem of a radius [m], pressed as the planner asks [N]."""
    return float(truth.pad_friction * (2 - truth.pad_wear) * PRESSING.most(2 * radius))


def shakes_of(
    grip: ShakenPlant, tones: Array, directions: Array, most: Array, least: float, holds: float, radius: float
) -> Shakes:
    """Return the shakes of a grip, from `least` up to `most` (Q, D) [m], none where that is less.

    `holds`: the pull that the pads hold [N]; `radius`: of the stem [m].
    """
    found, hertz = grip.across(tones), tones[:, None]

    def size(values: Array) -> Array:
        """Return (Q, D, ...) the peaks of vectors (Q, 2, ..., 2 or 3) that shakes along x and y cause."""
        return semi_major(np.einsum("dk,qk...->qd...", directions[:, :2], values))

    strain, omega2 = size(found.bending), (2 * np.pi * hertz) ** 2
    slow = 1 / (1 + (hertz / LEAF_BAND) ** 4)  # the judge's filter, there and back
    loads = grip.by_kind(strain) | {"leaf": size(found.leaves) * (omega2 * slow)[..., None]}
    pull, moment = found.load[..., :2], found.load[..., 2:]
    pulls = friction_force(size(pull), size(moment[..., :2]), size(moment[..., 2:]), radius=radius, width=PADS.width)
    ratio = np.maximum(most / least, 1.0) ** np.linspace(0, 1, SIZES)[:, None, None]
    amplitude = np.where(most < least, 0.0, least * ratio)
    felt, *stalks = (
        amplitude[..., None] * values
        for values in (size(found.flowers) * omega2[..., None], *grip.flower_stalks(strain))
    )
    largest = {kind: amplitude * values.max(axis=-1, initial=0.0) for kind, values in loads.items()}
    return Shakes(grip.point, amplitude, hertz, directions, felt, *stalks, largest, amplitude * pulls > holds)
