"""Say what is installed, what is missing and how to get it: versions, extras, GPU, compiled code, cameras, disk."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Args:
    """Attributes: how to print."""

    json: bool = False
    """Print the findings as JSON."""
