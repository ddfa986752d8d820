"""Who streams to an arm is served first, and all is as before afterwards."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest

from anther.robot.devices import LEAD, JointTrajectory
from anther.robot.drivers._streamed import PRIORITY, SHARED_PRIORITY, Reference, prioritize_thread


@pytest.fixture(autouse=True)
def _may_ask() -> None:
    if not hasattr(os, "sched_setscheduler"):
        pytest.skip("no real-time classes: not Linux")
    with prioritize_thread():
        asked = os.sched_getparam(0).sched_priority
    if asked != PRIORITY:
        pytest.skip("no right to real-time classes: docs/real_robot.md")


def of_this_thread() -> tuple[int, int]:
    """Return class and priority of this thread."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(0).sched_priority


def of_a_thread() -> tuple[int, int]:
    """Return class and priority of a thread that is begun now."""
    found: list[tuple[int, int]] = []
    thread = threading.Thread(target=lambda: found.append(of_this_thread()))
    thread.start()
    thread.join()
    return found[0]


def test_a_thread_is_served_first_and_those_it_begins_are_not() -> None:
    with prioritize_thread():
        assert os.sched_getparam(0).sched_priority == PRIORITY
        assert of_a_thread() == (os.SCHED_OTHER, 0)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_what_shares_the_lock_is_served_behind_it_and_stays_so() -> None:
    with prioritize_thread(SHARED_PRIORITY, threads_too=True):
        assert of_a_thread() == (os.SCHED_RR, SHARED_PRIORITY)
        with prioritize_thread():
            assert os.sched_getparam(0).sched_priority == PRIORITY > SHARED_PRIORITY
        assert os.sched_getparam(0).sched_priority == SHARED_PRIORITY


def test_who_asks_what_comes_next_is_served_like_the_process_and_not_behind_it() -> None:
    """It has the lock that the stream needs."""
    found: list[tuple[int, int]] = []
    with prioritize_thread(SHARED_PRIORITY, threads_too=True):
        motion = JointTrajectory.standstill(np.zeros(3), LEAD)
        reference = Reference(motion, lambda: found.append(of_this_thread()))
        with prioritize_thread():
            until = time.monotonic() + 20
            while not reference.whole and time.monotonic() < until:
                reference.look_ahead(0.0)
                time.sleep(0.001)
        reference.close()
    assert found == [(os.SCHED_RR, SHARED_PRIORITY)]
