"""Find a stem's stiffness, density and damping from a pluck and tip masses, and see what leaves and taper do to it.

The measurements are made here from a known stem. With your own, `anther identify` reads them from CSV files.

Run: python examples/05_identify_a_stem.py [PICTURE.png]
"""

from __future__ import annotations

import sys

import numpy as np

from anther.identification import (
    ClampedStem,
    MaterialTest,
    Orientation,
    first_frequency,
    fit_free_vibration,
    identify,
    leaf_mass_effect,
    tip_deflections,
)
from anther.pictures.material_test import LeafMassEffect, Pluck, draw_material_test

youngs, density, damping = 90e6, 1080.0, 0.04  # the truth: [Pa], [kg/m^3], [-]
rng = np.random.default_rng(0)

# A potted stem, 30 cm, 5 to 2.6 mm in radius, with five leaves.
stem = ClampedStem(
    distance=np.array([0.0, 0.1, 0.2, 0.3]),  # [m] from the clamp
    radius=np.array([5.0, 4.4, 3.6, 2.6]) * 1e-3,
    length=0.3,
    leaf_distance=np.array([0.08, 0.14, 0.20, 0.25, 0.28]),
    leaf_mass=np.array([2.0, 2.0, 1.5, 1.0, 0.5]) * 1e-3,  # [kg]
)

# Ten cut samples, one pluck filmed at 50 Hz, and three masses hung on the tip.
radius, length = rng.uniform(3e-3, 5e-3, 10), rng.uniform(0.02, 0.05, 10)
mass = rng.normal(density, 30, 10) * np.pi * radius**2 * length
times = np.arange(0, 6, 0.02)
omega = 2 * np.pi * first_frequency(stem, youngs, density, "upright")
motion = 0.01 * np.exp(-damping * omega * times) * np.cos(np.sqrt(1 - damping**2) * omega * times)
motion += rng.normal(0, 3e-4, len(times))  # what the camera adds
pluck = fit_free_vibration(times, motion)
load = np.array([4e-3, 8e-3, 12e-3])
sunk = tip_deflections(stem, youngs, density, load) + rng.normal(0, 3e-4, 3)

test = MaterialTest(
    stem,
    "upright",
    sample_mass=mass,
    sample_radius=radius,
    sample_length=length,
    plucks=(pluck,),
    tip_mass=load,
    deflection=sunk,
)
found = identify(test)
print(f"density {found.density.value:.0f} ± {found.density.standard_error:.0f} kg/m3 (truth {density:.0f})")
print(f"damping ratio {pluck.damping_ratio:.4f} ± {pluck.damping_error:.4f} (truth {damping})")
for estimate in found.estimates:
    low, high = estimate.value - estimate.standard_error, estimate.value + estimate.standard_error
    print(f"E from {estimate.name}: {low / 1e6:.0f} to {high / 1e6:.0f} MPa (truth {youngs / 1e6:.0f})")
assert found.bare_uniform_youngs is not None
print(f"E by the formula for a uniform bare stem: {found.bare_uniform_youngs / 1e6:.0f} MPa")

# The same frequency means another E for more or fewer leaves, and for another way of holding the stem.
shares = np.array([0.0, 0.5, 1.0, 1.5])
held: tuple[Orientation, ...] = ("weightless", "upright", "hanging")
stems = [stem.changed(leaf_mass=float(share) - 1) for share in shares]
moduli = leaf_mass_effect(stems, pluck.natural_frequency, found.density.value, held)
for share, row in zip(shares, moduli, strict=True):
    print(
        f"with {share:.0%} of the leaves:", ", ".join(f"{h} {e / 1e6:.0f} MPa" for h, e in zip(held, row, strict=True))
    )

if len(sys.argv) > 1:
    leaves = float(stem.leaf_mass.sum())
    effect = LeafMassEffect("leaf mass, where it is", leaves * shares, leaves, held, moduli)
    draw_material_test(test, found, [Pluck("pluck", times, motion, pluck)], effect).savefig(sys.argv[1], dpi=110)
