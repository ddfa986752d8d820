"""What does leaving twist out change (the paper's claim P20)? Flower amplitudes with and without it.

It writes docs/reports/twist.md.

Plants: the paper's two real ones (skeletons from --data; one radius, the authors' grip, flower and density) and ten of
the simulated greenhouse (five tomatoes, five peppers: their true segments, leaves and flowers as rods, gripped at a
quarter, half and three quarters of the stem). Each hangs in equilibrium, is clamped at the soil, and is shaken along x
and y at one stem node, which may turn in the grip. Amplitude is the semi-major axis of a flower's path in small
vibrations, with the same damping ratio at every frequency. Rods that cannot twist are compared with the same rods at
EI/GJ = 1.5 (a round bar) and 12 (dicot petioles). Some cases are simulated as well, as a check.

Change = |amplitude without twist / amplitude with it - 1|, over all plants, grips, directions and flowers, each plant
with the same weight. A band of one frequency is also given as rms amplitude over the octave around it ("around"), so
that a resonance that only moves a little does not count as much.

Keys of the --json file: change_<median|p90>_<1p5|12>_<band> and change_over_10_percent_<1p5|12>_<band> (a share), with
real_ in front for the paper's two plants alone; bands 0p7_1p9hz, 5hz, 10hz, 30hz, around_5hz, around_10hz, around_30hz;
simulated_difference (largest relative difference of a simulated flower amplitude from the linear one), plants, flowers.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.progress import track
from twist_plants import MARGIN, REAL_RADIUS, SOFTEST, Array, Plant, real_plants, simulated_plant

from anther.elastic_rod import Clamp, Drive, Rods, response_map, simulate, with_gravity_equilibrium
from anther.files import write_json, write_text
from anther.sim.pepper import grow_pepper
from anther.sim.tomato import grow_tomato
from anther.vibration.observables import semi_major

mpl.use("Agg")
import matplotlib.pyplot as plt

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))

NO_TWIST = 0.0
"""EI/GJ of rods that cannot twist."""
RATIOS = (1.5, SOFTEST)
"""EI/GJ: a round bar of constant volume; dicot petioles (facts: pollination 2)."""
OCTAVE = 2.0 ** np.linspace(-0.5, 0.5, 9)
BANDS: dict[str, Array] = {
    "0.7-1.9 Hz": np.linspace(0.7, 1.9, 7),
    "5 Hz": np.array([5.0]),
    "10 Hz": np.array([10.0]),
    "30 Hz": np.array([30.0]),
    "around 5 Hz": 5 * OCTAVE,
    "around 10 Hz": 10 * OCTAVE,
    "around 30 Hz": 30 * OCTAVE,
}
AXES = np.array([[1.0, 0, 0], [0, 1.0, 0]])
COLOURS = ("black", "tab:blue", "tab:red")
SHAKE, SIMULATED = 0.5e-3, (("tomato2", 1.3), ("tomato2", 5.0), ("tomato 1", 5.0))
"""Amplitude [m], plants and frequencies [Hz] of the nonlinear check."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Amplitudes of one plant, flattened over frequencies, grips, directions and flowers, by band and EI/GJ."""

    plant: Plant
    amplitudes: dict[tuple[str, float], Array]

    def change(self, ratio: float, band: str) -> Array:
        """Return |amplitude without twist / with it - 1|."""
        return np.abs(self.amplitudes[band, NO_TWIST] / self.amplitudes[band, ratio] - 1)


def hanging(plant: Plant, ratio: float) -> Rods:
    """Return the plant's rods at EI/GJ `ratio`, in equilibrium."""
    return with_gravity_equilibrium(replace(plant.rods, bend_over_twist=ratio), Clamp.root(plant.rods))


def amplitudes(plant: Plant, rods: Rods, hertz: Array) -> Array:
    """Return the flowers' amplitudes per grip amplitude, (Q, G, D, F)."""
    clamp, loss = Clamp.root(plant.rods), 2 * plant.damping_ratio
    return semi_major(response_map(rods, clamp, plant.grips, AXES, hertz, observe=plant.flowers, loss_factor=loss))


