"""Two truths of one plant: rigid pieces on sprung hinges in MuJoCo (the judge) against a frame of finite elements.

Plants: tomatoes and peppers of the simulated greenhouse, as many of each. Each is held at the middle of its main stem
and shaken sideways at twelve frequencies from 1 to 30 Hz; small motion about the shape in which it hangs. Both get the
same truth (segments, lumps, twist, joints, foot) and share no code. The frame is held where the judge holds.

Difference of a plant at a frequency: the sum over flowers of |one - other| over that of the other, of semi-major axes
per metre of grip. The judge is cut into pieces: in the frame's code (`frame_chain`) the same pieces tell how much of
its difference is theirs. That code is sparse, so that it also takes pieces of 0.75 mm.

Keys of the --json file, each with _max and _median over plants and frequencies: error_as_used, the judge as it is used
against the frame, each with modal damping; second_judge_error (and _share_within_3_percent), the judge without rotor
inertia against the frame, springs with the same loss factor, with what pieces of 0.75 mm instead of 25 mm change in the
frame's code; same_pieces, the same judge against its own pieces in the frame's code; pieces_25 and pieces_0.75, pieces
in the frame's code against the frame; flower_error_as_used, single flowers. Then frame_mesh_change_max (elements half
as long); plants, flowers, plants_that_buckle (passed over).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from anther.pollination.shake.observables import semi_major
from anther.sim import SimPlant, grow_pepper, grow_tomato, plant_mechanics
from anther.sim.pieces import TWISTING
from evaluation.harness import finish, options, progress
from evaluation.judge.frame_chain import HingedPlant
from evaluation.judge.frame_fe import Array, ComplexArray, hysteretic_response, modal_response
from evaluation.judge.frame_plant import FramedPlant
from evaluation.prediction.shaken_plant import Params, ShakenPlant
from evaluation.tables import by_part, written

FREQUENCIES = np.geomspace(1, 30, 12)
ELEMENT = 0.005
"""Longest element of the frame [m]."""
DAMPED_BELOW = 60.0
"""Modes faster than this are undamped in the frame [Hz]: they follow a shake of 30 Hz as springs do."""
STIFF = 3000.0
"""Slowest rotor inertia of judges that have none to speak of [Hz]."""
USED = 25.0
"""Longest piece of the judge as it is used [mm]."""
FINEST = 0.75
"""Longest piece to which it is carried [mm]."""
ALONG = np.eye(3)[0]
"""Direction of the shake."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """One plant; each motion (Q, F, 3), of the flowers per metre of grip.

    Attributes:
        used: the judge as it is used; modal damping.
        bare: without rotor inertia, springs with a loss factor.
        framed, framed_lossy, halved: the frame with either damping, and lossy with elements half as long.
        cut, finest: pieces of `USED` and of `FINEST` in the frame's code, lossy.
    """

    used: ComplexArray
    bare: ComplexArray
    framed: ComplexArray
    framed_lossy: ComplexArray
    halved: ComplexArray
    cut: ComplexArray
    finest: ComplexArray

    @property
    def differences(self) -> dict[str, Array]:
        """(Q,) differences by name."""
        return {
            "error_as_used": difference(self.used, self.framed),
            "second_judge_error": difference(self.bare + self.finest - self.cut, self.framed_lossy),
            "same_pieces": difference(self.bare, self.cut),
            f"pieces_{USED:g}": difference(self.cut, self.framed_lossy),
            f"pieces_{FINEST:g}": difference(self.finest, self.framed_lossy),
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
    cut, finest = (lossy_motion(HingedPlant(plant, point, ALONG, bare_params(piece))) for piece in (USED, FINEST))
    return Comparison(
        used=used.linear(FREQUENCIES),
        bare=bare.linear(FREQUENCIES, loss_factor=loss_factor(plant)),
        framed=modal_motion(frame),
        framed_lossy=lossy_motion(frame),
        halved=lossy_motion(framed(plant, point, ELEMENT / 2)),
        cut=cut,
        finest=finest,
    )


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
    """Return the keys that the module's docstring names, but how the plants were chosen."""
    out: dict[str, float] = {}
    for name in rows[0].differences:
        values = np.array([row.differences[name] for row in rows])
        out[f"{name}_max"], out[f"{name}_median"] = float(values.max()), float(np.median(values))
        if name == "second_judge_error":
            out[f"{name}_share_within_3_percent"] = float(np.mean(values < 0.03))
    single = np.concatenate([np.abs(semi_major(row.used) / semi_major(row.framed) - 1).ravel() for row in rows])
    out["flower_error_as_used_max"], out["flower_error_as_used_median"] = float(single.max()), float(np.median(single))
    out["frame_mesh_change_max"] = float(max(difference(row.halved, row.framed_lossy).max() for row in rows))
    return out | {"plants": len(rows), "flowers": sum(row.used.shape[1] for row in rows)}


WORDS = {
    "error_as_used": "the judge as it is used (pieces of 25 mm), and the frame",
    "second_judge_error": "the judge carried to pieces of 0.75 mm, and the frame",
    "same_pieces": "masses, gravity, joints, leaves and MuJoCo: the same pieces in both codes",
    f"pieces_{USED:g}": "pieces of 25 mm alone, in the frame's code",
    f"pieces_{FINEST:g}": "pieces of 0.75 mm",
}


def main() -> None:
    """Compare, print and write --json."""
    quick, own = "one plant of each species", {"--plants": (3, "of each species")}
    args = options(__doc__, quick=quick, seed=(7000, "of the first plant of each species"), own=own)
    chosen = [standing(grow, args.seed, 1 if args.quick else args.plants) for grow in (grow_tomato, grow_pepper)]
    plants, soft = [plant for some, _ in chosen for plant in some], sum(passed for _, passed in chosen)
    found = metrics([compare(plant) for plant in progress(plants, "two judges")]) | {"plants_that_buckle": soft}
    words = (
        f"plants:.0f plants, flowers:.0f flowers, {len(FREQUENCIES)} frequencies. Of pairs of plant and frequency the "
        "carried judge is within 3 % in second_judge_error_share_within_3_percent:.0%. Elements of half the length "
        "change at most frame_mesh_change_max:.1%. Plants that buckle and were passed over: plants_that_buckle:.0f."
    )
    numbers = {"median": "*_median:.2%", "worst": "*_max:.1%"}
    finish(args, found, written(words, found), by_part(found, "flowers' amplitudes, what differs", WORDS, numbers))


if __name__ == "__main__":
    main()
