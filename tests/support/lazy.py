"""Modules that take seconds to import, and that most workers collect but never use."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Lazy:
    """A module that is imported where the first of its names is asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # pytest asks every name of a test file for such
            raise AttributeError(name)
        return getattr(import_module(self._name), name)