def answer(plant: Plant) -> Answer:
    """Return the amplitudes of one plant in every band."""
    out: dict[tuple[str, float], Array] = {}
    for ratio in (NO_TWIST, *RATIOS):
        rods = hanging(plant, ratio)
        for band, hertz in BANDS.items():
            found = amplitudes(plant, rods, hertz)
            out[band, ratio] = (np.sqrt(np.mean(found**2, axis=0)) if "around" in band else found).ravel()
    return Answer(plant, out)


def quantile(answers: list[Answer], ratio: float, band: str, share: float) -> float:
    """Return a quantile of the change, each plant with the same weight."""
    changes = [a.change(ratio, band) for a in answers]
    values, weights = np.concatenate(changes), np.concatenate([np.full(len(c), 1 / len(c)) for c in changes])
    rising = np.argsort(values)
    middles = np.cumsum(weights[rising]) - weights[rising] / 2
    return float(np.interp(share, middles / len(answers), values[rising]))


def share_over(answers: list[Answer], ratio: float, band: str, limit: float) -> float:
    """Return the share of changes above a limit, each plant with the same weight."""
    return float(np.mean([np.mean(a.change(ratio, band) > limit) for a in answers]))


def simulated_differences(plants: list[Plant], console: Console) -> dict[str, float]:
    """Return the relative difference of the simulated flower amplitude from the linear one, by case."""
    chosen = [(p, f, r) for name, f in SIMULATED for p in plants if p.name == name for r in (NO_TWIST, SOFTEST)]
    return {
        f"{p.name}, {f:g} Hz, {_twist(r)}": _difference(p, f, r)
        for p, f, r in track(chosen, "simulations", console=console)
    }


