"""Figures, drawn with matplotlib without a screen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from anther.core.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["save_figure"]


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure, 110 dots an inch, to a file whose suffix says how.

    Raises:
        InputError: the file cannot be written.
    """
    figure.set_dpi(110)
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)  # to find the layout alone, `savefig` draws everything a first time
        figure.set_layout_engine(None)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110)
