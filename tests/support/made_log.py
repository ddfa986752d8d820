"""A trial of fake machines that is logged, and what its file holds."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fake_robot import LIMITS, FakeArm, fake_robot
from mcap.reader import make_reader
from mcap.records import Message
from test_execution import PLANNER, Plan

from anther.pollination.execution import Trial, execute
from anther.robot.arm.sawyer import TOOL
from anther.robot.devices import Robot
from anther.show.log import Log
from anther.show.log.live import Tail


def tapped(book: Log, arm: FakeArm | None = None, **devices: Any) -> Robot:
    arm = arm or FakeArm()
    return book.tap(fake_robot(arm, **devices), LIMITS, TOOL.T_flange_cam, lambda: arm.clock)


def done(book: Log, robot: Robot) -> Trial:
    """A whole trial with fake machines, which says its phases."""
    return execute(PLANNER, Plan(), robot, LIMITS, progress=lambda _, __, phase: book.told("phase", phase))


def kept_in(path: Path) -> dict[str, list[tuple[str, Message]]]:
    """Topic -> schema's name and message, of a whole file."""
    found: dict[str, list[tuple[str, Message]]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            found.setdefault(channel.topic, []).append((schema.name, message))
    return found


def spoken(found: dict[str, list[tuple[str, Message]]], words: str) -> bool:
    return any(words.encode() in message.data for _, message in found["/events"])


def readable(path: Path) -> int:
    """How many messages of a file without an end can be read."""
    return sum(isinstance(record, Message) for record in Tail(path).records())


def wait_until(true: Callable[[], bool]) -> None:
    until = time.monotonic() + 60
    while not true():
        assert time.monotonic() < until
        time.sleep(0.01)
