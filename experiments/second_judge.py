"""Two truths of one plant: rigid pieces on sprung hinges in MuJoCo (the judge) against a frame of finite elements.

Plants: three tomatoes and two peppers of the simulated greenhouse. Each is held at the middle of its main stem and
shaken sideways at twelve frequencies from 1 to 30 Hz; small motion about the shape in which it hangs. Both get the same
truth (segments, lumps, twist, joints, foot) and the same damping ratio in every mode; they share no code. The judge is
asked as it is used (pieces of 25 mm), and with finer pieces without rotor inertia. The frame is held where the judge
holds.

Difference of a plant at a frequency: the sum over flowers of |judge - frame| over that of the frame, of semi-major axes
per metre of grip.

Keys of the --json file: second_judge_error_max (largest over plants and frequencies, finest pieces),
second_judge_error_median (over plants and frequencies) and second_judge_error_plant_median_max (largest over plants of
the median over frequencies), second_judge_flower_error_max and second_judge_flower_error_median (single flowers); the
same with _as_used behind for the judge as it is used; second_judge_extrapolated_max, _median and
_share_within_3_percent (of plants and frequencies), the difference extrapolated from pieces of 12 and 6 mm to none (not
with --quick); hysteretic_change_median and hysteretic_change_max (frame: material with the loss factor that its damping
ratio means, against modal damping); frame_mesh_change_max (frame: elements of half the length); plants, flowers,
plants_that_buckle (passed over), finest_piece_mm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from frame_fe import Array, ComplexArray, hysteretic_response, modal_response
from frame_plant import FramedPlant
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.files import write_json
from anther.sim import plant_mechanics
from anther.sim.pepper import grow_pepper
from anther.sim.plant import SimPlant
from anther.sim.shaken_plant import Params, ShakenPlant
from anther.sim.tomato import grow_tomato
from anther.vibration.observables import semi_major

FREQUENCIES = np.geomspace(1, 30, 12)
ELEMENT = 0.01
"""Longest element of the frame [m]."""
DAMPED_BELOW = 60.0
"""Modes faster than this are undamped in the frame [Hz]: they follow a shake of 30 Hz as springs do."""
STIFF = 3000.0
"""Slowest rotor inertia of the finer judges [Hz]: none to speak of."""
TOMATOES, PEPPERS = 3, 2


@dataclass(frozen=True, eq=False)
class Comparison:
    """One plant.

    Attributes:
        name: species and seed.
        judged: by longest piece [mm], (Q, F, 3) flower motion of the judge per metre of grip; 0: as it is used.
        framed: likewise, those of the frame held at the same point.
        hysteretic: (Q, F) of the frame with material damping, held as the judge that is used.
        halved: (Q, F) of the frame with elements half as long, likewise.
    """

    name: str
    judged: dict[float, ComplexArray]
    framed: dict[float, ComplexArray]
    hysteretic: Array
    halved: Array

    def differences(self, piece: float) -> Array:
        """Return (Q,) the judge's difference from the frame, the flowers weighted by their amplitude."""
        return weighted(semi_major(self.judged[piece]), semi_major(self.framed[piece]))

    def flower_differences(self, piece: float) -> Array:
        """Return (Q, F) every flower's."""
        return np.abs(semi_major(self.judged[piece]) / semi_major(self.framed[piece]) - 1)

    def extrapolated(self, coarse: float, fine: float) -> Array:
        """Return (Q,) what remains of the difference for ever finer pieces, if it is of first order in their length."""
        gap = {piece: self.judged[piece] - self.framed[piece] for piece in (coarse, fine)}
        limit = self.framed[fine] + (coarse * gap[fine] - fine * gap[coarse]) / (coarse - fine)
        return weighted(semi_major(limit), semi_major(self.framed[fine]))


def weighted(found: Array, reference: Array) -> Array:
    """Return (Q,) the sum over flowers (Q, F) of |found - reference| over that of the reference."""
    return np.abs(found - reference).sum(axis=1) / reference.sum(axis=1)


def framed(plant: SimPlant, point: Array, direction: Array, size: float = ELEMENT) -> FramedPlant:
    """Return the plant as a frame in which the judge's organs twist."""
    return FramedPlant(plant, point, direction, size=size, twisting=plant_mechanics.TWISTING)


def modal_motion(frame: FramedPlant) -> ComplexArray:
    """Return (Q, F, 3) the flowers' motion per metre of grip, each mode damped as the truth states."""
    return frame.flowers(modal_response(frame.frame, frame.shake, FREQUENCIES, damped_below=DAMPED_BELOW))


