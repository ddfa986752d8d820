"""A short film of what the side camera saw of a shake."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from anther.devices import Frame
from anther.files import written

SECONDS, WIDTH, COLOURS, SLOWER = 1.5, 320, 96, 2.0
"""Of the film's last frames, its width [px], colours, and times slower than it was."""


def save_film(path: Path, frames: Sequence[Frame]) -> None:
    """Write the end of a recording as an animated GIF; nothing where fewer than two frames were kept.

    Args:
        path: of the file.
        frames: in order of time.

    Raises:
        InputError: the file cannot be written.
    """
    last = [frame for frame in frames if frame.time >= frames[-1].time - SECONDS]
    if len(last) < 2:
        return
    height = round(WIDTH * last[0].rgb.shape[0] / last[0].rgb.shape[1])
    pictures = [Image.fromarray(frame.rgb).resize((WIDTH, height)) for frame in last]
    palette = pictures[0].quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)
    shown = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    apart = 1000 * SLOWER * (last[-1].time - last[0].time) / (len(last) - 1)
    with written(path, "a folder that can be written"):
        shown[0].save(path, save_all=True, append_images=shown[1:], duration=round(apart), loop=0, optimize=True)
