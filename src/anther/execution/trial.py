"""The record of a trial: what was commanded and what happened."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from anther.checks import check_array
from anther.devices import Frame
from anther.errors import FailureKind
from anther.files import read_npz, write_npz
from anther.geometry import Array

PHASES = ("open", "reach", "approach", "close", "shake", "release", "retreat")
EARLY = "early reach"  # before these: the arm went to the grasp before it was told which shake (`early_reach`)
SCHEMA = 2


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What was commanded and what happened. P phases, T samples of the shake, N frames.

    Attributes:
        phases: (P,) names of the phases begun, in order, out of `EARLY` and `PHASES`.
        phase_times: (P, 2) begin and end of each [s], on the robot's clock. Only the arm tells the time: a phase of the
            gripper fills what lies between two motions.
        shake_times: (T,) [s], on the robot's clock; empty if it never shook; of a shake cut short what was read of it.
        commanded, measured: (T, 7) joints during the shake [rad].
        felt: (R, 2) when the arm told during the shake how large a force the world exerts on it [s], and that force
            [N]; NaN if it cannot tell.
        gripper: (G, 3) opening [m], force [N] and held after closing, after the shake and after release.
        frame_times: (N,) when the side camera's frames were taken [s].
        stop_reason: "finished", or why it stopped.
        failure: the failure's kind; None when it finished.
        frames: the side camera's frames; not saved.
    """

    phases: tuple[str, ...]
    phase_times: Array
    shake_times: Array
    commanded: Array
    measured: Array
    gripper: Array
    frame_times: Array
    stop_reason: str
    failure: FailureKind | None = None
    frames: tuple[Frame, ...] = field(default=(), repr=False)
    felt: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        n = len(self.shake_times)
        shapes: dict[str, tuple[int | None, ...]] = {
            "phase_times": (len(self.phases), 2),
            "shake_times": (n,),
            "commanded": (n, 7),
            "measured": (n, 7),
            "gripper": (None, 3),
            "frame_times": (None,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, check_array(f"trial {name}", getattr(self, name), shape))
        object.__setattr__(self, "felt", check_array("trial felt", self.felt, (None, 2), finite=False))

    @property
    def finished(self) -> bool:
        """Whether every phase ended as planned."""
        return self.stop_reason == "finished"

    def save(self, path: Path | str) -> None:
        """Write the trial, without the frames' pixels, to an .npz."""
        words = json.dumps({name: getattr(self, name) for name in ("phases", "stop_reason", "failure")})
        names = ("phase_times", "shake_times", "commanded", "measured", "gripper", "frame_times", "felt")
        write_npz(path, "trial", SCHEMA, words=words, **{name: getattr(self, name) for name in names})

    @classmethod
    def load(cls, path: Path | str) -> Trial:
        """Read a trial written by `save`.

        Raises:
            InputError: missing, truncated or of another kind.
        """
        arrays: dict[str, Any] = read_npz(path, "trial", SCHEMA)
        words = json.loads(str(arrays.pop("words")))
        return cls(phases=tuple(words.pop("phases")), **words, **arrays)
