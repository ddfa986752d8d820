"""Compile all kernels ahead, by doing on the sample inputs what people do: `anther doctor --compile`."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from anther.core.compiling import COMPILED
from anther.core.errors import MissingExtra, missing_extra


def compile_all() -> None:
    """Do each kind of work once, and print what compiling took; what an extra is missing for is left out."""
    with TemporaryDirectory() as folder:
        for words, work in _work(Path(folder)):
            begin, before = time.monotonic(), COMPILED.kernels
            print(f"{words} ...", end=" ", flush=True)
            try:
                with redirect_stdout(io.StringIO()):
                    work()
            except ImportError as error:
                missing = error if isinstance(error, MissingExtra) else missing_extra(error)
                if missing is None:
                    raise
                print(f"left out: {missing}")
                continue
            print(f"{COMPILED.kernels - before} kernels, {time.monotonic() - begin:.1f} s", flush=True)
    print(f"compiled for this machine: {COMPILED.kernels} kernels in {COMPILED.seconds:.1f} s of processor time")


def _work(folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield words and what to do; each is imported when its turn comes."""
    from anther.cli.sample_data import write_samples

    write_samples(folder)
    in_time = "--simulate --bare --youngs 1e9 --grip 4 --flower 8 --duration 0.1 --dt 0.01"
    yield "cloud, skeleton, stem, grasp", lambda: _command("skeletonize", folder / "plant.ply", folder / "cloud")
    yield "rods, shake", lambda: _command("plan", folder / "skeleton.swc", folder / "plan")
    yield "rods in time", lambda: _command("plan", folder / "skeleton.swc", folder / "motion", in_time)
    yield "views", lambda: _command("reconstruct", folder / "capture", folder / "views")
    yield "bags", lambda: _command("import", folder / "views.mcap", folder / "imported", positional=True)
    yield "simulated camera", _see_simulated_plant


def _command(name: str, source: Path, out: Path, more: str = "", *, positional: bool = False) -> None:
    from anther.cli.main import do

    do(name, [str(source), *([] if positional else ["--out"]), str(out), *more.split()])


def _see_simulated_plant() -> None:
    """Take one small picture of a simulated plant, with the camera's noise, and begin a film of it."""
    import numpy as np

    from anther.sim.capture import capture_from_poses, orbit_poses
    from anther.sim.render import Scene, d455
    from anther.sim.tomato import grow_tomato

    plant, camera, poses = grow_tomato(0), d455(64, 36), orbit_poses(1, (0.72, 0, -0.1))
    capture_from_poses(plant, poses, rng=np.random.default_rng(0), intrinsics=camera)
    Scene.of_plant(plant).still(camera, poses[0]).changing(camera, poses[0], [plant.vertices])
