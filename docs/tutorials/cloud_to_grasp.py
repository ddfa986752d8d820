# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # From a cloud to a grasp
#
# A point cloud of a plant goes in: from a laser scanner, photogrammetry, or depth cameras. Out come one rooted
# tree with radii, the main stem, and ranked places to hold it. The sample is a simulated tomato; put your own
# file in its place.

# %%
import tempfile
from pathlib import Path

import numpy as np

from anther.cli.sample_data import write_samples
from anther.perception import read_cloud, skeletonize, stem
from anther.pollination import plan_grasps
from anther.show import draw_plant

folder = Path(tempfile.mkdtemp())
write_samples(folder)

# %% [markdown]
# ## Read it
#
# Units and the upward axis are yours to say: a cloud in centimetres looks like one in metres to a program.

# %%
plant = read_cloud(folder / "plant.ply", units="m", up="z")
size = np.ptp(plant.points, axis=0)
print(f"{len(plant.points):,} points, {size[0]:.2f} x {size[1]:.2f} x {size[2]:.2f} m")

# %% [markdown]
# ## One tree, rooted in the soil
#
# Every node comes after its parent. The radius of a stem is half its thickness.

# %%
tree = skeletonize(plant)
tips = np.setdiff1d(np.arange(len(tree.nodes)), tree.parent)
print(f"{len(tree.nodes)} nodes, {len(tips)} tips; root at {np.round(tree.nodes[0], 3)} m")

# %% [markdown]
# ## The main stem, and how sure it is

# %%
main = stem.find_stem(tree)
print(f"main stem {main.arc_length[-1]:.2f} m long; right with a probability of {main.confidence:.0%}")

# %% [markdown]
# ## Where to hold it
#
# The places are ranked; each says why. Without an arm nobody asks whether it can be reached: give `plan_grasps`
# an arm's planner for that, as `anther reconstruct` does.

# %%
ranked = plan_grasps(main, tree, plant)
for one in ranked[:3]:
    print(f"{1000 * one.arc_length:.0f} mm above the root, {1000 * one.stem_diameter:.1f} mm thick: {one.reason}")

# %%
draw_plant(plant, tree, main, ranked[0])

# %% [markdown]
# The same from the command line, with all results in a folder and a report to look at:
#
# ```
# anther skeletonize plant.ply --units m --up z --out tree/
# ```
#
# Next: [how the skeleton is made](../skeleton.md), [grasps](../grasp.md), [files of other
# programs](../formats.md).
