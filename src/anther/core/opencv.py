"""OpenCV, imported at its first use: clouds, skeletons and rods need none of it (`pip install 'anther[images]'`)."""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

__all__ = ["cv2"]

if TYPE_CHECKING:
    import cv2
else:

    class _AtFirstUse(ModuleType):
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):  # what Python asks every module
                raise AttributeError(name)
            found = getattr(importlib.import_module(self.__name__), name)
            setattr(self, name, found)
            return found

    cv2 = _AtFirstUse("cv2")
