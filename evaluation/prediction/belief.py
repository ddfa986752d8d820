r"""Is what Anther believes of a shake calibrated? Flowers and loads of plants that nobody fitted anything to.

    python -m evaluation.prediction.belief --plants 40 --jobs 2

Simulated plants whose truth is drawn wide (`anther.sim.truth.WIDE`) are scanned in ten views, modelled, held at four
places and shaken a little at fifteen tones, as an arm and a motor do. The truth is MuJoCo's linear equations. The
camera sees the nodes that are in sight at rest, each with an error of 12 % and 0.03 px; how well a measured flower is
known, only films tell (`evaluation.trials.shaking`). What is believed, before and after that observation, is every
member of the ensemble with the lognormal error of `anther.pollination.decision.error`.

A belief is calibrated where the share of it below the truth (the probability integral transform) is uniform over plants
and shakes. With --development the plants are those on which the errors were fitted, and the fit is printed.

Keys of --json: pit_error_max, how far the distribution of the transform is at most from uniform at 0.05, 0.1, ... 0.95,
over kinds and bands; passed_95, the share of truths above the 95 % quantile; both also as <key>_<kind>_<when>_<band>,
with pit_chance, which 19 of 20 samples of as many plants would stay below if the belief were right (bootstrap over
plants); pit_cells, how many kinds, times and bands there are, and pit_beyond, in how many of them the error is larger;
motor_<species>_<tone>_ms2, the median flower's median over plants and grips when a motor moves the grip as far as it
can; plants.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.optimize import minimize
from scipy.spatial import KDTree
from scipy.special import logsumexp, ndtr

from anther.core import Array, StageFailure
from anther.core.geometry import ComplexArray, transform_each
from anther.plant import Crop
from anther.plant.limits import STALK_SPREAD, stalk_strain
from anther.pollination import decision, foresee
from anther.pollination.decision import believed
from anther.pollination.escalation import watch_points
from anther.pollination.escalation._foresight import update_members
from anther.pollination.escalation._knowledge import Answer, Prediction, predict
from anther.pollination.response.points import sight
from anther.pollination.shake import VIBRATING_GRIPPER
from anther.pollination.shake._actuators import ACCELERATION, STROKE
from anther.pollination.shake.observables import semi_major
from anther.robot import Frame
from anther.sim import Scene, SimPlant, layout
from anther.sim.robot import SIDE
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import CROPS, by_turns, finish, options, run_cases
from evaluation.prediction import known_plant
from evaluation.prediction.known_plant import stem_points
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.prediction.wide_plant import looks
from evaluation.tables import by_part, markdown
from evaluation.trials.grasping_trial import truth_of

TONES = np.array([2.0, 2.7, 3.6, 4.8, 6.4, 8.5, 11.3, 14.0, 16.9, 20.0, 24.0, 34.0, 50.0, 80.0, 110.0])
SHAKEN = np.clip(TONES / 3, 1.0, 5.0)
"""Of the grip, when it is looked at [m/s2]: about what an arm and a motor begin with."""
BANDS = {"1_14": (0.0, 14.0), "14_20": (14.0, 20.0), "20_40": (20.0, 40.0), "40_120": (40.0, 120.0)}
"""[Hz]."""
HEIGHTS = (0.3, 0.45, 0.65, 0.8)
FIRST, DEVELOPMENT = 9660, (520, 9620)
SEEN_WITH = 0.12
"""Error of what a camera sees of a node's motion: relative (films of eight plants)."""
NEAR = 0.015
"""A node is where a true segment is that is no further [m]."""
LEAFY = 1e-4
"""Leaves lighter than this are no load [kg], as the planner has it."""
LARGEST = ("base_strain", "stem_strain", "leaf_load")
WORDS = {
    "flowers": "acceleration of a flower",
    "pedicels": "strain of its pedicel or peduncle",
    "base_strain": "strain of the branch, petiole or peduncle bent most",
    "stem_strain": "strain of stem and forks",
    "leaf_load": "load of the leaf loaded most",
}
WHEN = {"before": None, "after": False}
"""Before an observation, and after it of what it did not measure itself -> `decision.error`'s `measured`."""
SHARES = np.arange(0.05, 0.96, 0.05)
FEWEST = 200
"""Values of which a distribution is told; those of one plant go together."""

