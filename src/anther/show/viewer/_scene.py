"""What stands in the scene: cloud, obstacles, cameras, skeleton, flowers, grasps. N skeleton nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, LEAF, ORGAN_NAMES, STEM, TRUSS
from anther.robot.arm.saved import load_arm
from anther.show.results import ARM, RunResults


def placed(T: Array) -> tuple[Any, Any]:
    """Return position (3,) and quaternion w, x, y, z of a transform (4, 4)."""
    return T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)


POINT_SIZE = 0.0015
"""[m]"""
FLOWER_RADIUS = 0.008
"""[m]"""
PALE = 0.45
"""Share of white in the cloud's colours, so that the skeleton shows through it."""
VIEW_FROM = np.array([0.4, -0.6, 0.2])
"""From where the plant is seen first, from its middle [m]: across the arm, which comes along +x."""
POINTS_IN_FILE = 150_000
"""Of the cloud at most, where the scene is written to one file."""
COLOURS = {STEM: (210, 40, 40), BRANCH: (230, 140, 40), TRUSS: (200, 60, 200), LEAF: (60, 150, 60)}
WIDTHS = {STEM: 0.004, BRANCH: 0.0015, TRUSS: 0.0015, LEAF: 0.001}
"""Organ -> how thick its lines are drawn [m]."""


@dataclass
class Handles:
    """What the scene holds that can be shown, hidden, moved or asked.

    Attributes:
        layers: name -> viser's handles.
        lines: (handle, the edges (E, 2) it draws) of each organ of the skeleton.
        rest: (N, 3) the skeleton's nodes at rest [m].
        joints: the balls at the skeleton's nodes, to be clicked.
        said: of each node, what is there.
        legend: which colour is what, as Markdown.
    """

    layers: dict[str, list[Any]] = field(default_factory=dict)
    lines: list[tuple[Any, NDArray[Any]]] = field(default_factory=list)
    rest: Array = field(default_factory=lambda: np.zeros((0, 3)))
    joints: Any = None
    said: list[str] = field(default_factory=list)
    legend: str = ""

    def bend(self, moved: Array) -> None:
        """Draw the skeleton with its nodes displaced by (N, 3) [m]."""
        nodes = (self.rest + moved).astype(np.float32)
        for line, edges in self.lines:
            line.points = nodes[edges]
        if self.joints is not None:
            self.joints.batched_positions = nodes


def build_scene(server: viser.ViserServer, results: RunResults, most_points: int | None = None) -> Handles:
    """Add what a run holds to a viser scene; of the cloud at most so many points, None: all."""
    scene, handles = server.scene, Handles()
    scene.set_up_direction("+z")
    scene.add_frame("/world", axes_length=0.1, axes_radius=0.002)
    _add_cloud(scene, results, handles, most_points)
    _add_cameras(scene, results, handles)
    _add_keep_out(scene, results, handles)
    _add_skeleton(scene, results, handles)
    _add_grasps(scene, results, handles)
    points = results.cloud.points if results.cloud is not None else handles.rest
    if len(points):
        middle = points.mean(axis=0)
        server.initial_camera.look_at = tuple(middle)
        server.initial_camera.position = tuple(middle + VIEW_FROM)
    return handles


