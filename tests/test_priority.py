"""Who streams to an arm is served first, and all is as before afterwards."""

from __future__ import annotations

import os
import threading

import pytest

from anther.drivers._priority import BESIDE, PRIORITY, served_first


@pytest.fixture(autouse=True)
def _may_ask() -> None:
    if not hasattr(os, "sched_setscheduler"):
        pytest.skip("no real-time classes: not Linux")
    with served_first():
        asked = os.sched_getparam(0).sched_priority
    if asked != PRIORITY:
        pytest.skip("no right to real-time classes: docs/real_robot.md")


def of_a_thread() -> tuple[int, int]:
    """Return class and priority of a thread that is begun now."""
    found: list[tuple[int, int]] = []

    def look() -> None:
        found.append((os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(0).sched_priority))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    return found[0]


def test_a_thread_is_served_first_and_those_it_begins_are_not() -> None:
    with served_first():
        assert os.sched_getparam(0).sched_priority == PRIORITY
        assert of_a_thread() == (os.SCHED_OTHER, 0)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_what_shares_the_lock_is_served_behind_it_and_stays_so() -> None:
    with served_first(BESIDE, threads_too=True):
        assert of_a_thread() == (os.SCHED_RR, BESIDE)
        with served_first():
            assert os.sched_getparam(0).sched_priority == PRIORITY > BESIDE
        assert os.sched_getparam(0).sched_priority == BESIDE
