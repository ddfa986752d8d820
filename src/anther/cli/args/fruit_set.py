"""What the counts of fruit set teach of the dose-response, with its uncertainty, and what they do not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from anther.cli.args.shared import HISTORY, Output


@dataclass(frozen=True)
class Args(Output):
    """Attributes: which history and crop, and how the answer is wanted."""

    history: Annotated[str, tyro.conf.Positional] = HISTORY
    """A SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    species: str = "tomato"
    """The crop."""
    figure: Path | None = None
    """Draw the dose-response there (.png)."""
