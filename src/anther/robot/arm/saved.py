"""An arm in a file of its own: a run keeps the arm and the gripper of its cell file, to be shown later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from anther.core.errors import bad_input
from anther.core.files import read_object, understood, write_json
from anther.core.geometry import Box
from anther.robot.arm.model import ArmModel, Capsule, Link, Solid, Tool

KIND, SCHEMA = "arm", 1


def save_arm(path: Path, arm: ArmModel, keep_out: Sequence[Box] = ()) -> None:
    """Write an arm with its tool, and boxes that it keeps out of, as JSON."""
    told = asdict(arm)
    del told["local"]
    boxes = [[box.lower, box.upper] for box in keep_out]
    write_json(path, {"kind": KIND, "schema": SCHEMA, "arm": told, "keep_out": boxes})


def load_arm(path: Path) -> tuple[ArmModel, tuple[Box, ...]]:
    """Read what `save_arm` wrote.

    Raises:
        InputError: the file is no such thing, or of another version.
    """
    told = read_object(path)
    if (told.get("kind"), told.get("schema")) != (KIND, SCHEMA):
        given, allowed = f"{told.get('kind')}, schema {told.get('schema')}", f"{KIND}, schema {SCHEMA}"
        raise bad_input(str(path), given=given, allowed=allowed, do="Make the run again with this version.")
    with understood(path):
        return _arm(told["arm"]), tuple(Box(np.array(lower), np.array(upper)) for lower, upper in told["keep_out"])


ARRAYS = {field.name for kind in (ArmModel, Tool) for field in fields(kind) if field.type == "Array"}
"""Names of what are arrays of an arm and its tool; `slows` may be missing."""


def _arm(told: Any) -> ArmModel:
    told = _arrays(told)
    told["links"] = tuple(map(_link, told["links"]))
    told["riders"] = tuple((int(on), _link(rider)) for on, rider in told["riders"])
    told["base_capsules"] = tuple(map(_capsule, told["base_capsules"]))
    told["base_solids"] = tuple(map(_solid, told["base_solids"]))
    told["wrist"] = None if told["wrist"] is None else _capsule(told["wrist"])
    told["slows"] = None if told["slows"] is None else np.array(told["slows"])
    told["joints"], told["neighbours"] = tuple(told["joints"]), tuple(map(tuple, told["neighbours"]))
    tool = _arrays(told["tool"])
    tool |= {"body": _solid(tool["body"]), "camera": tuple(map(_solid, tool["camera"]))}
    told["tool"] = Tool(**tool | {name: tuple(tool[name]) for name in ("com", "pad")})
    return ArmModel(**told)


def _arrays(told: Any) -> Any:
    return {name: np.array(value) if name in ARRAYS else value for name, value in told.items()}


def _link(told: Any) -> Link:
    shapes = {"capsules": tuple(map(_capsule, told["capsules"])), "solids": tuple(map(_solid, told["solids"]))}
    return Link(**told | {name: tuple(told[name]) for name in ("xyz", "rpy", "com", "inertia")} | shapes)


def _capsule(told: Any) -> Capsule:
    return Capsule(**told | {name: tuple(told[name]) for name in ("start", "end")})


def _solid(told: Any) -> Solid:
    return Solid(**told | {name: tuple(told[name]) for name in ("center", "half")})
