"""Shake a leafless stem and compare the nonlinear motion with the linear frequency response.

Run: python examples/01_shake_a_cantilever.py
"""

from __future__ import annotations

import numpy as np

from anther.rods import Clamp, Drive, Rods, frequency_response, natural_frequencies, simulate

# A straight vertical stem: 40 edges, 0.4 m high, 3 mm thick in radius, the stiffness of a tomato stem.
nodes = np.zeros((41, 3))
nodes[:, 2] = np.linspace(0, 0.4, 41)
stem = Rods(
    nodes,
    parent=np.arange(41) - 1,  # node j hangs on node j - 1; node 0 is the root
    edge_radius=3e-3,  # [m]
    youngs=100e6,  # [Pa]
    density=1050.0,  # [kg/m^3]
    viscous_time=2e-3,  # [s]: damping ratio pi f viscous_time
)
clamp = Clamp.root(stem)  # the soil holds the first edge
hertz = natural_frequencies(stem, clamp, 6).frequencies
print("natural frequencies [Hz]:", np.round(hertz[::2], 2), "each twice: the stem is round")

grip, tip, frequency, amplitude = 15, 40, 5.0, 2e-3
shake = Drive(grip, np.array([1.0, 0.0, 0.0]), amplitude, frequency, ramp=1.0)
run = simulate(stem, clamp, shake, duration=8.0, dt=1e-3)
last = run.times > 8.0 - 2 / frequency
moved = np.ptp(run.displacement(tip)[last, 0]) / 2

linear = frequency_response(stem, clamp, grip, (1, 0, 0), [frequency])[0, tip, 0]
expected, lag = abs(linear) * amplitude, np.degrees(np.angle(linear))
print(f"grip {amplitude * 1e3:.1f} mm at {frequency:g} Hz: the tip moves {moved * 1e3:.2f} mm (simulated), ")
print(f"{expected * 1e3:.2f} mm (linear response, phase {lag:.0f} deg)")
print(f"largest force on the grip: {np.linalg.norm(run.grip_force[last], axis=1).max():.3f} N")
