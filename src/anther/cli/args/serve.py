"""Show the history on pages for a browser or a phone: today's visits, failures, trends, robots, plants. Read-only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from anther.cli.args.shared import HISTORY


@dataclass(frozen=True)
class Args:
    """Attributes: which history, for whom, and who may write notes."""

    history: Annotated[str, tyro.conf.Positional] = HISTORY
    """A SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    runs: Path = Path()
    """The folder that run folders in the history are relative to; no report outside of it is shown."""
    host: str = "127.0.0.1"
    """Address to listen on. Any other than this computer's own lets whoever reaches it read everything."""
    port: int = 8000
    """TCP port; 0: any that is free."""
    token: Path | None = None
    """File with the token that people need to write a note; without it nothing can be written."""