def compare(plant: SimPlant, pieces_mm: tuple[float, ...], direction: Array) -> Comparison:
    """Shake one plant in both codes.

    Args:
        plant: ground truth.
        pieces_mm: longest pieces of the finer judges.
        direction: (3,) of the shake.
    """
    stem = plant.stem_centreline()[0]
    point = stem[len(stem) // 2]
    fine = [
        Params(plant=plant_mechanics.Params(p / 1e3, stiffest=STIFF, foliage=STIFF, twist_every=1)) for p in pieces_mm
    ]
    judged: dict[float, ComplexArray] = {}
    frames: dict[float, FramedPlant] = {}
    for piece, params in zip((0.0, *pieces_mm), (Params(), *fine), strict=True):
        shaken = ShakenPlant(plant, point, direction, params)
        judged[piece] = shaken.linear(FREQUENCIES)
        frames[piece] = framed(plant, shaken.point, direction)
    used = frames[0.0]
    lossy = semi_major(used.flowers(hysteretic_response(used.frame, used.shake, FREQUENCIES)))
    halved = semi_major(modal_motion(framed(plant, used.mesh.nodes[used.shake.node], direction, ELEMENT / 2)))
    moved = {piece: modal_motion(frame) for piece, frame in frames.items()}
    return Comparison(f"{plant.species} {plant.seed}", judged, moved, lossy, halved)


def standing(grow: Callable[[int], SimPlant], seed: int, count: int) -> tuple[list[SimPlant], int]:
    """Return the first plants from a seed on that carry their weight in the frame, and how many do not."""
    found: list[SimPlant] = []
    passed = 0
    while len(found) < count:
        plant = grow(seed + len(found) + passed)
        stem = plant.stem_centreline()[0]
        try:
            framed(plant, stem[len(stem) // 2], np.eye(3)[0]).frame.modes(1.0)
            found.append(plant)
        except ValueError:
            passed += 1
    return found, passed


def metrics(rows: list[Comparison], finest: float) -> dict[str, float]:
    """Return the keys that the module's docstring names, but for how the plants were chosen."""
    out: dict[str, float] = {}
    for piece, tail in ((finest, ""), (0.0, "_as_used")):
        plants = np.array([row.differences(piece) for row in rows])
        flowers = np.concatenate([row.flower_differences(piece).ravel() for row in rows])
        out[f"second_judge_error_max{tail}"] = float(plants.max())
        out[f"second_judge_error_median{tail}"] = float(np.median(plants))
        out[f"second_judge_error_plant_median_max{tail}"] = float(np.median(plants, axis=1).max())
        out[f"second_judge_flower_error_max{tail}"] = float(flowers.max())
        out[f"second_judge_flower_error_median{tail}"] = float(np.median(flowers))
    if len(rows[0].judged) > 2:
        limits = np.array([row.extrapolated(2 * finest, finest) for row in rows])
        out["second_judge_extrapolated_max"] = float(limits.max())
        out["second_judge_extrapolated_median"] = float(np.median(limits))
        out["second_judge_extrapolated_share_within_3_percent"] = float(np.mean(limits < 0.03))
    lossy = np.array([weighted(row.hysteretic, semi_major(row.framed[0.0])) for row in rows])
    out["hysteretic_change_median"], out["hysteretic_change_max"] = float(np.median(lossy)), float(lossy.max())
    out["frame_mesh_change_max"] = float(max(weighted(row.halved, semi_major(row.framed[0.0])).max() for row in rows))
    out["plants"], out["flowers"] = len(rows), sum(row.halved.shape[1] for row in rows)
    return out | {"finest_piece_mm": finest}


def table(rows: list[Comparison]) -> Table:
    """Return the differences by plant, judge and frequency, in per cent."""
    out = Table("plant", "judge", *(f"{f:.3g} Hz" for f in FREQUENCIES), "median", title="difference from the frame, %")
    for row in rows:
        found = {("as used" if piece == 0 else f"{piece:g} mm"): row.differences(piece) for piece in row.judged}
        if 12.0 in row.judged and 6.0 in row.judged:
            found["extrapolated"] = row.extrapolated(12.0, 6.0)
        found["(material damping)"] = weighted(row.hysteretic, semi_major(row.framed[0.0]))
        for name, values in found.items():
            out.add_row(row.name, name, *(f"{100 * v:.1f}" for v in values), f"{100 * np.median(values):.1f}")
    return out


def main() -> None:
    """Compare, print and write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="one plant of each species, coarser")
    parser.add_argument("--seed", type=int, default=7000, help="of the first plant of each species")
    args = parser.parse_args()
    console = Console(width=160)
    pieces = (12.0,) if args.quick else (12.0, 6.0)
    tomatoes, soft = standing(grow_tomato, args.seed, 1 if args.quick else TOMATOES)
    peppers, softer = standing(grow_pepper, args.seed, 1 if args.quick else PEPPERS)
    plants = [*tomatoes, *peppers]
    rows = [compare(p, pieces, np.eye(3)[0]) for p in track(plants, "two judges", console=console)]
    console.print(table(rows))
    found = metrics(rows, pieces[-1]) | {"plants_that_buckle": soft + softer}
    console.print(found)
    if args.json:
        write_json(args.json, found)


if __name__ == "__main__":
    main()
