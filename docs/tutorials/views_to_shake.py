# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # From views to a shake
#
# RGB-D views of one plant go in, with the camera's pose at each. Out comes which shake moves its flowers most
# within what the plant bears. The sample holds six views of a simulated tomato; [capture](../capture.md) says how
# to lay out your own.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from anther.cli.sample_data import write_samples
from anther.perception import Capture, find_stem, flowers, fuse, segment, skeletonize
from anther.plant import TOMATO, build_plant
from anther.pollination import plan_grasps, plan_shake
from anther.show import draw_plan

folder = Path(tempfile.mkdtemp())
write_samples(folder)
capture = Capture.load(folder / "capture")
print(f"{len(capture.depth)} views of {capture.intrinsics.width} x {capture.intrinsics.height} pixels")

# %% [markdown]
# ## Look at what went in

# %%
fig, axes = plt.subplots(1, 3, figsize=(9, 3))
for axis, image in zip(axes, capture.rgb[:3], strict=True):
    axis.imshow(image)
    axis.set_axis_off()
fig.tight_layout()

# %% [markdown]
# ## Views to plant
#
# Masks say which pixels are plant and flower, the cloud brings the views together, the rest reads the tree from
# it.

# %%
seen = fuse(capture, segment(capture))
tree = skeletonize(seen)
main = find_stem(tree)
blossoms = flowers.find_flowers(seen, tree, main)
if not len(blossoms.positions):  # hidden behind leaves: shake for flowers at the ends of trusses
    blossoms = flowers.assume_flowers(tree, main)
print(f"main stem {main.arc_length[-1]:.2f} m, {len(blossoms.positions)} flowers")
for note in (*seen.notes, *blossoms.notes):
    print("note:", note)

# %% [markdown]
# ## Plant to rods
#
# The tree becomes elastic rods that stand still under gravity, with leaves as masses and a pedicel for every
# flower. What no scan shows, stiffness above all, is a belief with a spread.

# %%
rods = build_plant(tree, main, blossoms, seen, TOMATO)
matter = rods.material
print(f"E {matter.youngs / 1e6:.0f} MPa, to a factor of {np.exp(1.645 * matter.youngs_spread):.1f} either way (90 %)")

# %% [markdown]
# ## Which shake
#
# All grasps, directions and frequencies are compared over plants drawn from that belief. The margin is stated: in
# one shake of forty a load of the plant may pass its limit.

# %%
plan = plan_shake(rods, plan_grasps(main, tree, seen)[:6])
print(plan.reason)
for name, value, limit, share in plan.limits:
    print(f"{share:6.0%}  {name}: {value:.3g} of {limit:.3g}")

# %%
draw_plan(plan)

# %% [markdown]
# A robot raises this shake while a camera watches the flowers: [escalation](../escalation.md). The same from the
# command line:
#
# ```
# anther reconstruct capture --out run/
# anther plan run/ --out plan/
# ```