MOTOR = "motor"
"""Kind of what the median flower truly feels when a motor moves the grip as far as it can [m/s2]: [kind, species, tone,
[value]]."""
Value = list[Any]
"""[kind, one of `WHEN`, tone, ln of each member's value, and last of the truth]."""


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the values of a plant (species, seed), for a sweep."""
    del folder
    try:
        return {"values": list(values_of(row["species"], row["seed"]))}
    except StageFailure:
        return {"values": []}


class Grip(NamedTuple):
    """A plant held at a place, shaken a little along one direction at `TONES`. Q tones.

    Attributes:
        it: the plant, and what was seen of it.
        point, direction: (3,) where it is held [m], and along what it is shaken.
        true: by kind what a metre of the grip truly does, see `truths`.
        before: (Q,) what is believed of each shake.
        after: (Q,) the same after an observation.
    """

    it: known_plant.Known
    point: Array
    direction: Array
    true: dict[str, Array]
    before: list[decision.Answer]
    after: list[Prediction]


def grips_of(species: Crop, seed: int) -> Iterator[Grip]:
    """Yield a plant's grips at `HEIGHTS`."""
    truth = truth_of("wide", seed)
    it = known_plant.known(species, seed, truth, "fast", looks(truth))
    pose = layout(USUAL_DISTANCE).T_world_side_camera
    points = watch_points(it.model, camera=(SIDE, pose), surface=it.seen.cloud.points)
    image, watched = Scene.of_plant(it.plant).render(SIDE, pose), it.model.rods.nodes[points]
    at = sight(Frame(0.0, image.rgb, image.depth), SIDE, pose, it.seen.flowers.positions, watched)
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, np.pi)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    places = np.concatenate([it.seen.flowers.positions.reshape(-1, 3), watched])
    for height in HEIGHTS:
        grip = ShakenPlant(it.plant, stem_points(it.plant, (height,))[0], direction, truth=truth)
        foresight = foresee(it.model, grip.point, TONES, points)
        middles, motion = segment_motion(grip)
        gap, nearest = KDTree(middles).query(places)
        used, before, after = at.shown & (gap < NEAR), list[decision.Answer](), list[Prediction]()
        for k, tone in enumerate(TONES.tolist()):
            shown, std = (np.full((len(used), 3), np.nan, kind) for kind in (complex, float))
            shown[used] = np.einsum("px,pxa->pa", motion[k, nearest[used]], at.axes[used])
            size = np.linalg.norm(shown[used, :2], axis=1, keepdims=True)
            noise = rng.normal(size=(2, used.sum(), 3)) / np.sqrt(2)
            shown[used] += SEEN_WITH * size * (noise[0] + 1j * noise[1])
            std[used] = 0.03 * at.per_pixel[used, None] * (2 * np.pi * tone) ** 2 / SHAKEN[k] * [1, 1, np.nan]
            members = foresight.of(k, direction)
            own = slice(len(it.seen.flowers.positions))
            of = Answer(update_members(members, shown, std, at.axes, k), shown[own], std[own], at.axes[own])
            before.append(foresight.answer(members, tone))
            after.append(predict(foresight, tone, of, 0.0))
        yield Grip(it, grip.point, direction, truths(grip, middles, motion), before, after)


def values_of(species: Crop, seed: int) -> Iterator[Value]:
    """Yield a value for each grip, tone, kind and flower that was found."""
    for it, _, _, true, before, after in grips_of(species, seed):
        yield from (
            [MOTOR, species, tone, [float(np.median(felt)) * motor_amplitude(tone)]]
            for tone, felt in zip(TONES.tolist(), true["flowers"], strict=True)
            if len(felt)
        )
        for k, tone in enumerate(TONES.tolist()):
            for answer, when in ((before[k], "before"), (after[k].answer, "after")):
                found = [(kind, true[kind][k], getattr(answer, kind)) for kind in LARGEST]
                for i, j in zip(it.i.tolist(), it.j.tolist(), strict=True):
                    if when == "before" or not after[k].seen[i]:
                        found.append(("flowers", true["flowers"][k, j], answer.flowers[:, i]))
                        found.append(
                            ("pedicels", max(true["pedicels"][k, j], true["peduncles"][k, j]), answer.flowers[:, i])
                        )
                for kind, truly, values in found:
                    if truly > 0 and values.min(initial=1.0) > 0:
                        yield [kind, when, tone, np.round(np.log([*values, truly]), 4).tolist()]


def motor_amplitude(tone: float) -> float:
    """Return how far a motor in the gripper can move the grip at a tone [Hz], whatever its band [m]."""
    return min(STROKE, ACCELERATION / (2 * np.pi * tone) ** 2)


