"""A clock slower than the wall's, so that what is a matter of milliseconds can be tested on a busy machine."""

from __future__ import annotations

import time

import pytest

SLOWER = 4.0
HELD_UP = "or the machine held up the driver, until the watchdog acted"
AGAIN_IF_HELD_UP = pytest.mark.flaky(
    reruns=3,
    only_rerun=[
        r"the newest joints are \d+ ms old",
        r"a command came \d+ ms",
        "communication_constraints_violation",
        HELD_UP,
    ],
)
"""A driver stops when the machine holds it up, as it must: the test is made again then, and for nothing else. One that
never acts in time fails every time."""


def clock() -> float:
    return time.monotonic() / SLOWER


def sleep(seconds: float) -> None:
    time.sleep(SLOWER * seconds)
