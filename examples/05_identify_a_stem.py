"""Find a stem's stiffness, density and damping from measurements made here. With your own: anther identify.

Run: python examples/05_identify_a_stem.py [PICTURE.png]
"""

import sys

import numpy as np

from anther.plant import bench
from anther.show.pictures.estimates import Pluck, draw_material_test

youngs, density, damping = 90e6, 1080.0, 0.04  # the truth: [Pa], [kg/m^3], [-]
rng = np.random.default_rng(0)
stem = bench.ClampedStem(  # potted, 30 cm, 5 to 2.6 mm in radius, with three leaves
    distance=np.array([0.0, 0.1, 0.2, 0.3]),  # [m] from the clamp
    radius=np.array([5.0, 4.4, 3.6, 2.6]) * 1e-3,
    length=0.3,
    leaf_distance=np.array([0.10, 0.20, 0.28]),
    leaf_mass=np.array([3.0, 2.5, 1.5]) * 1e-3,  # [kg]
)
radius, length = rng.uniform(3e-3, 5e-3, 10), rng.uniform(0.02, 0.05, 10)  # ten cut samples
mass = rng.normal(density, 30, 10) * np.pi * radius**2 * length
times, omega = np.arange(0, 6, 0.02), 2 * np.pi * bench.first_frequency(stem, youngs, density, "upright")
motion = 0.01 * np.exp(-damping * omega * times) * np.cos(np.sqrt(1 - damping**2) * omega * times)
motion += rng.normal(0, 3e-4, len(times))  # filmed at 50 Hz
pluck = bench.fit_free_vibration(times, motion)
load = np.array([4e-3, 8e-3, 12e-3])  # hung on the tip [kg]
sunk = bench.tip_deflections(stem, youngs, density, load) + rng.normal(0, 3e-4, 3)

samples = {"sample_mass": mass, "sample_radius": radius, "sample_length": length}
test = bench.MaterialTest(stem, "upright", **samples, plucks=(pluck,), tip_mass=load, deflection=sunk)
found = bench.identify(test)
print(f"density {found.density.value:.0f} ± {found.density.standard_error:.0f} kg/m3 (truth {density:.0f})")
print(f"damping ratio {pluck.damping_ratio:.4f} ± {pluck.damping_error:.4f} (truth {damping})")
for estimate in found.estimates:
    low, high = estimate.value - estimate.standard_error, estimate.value + estimate.standard_error
    print(f"E from {estimate.name}: {low / 1e6:.0f} to {high / 1e6:.0f} MPa (truth {youngs / 1e6:.0f})")
if len(sys.argv) > 1:
    draw_material_test(test, found, [Pluck("pluck", times, motion, pluck)]).savefig(sys.argv[1], dpi=110)