def truths(grip: ShakenPlant, middles: Array, motion: ComplexArray) -> dict[str, Array]:
    """Return by kind what a metre of the grip truly does at `TONES`: (Q,), or (Q, F) of each flower."""
    strain = semi_major(grip.bending(TONES))
    strains, (pedicels, peduncles) = grip.by_kind(strain), grip.flower_stalks(strain)
    return {
        "flowers": semi_major(grip.linear(TONES)) * (2 * np.pi * TONES[:, None]) ** 2,
        "pedicels": pedicels,
        "peduncles": peduncles,
        "base_strain": strains["base"].max(axis=1, initial=0.0),
        "stem_strain": strains["stem"].max(axis=1, initial=0.0),
        "leaf_load": leaf_load(grip.plant, middles, motion),
    }


def segment_motion(grip: ShakenPlant) -> tuple[Array, ComplexArray]:
    """Return where the plant's segments (K, 3) have their mass, and how a metre of the grip moves that (Q, K, 3)."""
    plant, tiny = grip.plant, 1e-4
    middle = plant.mass_centres()
    motion = []
    for tone in TONES:
        times = np.arange(8) / (8 * tone)
        poses = np.array([grip.segment_poses(q) for q in grip.swing(tiny, tone, times)])
        path = transform_each(poses, middle)
        turned = 2j / 8 * np.exp(-2j * np.pi * tone * times)
        motion.append(np.einsum("tki,t->ki", path - path.mean(axis=0), turned) / tiny)
    return path.mean(axis=0), np.array(motion)


def leaf_load(plant: SimPlant, middles: Array, motion: ComplexArray) -> Array:
    """Return (Q,) the largest inertia torque about a leaf's base over its sum of mass times distance [1/s2]."""
    owner, mass, largest = plant.leaf_of(), plant.mass + plant.lump_mass, np.zeros(len(TONES))
    for b in plant.leaf_bases():
        own = np.flatnonzero(owner == b)
        if plant.lump_mass[own].sum() < LEAFY:
            continue
        lever = middles[own] - plant.start[b]
        torque = np.einsum("k,qki->qi", mass[own], np.cross(lever, motion[:, own]))
        moment = np.sum(mass[own] * np.linalg.norm(lever, axis=1))
        largest = np.maximum(largest, (2 * np.pi * TONES) ** 2 * semi_major(torque) / moment)
    return largest


def chosen(values: list[Value], kind: str, when: str, band: str) -> list[Value]:
    """Return the values of a kind, one of `WHEN` and one of `BANDS`."""
    low, high = BANDS[band]
    return [value for value in values if value[0] == kind and value[1] == when and low < value[2] <= high]


def transform(value: Value) -> float:
    """Return the share of what was believed that lies below the truth."""
    kind, when, tone, (*members, truth) = value
    logs, spread = believed(kind.replace("pedicels", "flowers"), np.exp(members), tone, WHEN[when])
    if kind == "pedicels":
        logs, spread = logs + np.log(stalk_strain(tone)), np.hypot(spread, STALK_SPREAD)
    return float(ndtr((truth - logs) / spread).mean())


def by_chance(shares: Array, plant: NDArray[np.int64]) -> float:
    """Return how far apart the distributions of shares (n,) are, of 19 in 20 samples of as many plants (n,)."""
    _, plant = np.unique(plant, return_inverse=True)
    count = np.bincount(plant)
    below = np.zeros((len(count), len(SHARES)))
    np.add.at(below, plant, shares[:, None] <= SHARES)
    drawn = np.random.default_rng(0).multinomial(len(count), np.full(len(count), 1 / len(count)), 400)
    apart = (drawn @ below) / (drawn @ count)[:, None] - below.sum(axis=0) / count.sum()
    return float(np.quantile(np.abs(apart).max(axis=1), 0.95))


def metrics(of_plants: list[list[Value]]) -> dict[str, float]:
    """Return the table's numbers, of the values of each plant."""
    table: dict[str, float] = {"plants": float(sum(bool(part) for part in of_plants))}
    moved = [value for part in of_plants for value in part if value[0] == MOTOR]
    numbered = [(n, value) for n, part in enumerate(of_plants) for value in part if value[0] != MOTOR]
    for species, tone in product(CROPS, TONES[VIBRATING_GRIPPER.lowest <= TONES]):
        felt = [value[3][0] for value in moved if value[1] == species and value[2] == tone]
        if felt:
            table[f"motor_{species}_{tone:.0f}_ms2"] = float(np.median(felt))
    plant, all_shares = np.array([n for n, _ in numbered]), np.array([transform(value) for _, value in numbered])
    errors, beyond = list[float](), 0
    for kind, when, (band, (low, high)) in product(WORDS, WHEN, BANDS.items()):
        cell = np.array([v[0] == kind and v[1] == when and low < v[2] <= high for _, v in numbered], dtype=bool)
        shares = all_shares[cell]
        if len(shares) >= FEWEST:
            below = np.array([np.mean(shares <= share) for share in SHARES])
            errors.append(float(np.abs(below - SHARES).max()))
            chance = by_chance(shares, plant[cell])
            beyond += errors[-1] > chance
            table[f"pit_error_{kind}_{when}_{band}"] = errors[-1]
            table[f"pit_chance_{kind}_{when}_{band}"] = chance
            table[f"passed_95_{kind}_{when}_{band}"] = float(np.mean(shares > 0.95))
    table |= {"pit_cells": float(len(errors)), "pit_beyond": float(beyond)}
    table["pit_error_max"] = max(errors, default=np.nan)
    table["passed_95"] = float(np.mean(all_shares > 0.95)) if numbered else np.nan
    return table


