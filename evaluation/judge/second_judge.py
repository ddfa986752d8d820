"""Two truths of one plant: rigid pieces on sprung hinges in MuJoCo (the judge) against a frame of finite elements.

Plants: tomatoes and peppers of the simulated greenhouse, as many of each. Each is held at the middle of its main stem
and shaken sideways at twelve frequencies from 1 to 30 Hz; small motion about the shape in which it hangs. Both get the
same truth (segments, lumps, twist, joints, foot) and share no code. The frame is held where the judge holds.

Difference of a plant at a frequency: the sum over flowers of |one - other| over that of the other, of semi-major axes
per metre of grip. The whole difference of the judge as it is used is split by cause, each shown alone:
    pieces: the judge's pieces in the frame's code (`frame_chain`) against the frame, springs with the same loss factor;
        for ever shorter pieces;
    same_pieces: the judge, no rotor inertia, against its pieces in the frame's code, springs with the same loss factor:
        what is left is masses, gravity, joints, leaves, and MuJoCo itself;
    damping: likewise, but every mode with the plant's damping ratio, each by its own code;
    rotor: the judge with its rotor inertia against none;
    hinge_order: pieces whose hinges turn one after the other against at once (a part of `pieces`).

Keys of the --json file: second_judge_error_max, _median, _share_within_3_percent (over plants and frequencies): the
judge without rotor inertia against the frame, equal loss factors, with what pieces of 0.75 mm instead of 25 mm change
in the frame's code; extrapolated_max, _median: likewise, what none change (first order, from 1.5 and 0.75 mm);
error_as_used_max, _median: the judge as it is used against the frame, each with modal damping;
flower_error_as_used_max, _median: single flowers; <cause>_max, _median for the causes but pieces; pieces_<length>_max,
_median, shift_<length> (median size of the natural frequencies' relative shifts, modes below 10 Hz whose shapes agree)
by length in mm; judge_<length>_max, _median, judge_<length>_same_pieces_max: the first plant, finer pieces in MuJoCo
against the frame and against the same pieces in the frame's code; hysteretic_change_max, _median (frame: material with
a loss factor against modal damping); frame_mesh_change_max (elements of half the length); plants, flowers,
plants_that_buckle (passed over).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rich.table import Table
from scipy.spatial import KDTree

from anther.pollination.shake.observables import semi_major
from anther.sim import SimPlant, grow_pepper, grow_tomato, plant_mechanics
from anther.sim.pieces import TWISTING
from evaluation.harness import finish, options, progress
from evaluation.judge.frame_chain import HingedPlant
from evaluation.judge.frame_fe import Array, ComplexArray, hysteretic_response, modal_response
from evaluation.judge.frame_plant import FramedPlant
from evaluation.prediction.shaken_plant import Params, ShakenPlant
from evaluation.tables import markdown, percent

FREQUENCIES = np.geomspace(1, 30, 12)
ELEMENT = 0.005
"""Longest element of the frame [m]."""
DAMPED_BELOW = 60.0
"""Modes faster than this are undamped in the frame [Hz]: they follow a shake of 30 Hz as springs do."""
STIFF = 3000.0
"""Slowest rotor inertia of judges that have none to speak of [Hz]."""
USED = 25.0
"""Longest piece of the judge as it is used [mm]."""
PIECES = (USED, 12.0, 6.0, 3.0, 1.5, 0.75)
"""[mm]; the last two tell what none would do."""
SHIFTED = PIECES[:4]
"""Of these pieces the natural frequencies are compared [mm]."""
FINER = (12.0, 6.0, 3.0)
"""Of the first plant in MuJoCo [mm]."""
BELOW, ALIKE = 10.0, 0.9
"""Natural frequencies are compared below this [Hz], of modes whose shapes have this criterion of assurance (MAC)."""
ALONG = np.eye(3)[0]
"""Direction of the shake."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """One plant; each motion (Q, F, 3), of the flowers per metre of grip.

    Attributes:
        name: species and seed.
        used, bare: the judge as it is used, and without rotor inertia; modal damping.
        bare_lossy: without rotor inertia, springs with a loss factor.
        framed, framed_lossy, halved: the frame with either damping, and lossy with elements half as long.
        hinged, unordered: the judge's pieces in the frame's code, modal damping; lossy, hinges that turn at once.
        cut: by longest piece [mm], pieces in the frame's code, lossy.
        shifts: by longest piece [mm], (M,) relative shifts of natural frequencies from the frame's.
    """

    name: str
    used: ComplexArray
    bare: ComplexArray
    bare_lossy: ComplexArray
    framed: ComplexArray
    framed_lossy: ComplexArray
    halved: ComplexArray
    hinged: ComplexArray
    unordered: ComplexArray
    cut: dict[float, ComplexArray]
    shifts: dict[float, Array]

    @property
    def causes(self) -> dict[str, Array]:
        """(Q,) differences by name: the whole one, those with the shortest pieces and with none, and the causes."""
        fine, finest = self.cut[PIECES[-2]], self.cut[PIECES[-1]]
        none = (PIECES[-2] * finest - PIECES[-1] * fine) / (PIECES[-2] - PIECES[-1])
        return {
            "error_as_used": difference(self.used, self.framed),
            "second_judge_error": difference(self.bare_lossy + finest - self.cut[USED], self.framed_lossy),
            "extrapolated": difference(self.bare_lossy + none - self.cut[USED], self.framed_lossy),
            "same_pieces": difference(self.bare_lossy, self.cut[USED]),
            "damping": difference(self.bare, self.hinged),
            "rotor": difference(self.used, self.bare),
            "hinge_order": difference(self.unordered, self.cut[USED]),
            **{f"pieces_{length:g}": difference(cut, self.framed_lossy) for length, cut in self.cut.items()},
            "hysteretic_change": difference(self.framed_lossy, self.framed),
        }


def weighted(found: Array, reference: Array) -> Array:
    """Return (Q,) the sum over flowers (Q, F) of |found - reference| over that of the reference."""
    return np.abs(found - reference).sum(axis=1) / reference.sum(axis=1)


def difference(found: ComplexArray, reference: ComplexArray) -> Array:
    """Return (Q,) the same of the semi-major axes of motions (Q, F, 3)."""
    return weighted(semi_major(found), semi_major(reference))


def framed(plant: SimPlant, point: Array, size: float = ELEMENT) -> FramedPlant:
    """Return the plant as a frame in which the judge's organs twist."""
    return FramedPlant(plant, point, ALONG, size=size, twisting=TWISTING)


