"""Write the README's film: a simulated trial's watched shake, as the side camera sees it, at half the speed.

python tools/film_shake.py docs/pictures/shake.gif [tomato|pepper] [SEED]
"""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
from PIL import Image

from anther.commands.simulated_cell import PRESETS, Species, build
from anther.pipeline import Params, pollinate
from anther.plant import PEPPER, TOMATO
from anther.runs import Run

WIDTH, MARGIN, COLOURS, SLOWER, LIVELY = 420, 30, 64, 2.0, 40
"""Width of the film [px], how much is shown around what moves [px], colours, times slower; and what counts as
moving, of 255."""


class Quiet(Run):
    """A run that keeps nothing."""

    def stage(self, name: str, load: Any, compute: Any, save: Any = None) -> Any:
        """Compute a stage."""
        return compute(lambda *_: None)


def main(out: str, species: str = "tomato", seed: str = "0") -> None:
    """Run the trial and write the film of its last, held shake."""
    cell = build(cast(Species, species), int(seed), 0.0, PRESETS["fast"])
    done = pollinate(cell.robot_side, PEPPER if species == "pepper" else TOMATO, Quiet(Path(), quiet=True), Params())
    begin, end = done.trial.steady
    frames = [frame for frame in done.trial.frames if begin <= frame.time <= end]
    period = len(frames) * 1 / done.shake.frequency / (end - begin)
    frames = frames[: round(period * int(len(frames) / period))]  # whole periods, so that the film goes on as it began
    usual = np.median(frames[0].rgb, axis=(0, 1))
    even = [np.clip(f.rgb * (usual / np.median(f.rgb, axis=(0, 1))), 0, 255).astype(np.uint8) for f in frames]
    moved = np.ptp([picture.mean(axis=2) for picture in even], axis=0) > LIVELY
    rows, columns = np.flatnonzero(moved.mean(axis=1) > 0.01), np.flatnonzero(moved.mean(axis=0) > 0.01)
    shown = (
        slice(max(rows[0] - MARGIN, 0), rows[-1] + MARGIN),
        slice(max(columns[0] - MARGIN, 0), columns[-1] + MARGIN),
    )
    pictures = []
    for picture in even:
        part = Image.fromarray(picture[shown])
        pictures.append(part.resize((WIDTH, round(WIDTH * part.height / part.width))).quantize(COLOURS))
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    pictures[0].save(
        out,
        save_all=True,
        append_images=pictures[1:],
        duration=round(SLOWER * 1000 * (end - begin) / len(frames)),
        loop=0,
        optimize=True,
    )
    print(f"{out}: {len(pictures)} pictures, {Path(out).stat().st_size / 1e6:.1f} MB, {done.shake.reason}")


if __name__ == "__main__":
    main(*sys.argv[1:])
