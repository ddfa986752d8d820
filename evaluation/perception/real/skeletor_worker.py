"""skeletor's wave fronts with default settings, on a mesh around the voxels."""

import numpy as np
import skeletor
import trimesh
from scipy.ndimage import binary_dilation, binary_fill_holes
from skimage.measure import marching_cubes
from worker import serve


def skeleton(index):
    """Return skeletor's nodes and edges; it wants a closed mesh, so the voxels are thickened by one and filled."""
    low = index.min(axis=0) - 3
    grid = np.zeros(index.max(axis=0) - low + 4, dtype=bool)
    grid[tuple((index - low).T)] = True
    grid = np.asarray(binary_fill_holes(binary_dilation(grid, np.ones((3, 3, 3)))))
    vertices, faces, _, _ = marching_cubes(grid.astype(np.float32), 0.5)
    found = skeletor.skeletonize.by_wavefront(trimesh.Trimesh(vertices, faces), waves=1, step_size=1, progress=False)
    return np.asarray(found.vertices) + low, np.asarray(found.edges)


serve(skeleton)
