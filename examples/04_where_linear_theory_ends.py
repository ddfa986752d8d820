"""Sixteen shakes of a branched plant at once: how far a flower moves per millimetre of shake, small shakes and large.

Run: python examples/04_where_linear_theory_ends.py
The frequency response knows one ratio for every amplitude. Large shakes bend the plant so far that it is wrong.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from anther.rods import Clamp, Drive, Rods, frequency_response, simulate, with_gravity_equilibrium

EDGE, STEM, TRUSS, ZETA, DT = 0.015, 30, 10, 0.05, 4e-3  # m, edges of stem and truss, damping ratio, s
stem = np.outer(np.arange(STEM + 1), [0, 0, EDGE])
truss = stem[20] + np.outer(np.arange(1, TRUSS + 1), [0.8 * EDGE, 0, 0.6 * EDGE])
inside = np.arange(STEM + 1 + TRUSS) <= STEM
plant = Rods(
    np.concatenate([stem, truss]),
    parent=np.array([*range(-1, STEM), 20, *range(STEM + 1, STEM + TRUSS)]),
    edge_radius=np.where(inside, 4e-3, 1.2e-3),
    youngs=150e6,
    density=1050.0,
    lumped_mass=np.where(inside, 4e-4, 1e-4),  # leaves along the stem, flowers along the truss [kg]
)
clamp, grip, flower, axis = Clamp.root(plant), 12, STEM + TRUSS, np.array([1.0, 0.0, 0.0])
plant = with_gravity_equilibrium(plant, clamp)

frequencies, amplitudes, many = (1.5, 2.5, 3.0, 4.0), (0.1e-3, 0.5e-3, 2e-3, 5e-3), []
with ThreadPoolExecutor() as pool:  # compiled code releases Python's lock: threads suffice for all cores
    for frequency in frequencies:
        damped = replace(plant, viscous_time=ZETA / (np.pi * frequency))
        shakes = [Drive(grip, axis, amplitude, frequency, ramp=4.0) for amplitude in amplitudes]
        many += [pool.submit(simulate, damped, clamp, shake, 10.0, DT, start="scanned") for shake in shakes]
runs = iter(many)

print("flower mm per mm of shake\n  Hz   linear " + "".join(f"{1e3 * a:6.1f} mm" for a in amplitudes))
for f in frequencies:
    ratio = abs(frequency_response(plant, clamp, grip, axis, [f], loss_factor=2 * ZETA)[0, flower, 0])
    line = f"{f:4.1f} {ratio:8.2f} "
    for amplitude, run in zip(amplitudes, runs, strict=False):
        period = slice(-round(1 / f / DT) - 1, None)
        moved = None if run.exception() else np.ptp(run.result().displacement(flower)[period, 0]) / 2
        line += "  failed " if moved is None else f"{moved / amplitude:9.2f}"
    print(line)