def bare_params(piece: float) -> plant_mechanics.Params:
    """Return how the judge cuts into pieces [mm], without rotor inertia."""
    return plant_mechanics.Params(piece / 1e3, stiffest=STIFF, foliage=STIFF, twist_every=1)


def modal_motion(frame: FramedPlant) -> ComplexArray:
    """Return (Q, F, 3) the flowers' motion per metre of grip, each mode damped as the truth states."""
    return frame.flowers(modal_response(frame.frame, frame.shake, FREQUENCIES, damped_below=DAMPED_BELOW))


def lossy_motion(frame: FramedPlant) -> ComplexArray:
    """Return (Q, F, 3) the same when the material has the loss factor that its damping ratio means."""
    return frame.flowers(hysteretic_response(frame.frame, frame.shake, FREQUENCIES))


def loss_factor(plant: SimPlant) -> float:
    """Return twice the damping ratio, which is one all over a nominal plant."""
    (ratio,) = np.unique(plant.damping_ratio)
    return 2 * float(ratio)


def compare(plant: SimPlant) -> Comparison:
    """Shake one plant in both codes."""
    stem = plant.stem_centreline()[0]
    used = ShakenPlant(plant, stem[len(stem) // 2], ALONG)
    point, bare = used.point, ShakenPlant(plant, used.point, ALONG, Params(plant=bare_params(USED)))
    frame = framed(plant, point)
    cut: dict[float, ComplexArray] = {}
    shifts: dict[float, Array] = {}
    for piece in PIECES:
        chain = HingedPlant(plant, point, ALONG, bare_params(piece))
        cut[piece] = lossy_motion(chain)
        if piece in SHIFTED:
            shifts[piece] = frequency_shifts(chain, frame)
    return Comparison(
        name=f"{plant.species} {plant.seed}",
        used=used.linear(FREQUENCIES),
        bare=bare.linear(FREQUENCIES),
        bare_lossy=bare.linear(FREQUENCIES, loss_factor=loss_factor(plant)),
        framed=modal_motion(frame),
        framed_lossy=lossy_motion(frame),
        halved=lossy_motion(framed(plant, point, ELEMENT / 2)),
        hinged=modal_motion(HingedPlant(plant, point, ALONG, bare_params(USED))),
        unordered=lossy_motion(HingedPlant(plant, point, ALONG, bare_params(USED), ordered=False)),
        cut=cut,
        shifts=shifts,
    )


def frequency_shifts(chain: FramedPlant, frame: FramedPlant) -> Array:
    """Return (M,) the relative shifts of a chain's natural frequencies from the frame's, of modes that look alike."""
    beside = KDTree(chain.mesh.nodes).query(frame.mesh.nodes[frame.mesh.first])[1]
    found: list[tuple[Array, Array]] = []
    for plant, nodes in ((chain, beside), (frame, frame.mesh.first)):
        omega, shapes = plant.frame.modes(BELOW, plant.shake.held)
        moved = shapes.reshape(-1, 2, 3, len(omega))[nodes, 0].reshape(-1, len(omega))
        found.append((omega, moved / np.linalg.norm(moved, axis=0)))
    (ours, cut), (theirs, whole) = found
    alike = (cut.T @ whole) ** 2
    best = alike.argmax(axis=0)
    told = (theirs < 2 * np.pi * BELOW) & (alike.max(axis=0) > ALIKE)
    return (ours[best] / theirs - 1)[told]


def finer_in_mujoco(plant: SimPlant, pieces: tuple[float, ...]) -> dict[str, float]:
    """Return the keys judge_<length>..., springs with the same loss factor."""
    stem, out = plant.stem_centreline()[0], {}
    for piece in pieces:
        judge = ShakenPlant(plant, stem[len(stem) // 2], ALONG, Params(plant=bare_params(piece)))
        judged = judge.linear(FREQUENCIES, loss_factor=loss_factor(plant))
        error = difference(judged, lossy_motion(framed(plant, judge.point)))
        same = difference(judged, lossy_motion(HingedPlant(plant, judge.point, ALONG, bare_params(piece))))
        out[f"judge_{piece:g}_max"], out[f"judge_{piece:g}_median"] = float(error.max()), float(np.median(error))
        out[f"judge_{piece:g}_same_pieces_max"] = float(same.max())
    return out


def standing(grow: Callable[[int], SimPlant], seed: int, count: int) -> tuple[list[SimPlant], int]:
    """Return the first plants from a seed on that carry their weight in the frame, and how many do not."""
    found: list[SimPlant] = []
    passed = 0
    while len(found) < count:
        plant = grow(seed + len(found) + passed)
        stem = plant.stem_centreline()[0]
        try:
            framed(plant, stem[len(stem) // 2]).frame.modes(1.0)
            found.append(plant)
        except ValueError:
            passed += 1
    return found, passed


def metrics(rows: list[Comparison]) -> dict[str, float]:
    """Return the keys that the module's docstring names, but for finer pieces and how the plants were chosen."""
    out: dict[str, float] = {}
    for name in rows[0].causes:
        values = np.array([row.causes[name] for row in rows])
        out[f"{name}_max"], out[f"{name}_median"] = float(values.max()), float(np.median(values))
        if name == "second_judge_error":
            out[f"{name}_share_within_3_percent"] = float(np.mean(values < 0.03))
    single = np.concatenate([np.abs(semi_major(row.used) / semi_major(row.framed) - 1).ravel() for row in rows])
    out["flower_error_as_used_max"], out["flower_error_as_used_median"] = float(single.max()), float(np.median(single))
    for piece in SHIFTED:
        out[f"shift_{piece:g}"] = float(np.median(np.abs(np.concatenate([row.shifts[piece] for row in rows]))))
    out["frame_mesh_change_max"] = float(max(difference(row.halved, row.framed_lossy).max() for row in rows))
    return out | {"plants": len(rows), "flowers": sum(row.used.shape[1] for row in rows)}


WORDS = {
    "error_as_used": "the judge as it is used (pieces of 25 mm), and the frame",
    "second_judge_error": "the judge carried to pieces of 0.75 mm, and the frame",
    "extrapolated": "the judge extrapolated to no pieces, and the frame",
    "same_pieces": "masses, gravity, joints, leaves and MuJoCo: the same pieces in both codes",
    "damping": "damping in modes, each code by its own rule",
    "rotor": "rotor inertia of the hinges",
    "hinge_order": "hinges that turn one after the other, and at once",
    "hysteretic_change": "in the frame alone: a loss factor, and modal damping",
}
"""Causes in words; those of pieces are in a table of their own."""


def tables(found: dict[str, float]) -> list[str | Table]:
    """Return the differences by cause, and by length of the pieces, each after a line that says what it shows."""
    causes = [(words, f"{found[f'{name}_median']:.2%}", f"{found[f'{name}_max']:.1%}") for name, words in WORDS.items()]
    keys = ("pieces_{:g}_median", "pieces_{:g}_max", "shift_{:g}", "judge_{:g}_max")
    pieces = [(f"{length:g}", *(percent(found.get(k.format(length)), 1) for k in keys)) for length in PIECES]
    heads = ("amplitude, median", "amplitude, worst", "natural frequencies below 10 Hz, median shift")
    which = "Pieces alone, in the frame's code, against none; springs with the same loss factor on both sides:"
    lengths = markdown(("longest piece, mm", *heads, "MuJoCo itself, first plant, worst"), pieces)
    return [
        "Differences of the flowers' amplitudes:",
        markdown(("what differs", "median", "worst"), causes),
        which,
        lengths,
    ]


def main() -> None:
    """Compare, print and write --json."""
    quick, own = "one plant of each species, pieces of 12 mm in MuJoCo", {"--plants": (3, "of each species")}
    args = options(__doc__, quick=quick, seed=(7000, "of the first plant of each species"), own=own)
    chosen = [standing(grow, args.seed, 1 if args.quick else args.plants) for grow in (grow_tomato, grow_pepper)]
    plants, soft = [plant for some, _ in chosen for plant in some], sum(passed for _, passed in chosen)
    rows = [compare(plant) for plant in progress(plants, "two judges")]
    found = metrics(rows) | finer_in_mujoco(plants[0], FINER[:1] if args.quick else FINER)
    found |= {"plants_that_buckle": soft}
    words = (
        f"{found['plants']:.0f} plants, {found['flowers']:.0f} flowers, {len(FREQUENCIES)} frequencies. Of pairs of "
        f"plant and frequency the carried judge is within 3 % in "
        f"{found['second_judge_error_share_within_3_percent']:.0%}. Elements of half the length change at most "
        f"{found['frame_mesh_change_max']:.1%}. Plants that buckle and were passed over: {soft}."
    )
    finish(args, found, words, *tables(found))


if __name__ == "__main__":
    main()
