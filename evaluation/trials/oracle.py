"""The best shake of a plant that is known: what every way of shaking falls short of.

Plant, truth and actuator are a trial's. Every grip, direction, tone and amplitude of a grid is judged as a trial is
(`anther.sim.judge.net_fruit`), so a lost flower costs one fruit; the motions are those of MuJoCo's linear equations
(`prediction.shaken_plant`), of the plant cut as in the robot's cell.

It is an upper bound that a trial cannot quite reach: any place of the stem and any horizontal direction are free, the
stem is not strained by how the pads displace it, and there are no ramps. The air's drag is left out; at 5 mm and 3 Hz
it changes a flower by up to 7 %, at 8 Hz and more by 2 % (a tomato and a pepper).
Q tones, D directions, A amplitudes, F flowers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from anther.core import Array
from anther.plant import Crop
from anther.plant.limits import MOVED
from anther.pollination.grasp import Grasp
from anther.pollination.shake import VIBRATING_GRIPPER, Actuator, arm_shaker
from anther.pollination.shake.choice import DIRECTIONS, MOST_SPEED
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import PADS, friction_force
from anther.pollination.shake.params import Params
from anther.robot.pressing import PRESSING
from anther.sim import Organ, SimPlant, Truth, cell, grow
from anther.sim.judge import LEAF_BAND, Harm, lost_flowers, net_fruit, pollen_freed
from anther.sim.simulated_cell import USUAL_DISTANCE
from anther.sim.truth import DOSE_MEASURES, TOLERANCE, tolerances
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


def foreseen(species: Crop, seed: int, viewpoint: float, truth: Truth, way: str) -> dict[str, Any]:
    """Return the row of the best shake, with the keys of a trial's; `best`: what one is worth at most by each measure.

    Args:
        species, seed, viewpoint: of the plant, as `sim.build` takes them.
        truth: of plant and pads.
        way: of `ACTUATORS`.
    """
    plant = grow(species, seed, viewpoint, USUAL_DISTANCE, truth)
    return best(tried(plant, truth, ACTUATORS[way]), tolerances(species, seed))


def best(grips: Iterable[Shakes], limits: Mapping[str, float]) -> dict[str, Any]:
    """Return the row of the best of all shakes on a plant that bears these limits; see `foreseen`."""
    row: dict[str, Any] = {"success": True, "held": True, "failure": None, "message": "none is worth anything"}
    most = dict.fromkeys(MEASURES, 0.0)
    for shakes in grips:
        for name, measure in MEASURES.items():
            net = shakes.net(limits, measure)
            at = np.unravel_index(int(net.argmax()), net.shape)
            if net[at] > most[name]:
                most[name] = float(net[at])
                row = _row(shakes, at, limits) if name == "acceleration" else row
    return row | {"best": most}


def tried(plant: SimPlant, truth: Truth, actuator: Actuator, shares: Sequence[float] = SHARES) -> Iterator[Shakes]:
    """Yield the shakes from each grip."""
    tones = np.geomspace(actuator.lowest, actuator.highest, TONES)
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)], axis=1)
    cut = shaken_plant.Params(plant=cell.Params().plant)
    points, radii, _ = plant.stem_centreline()
    for point in stem_points(plant, shares):
        grip = ShakenPlant(plant, point, directions[0], cut, truth)
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
    return most * np.exp(actuator.delivers(tones)[0])[:, None]


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

    plant, pieces, omega2 = grip.mechanics.plant, grip.mechanics.pieces, (2 * np.pi * hertz) ** 2
    strain, organ = size(found.bending), plant.organ[pieces.first]
    trunk, stalk = np.isin(organ, (Organ.STEM, Organ.BRANCH)), organ == Organ.PEDICEL
    slow = 1 / (1 + (hertz / LEAF_BAND) ** 4)  # the judge's filter, there and back
    loads = {"stem": strain[..., trunk], "pedicel": strain[..., stalk], "base": strain[..., ~trunk & ~stalk]}
    loads["leaf"] = size(found.leaves) * (omega2 * slow)[..., None]
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


def _row(shakes: Shakes, at: tuple[Any, ...], limits: Mapping[str, float]) -> dict[str, Any]:
    """Return the row of a shake at (A, Q, D), which does not slip."""
    loads, felt = {kind: float(load[at]) for kind, load in shakes.loads.items()}, shakes.felt[at]
    harm = Harm(loads, limits, shakes.pedicels[at], shakes.peduncles[at])
    freed = dict(zip(("low", "median", "high"), pollen_freed(felt), strict=True))
    return {
        "success": not harm.passed,
        "held": True,
        "failure": None,
        "message": harm.words,
        "harmed": ", ".join(harm.passed),
        "harm_probability": harm.probability,
        "grip_point": shakes.point.tolist(),
        "direction": shakes.directions[at[2]].tolist(),
        "shake_frequency_hz": float(shakes.hertz[at[1], 0]),
        "shake_amplitude_m": float(shakes.amplitude[at]),
        "true_flower_acceleration_peak_ms2": felt.tolist(),
        "true_flower_acceleration_median_ms2": float(np.median(felt)) if len(felt) else None,
        "share_above_5_ms2": float(np.mean(felt > MOVED)) if len(felt) else None,
        "true_pedicel_strains": harm.pedicels.tolist(),
        "true_peduncle_strains": harm.peduncles.tolist(),
        "flowers_lost": harm.flowers_lost,
        **{f"pollen_freed_{which}": value for which, value in freed.items()},
        **{f"true_{LOADS[kind]}": loads[kind] for kind in TOLERANCE},
        **{f"borne_{LOADS[kind]}": limits[kind] for kind in TOLERANCE},
    }
