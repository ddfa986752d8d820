"""An arm in a file of its own: a run keeps the arm and the gripper of its cell file, to be shown later."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from anther.core.files import understood, write_json
from anther.core.geometry import Box
from anther.core.records import decode, encode, read_tree
from anther.robot.arm.model import ArmModel

KIND, SCHEMA = "arm", 1


def save_arm(path: Path, arm: ArmModel, keep_out: Sequence[Box] = ()) -> None:
    """Write an arm with its tool, and boxes that it keeps out of, as JSON."""
    write_json(path, {"kind": KIND, "schema": SCHEMA, "arm": encode(arm), "keep_out": encode(tuple(keep_out))})


def load_arm(path: Path) -> tuple[ArmModel, tuple[Box, ...]]:
    """Read what `save_arm` wrote.

    Raises:
        InputError: the file is no such thing, or of another version.
    """
    with understood(path):
        tree = read_tree(path, KIND, SCHEMA)
        return decode(tree["arm"], ArmModel), decode(tree["keep_out"], tuple[Box, ...])
