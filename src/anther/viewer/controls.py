"""What a person can set in the live viewer: play, time, speed, exaggeration, and what is shown."""

from __future__ import annotations

from typing import Any

from anther.results import RunResults
from anther.viewer.player import Player
from anther.viewer.scene import Handles

SPEEDS = {"real time": 1.0, "half": 0.5, "a tenth": 0.1}


class Controls:
    """The live viewer's panel.

    Args:
        server: viser's.
        player: of the shake; None where nothing moved.
        exaggeration: to begin with.
    """

    def __init__(self, server: Any, player: Player | None, exaggeration: float) -> None:
        self._player, self._at = player, 0.0
        if player is None:
            server.gui.add_markdown("Nothing was shaken in this run.")
            return
        times = player.motion.times
        with server.gui.add_folder("The shake"):
            self._play = server.gui.add_checkbox("play", True)
            self._time = server.gui.add_slider("time [s]", 0.0, float(times[-1]), float(times[1] - times[0]), 0.0)
            self._speed = server.gui.add_dropdown("speed", list(SPEEDS), initial_value="a tenth")
            self._larger = server.gui.add_slider("motions larger", 1.0, 20.0, 0.5, exaggeration)
            server.gui.add_markdown("Blue: flowers as filmed. Pink: as the model follows the grip.")
        self._time.on_update(lambda _: self._show())
        self._larger.on_update(lambda _: self._show())
        self._show()

    def tick(self, seconds: float) -> None:
        """Let so much time pass [s]."""
        if self._player is None or not self._play.value:
            return
        last = float(self._player.motion.times[-1])
        self._time.value = (self._time.value + SPEEDS[self._speed.value] * seconds) % last

    def _show(self) -> None:
        assert self._player is not None
        times = self._player.motion.times
        at = min(int(self._time.value / (times[1] - times[0])), len(times) - 1)
        self._player.show(at, self._larger.value)


def add_controls(
    server: Any, results: RunResults, handles: Handles, player: Player | None, exaggeration: float
) -> Controls:
    """Add the panel: what the trial's answers are, what to show, the shake in time."""
    answers = [f"**{a.question}** {a.said}" for a in results.answers()]
    if answers:
        server.gui.add_markdown("  \n".join(answers))
    with server.gui.add_folder("Show"):
        for name, parts in handles.layers.items():
            box = server.gui.add_checkbox(name, all(part.visible for part in parts))
            box.on_update(lambda event, parts=parts: _set_visible(parts, event.target.value))
        server.gui.add_markdown(handles.legend)
        picked = server.gui.add_markdown("Click on the skeleton to see what is there.")
    if handles.joints is not None:
        handles.joints.on_click(lambda event: _tell(picked, handles, event.instance_index))
    return Controls(server, player, exaggeration)


def _set_visible(parts: list[Any], value: bool) -> None:
    for part in parts:
        part.visible = value


def _tell(picked: Any, handles: Handles, node: int | None) -> None:
    if node is not None:
        picked.content = handles.said[node]
