"""The 3-D viewer: a run as a viser scene that plays the shake, live in the browser or as one HTML file."""

from __future__ import annotations

import html
import io
import time
from contextlib import redirect_stdout
from pathlib import Path

import viser

from anther.files import write_text
from anther.results import RunResults
from anther.viewer._motion import RATE, motion_of
from anther.viewer._player import Player, add_controls
from anther.viewer._scene import POINTS_IN_FILE, build_scene

__all__ = ["build_scene", "serve", "write_html"]


def write_html(path: Path, results: RunResults, *, exaggeration: float, seconds: float = 8.0) -> None:
    """Write the scene of a run to one HTML file that opens without a server and plays the end of the shake.

    Args:
        path: of the file.
        results: what the run folder holds.
        exaggeration: by how much motions are shown larger [-].
        seconds: of play at most [s]; the file grows with them.
    """
    with redirect_stdout(io.StringIO()):  # viser announces its address even when nobody is to visit it
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            handles = build_scene(server, results, most_points=POINTS_IN_FILE)
            motion = motion_of(results)
            page = server.get_scene_serializer()
            if motion is not None:
                player = Player(server, results, motion, handles)
                for i in range(max(0, len(motion.times) - int(seconds * RATE)), len(motion.times)):
                    player.show(i, exaggeration)
                    page.insert_sleep(1 / RATE)
            write_text(path, _titled(page.as_html(), results.title))
        finally:
            server.stop()


def serve(results: RunResults, port: int, *, exaggeration: float) -> None:
    """Show a run in the browser until interrupted.

    Args:
        results: what the run folder holds.
        port: TCP port on this machine.
        exaggeration: by how much motions are shown larger to begin with [-].
    """
    server = viser.ViserServer(host="127.0.0.1", port=port)
    server.gui.set_panel_label(f"Anther: {results.title}")
    handles, motion = build_scene(server, results), motion_of(results)
    player = Player(server, results, motion, handles) if motion is not None else None
    controls = add_controls(server, results, handles, player, exaggeration)
    while True:
        time.sleep(1 / RATE)
        controls.tick(1 / RATE)


def _titled(page: str, title: str) -> str:
    """Return viser's page under the run's own name."""
    return page.replace("<title>Viser</title>", f"<title>Anther: {html.escape(title)}</title>", 1)