def report(table: dict[str, float]) -> Table:
    """Return the table by kind and band, before and after an observation."""
    cell = "pit_error_*_{0}:.2f (pit_chance_*_{0}:.2f) / passed_95_*_{0}:.0%"
    numbers = {
        f"{when}, {band.replace('_', '–')} Hz": cell.format(f"{when}_{band}") for when, band in product(WHEN, BANDS)
    }
    return by_part(table, "furthest from uniform (by chance) / above the 95 % quantile", WORDS, numbers)


def by_motor(table: dict[str, float]) -> Table:
    """Return what the median flower feels when a motor moves the grip as far as it can, by frequency."""
    tones = {f"{tone:.0f} Hz": f"motor_*_{tone:.0f}_ms2:.0f" for tone in TONES[VIBRATING_GRIPPER.lowest <= TONES]}
    return by_part(table, "a motor at its limit: median flower (m/s2)", {crop: crop for crop in CROPS}, tones)


def fitted(values: list[Value]) -> Table:
    """Return what is likeliest: intercept, slope and spread, as `anther.pollination.decision.ERRORS` has them."""
    text = markdown(["what", "when", *(band.replace("_", "–") for band in BANDS)])
    for kind, when in product(WORDS, WHEN):
        cells = [_likeliest(chosen(values, kind, when, band)) for band in BANDS]
        text.add_row(kind, when, *cells)
    return text


def _likeliest(values: list[Value]) -> str:
    if len(values) < 2:
        return "–"
    inertia = 2 * np.log(2 * np.pi * np.array([[value[2]] for value in values]))
    rows = np.array([value[3] for value in values]) - inertia
    members, truth = rows[:, :-1], rows[:, -1:]
    middle = members.mean()

    def unlikely(guess: Array) -> float:
        """Of an offset at the middle of what is modelled, a slope, and ln of a spread."""
        parts = (truth - middle - guess[0] - guess[1] * (members - middle)) / np.exp(guess[2])
        return float(guess[2] - logsumexp(-(parts**2) / 2, axis=1).mean())

    start = [float(truth.mean() - middle), 1.0, float(np.log((truth[:, 0] - members.mean(axis=1)).std()))]
    offset, slope, log_spread = minimize(unlikely, start, method="Nelder-Mead").x
    return f"{offset + (1 - slope) * middle:+.2f}, {slope:.2f}, {np.exp(log_spread):.2f}"


def main() -> None:
    """Run what is missing and print the table."""
    own = {
        "--plants": (40, "tomatoes and peppers by turns"),
        "--development": (False, "the plants on which the errors were fitted"),
    }
    seed = (0, "added to the seeds of all plants")
    args = options(__doc__, quick="two plants", seed=seed, jobs="plants", out="runs/belief", own=own)
    count = 2 if args.quick else args.plants
    firsts = DEVELOPMENT if args.development else (FIRST,)
    plants = [plant for first in firsts for plant in by_turns(count // len(firsts), first + args.seed)]
    cases = [{"species": species, "seed": seed} for species, seed in plants]
    done = [part["values"] for part in run_cases(one_plant, cases, args.out, args.jobs, lambda _: {"values": []})]
    width = min((len(value[3]) for part in done for value in part if value[0] != MOTOR), default=0)
    done = [[v if v[0] == MOTOR else [*v[:3], [*v[3][: width - 1], v[3][-1]]] for v in part] for part in done]
    table = metrics(done)
    words = f"{table['plants']:.0f} plants, {len(HEIGHTS)} grips, {len(TONES)} tones each."
    finish(
        args,
        table,
        words,
        report(table),
        by_motor(table),
        *([fitted([v for part in done for v in part])] if args.development else []),
    )


if __name__ == "__main__":
    main()
