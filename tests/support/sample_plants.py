"""Small synthetic plants and the paper's skeletons, for the tests of the plant model and what is built on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial.transform import Rotation

from anther.core.geometry import arc_length
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, STEM, Stem
from anther.pollination.grasp import Grasp


def straight_stem(count: int = 25, height: float = 0.4, radius: tuple[float, float] = (4e-3, 2.5e-3)) -> Skeleton:
    """A vertical stem with a linear taper."""
    z = np.linspace(0, height, count)
    nodes = np.stack([np.full(count, 0.7), np.zeros(count), z], axis=1)
    return Skeleton(nodes, np.arange(-1, count - 1), np.linspace(*radius, count))


def branched(branches: int = 3, *, radius: tuple[float, float] = (4e-3, 2.5e-3)) -> tuple[Skeleton, Stem, Flowers]:
    """A vertical stem with side branches of 60 mm in a spiral, a flower 20 mm beyond each tip."""
    trunk = straight_stem(radius=radius)
    nodes, parent, r = trunk.nodes.tolist(), trunk.parent.tolist(), trunk.radius.tolist()
    places, attachment = [], []
    for b in range(branches):
        base = 10 + 4 * b
        angle = np.radians(137.5 * b + 20)
        way = np.array([np.cos(angle), np.sin(angle), 0.7])
        way /= np.linalg.norm(way)
        last = base
        for k in range(1, 7):
            nodes.append(trunk.nodes[base] + 0.01 * k * way)
            parent.append(last)
            r.append(1.2e-3)
            last = len(nodes) - 1
        places.append(trunk.nodes[base] + 0.08 * way)
        attachment.append(last)
    skeleton = Skeleton(np.array(nodes), np.array(parent), np.array(r))
    return skeleton, stem_along(skeleton, 24), Flowers(np.array(places).reshape(-1, 3), np.array(attachment, dtype=int))


def stem_along(skeleton: Skeleton, top: int) -> Stem:
    """The main stem from the root to node `top`."""
    path = skeleton.path_from_root(top)
    organ = np.full(len(skeleton.nodes), BRANCH, dtype=np.uint8)
    organ[path] = STEM
    on_stem = organ == STEM
    attached = np.unique(skeleton.parent[1:][~on_stem[1:] & on_stem[skeleton.parent[1:]]])
    return Stem(path, arc_length(skeleton.nodes[path]), np.flatnonzero(np.isin(path, attached)), organ)


def turned(skeleton: Skeleton, flowers: Flowers, angle: float) -> tuple[Skeleton, Flowers]:
    """The same plant turned about the vertical through its root."""
    R, root = Rotation.from_euler("z", angle).as_matrix(), skeleton.nodes[0]
    moved = Skeleton((skeleton.nodes - root) @ R.T + root, skeleton.parent, skeleton.radius)
    return moved, Flowers((flowers.positions - root) @ R.T + root, flowers.attachment)


def grasps_on(skeleton: Skeleton, stem: Stem, places: list[int], approach_angle: float = 0.0) -> list[Grasp]:
    """Horizontal grasps at positions within the stem's node list."""
    n = np.array([np.cos(approach_angle), np.sin(approach_angle), 0.0])
    y = np.cross([0.0, 0.0, 1.0], n)
    grasps = []
    for k in places:
        T = np.eye(4)
        T[:3, :3] = np.stack([np.cross(y, n), y, n], axis=1)
        point = skeleton.nodes[stem.node_ids[k]]
        T[:3, 3] = point - 0.13 * n
        up = np.array([0.0, 0.0, 1.0])
        grasps.append(Grasp(T, point, up, n, float(stem.arc_length[k]), 7e-3, 0.03, 1.0, "test"))
    return grasps


def read_paper_plant(path: Path, flower: int, radius: float = 4e-3) -> tuple[Skeleton, Stem, Flowers]:
    """One of the paper's skeletons with a taper of ours; `flower` is the authors' zero-based node number."""
    nodes_text, edges_text = path.read_text().split("*Edges")
    nodes = np.array([[float(v) for v in line.split(",")] for line in nodes_text.splitlines()[1:] if line.strip()])
    edges = np.array([[int(v) - 1 for v in line.split(",")] for line in edges_text.splitlines() if line.strip()])
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(nodes),) * 2).tocsr()
    order, before = breadth_first_order(graph, int(nodes[:, 2].argmin()), directed=False)
    new = np.empty(len(nodes), dtype=int)
    new[order] = np.arange(len(order))
    parent = np.array([-1, *new[before[order[1:]]]])
    x = nodes[order]
    skeleton = Skeleton(x, parent, radius - 0.003 * np.clip(x[:, 2] - x[0, 2], 0, 0.6))
    node = int(new[flower])
    flowers = Flowers(x[[node]] + [0.012, 0.005, 0.0], np.array([node]))
    return skeleton, stem_along(skeleton, int(x[:, 2].argmax())), flowers