def _difference(plant: Plant, frequency: float, ratio: float) -> float:
    """Shake with a slow rise, so that few transients are left at the end, and project on sine and cosine."""
    rods = replace(hanging(plant, ratio), viscous_time=plant.damping_ratio / (np.pi * frequency))
    grip = int(plant.grips[len(plant.grips) // 2])
    dt, periods = 1 / frequency / 200, round(24 * frequency)
    drive = Drive(grip, AXES[0], SHAKE, frequency, ramp=16.0)
    run = simulate(rods, Clamp.root(rods), drive, periods / frequency, dt)
    last = slice(-round(2 / frequency / dt), None)
    moves = run.positions[last][:, plant.flowers] - run.positions[0, plant.flowers]
    turning = np.exp(-2j * np.pi * frequency * run.times[last])
    found = semi_major(2j * np.tensordot(turning, moves, 1) / len(turning)) / SHAKE
    expected = amplitudes(plant, hanging(plant, ratio), np.array([frequency]))[0, len(plant.grips) // 2, 0]
    return float(np.abs(found - expected).max() / expected.max())


def metrics(answers: list[Answer], differences: dict[str, float]) -> dict[str, float]:
    """Return the keys that the module's docstring names."""
    out: dict[str, float] = {}
    real = [a for a in answers if " " not in a.plant.name]
    for prefix, group in (("", answers), ("real_", real)):
        for band in BANDS if group else ():
            for ratio in RATIOS:
                tail = f"{ratio:g}_{band.lower()}".replace(".", "p").replace("-", "_").replace(" hz", "hz")
                tail = tail.replace(" ", "_")
                out[f"{prefix}change_median_{tail}"] = quantile(group, ratio, band, 0.5)
                out[f"{prefix}change_p90_{tail}"] = quantile(group, ratio, band, 0.9)
                out[f"{prefix}change_over_10_percent_{tail}"] = share_over(group, ratio, band, 0.1)
    out |= {"plants": len(answers), "flowers": sum(len(a.plant.flowers) for a in answers)}
    return out | ({"simulated_difference": max(differences.values())} if differences else {})


def main() -> None:
    """Run, print, write docs/reports/twist.md, its figure and --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "skeletons", help="folder of the real skeletons")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the page; with --quick, not written")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="two simulated plants instead of ten, one simulation")
    parser.add_argument("--seed", type=int, default=0, help="of the first simulated plants")
    args = parser.parse_args()
    console = Console()
    real = real_plants(args.data)
    if len(real) < 2:
        console.print(f"real skeletons not found in {args.data} (set ANTHER_DATA); simulated plants only")
    seeds = range(args.seed, args.seed + (1 if args.quick else 5))
    jobs = [grow(seed) for grow in (grow_tomato, grow_pepper) for seed in seeds]
    plants = real + [simulated_plant(p) for p in track(jobs, "plants as rods", console=console)]
    answers = [answer(plant) for plant in track(plants, "with and without twist", console=console)]
    differences = simulated_differences(plants[:1] if args.quick else plants, console)
    text = page(answers, differences)
    console.print(text, markup=False, highlight=False)
    if not args.quick:
        write_text(args.docs / "reports" / "twist.md", text)
        draw(answers, args.docs / "pictures" / "twist.png")
    if args.json:
        write_json(args.json, metrics(answers, differences))


def page(answers: list[Answer], differences: dict[str, float]) -> str:
    """Return the text of docs/reports/twist.md."""
    return "\n".join([*_head(answers), *_band_table(answers), "", *_plant_table(answers), "", *_check(differences), ""])


def _head(answers: list[Answer]) -> Iterator[str]:
    typical = [(b, r) for b in BANDS for r in RATIOS if quantile(answers, r, b, 0.5) < 0.1]
    most = [(b, r) for b in BANDS for r in RATIOS if quantile(answers, r, b, 0.9) < 0.1]
    yield "# May twist be left out?\n\nMade by `python experiments/twist.py`; do not edit.\n"
    yield "The paper's rods do not twist (P20). This changes a flower's amplitude by (median, and 90th percentile):\n"
    for ratio in RATIOS:
        parts = [
            f"{band}: {_percent(answers, ratio, band, 0.5)} ({_percent(answers, ratio, band, 0.9)})" for band in BANDS
        ]
        yield f"- against EI/GJ = {ratio:g}: {', '.join(parts)}."
    yield f"\nLess than 10 % for the median flower: {_listed(typical)}. For nine flowers in ten: {_listed(most)}.\n"
    yield "Change = amplitude of a flower without twist over that with it, minus one, without its sign; over all"
    yield "plants, grips, directions (x, y) and flowers, each plant with the same weight. Amplitude: semi-major axis of"
    yield 'the flower\'s path in small vibrations. "around": rms amplitude over the octave around that frequency, in'
    yield "which a resonance that only moves a little does not count.\n"
    yield f"Real plants: the authors' skeletons, grip, flower and density; radius {1e3 * REAL_RADIUS:g} mm everywhere."
    yield "Simulated plants: their true segments, leaves and flowers as rods, gripped at a quarter, half and three"
    yield f"quarters of the stem. E is at least {MARGIN:g} times that at which the plant at EI/GJ = {SOFTEST:g}"
    yield "buckles. One stem node is driven; the stem may turn in the grip.\n"
    yield "![change over frequency](../pictures/twist.png)\n"


def _percent(answers: list[Answer], ratio: float, band: str, share: float) -> str:
    return f"{100 * quantile(answers, ratio, band, share):.0f} %"


def _listed(pairs: list[tuple[str, float]]) -> str:
    return ", ".join(f"{band} against {ratio:g}" for band, ratio in pairs) if pairs else "nothing"


def _band_table(answers: list[Answer]) -> Iterator[str]:
    real = [a for a in answers if " " not in a.plant.name]
    titles = [f"EI/GJ {r:g}: {what}" for r in RATIOS for what in ("median", "p90", "share over 10 %", "real, median")]
    yield f"| shake | {' | '.join(titles)} |\n{'|---' * (len(titles) + 1)}|"
    for band in BANDS:
        cells = []
        for r in RATIOS:
            cells += [quantile(answers, r, band, 0.5), quantile(answers, r, band, 0.9)]
            cells += [share_over(answers, r, band, 0.1), quantile(real, r, band, 0.5) if real else float("nan")]
        yield f"| {band} | {' | '.join(f'{100 * c:.0f} %' for c in cells)} |"


def _plant_table(answers: list[Answer]) -> Iterator[str]:
    yield f"Median change of each plant, EI/GJ {RATIOS[0]:g} / {RATIOS[1]:g}:\n"
    yield f"| plant | nodes | flowers | E of the stem | {' | '.join(BANDS)} |\n{'|---' * (4 + len(BANDS))}|"
    for a in answers:
        p = a.plant
        cells = [" / ".join(f"{100 * np.median(a.change(r, band)):.0f} %" for r in RATIOS) for band in BANDS]
        first = f"| {p.name} | {len(p.rods.nodes)} | {len(p.flowers)} | {p.youngs / 1e6:.0f} MPa |"
        yield f"{first} {' | '.join(cells)} |"


def _check(differences: dict[str, float]) -> Iterator[str]:
    if not differences:
        return
    yield f"Check: simulated ({1e3 * SHAKE:g} mm, nonlinear) against linear flower amplitudes, largest difference over"
    yield "the largest amplitude:\n\n| case | difference |\n|---|---|"
    for case, value in differences.items():
        yield f"| {case} | {100 * value:.1f} % |"


def _twist(ratio: float) -> str:
    return "no twist" if ratio == NO_TWIST else f"EI/GJ {ratio:g}"


def draw(answers: list[Answer], path: Path) -> None:
    """Draw the change over frequency, and two plants' responses."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
    _draw_change(axes[0], answers)
    shown = [answers[0], next((a for a in answers if a.plant.name.startswith("tomato ")), answers[-1])]
    for ax, a in zip(axes[1:], shown, strict=True):
        _draw_response(ax, a.plant)
    for ax in axes:
        ax.set_xlabel("frequency [Hz]")
        ax.set_xticks([1, 2, 5, 10, 20, 40], ["1", "2", "5", "10", "20", "40"])
        ax.minorticks_off()
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_change(ax: Any, answers: list[Answer]) -> None:
    """Median and 90th percentile of each plant's flowers, averaged over the plants."""
    hertz = np.geomspace(0.7, 40, 60)
    rows: dict[float, list[Array]] = {ratio: [] for ratio in RATIOS}
    for a in answers:
        none = amplitudes(a.plant, hanging(a.plant, NO_TWIST), hertz)
        for ratio in RATIOS:
            change = np.abs(none / amplitudes(a.plant, hanging(a.plant, ratio), hertz) - 1).reshape(len(hertz), -1)
            rows[ratio].append(np.percentile(change, (50, 90), axis=1))
    for ratio, colour in zip(RATIOS, COLOURS[1:], strict=True):
        median, most = 100 * np.mean(rows[ratio], axis=0)
        ax.loglog(hertz, median, color=colour, label=f"EI/GJ {ratio:g}, median")
        ax.loglog(hertz, most, "--", color=colour, label=f"EI/GJ {ratio:g}, 90th percentile")
    ax.axhline(10, color="0.5", lw=0.8, ls=":")
    ax.set(title="change without twist, mean of the plants", ylabel="change of flower amplitude [%]")


def _draw_response(ax: Any, plant: Plant) -> None:
    hertz, middle = np.geomspace(0.7, 40, 250), len(plant.grips) // 2
    for ratio, colour in zip((NO_TWIST, *RATIOS), COLOURS, strict=True):
        found = amplitudes(plant, hanging(plant, ratio), hertz)[:, middle, 0, 0]
        ax.loglog(hertz, found, color=colour, label=_twist(ratio), lw=1.3)
    ax.set(title=f"{plant.name}: one flower, shaken along x", ylabel="flower over grip amplitude")


if __name__ == "__main__":
    main()
