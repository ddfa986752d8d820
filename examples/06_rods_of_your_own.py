"""A flat petiole: bent by a force, swinging in two planes, plucked, on a shaking table, leaning on an elastic string.

Run: python examples/06_rods_of_your_own.py
"""

from dataclasses import replace

import numpy as np

from anther.rods import Clamp, FunctionDrive, Loads, Rods, Section, Support, equilibrium, natural_frequencies, simulate

LENGTH, EDGES, YOUNGS, DENSITY, WIDTH, HEIGHT = 0.15, 30, 300e6, 950.0, 5e-3, 2.5e-3  # m, -, Pa, kg/m^3, m, m
nodes = np.outer(np.linspace(0, LENGTH, EDGES + 1), [1, 0, 0])
section = Section.ellipse(WIDTH, HEIGHT, axis=(0, 1, 0))  # the wide side lies along y
petiole = Rods(nodes, np.arange(EDGES + 1) - 1, WIDTH / 2, YOUNGS, DENSITY, viscous_time=2e-3, section=section)
clamp, nothing, tip = Clamp.root(petiole), (0, 0, 0), EDGES

pull = Loads.at(petiole, tip, force=(0, 2e-3, 2e-3))
bent = (equilibrium(petiole, clamp, gravity=nothing, loads=pull) - nodes)[tip]
beam = 2e-3 * LENGTH**3 / 3 / YOUNGS / np.array([section.bend_1, section.bend_2])
print(
    f"2 mN bend it by {1e3 * bent[1]:.3f}, {1e3 * bent[2]:.3f} mm; theory {1e3 * beam[0]:.3f}, {1e3 * beam[1]:.3f} mm"
)

hertz = natural_frequencies(petiole, clamp, 2, gravity=nothing).frequencies
mass = DENSITY * section.area
theory = 1.87510407**2 / (2 * np.pi * LENGTH**2) * np.sqrt(YOUNGS * np.array([section.bend_2, section.bend_1]) / mass)
print(f"frequencies {hertz.round(2)} Hz; theory {theory.round(2)} Hz")

free = simulate(petiole, clamp, None, 6 / hertz[0], 0.01 / hertz[0], gravity=nothing, start="plucked", loads=pull)
tops = free.positions[[300, 400, 500], tip, 2]
print(f"plucked: log decrement {np.log(tops[0] / tops[2]) / 2:.3f}; theory {2 * np.pi**2 * hertz[0] * 2e-3:.3f}")

table = FunctionDrive(0, lambda t: np.outer(1e-3 * np.sin(2 * np.pi * hertz[0] * t), [0, 0, 1]))
shaken = simulate(petiole, clamp, None, 4 / hertz[0], 0.01 / hertz[0], gravity=nothing, base=table)
swing = 1e3 * np.abs(shaken.positions[:, tip, 2]).max()
print(f"on a table shaken by 1 mm at its frequency the tip swings {swing:.1f} mm")

leaning = replace(petiole, supports=(Support(tip, translation=20.0),))  # [N/m]
print("leaning on a string:", natural_frequencies(leaning, clamp, 2, gravity=nothing).frequencies.round(2), "Hz")
