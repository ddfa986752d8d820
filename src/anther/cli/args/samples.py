"""Write small sample inputs: views, a cloud, a skeleton, a bag, pictures of a board, measurements of a stem."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from anther.cli.args.shared import Overwrite


@dataclass(frozen=True)
class Args(Overwrite):
    """Attributes: where the samples go."""

    out: Annotated[Path, tyro.conf.Positional] = Path("samples")
    """Folder to write."""
