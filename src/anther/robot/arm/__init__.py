"""Arms: reach, paths, and how hard they can shake. Each stage is a module of its own."""

from typing import Literal

__all__ = ["ArmName"]

ArmName = Literal["sawyer", "ur5e", "fr3", "xarm7"]
"""The arms that are described here (`arms.named`); a cell file may describe another."""
