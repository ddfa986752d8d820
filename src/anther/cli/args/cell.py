"""A cell's machines: check that all are there (nothing moves), enable them, move one joint a little, or serve ROS 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from anther.cli.args.shared import Given


@dataclass(frozen=True)
class Args:
    """Attributes: what to do with which cell. docs/cell_file.md has the file, docs/real_robot.md the first hour."""

    action: Annotated[Literal["check", "enable", "jog", "serve-ros"], tyro.conf.Positional]
    """check: connect to each part and show what it sees; enable: switch motors on, after a released stop too, and let
    the gripper find its ends; jog: move one joint a little, within all limits; both ask first. serve-ros: a ROS 2 node
    that answers with skeleton, grasp and plan for a cloud (docs/ros.md); it connects to no machine."""
    file: Given
    """The cell file."""
    joint: int | None = None
    """Which joint to jog, from 0; by default the last."""
    by: float = 2.0
    """How far [degrees]."""
    frame: str = "base_link"
    """Name of the arm's base frame under ROS 2."""
