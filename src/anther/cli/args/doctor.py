"""Say what is installed, what is missing and how to get it: versions, extras, GPU, compiled code, cameras, disk."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Args:
    """Attributes: how to print, and what to do besides."""

    json: bool = False
    """Print the findings as JSON."""
    compile: bool = False
    """Compile all kernels for this machine first, about a minute, so that nothing waits for it later."""
