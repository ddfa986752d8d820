"""The 3-D viewer: a run as a viser scene that plays the shake, live in the browser or as one HTML file."""

from __future__ import annotations

import html
import io
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import viser

from anther.core.files import write_text
from anther.core.geometry import Array
from anther.show.results import RunResults
from anther.show.scene import FLOWER_RADIUS, hand, limbs
from anther.show.style import GRIPPER_COLOR, PREDICTED_COLOR, ROBOT_COLOR, SHAKE_COLOR, rgb
from anther.show.viewer._motion import RATE, Replay, motion_of
from anther.show.viewer._scene import Handles, add_mesh, build_scene, placed

__all__ = ["serve", "write_html"]

MEASURED, PREDICTED = SHAKE_COLOR, PREDICTED_COLOR


def write_html(path: Path, results: RunResults, *, exaggeration: float) -> None:
    """Write the scene of a run to one HTML file that opens without a server and plays the end of the shake.

    Motions are shown larger by the exaggeration [-].
    """
    seconds, most_points = 8.0, 40_000  # of play, and of the cloud: the file grows with both
    with redirect_stdout(io.StringIO()):  # viser announces its address even when nobody is to visit it
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            handles = build_scene(server, results, most_points=most_points)
            motion = motion_of(results)
            page = server.get_scene_serializer()
            if motion is not None:
                player = Player(server, results, motion, handles)
                for i in range(max(0, len(motion.times) - int(seconds * RATE)), len(motion.times)):
                    player.show(i, exaggeration)
                    page.insert_sleep(1 / RATE)
            text = _add_title(page.as_html(), results.title, handles.legend + (f"<br>{PLAYED}" if motion else ""))
            write_text(path, text)
        finally:
            server.stop()


PLAYED = (
    f'<span style="color:{MEASURED}">●</span> flowers as filmed '
    f'<span style="color:{PREDICTED}">●</span> as the model follows the grip'
)


OPENED = """<script>const waiting = setInterval(() => { if (document.querySelector("canvas")) {
  clearInterval(waiting); setTimeout(() => document.getElementById("opens").remove(), 1500) } }, 200)</script>"""
"""Takes the word away when the scene, which viser fades in, can be seen."""


def _add_title(page: str, title: str, legend: str) -> str:
    """Return a page of viser's with a title, a legend, and a word to those who wait for its scene."""
    font = "font:13px/1.5 system-ui,sans-serif;color:#1d2a22"
    over = "position:fixed;left:10px;top:10px;right:10px;pointer-events:none;z-index:9"  # viser's slider is below
    middle = f"{over};bottom:10px;display:grid;place-items:center"
    wait = f"<div id=opens style='{middle};{font}'>The scene opens …</div>{OPENED}"
    above = f"<div style='{over};{font}'><span style='background:#fffc;padding:4px 8px'>{legend}</span></div>"
    page = page.replace("<title>Viser</title>", f"<title>Anther: {html.escape(title)}</title>", 1)
    head, body, rest = page.partition("<body>")
    return f"{head}{body}{wait}{above}{rest}"


def serve(results: RunResults, port: int, *, exaggeration: float) -> None:
    """Show a run in the browser, on a TCP port of this machine, until interrupted."""
    server = viser.ViserServer(host="127.0.0.1", port=port)
    server.gui.set_panel_label(f"Anther: {results.title}")
    handles, motion = build_scene(server, results), motion_of(results)
    player = Player(server, results, motion, handles) if motion is not None else None
    _add_panel(server, results, handles)
    if player is None:
        server.gui.add_markdown("Nothing was shaken in this run.")
        while True:
            time.sleep(1)
    controls = Controls(server, player, exaggeration)
    while True:
        time.sleep(1 / RATE)
        controls.tick(1 / RATE)


