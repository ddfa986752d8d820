"""Record how many flowers of a plant, or of one visit to it, set fruit: what the dose-response is learned from."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date
from typing import Annotated

import tyro

from anther.cli.args.shared import HISTORY


@dataclass(frozen=True)
class Args:
    """Attributes: what was counted, on which plant, when."""

    of: Annotated[str, tyro.conf.Positional]
    """The plant's label, or the number of a visit; plant:LABEL or visit:NUMBER where both could be meant. Of a plant,
    the count belongs to all visits since its previous count."""
    flowers: int
    """Flowers that were open when the plant was visited, and could have set."""
    fruit: int
    """How many of them did."""
    date: date = field(default_factory=date.today)
    """Day of the count (YYYY-MM-DD)."""
    species: str | None = None
    """The crop, where two crops have plants of the same label, and of a control."""
    control: bool = False
    """The plant was never visited: it tells how many flowers set without a shake."""
    note: str = ""
    """Anything worth keeping."""
    history: str = HISTORY
    """A SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
