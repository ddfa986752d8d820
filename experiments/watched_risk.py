r"""How much may be risked of a shake that was watched: what flowers feel against harm, and what margins are worth.

    python tools/record.py experiments/watched_risk.py --jobs 2

Trials of `shaking.py` on plants on which constants may be set go on until the shake would begin. From there Anther's
own escalation is given looks that are drawn from the true plant instead of films: the grip goes as a simulated arm of
the wide truth goes and reads (`arm_readings.py`), flowers and points as MuJoCo's linear equations of the true plant
say with the drag at 2 mm, seen with the errors of `SEEN` and `OFF`. So a shake takes a tenth of a second instead of a
minute, and the same plants can be shaken with every risk of `RISKS`. What is not linear, and swings that overshoot, are
left out: in the whole cell pedicels are bent 1.15 to 1.4 times as far. Slip is not counted.

Keys of --json, after <way>_: plants; of each risk <r> (times the plan's) felt_<r>, the geometric mean over plants of
the median flower's peak acceleration [m/s2]; harm_<r>, the mean probability of harm, and harm_rest_<r>, without the
worst plant; and over looks at one tone <band> (`BANDS`), of loads <kind> (`SAID`): passed_<kind>_<band>, the
share in which the true load is more than was said at the risk in use.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from unittest.mock import patch

import numpy as np
from arm_readings import read_and_true
from grasping_trial import Memory, truth_of
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shaken_plant import ShakenPlant
from swept import failed, swept
from vibration_plant import matched

from anther import escalation, pipeline
from anther.commands.simulated_cell import PRESETS, SimulatedCell, build
from anther.devices import LEAD, ArmSample, Frame
from anther.errors import StageFailure
from anther.escalation import Escalation
from anther.escalation import _option as option
from anther.execution import Step
from anther.files import write_json
from anther.geometry import Array
from anther.pipeline import Params, pollinate
from anther.plant import PEPPER, TOMATO
from anther.response.points import Sight, Swings, sight
from anther.shake import PlantLimits, ShakePlan
from anther.shake.observables import ComplexArray, semi_major
from anther.shake.params import FAST, RINGING
from anther.sim.judge import Harm
from anther.sim.plant import Organ
from anther.sim.truth import TOLERANCE
from anther.swing import Swing

FIRST = 9720
RISKS = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0)
NOISE = 2
"""Each shake is looked at so many times, with other errors."""
SEEN, OFF = np.array([0.03e-3, 0.03e-3, 0.15e-3]), (0.12, 0.2)
"""Standard deviation of what is seen of a swing across, down and away [m]; and that of flowers and of other points in
proportion to the swing, the same in all looks: petals do not move as a flower's middle does (docs/reports/shaking)."""
LATE = 0.01  # s: the camera's clock
LOST_FROM = 0.015  # m: a point that swings further is not followed
DRAG_AT = 2e-3  # m
TOGETHER = 0.7
"""Several tones bend a piece about so much of the sum of what each does: they seldom peak at once."""
SLOW = 5.0  # Hz: the judge counts leaves' loads below
SAID = {"stem": "stem_strain", "pedicel": "joint_strain", "base": "base_strain"}
"""Kinds of `TOLERANCE` -> of `foresight.LOADS`; limits are those of `PlantLimits`, <kind>_strain."""
BANDS = {"slow": (0.0, FAST), "ringing": (FAST, RINGING), "fast": (RINGING, np.inf)}


class Begins(BaseException):
    """The shake would begin: (escalation, frame at rest)."""


class Kept(Escalation):
    """An escalation that says what it was made of instead of beginning."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.places, self.camera, self.by_arm = given[2:4], named["camera"], named["middle"] is not None
        self.anew = partial(Escalation, *given, **named)
        self.bears: PlantLimits = named["limits"].plant

    def begin(self, frame: Frame) -> NoReturn:
        """End the trial."""
        raise Begins(self, frame)


class TrueMotion(NamedTuple):
    """What a plant held by its grip does per metre of the grip along x and y; K tones.

    Attributes:
        flowers: (K, F, 3, 2) of the true flowers.
        points: (K, P, 3, 2) of the places that the escalation watches, its flowers first.
        bent: (K, B, 2, 2) bending strain at the root of each piece [1/m].
        organ: (B,) key of `TOLERANCE` of each piece.
        leaves: (K, L, 3, 2) of the leaves' bases.
        grip: (2, D, K, 3) what the grip is read and true to do along each probed line, over what was commanded.
    """

    flowers: ComplexArray
    points: ComplexArray
    bent: ComplexArray
    organ: NDArray[np.str_]
    leaves: ComplexArray
    grip: ComplexArray


def one(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what a plant's shakes came to with every risk, for a sweep."""
    species, seed, actuator = row["species"], row["seed"], row["actuator"]
    cell = build(species, seed, 90.0 * (seed % 4), PRESETS["fast"], truth=truth_of("wide", seed), actuator=actuator)
    params = replace(Params(), actuator=actuator)
    try:
        with patch.object(pipeline, "Escalation", Kept):
            pollinate(cell.robot_side, PEPPER if species == "pepper" else TOMATO, Memory(folder), params)
    except StageFailure as failure:
        return failed(str(failure))
    except Begins as begins:
        kept, frame = begins.args
        at = sight(frame, *kept.camera, *kept.places)
        true = truth(cell, kept)
        return {"success": True, "shakes": [shake(kept, at, true, r, n) for r in RISKS for n in range(NOISE)]}
    return failed("the plan alone was done")


