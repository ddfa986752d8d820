"""Options that several commands share, each defined once, and the marks that `anther.cli.main` reads."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, make_dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import tyro

from anther.core.choices import Axis, Units

EXISTS = "exists"
"""Marks a path that must exist before anything is imported for it."""
Given = Annotated[Path, tyro.conf.Positional, EXISTS]
"""The file or folder that a command reads."""
Stage = Annotated[Any, tyro.conf.Fixed, tyro.conf.Suppress]
"""Parameters of a stage, of which `stage` says the type: parsed only where one of them is given."""
HISTORY = "runs/history.sqlite"
"""A SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""


def stage(module: str, name: str = "Params", *, flat: bool = False) -> Any:
    """Return a field for a stage's parameters; None until one is given (`tuned`). `flat`: options without prefix."""
    return field(default=None, metadata={"stage": (module, name), "flat": flat})


def stages(args: type) -> dict[str, Any]:
    """Return the fields of a command's arguments that hold parameters of stages, by name."""
    return {each.name: each for each in fields(args) if "stage" in each.metadata}


def tuned(args: type) -> type:
    """Return the arguments' class with the parameters of its stages as options; imports the stages."""
    made: list[Any] = []
    for name, each in stages(args).items():
        module, kind = each.metadata["stage"]
        kind = getattr(import_module(module), kind)
        option: Any = Annotated[kind, tyro.conf.OmitArgPrefixes] if each.metadata["flat"] else kind
        made.append((name, option, field(default_factory=kind)))
    return make_dataclass(args.__name__, made, bases=(args,), frozen=True)


def shortened(args: type) -> tuple[type, list[str]]:
    """Return the arguments' class without what only --help-all shows, and the names of that."""
    more = [each.name for each in fields(args) if "more" in each.metadata]
    made: list[Any] = [(name, Stage, field(default=None)) for name in more]
    return make_dataclass(args.__name__, made, bases=(args,), frozen=True), [*more, *stages(args)]


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where the plant stands and where its main stem ends, by who knows better."""

    root: str | None = None
    """Where the stem leaves the soil, if you know better: x,y,z [m], as `anther view` prints it on a click; of a
    skeleton file a node's number too."""
    stem_tip: str | None = None
    """Where the main stem ends, if you know better, named likewise."""


@dataclass(frozen=True, kw_only=True)
class Source(Place):
    """What the numbers in a plant's file mean; a run folder says it itself."""

    units: Units | None = None
    """Of the lengths in the file; by default what it states, else metres if that makes a plant."""
    up: Axis | None = None
    """Axis that points up in the file; by default what it states, else z."""


@dataclass(frozen=True, kw_only=True)
class Overwrite:
    """What becomes of earlier results where the new ones go."""

    overwrite: bool = False
    """Replace what this command wrote there before; nothing else is touched."""


@dataclass(frozen=True, kw_only=True)
class Output(Overwrite):
    """What becomes of earlier results, and how the new ones are printed."""

    json: bool = False
    """Print the result as JSON."""
