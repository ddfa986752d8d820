"""A Y-shaped plant held at its fork: natural frequency, damping ratio and frequency response, against the formulas.

Run: python examples/03_tuning_fork.py
Held at the fork, each arm is a cantilever shaken at its base, which textbooks solve (Rao, Vibration of Continuous
Systems). The arms are shaken across the plane of the Y, in weightlessness, so that the formulas hold.
"""

from __future__ import annotations

import numpy as np

from anther.rods import Clamp, Rods, natural_frequencies, response_map

STEM, ARM, LENGTH = 20, 40, 0.2  # edges of the stem, edges and length [m] of each arm
RADIUS, YOUNGS, DENSITY, VISCOUS_TIME = 2e-3, 100e6, 1050.0, 3e-3  # m, Pa, kg/m^3, s

nodes, parent = [[0, 0, 0.01 * k] for k in range(STEM + 1)], list(range(-1, STEM))
for side in (-1, 1):
    for k in range(1, ARM + 1):
        parent.append(len(nodes) - 1 if k > 1 else STEM)
        nodes.append([side * np.sqrt(0.5) * LENGTH * k / ARM, 0, 0.01 * STEM + np.sqrt(0.5) * LENGTH * k / ARM])
radius = np.where(np.arange(len(nodes)) <= STEM, 8e-3, RADIUS)
plant = Rods(np.array(nodes), np.array(parent), radius, YOUNGS, DENSITY, viscous_time=VISCOUS_TIME)
nothing, fork, tip = (0, 0, 0), (STEM, STEM - 1), STEM + ARM

speed = RADIUS / 2 * np.sqrt(YOUNGS / DENSITY)  # sqrt(EI / mass per length) of a round rod [m^2/s]
first = 1.87510407**2 * speed / (2 * np.pi * LENGTH**2)
modes = natural_frequencies(plant, Clamp(np.arange(STEM + 1)), 4, gravity=nothing)  # the fork held: 2 arms x 2 planes
print(f"first natural frequencies: {modes.frequencies.round(3)} Hz (rods), {first:.3f} Hz (formula)")

fine = np.linspace(0.7, 1.3, 1201) * first
swing = abs(response_map(plant, Clamp.root(plant), [fork], [(0, 1, 0)], fine, observe=[tip], gravity=nothing)[..., 1])
above = fine[swing.ravel() > swing.max() / np.sqrt(2)]
width = np.ptp(above) / (2 * first)  # half-power bandwidth / 2 f
ratio = np.pi * first * VISCOUS_TIME
print(f"damping ratio: {modes.damping_ratios[0]:.4f} (modes), {width:.4f} (bandwidth), {ratio:.4f} (formula)")
print("\n   Hz    tip / grip: rods         formula")
some = np.array([1, 2, 4, first, 5, 10, 20, 27])
rods = response_map(plant, Clamp.root(plant), [fork], [(0, 1, 0)], some, observe=[tip], gravity=nothing)[:, 0, 0, 0, 1]
omega = 2 * np.pi * some
bl = LENGTH * np.sqrt(omega / (speed * np.sqrt(1 + 1j * omega * VISCOUS_TIME)))  # beta L; E (1 + i omega tau)
formula = (np.cos(bl) + np.cosh(bl)) / (1 + np.cos(bl) * np.cosh(bl))
for f, ours, theirs in zip(some, rods, formula, strict=True):
    a, b = np.degrees(np.angle([ours, theirs]))
    print(f"{f:5.2f} {abs(ours):9.3f} at {a:5.0f} deg {abs(theirs):9.3f} at {b:5.0f} deg")