def truth(cell: SimulatedCell, kept: Kept) -> TrueMotion:
    """Return what the plant truly does at the plan's tones, held where the plan holds it."""
    plan, seed = kept.plan, cell.plant.seed
    tones, truth = plan.tones.frequencies, truth_of("wide", seed)
    lines = plan.tones.directions[list(plan.tones.probed)]
    watched, plant = np.concatenate(kept.places), cell.plant
    seen, real = matched(kept.places[0], plant.flower_position)
    petioles = (plant.organ == Organ.PETIOLE) & (plant.organ[plant.parent] != Organ.PETIOLE)
    along = [ShakenPlant(plant, plan.grasp.point, axis, truth=truth) for axis in np.eye(3)[:2]]
    flowers = np.stack([held.linear(tones, DRAG_AT) for held in along], axis=-1)
    bent = np.stack([held.bending(tones, DRAG_AT) for held in along], axis=-1)
    points, leaves = (
        np.stack([held.linear_at(places, tones, DRAG_AT) for held in along], axis=-1)
        for places in (watched, plant.start[petioles])
    )
    points[:, seen] = flowers[:, real]
    organ = along[0].mechanics.plant.organ[along[0].mechanics.pieces.first]
    kinds = np.select([np.isin(organ, (Organ.STEM, Organ.BRANCH)), organ == Organ.PEDICEL], ["stem", "pedicel"], "base")
    if kept.by_arm:
        assert plan.grasp.joints is not None
        grip = np.stack([read_and_true(seed, plan.grasp.joints, line, tones) for line in lines], axis=1)
    else:
        told = np.repeat(lines[:, None].astype(np.complex128), len(tones), axis=1)
        grip = np.stack([told, truth.motor_gain * told])
    return TrueMotion(flowers, points, bent, kinds, leaves, grip)


def shake(kept: Kept, at: Sight, true: TrueMotion, risk: float, noise: int) -> dict[str, Any]:
    """Carry out the escalation by the equations; return what flowers felt, the harm, and loads over what was said."""
    plan, rng = kept.plan, np.random.default_rng(noise)
    count, flowers = len(at.pixels), len(kept.places[0])
    off = np.where(np.arange(count) < flowers, *OFF)[:, None]
    wrong = {tone: 1 + off * _complex(rng, (count, 3)) for tone in range(len(plan.tones.frequencies))}
    piece: list[Swing] = []

    def done() -> list[tuple[int, Array, float]]:
        """Return tone, line and amplitude of all that the piece moves."""
        numbers = np.flatnonzero(piece[-1].amplitudes)
        lines = [next(one.direction for one in escalated.lines if one.tones[n]) for n in numbers]
        tones = [int(np.abs(plan.tones.frequencies - piece[-1].frequencies[n]).argmin()) for n in numbers]
        return list(zip(tones, lines, piece[-1].amplitudes[numbers].tolist(), strict=True))

    def filmed(_: Sight, __: Sequence[Frame], tones: Array, expected: Any = None) -> Swings:
        phasors = np.full((count, len(tones), 3), np.nan, dtype=complex)
        for k, (tone, line, amplitude) in enumerate(done()):
            moved = amplitude * true.points[tone] @ gripped(plan, true, tone, line)[1][:2]
            across = np.einsum("px,pxa->pa", moved, at.axes) * wrong[tone]
            phasors[:, k] = across * np.exp(-2j * np.pi * tones[k] * LATE)
        phasors += SEEN * _complex(rng, phasors.shape) * np.sqrt(2)
        phasors[flowers:, :, 2] = np.nan
        far = np.sqrt(np.nansum(np.abs(phasors[:, :, :2]) ** 2, axis=(1, 2))) > LOST_FROM
        phasors[~at.shown | far] = np.nan
        std = np.where(np.isfinite(phasors[:, 0]), SEEN, np.nan)
        return Swings(phasors, std, at.axes)

    def read(*_: Any) -> ComplexArray:
        return np.array([amplitude * gripped(plan, true, tone, line)[0] for tone, line, amplitude in done()])

    with ExitStack() as instead:
        for name, value in (("swings", filmed), ("gripper_motion", read), ("sight", lambda *_: at)):
            instead.enter_context(patch.object(escalation, name, value))
        instead.enter_context(patch.object(option, "WATCHED", risk))
        escalated = kept.anew()
        piece.append(escalated.begin(None))  # pyright: ignore[reportArgumentType]
        while piece[-1].amplitudes.any():
            times = np.arange(0, piece[-1].begin + piece[-1].seconds - LEAD, 0.02)
            piece.append(escalated.go_on(piece[-1], [], [ArmSample(t, None, None) for t in times]))  # pyright: ignore[reportArgumentType]
    return judged(kept, true, escalated.steps) | {"risk": risk}


