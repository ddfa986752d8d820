# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # The rod solver alone
#
# `anther.rods` knows nothing of plants or robots. This page builds a cantilever, checks it against beam
# theory, shakes its base, hangs a mass on its tip, and goes on to motion so large that linear theory no longer
# holds.

# %%
import matplotlib.pyplot as plt
import numpy as np

from anther.rods import (
    Clamp,
    Drive,
    Rods,
    base_response,
    frequency_response,
    natural_frequencies,
    simulate,
)

# %% [markdown]
# ## A rod is a tree of nodes
#
# Node `j` hangs on node `parent[j]`; node 0 is the root. All in SI units. `Clamp.root` plants it: the soil holds
# the first node and the direction in which the rod leaves it.

# %%
EDGES, LENGTH, RADIUS, YOUNGS, DENSITY = 40, 0.30, 2e-3, 2e9, 1200.0
nodes = np.zeros((EDGES + 1, 3))
nodes[:, 2] = np.linspace(0, LENGTH, EDGES + 1)


def cantilever(tip_mass=0.0):
    lumps = np.zeros(EDGES + 1)
    lumps[-1] = tip_mass
    return Rods(
        nodes,
        parent=np.arange(EDGES + 1) - 1,
        edge_radius=RADIUS,
        youngs=YOUNGS,
        density=DENSITY,
        lumped_mass=lumps,
        viscous_time=4e-4,  # damping ratio pi f viscous_time
    )


rods = cantilever()
clamp = Clamp.root(rods)

# %% [markdown]
# ## Natural frequencies, beside Euler and Bernoulli
#
# Each comes twice, because the rod is round. Gravity is switched off here: beam theory knows none.

# %%
hertz = natural_frequencies(rods, clamp, 6, gravity=(0, 0, 0)).frequencies[::2]
speed = np.sqrt(YOUNGS * RADIUS**2 / 4 / DENSITY)
theory = np.array([1.8751, 4.6941, 7.8548]) ** 2 * speed / (2 * np.pi * LENGTH**2)
for mine, beam in zip(hertz, theory, strict=True):
    print(f"{mine:8.3f} Hz, beam theory {beam:8.3f} Hz, off by {100 * (mine / beam - 1):+.2f} %")

# %% [markdown]
# ## On a shaking table, with and without a tip mass
#
# `base_response` moves all that is clamped. The answer is complex: its modulus is the amplitude of a node per
# metre of the base's, its argument the phase lead.

# %%
frequencies = np.geomspace(2, 200, 300)
bare = base_response(rods, clamp, (1, 0, 0), frequencies)[:, -1, 0]
beam_mass = DENSITY * np.pi * RADIUS**2 * LENGTH
loaded = base_response(cantilever(beam_mass), clamp, (1, 0, 0), frequencies)[:, -1, 0]

fig, ax = plt.subplots(figsize=(7, 3.5))
ax.loglog(frequencies, abs(bare), label="bare")
ax.loglog(frequencies, abs(loaded), label="its own mass at the tip")
ax.set(xlabel="frequency [Hz]", ylabel="tip over base [m/m]")
ax.legend()
ax.grid(alpha=0.3)
fig.tight_layout()

# %% [markdown]
# ## Held and shaken half-way up
#
# A gripper holds one node, or several that move as one body, and the rest answers.

# %%
grip = 20
held = frequency_response(rods, clamp, grip, (1, 0, 0), [12.0])[0, -1, 0]
pads = frequency_response(rods, clamp, [19, 20, 21], (1, 0, 0), [12.0])[0, -1, 0]
print(f"at 12 Hz the tip moves {abs(held):.2f} times as far as a grip in which the rod can turn,")
print(f"and {abs(pads):.2f} times as far as pads that hold 15 mm of it")

# %% [markdown]
# ## Large motion
#
# `simulate` is nonlinear. It is asked to be steady for a second, and its last two periods are compared with the
# linear answer at growing amplitudes.

# %%
frequency = 12.0
for amplitude in (1e-3, 5e-3, 20e-3):
    shake = Drive(grip, np.array([1.0, 0.0, 0.0]), amplitude, frequency, ramp=0.5)
    run = simulate(rods, clamp, shake, duration=2.0, dt=1e-3)
    last = run.times > 2.0 - 2 / frequency
    moved = np.ptp(run.displacement(EDGES)[last, 0]) / 2
    print(f"grip {1e3 * amplitude:4.0f} mm: tip {1e3 * moved:6.2f} mm, linear {1e3 * amplitude * abs(held):6.2f} mm")

# %% [markdown]
# Where next: [how the solver works](../elastic_rod.md), [what it was checked against](../reports/rod_validation.md),
# and `anther plan --simulate` and `anther plan --map`, which do this to a skeleton file.
