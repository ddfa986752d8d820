"""Make a copy of a capture that can be given away: no names, places or texts, faces masked, calibration kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from anther.cli.args.shared import Given, Overwrite
from anther.core.choices import Crop


@dataclass(frozen=True)
class Args(Overwrite):
    """Attributes: what to share, and what must not be seen."""

    capture: Given
    """Capture folder with a transforms.json (docs/capture.md)."""
    out: Annotated[Path, tyro.conf.Positional]
    """Folder to write, or a .zip."""
    crop: Crop | None = None
    """What grows there."""
    licence: Literal["CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0"] | None = None
    """What others may do with it; without one they may do nothing."""
    faces: bool = True
    """Look for faces in the colour images and mask them, in depth too."""
    mask: tuple[str, ...] = ()
    """Boxes to mask besides: VIEW:X,Y,WIDTH,HEIGHT [px], the view from 0 on, or 'all'; e.g. 3:100,40,80,90."""