def gripped(plan: ShakePlan, true: TrueMotion, tone: int, line: Array) -> ComplexArray:
    """Return (2, 3) what the grip is read and true to do along a line, over what was commanded."""
    parts = plan.tones.parts(int((plan.tones.directions @ line).argmax()))
    return np.tensordot(parts, true.grip[:, :, tone], axes=(0, 1))


def judged(kept: Kept, true: TrueMotion, steps: Sequence[Step]) -> dict[str, Any]:
    """Return what steps did: the median flower's acceleration in the last, the harm of the worst, loads over said."""
    tones, worst, looks = kept.plan.tones.frequencies, dict.fromkeys(TOLERANCE, 0.0), list[dict[str, Any]]()
    felt = 0.0
    for step in steps:
        loads = dict.fromkeys(TOLERANCE, 0.0)
        for hertz, amplitude in zip(step.frequencies, step.amplitudes, strict=True):
            tone = int(np.abs(tones - hertz).argmin())
            grip = amplitude * gripped(kept.plan, true, tone, np.array(step.direction))[1][:2]
            bent, omega2 = semi_major(true.bent[tone] @ grip), (2 * np.pi * hertz) ** 2
            for kind in SAID:
                loads[kind] += float(bent[true.organ == kind].max(initial=0.0))
            leaf = omega2 * semi_major(true.leaves[tone] @ grip).max(initial=0.0)
            loads["leaf"] += float(leaf) if hertz < SLOW else 0.0
            felt = float(np.median(omega2 * semi_major(true.flowers[tone] @ grip)))
        alone = len(step.frequencies) == 1
        worst = {kind: max(load, loads[kind] if alone else TOGETHER * loads[kind]) for kind, load in worst.items()}
        if alone:
            said = {kind: step.loads[option.WORDS[name]] for kind, name in SAID.items()}
            said = {kind: share * getattr(kept.bears, f"{kind}_strain") for kind, share in said.items()}
            looks.append({"hertz": step.frequencies[0]} | {kind: loads[kind] / said[kind] for kind in said})
    return {"felt": felt, "harm": Harm(worst, {}).probability, "looks": looks}


def _complex(rng: np.random.Generator, shape: tuple[int, ...]) -> ComplexArray:
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def metrics(way: str, rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return what the module's docstring names, of one way."""
    out = {"plants": float(len(rows))}
    for risk in RISKS:
        own = [[one for one in row["shakes"] if one["risk"] == risk] for row in rows]
        harm = np.sort([np.mean([one["harm"] for one in shakes]) for shakes in own])
        out[f"felt_{risk:g}"] = float(np.exp(np.mean([np.log(max(one["felt"], 0.05)) for s in own for one in s])))
        out |= {f"harm_{risk:g}": float(harm.mean()), f"harm_rest_{risk:g}": float(harm[:-1].mean())}
    used = [
        (look, one["risk"])
        for row in rows
        for one in row["shakes"]
        for look in one["looks"]
        if one["risk"] == option.WATCHED
    ]
    for band, (low, high) in BANDS.items():
        looks = [look for look, _ in used if low < look["hertz"] <= high]
        for kind in SAID if looks else ():
            out[f"passed_{kind}_{band}"] = float(np.mean([look[kind] > 1 for look in looks]))
    return {f"{way}_{name}": value for name, value in out.items()}


def main() -> None:
    """Run what is missing, print a table, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plants", type=int, default=40, help="half tomatoes, half peppers")
    parser.add_argument("--jobs", type=int, default=1, help="plants at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/watched_risk"), help="where what is done is kept")
    args = parser.parse_args()
    cases = [
        {"species": ("tomato", "pepper")[k % 2], "seed": FIRST + k // 2, "actuator": actuator}
        for actuator in ("arm", "gripper")
        for k in range(args.plants)
    ]
    rows = [row for row in swept(one, cases, args.out, args.jobs, failed) if row["success"]]
    told: dict[str, float] = {}
    table = Table("shaken by", "plants", "risk, times the plan's", "flowers [m/s²]", "harm", "without the worst plant")
    for way, actuator in (("arm", "arm"), ("motor", "gripper")):
        own = metrics(way, [row for row in rows if row["actuator"] == actuator])
        told |= own
        for r in RISKS:
            harm = [f"{own[f'{way}_{name}_{r:g}']:.1%}" for name in ("harm", "harm_rest")]
            table.add_row(way, f"{own[f'{way}_plants']:g}", f"{r:g}", f"{own[f'{way}_felt_{r:g}']:.1f}", *harm)
    console = Console()
    console.print(table)
    console.print({name: round(value, 3) for name, value in told.items() if "passed" in name})
    if args.json:
        write_json(args.json, told)


if __name__ == "__main__":
    main()
