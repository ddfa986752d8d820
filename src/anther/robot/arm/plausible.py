"""What an arm can be: its joints, its size, and how far away what it has to know of may be.

A number beyond is a mistake of unit or scale, which no later check tells from a good one: degrees are 57 times too
large, millimetres 1000 times. Figures of robots are remembered, not looked up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from anther.core.checks import check_range
from anther.core.errors import bad_input

LARGEST_SPEED = 30.0
"""Of a joint [rad/s]: half as much again as the quickest wrists turn (Stäubli TX2-40: 20)."""
LONGEST_REACH = 5.0
"""Of the flange [m]: desk-top arms reach 0.2 m, the largest 4.7 m (Fanuc M-2000iA)."""
FARTHEST = 2 * LONGEST_REACH
"""What an arm has to know of is no farther from its base [m]."""

DO = "Check value and unit."


def check_joint(joint: str, lower: float, upper: float, velocity: float, effort: float, do: str = DO) -> None:
    """Check a joint's range [rad], velocity [rad/s] and effort [N m].

    Raises:
        InputError: no arm has such a joint.
    """
    largest = 13.0  # rad: two turns, more than a joint's cables bear; 18 are degrees
    if not -largest <= lower < upper <= largest:
        allowed = f"-{largest:g} <= lower < upper <= {largest:g} rad"
        raise bad_input(f"{joint}: range", given=f"{lower:g} .. {upper:g} rad", allowed=allowed, do=do)
    _check_above_zero(f"{joint}: velocity", velocity, LARGEST_SPEED, "rad/s", do)
    strongest = 1e5  # N m: holds 2 t at 5 m
    _check_above_zero(f"{joint}: effort", effort, strongest, "N m", do)


def check_acceleration(joint: str, acceleration: float) -> None:
    """Check a joint's acceleration [rad/s^2].

    Raises:
        InputError: no arm has such a joint.
    """
    # the largest speed within 0.1 s
    _check_above_zero(f"{joint}: acceleration", acceleration, 10 * LARGEST_SPEED, "rad/s^2", DO)


def _check_above_zero(what: str, value: float, most: float, unit: str, do: str) -> None:
    if not 0 < value <= most:
        raise bad_input(what, given=f"{value:g} {unit}", allowed=f"> 0 and <= {most:g} {unit}", do=do)


def check_extent(
    name: str, reach: float, floor: float, links: Sequence[tuple[str, Sequence[Any]]], base: Sequence[Any]
) -> None:
    """Check how large an arm is: no link is larger than the whole, and its shoulder is above the floor.

    Args:
        name: of the arm.
        reach: of the flange from the shoulder [m].
        floor: height over the shoulder [m].
        links: name of each and its capsules (`model.Capsule`).
        base: capsules of what never moves, which may be a pedestal.

    Raises:
        InputError: no arm is so.
    """
    check_range(f"{name}'s reach", reach, 0.1, LONGEST_REACH, "m")
    check_range(f"{name}'s floor, over its shoulder", floor, -LONGEST_REACH, 0.0, "m")
    shapes = [(link, capsules, reach) for link, capsules in links]
    for link, capsules, most in [*shapes, ("base", base, LONGEST_REACH)]:
        ends = [np.linalg.norm(end) + one.radius for one in capsules for end in (one.start, one.end)]
        if not max(ends, default=0.0) <= most:
            do = 'Are its meshes in millimetres? Then they need scale="0.001 0.001 0.001".'
            given = f"shapes up to {max(ends):.3g} m from its joint"
            raise bad_input(f"{name}'s {link}", given=given, allowed=f"<= {most:.3g} m", do=do)
