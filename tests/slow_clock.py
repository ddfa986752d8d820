"""A clock slower than the wall's, so that what is a matter of milliseconds can be tested on a busy machine."""

from __future__ import annotations

import time

SLOWER = 4.0


def clock() -> float:
    return time.monotonic() / SLOWER


def sleep(seconds: float) -> None:
    time.sleep(SLOWER * seconds)
