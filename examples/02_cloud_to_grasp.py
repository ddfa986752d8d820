"""From a point cloud to a main stem and a grasp, stage by stage.

Run: python examples/02_cloud_to_grasp.py plant.ply
Without a file it uses a simulated pepper, seen from all around.
"""

from __future__ import annotations

import sys

import numpy as np

from anther.perception import find_stem, flowers, fuse, read_cloud, segment, skeletonize
from anther.pollination import grasp
from anther.show import draw_plant
from anther.sim import capture_from_poses, grow_pepper, orbit_poses

if len(sys.argv) > 1:
    plant = read_cloud(sys.argv[1], units="m", up="z")
else:
    poses = orbit_poses(12, target=(0.72, 0.0, 0.0), distance=0.75, azimuths=(0, 330))
    capture, _truth = capture_from_poses(grow_pepper(0), poses, rng=np.random.default_rng(0))
    plant = fuse(capture, segment(capture))

tree = skeletonize(plant)
main = find_stem(tree)
found = flowers.find_flowers(plant, tree, main)
best = grasp.plan_grasps(main, tree, plant)[0]

print(f"{len(plant.points):,} points, {len(tree.nodes)} nodes, {len(found.positions)} flowers")
print(f"main stem {main.arc_length[-1]:.2f} m; grasp {best.arc_length:.2f} m up: {best.reason}")
print("flange pose (x, y, z, qx, qy, qz, qw):", np.round(best.pose7, 3))
draw_plant(plant, tree, main, best, flowers=found).savefig("plant.png")