class Player:
    """Shows a motion in a scene, of whose parts that stand still it moves some."""

    def __init__(self, server: Any, results: RunResults, motion: Replay, handles: Handles) -> None:
        assert results.plant is not None
        self.motion, self._handles, self._plant, scene = motion, handles, results.plant, server.scene
        for name in ("arm", "gripper", "flowers", "grasp"):  # they move from now on, and the gripper shows the grasp
            handles.remove(name)
        base, *links = limbs(motion.arm)
        robot = [add_mesh(scene, "/robot/base", base, rgb(ROBOT_COLOR))] if base else []
        self._links = []
        parts = [*((link, ROBOT_COLOR) for link in links), (hand(motion.arm.tool, motion.opening), GRIPPER_COLOR)]
        for i, (shapes, colour) in enumerate(parts):
            self._links.append(scene.add_frame(f"/robot/{i}", show_axes=False))
            robot += [add_mesh(scene, f"/robot/{i}/shape", shapes, rgb(colour))] if shapes else []
        handles.layers["arm and gripper"], handles.colours["arm and gripper"] = robot, GRIPPER_COLOR

        def balls(name: str, count: int, colour: str) -> list[Any]:
            style = {"radius": 0.6 * FLOWER_RADIUS, "color": rgb(colour), "subdivisions": 1}
            return [scene.add_icosphere(f"/{name}/{f + 1}", **style) for f in range(count)]

        tracked = motion.flowers.shape[1]
        self._predicted = balls("predicted", len(self._plant.flower_nodes), PREDICTED)
        self._measured = balls("measured", tracked, MEASURED)
        self._rest = np.array([_middle(motion.flowers[:, f]) for f in range(tracked)]).reshape(tracked, 3)

    def show(self, i: int, exaggeration: float) -> None:
        """Show the picture number i, motions so many times larger."""
        motion = self.motion
        joints = motion.joints[0] + exaggeration * (motion.joints[i] - motion.joints[0])
        for frame, T in zip(self._links, motion.arm.link_poses(joints), strict=True):
            frame.position, frame.wxyz = placed(T)
        moved = exaggeration * motion.nodes[i]
        self._handles.bend(moved[: len(self._handles.rest)])
        tips = self._plant.rods.nodes[self._plant.flower_nodes] + moved[self._plant.flower_nodes]
        for ball, place in zip(self._predicted, tips, strict=True):
            ball.position = place
        for ball, place, rest in zip(self._measured, motion.flowers[i], self._rest, strict=True):
            ball.visible = bool(np.isfinite(place).all())
            if ball.visible:
                ball.position = rest + exaggeration * (place - rest)


def _middle(track: Array) -> Array:
    seen = track[np.isfinite(track).all(axis=1)]
    return np.median(seen, axis=0) if len(seen) else np.zeros(3)


class Controls:
    """The panel's part that plays the shake."""

    _speeds: ClassVar = {"real time": 1.0, "half": 0.5, "a tenth": 0.1}

    def __init__(self, server: Any, player: Player, exaggeration: float) -> None:
        self._player, times = player, player.motion.times
        with server.gui.add_folder("The shake"):
            self._play = server.gui.add_checkbox("play", True)
            self._time = server.gui.add_slider("time [s]", 0.0, float(times[-1]), float(times[1] - times[0]), 0.0)
            self._speed = server.gui.add_dropdown("speed", list(self._speeds), initial_value="a tenth")
            self._larger = server.gui.add_slider("motions larger", 1.0, 20.0, 0.5, exaggeration)
            server.gui.add_markdown(PLAYED)
        self._time.on_update(lambda _: self._show())
        self._larger.on_update(lambda _: self._show())
        self._show()

    def tick(self, seconds: float) -> None:
        """Let so much time pass [s]."""
        if self._play.value:
            last = float(self._player.motion.times[-1])
            self._time.value = (self._time.value + self._speeds[self._speed.value] * seconds) % last

    def _show(self) -> None:
        times = self._player.motion.times
        at = min(int(self._time.value / (times[1] - times[0])), len(times) - 1)
        self._player.show(at, self._larger.value)


def _add_panel(server: Any, results: RunResults, handles: Handles) -> None:
    """Add what the trial's answers are, what to show, and what is where on the skeleton."""
    answers = [f"**{a.question}** {a.said}" for a in results.answers()]
    if answers:
        server.gui.add_markdown("  \n".join(answers))
    with server.gui.add_folder("Show"):
        for name, parts in handles.layers.items():
            box = server.gui.add_checkbox(name, all(part.visible for part in parts))
            box.on_update(lambda event, parts=parts: _set_visible(parts, event.target.value))
        server.gui.add_markdown(handles.legend)
        picked = server.gui.add_markdown("Click on the skeleton to see what is there.")

    def tell(event: Any) -> None:
        if event.instance_index is not None:
            picked.content = handles.said[event.instance_index]

    if handles.joints is not None:
        handles.joints.on_click(tell)


def _set_visible(parts: list[Any], value: bool) -> None:
    for part in parts:
        part.visible = value
