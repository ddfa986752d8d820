"""Incoming views: what each shows by itself is found while the arm moves on to the next."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from anther.core.geometry import Box
from anther.perception import cloud, masks
from anther.perception.capture import View

__all__ = ["FirstLook", "IncomingViews"]


@dataclass(frozen=True, slots=True, eq=False)
class FirstLook:
    """What was found of each view by itself; nothing where the views did not come one by one.

    Attributes:
        observations: for `masks.segment`.
        surfaces: for `cloud.fuse`.
    """

    observations: Sequence[masks.Observation] = ()
    surfaces: Sequence[cloud.Surface] = ()


class IncomingViews:
    """Looks at views in a thread beside what takes them. Use it in a `with`.

    Args:
        workspace: where the plant may be, world [m].
        by_colour: whether `masks.segment` finds the masks; nothing is observed for other ways.
    """

    def __init__(self, workspace: Box, *, by_colour: bool = True) -> None:
        self._workspace, self._by_colour, self._pool = workspace, by_colour, ThreadPoolExecutor(1)
        self._looks = list[Future[tuple[masks.Observation | None, cloud.Surface]]]()

    def __enter__(self) -> IncomingViews:
        return self

    def __exit__(self, *reason: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._looks.clear()

    def add(self, view: View) -> None:
        """Begin to look at the next view."""
        self._looks.append(self._pool.submit(self._look, view))

    def first_look(self, views: int) -> FirstLook:
        """Return what was found, once it is; nothing if other than so many views were added."""
        if len(self._looks) != views:
            return FirstLook()
        observations, surfaces = zip(*(look.result() for look in self._looks), strict=True)
        return FirstLook(tuple(found for found in observations if found is not None), surfaces)

    def _look(self, view: View) -> tuple[masks.Observation | None, cloud.Surface]:
        observed = masks.observed(view, self._workspace) if self._by_colour else None
        return observed, cloud.surface(view, self._workspace)