def _add_cloud(scene: Any, results: RunResults, handles: Handles, most: int | None) -> None:
    cloud = results.cloud
    if cloud is None:
        return
    step = 1 if most is None else max(1, -(-len(cloud.points) // most))
    points = cloud.points[::step].astype(np.float32)
    colours = cloud.colors[::step] if cloud.colors is not None else np.tile([90, 150, 90], (len(points), 1))
    colours = (PALE * 255 + (1 - PALE) * colours).astype(np.uint8)
    size = POINT_SIZE * np.sqrt(step)
    plant = scene.add_point_cloud("/plant", points, colours, point_size=size, point_shape="circle")
    handles.layers["cloud"] = [plant]
    if len(cloud.obstacles):
        grey = np.full((len(cloud.obstacles), 3), 120, np.uint8)
        pot = scene.add_point_cloud("/pot and bench", cloud.obstacles.astype(np.float32), grey, point_size=0.005)
        handles.layers["pot and bench"] = [pot]


def _add_keep_out(scene: Any, results: RunResults, handles: Handles) -> None:
    """Add the boxes of the run's cell file that the arm keeps out of."""
    if not (results.folder / ARM).exists():
        return
    style = {"color": (150, 110, 70), "opacity": 0.15}
    shown = [
        scene.add_box(
            f"/keep out/{i}", dimensions=tuple(b.upper - b.lower), position=tuple((b.lower + b.upper) / 2), **style
        )
        for i, b in enumerate(load_arm(results.folder / ARM)[1])
    ]
    if shown:
        handles.layers["keep-out boxes"] = shown


def _add_cameras(scene: Any, results: RunResults, handles: Handles) -> None:
    if results.capture is None:
        return
    k = results.capture.intrinsics
    style = {"fov": 2 * np.arctan(k.height / (2 * k.fy)), "aspect": k.width / k.height, "color": (90, 110, 170)}
    handles.layers["views"] = [
        scene.add_camera_frustum(
            f"/views/{i:02d}", **style, scale=0.03, thickness=0.001, position=position, wxyz=wxyz, visible=False
        )
        for i, (position, wxyz) in enumerate(map(placed, results.capture.T_world_cam))
    ]


def _add_skeleton(scene: Any, results: RunResults, handles: Handles) -> None:
    skeleton, stem = results.skeleton, results.stem
    if skeleton is None:
        return
    handles.rest = skeleton.nodes
    organ = stem.organ if stem is not None else np.full(len(skeleton.nodes), BRANCH)
    shown = []
    for kind, colour in COLOURS.items():
        edges = skeleton.edges[organ[1:] == kind]  # edge j - 1 ends at node j
        if len(edges):
            points = skeleton.nodes[edges].astype(np.float32)
            line = scene.add_line_segments(f"/skeleton/{ORGAN_NAMES[kind]}", points, colour, thickness=WIDTHS[kind])
            handles.lines.append((line, edges))
            shown.append(line)
    handles.layers["skeleton"] = shown
    handles.legend = " ".join(
        f'<span style="color:rgb{COLOURS[kind]}">●</span> {ORGAN_NAMES[kind]}'
        for kind in COLOURS
        if (organ == kind).any()
    )
    handles.joints = _add_joints(scene, skeleton, organ)
    handles.said = _said(skeleton, organ, results)
    handles.layers["thickness"] = [handles.joints]
    if results.flowers is not None:
        style = {"radius": FLOWER_RADIUS, "color": (240, 60, 200), "opacity": 0.35}
        handles.layers["flowers at rest"] = [
            scene.add_icosphere(f"/flowers/{i + 1}", position=tuple(p), **style)
            for i, p in enumerate(results.flowers.positions)
        ]


def _add_joints(scene: Any, skeleton: Skeleton, organ: NDArray[Any]) -> Any:
    """Add a ball as thick as the plant at every node: they can be clicked."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    colours = np.array([COLOURS.get(int(kind), (128, 128, 128)) for kind in organ], np.uint8)
    count = len(skeleton.nodes)
    return scene.add_batched_meshes_simple(
        "/thickness",
        np.asarray(ball.vertices, np.float32),
        np.asarray(ball.faces, np.uint32),
        batched_wxyzs=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        batched_positions=skeleton.nodes.astype(np.float32),
        batched_scales=np.maximum(skeleton.radius, 1e-3).astype(np.float32),
        batched_colors=colours,
        lod="off",
    )


def _said(skeleton: Skeleton, organ: NDArray[Any], results: RunResults) -> list[str]:
    sure = None if results.stem is None else results.stem.confidence
    confidence = "" if sure is None else f"; the main stem with a probability of {sure:.0%}"
    numbers = np.arange(len(organ)) if results.numbers is None else results.numbers
    return [
        f"node {j}: {ORGAN_NAMES[int(kind)]}, {2000 * r:.1f} mm thick{confidence if kind == STEM else ''}  \n"
        f"`--root={x:.3f},{y:.3f},{z:.3f}`, or `--stem-tip=` the same"
        for j, (x, y, z), r, kind in zip(numbers, skeleton.nodes, skeleton.radius, organ, strict=True)
    ]


def _add_grasps(scene: Any, results: RunResults, handles: Handles) -> None:
    chosen = results.shaken.grasp_index if results.shaken is not None else 0
    frames = []
    for rank, grasp in enumerate(results.grasps):
        position, wxyz = placed(grasp.T_world_flange)
        size = 0.08 if rank == chosen else 0.03
        name = f"/grasps/{rank + 1}{' (chosen)' if rank == chosen else ''}"
        frames.append(scene.add_frame(name, position=position, wxyz=wxyz, axes_length=size, axes_radius=size / 25))
    if frames:
        handles.layers["grasps"] = frames
