"""The scene's layers as viser draws them. N skeleton nodes."""

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
from anther.perception.stem import BRANCH, ORGAN_NAMES, STEM
from anther.show.results import RunResults
from anther.show.run_scene import layers_of
from anther.show.scene import ORGAN_COLORS, Layer
from anther.show.style import rgb


def placed(T: Array) -> tuple[Any, Any]:
    """Return position (3,) and quaternion w, x, y, z of a transform (4, 4)."""
    return T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)


@dataclass
class Handles:
    """What the scene holds that can be shown, hidden, moved or asked.

    Attributes:
        layers: name -> viser's handles.
        lines: (handle, the edges (E, 2) it draws) of each layer that follows the skeleton.
        rest: (N, 3) the skeleton's nodes at rest [m].
        joints: the balls at the skeleton's nodes, to be clicked.
        said: of each node, what is there.
        colours: name of a layer that is seen at first -> "#rrggbb".
    """

    layers: dict[str, list[Any]] = field(default_factory=dict)
    lines: list[tuple[Any, NDArray[Any]]] = field(default_factory=list)
    rest: Array = field(default_factory=lambda: np.zeros((0, 3)))
    joints: Any = None
    said: list[str] = field(default_factory=list)
    colours: dict[str, str] = field(default_factory=dict)

    @property
    def legend(self) -> str:
        """Which colour is what, as Markdown, of the layers that are there."""
        there = ((name, colour) for name, colour in self.colours.items() if name in self.layers)
        return " ".join(f'<span style="color:{colour}">●</span> {name}' for name, colour in there)

    def bend(self, moved: Array) -> None:
        """Draw the skeleton with its nodes displaced by (N, 3) [m]."""
        nodes = (self.rest + moved).astype(np.float32)
        for line, edges in self.lines:
            line.points = nodes[edges]
        if self.joints is not None:
            self.joints.batched_positions = nodes

    def remove(self, name: str) -> None:
        """Take a layer out of the scene."""
        for part in self.layers.pop(name, []):
            part.remove()


def build_scene(server: viser.ViserServer, results: RunResults, most_points: int | None = None) -> Handles:
    """Add what a run holds to a viser scene; of the cloud at most so many points, None: all."""
    scene, handles, layers = server.scene, Handles(), layers_of(results)
    scene.set_up_direction("+z")
    scene.world_axes.visible = False
    handles.layers["axes of the world"] = [
        scene.add_frame("/world axes", axes_length=0.1, axes_radius=0.002, visible=False)
    ]
    for layer in layers:
        handles.layers[layer.name] = _add(scene, layer, handles, most_points)
    handles.colours |= {layer.name: layer.colour for layer in layers if layer.shown}
    tree = results.skeleton
    if tree is not None:
        organ = results.stem.organ if results.stem is not None else np.full(len(tree.nodes), BRANCH)
        handles.rest, handles.said = tree.nodes, _said(tree, organ, results)
        handles.joints = _add_joints(scene, tree, organ)
        handles.layers["thickness"] = [handles.joints]
    points = results.cloud.points if results.cloud is not None else handles.rest
    if len(points):
        middle = points.mean(axis=0)
        server.initial_camera.look_at = tuple(middle)
        view_from = np.array([0.4, -0.6, 0.2])  # m from the plant's middle: across the arm, which comes along +x
        server.initial_camera.position = tuple(middle + view_from)
    return handles


def _add(scene: Any, layer: Layer, handles: Handles, most: int | None) -> list[Any]:
    """Add all that a layer holds, and return viser's handles of it."""
    name, colour, shown, parts = f"/{layer.name}", rgb(layer.colour), {"visible": layer.shown}, list[Any]()
    if layer.points is not None:
        parts.append(_add_points(scene, name, layer, most))
    if layer.lines is not None:
        lines = layer.lines.astype(np.float32)
        parts.append(scene.add_line_segments(f"{name}/lines", lines, colour, thickness=layer.width, **shown))
        if layer.edges is not None:
            handles.lines.append((parts[-1], layer.edges))
    for i, (*centre, radius) in enumerate(() if layer.balls is None else layer.balls):
        style = {"radius": radius, "color": colour, "opacity": 0.6}
        parts.append(scene.add_icosphere(f"{name}/{i + 1}", **style, position=centre, **shown))
    if layer.arrows is not None:
        size = {"shaft_radius": 0.002, "head_radius": 0.005, "head_length": 0.015}  # m
        parts.append(scene.add_arrows(f"{name}/arrows", layer.arrows.astype(np.float32), colour, **size, **shown))
    if layer.solids:
        parts.append(add_mesh(scene, f"{name}/solids", list(layer.solids), colour, **shown))
    k = layer.camera
    for i, T in enumerate(() if layer.poses is None or k is None else layer.poses):
        assert k is not None
        (position, wxyz), fov = placed(T), 2 * np.arctan(k.height / (2 * k.fy))
        style = {"aspect": k.width / k.height, "color": colour, "scale": 0.03, "thickness": 0.001} | shown
        parts.append(scene.add_camera_frustum(f"{name}/{i:02d}", fov, position=position, wxyz=wxyz, **style))
    return parts


def _add_points(scene: Any, name: str, layer: Layer, most: int | None) -> Any:
    """Add small points with a share of white in their colours: the skeleton is seen between them, and stands out."""
    assert layer.points is not None
    white = 0.45
    step = 1 if most is None else max(1, -(-len(layer.points) // most))
    points = layer.points[::step].astype(np.float32)
    colours = np.tile(rgb(layer.colour), (len(points), 1)) if layer.colours is None else layer.colours[::step]
    colours = (white * 255 + (1 - white) * colours).astype(np.uint8)
    style = {"point_size": 0.0006, "point_shape": "circle", "point_shading": "flat"}
    return scene.add_point_cloud(name, points, colours, **style, visible=layer.shown)


def add_mesh(scene: Any, name: str, shapes: list[Any], colour: tuple[int, int, int], **shown: bool) -> Any:
    """Add meshes as one part of a scene."""
    whole: Any = trimesh.util.concatenate(shapes)
    vertices, faces = np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.uint32)
    return scene.add_mesh_simple(name, vertices, faces, color=colour, **shown)


def _add_joints(scene: Any, skeleton: Skeleton, organ: NDArray[Any]) -> Any:
    """Add a ball as thick as the plant at every node: they can be clicked."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    colours = np.array([rgb(ORGAN_COLORS[int(kind)]) for kind in organ], np.uint8)
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
