"""Write the README's film: a simulated trial's watched shake from the side camera's place, at half the speed.

python tools/film_shake.py docs/pictures/shake.gif [tomato|pepper] [SEED]
"""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
from PIL import Image

from anther.core import Run
from anther.plant import PEPPER, TOMATO, Crop
from anther.pollination import Params, pollinate
from anther.sim import Scene, build
from anther.sim.robot import SIDE
from anther.sim.simulated_cell import PRESETS

WIDTH, COLOURS, RATE, PERIODS, SLOWER = 420, 128, 40, 6, 2.0
"""Width of the film [px], colours, pictures a second, periods of the shake (whole ones, so that the film goes on as it
began), and times slower than it was."""


class Quiet(Run):
    """A run that keeps nothing."""

    def stage(self, name: str, load: Any, compute: Any, save: Any = None) -> Any:
        """Compute a stage."""
        return compute(lambda *_: None)


def main(out: str, species: str = "tomato", seed: str = "0") -> None:
    """Run the trial and write the film of its last, held shake."""
    cell = build(cast(Crop, species), int(seed), 0.0, PRESETS["fast"])
    done = pollinate(cell.robot_side, PEPPER if species == "pepper" else TOMATO, Quiet(Path(), quiet=True), Params())
    log, side, period = cell.world.log(), cell.robot_side.robot, 1 / done.shake.frequency
    end = done.trial.steady[1]
    times = np.linspace(end - PERIODS * period, end, round(PERIODS * period * RATE), endpoint=False)
    scene = Scene.of_plant(cell.plant)
    shapes = [
        cell.plant.posed_vertices(cell.world.segment_poses(log.qpos[int(np.searchsorted(log.times, t))])) for t in times
    ]
    pictures = [scene.moved(shape).render(SIDE, side.T_world_side_camera).rgb for shape in shapes]
    pictures = [Image.fromarray(picture).resize((WIDTH, WIDTH)) for picture in pictures]
    palette = pictures[0].quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    pictures[0].save(
        out, save_all=True, append_images=pictures[1:], duration=round(SLOWER * 1000 / RATE), loop=0, optimize=True
    )
    print(f"{out}: {len(pictures)} pictures, {Path(out).stat().st_size / 1e6:.1f} MB, {done.shake.reason}")


if __name__ == "__main__":
    main(*sys.argv[1:])
