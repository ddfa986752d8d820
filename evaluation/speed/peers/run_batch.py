"""Solve small vibrations of many plants that differ in stiffness, at this or another commit; print processor seconds.

    PYTHONPATH=SRC python evaluation/speed/peers/run_batch.py ROOM BATCH.npz

ROOM is the package of the rods, anther.rods or what it was called. BATCH holds nodes (N, 3), parent (N,), seen (F,) and
how many plants. Each is 2 to 0.5 times as stiff, settles under gravity, and answers at FREQUENCIES from a grip in the
middle of its stem along x, y and z. Compiling is not counted.
"""

import importlib
import sys
import time

import numpy as np

FREQUENCIES = np.geomspace(1, 40, 40)
GRIP = 60
YOUNGS = 5e9  # Pa, at which 1.3 m can stand


def main(room: str, path: str) -> None:
    """Solve one plant, which compiles, then all."""
    rods, batch = importlib.import_module(room), dict(np.load(path))

    def solve(factor: float) -> None:
        parts = (batch["nodes"], batch["parent"], 3e-3, factor * YOUNGS, 1000.0)
        plant = rods.Rods(*parts, viscous_time=1e-4)
        rods.response_map(plant, rods.Clamp.root(plant), [[GRIP]], np.eye(3), FREQUENCIES, observe=batch["seen"])

    solve(1.0)
    begin = time.process_time()
    for factor in 2 ** np.linspace(1, -1, int(batch["plants"])):
        solve(factor)
    print(time.process_time() - begin)


if __name__ == "__main__":
    main(*sys.argv[1:])
