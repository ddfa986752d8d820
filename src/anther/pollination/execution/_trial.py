"""The record of a trial: what was commanded and what happened."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from anther.core.checks import check_array
from anther.core.errors import FailureKind
from anther.core.files import read_npz, understood, write_npz
from anther.core.geometry import Array
from anther.robot.devices import Frame

PHASES = ("open", "reach", "approach", "close", "shake", "release", "retreat")
EARLY = "early reach"  # before these: the arm went to the grasp before it was told which shake (`early_reach`)
SCHEMA = 4


@dataclass(frozen=True, slots=True)
class Step:
    """One piece of a shake that is watched while it lasts. F flowers, K tones.

    Attributes:
        begin, end: when the pads were steady in it [s], on the robot's clock.
        frequencies: (K,) of its tones [Hz].
        amplitudes: (K,) of the gripper, commanded [m].
        direction: (3,) unit, world: the line along which it moved.
        flowers: (F,) peak acceleration that the camera measured [m/s2]; NaN where it did not. Of several tones, the
            root of the sum of squares.
        loads: name of each limit of plant and grip -> share of it that was reached, as far as known, with its margin.
        decided: what comes next and why, for people.
        seconds: that measuring and deciding took [s].
    """

    begin: float
    end: float
    frequencies: tuple[float, ...]
    amplitudes: tuple[float, ...]
    direction: tuple[float, ...]
    flowers: tuple[float, ...]
    loads: dict[str, float]
    decided: str
    seconds: float

    @property
    def used(self) -> float:
        """Largest share of a limit that was reached."""
        return max(self.loads.values(), default=0.0)

    @property
    def binds(self) -> str:
        """The limit of which most was reached."""
        return max(self.loads, key=lambda name: self.loads[name], default="")

    @property
    def median(self) -> float:
        """Of the flowers that were measured [m/s2]; NaN if none was."""
        seen = [a for a in self.flowers if np.isfinite(a)]
        return float(np.median(seen)) if seen else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What was commanded and what happened. P phases, T samples of the shake, N frames.

    Attributes:
        phases: (P,) names of the phases begun, in order, out of `EARLY` and `PHASES`.
        phase_times: (P, 2) begin and end of each [s], on the robot's clock. Only the arm tells the time: a phase of the
            gripper fills what lies between two motions.
        shake_times: (T,) [s], on the robot's clock; empty if it never shook; of a shake cut short what was read of it.
        commanded, measured: (T, J) joints during the shake [rad].
        felt: (R, 2) when the arm told during the shake how large a force the world exerts on it [s], and that force
            [N]; NaN if it cannot tell.
        gripper: (G, 3) opening [m], force [N] and held after closing, after the shake and after release; force NaN:
            it was not told.
        frame_times: (N,) when the side camera's frames were taken [s].
        stop_reason: "finished", or why it stopped.
        failure: the failure's kind; None when it finished.
        frames: the side camera's frames; not saved.
        steps: of a shake that was watched.
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
    steps: tuple[Step, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.shake_times)
        shapes: dict[str, tuple[int | None, ...]] = {
            "phase_times": (len(self.phases), 2),
            "shake_times": (n,),
            "commanded": (n, None),
            "measured": (n, None),
            "frame_times": (None,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, check_array(f"trial {name}", getattr(self, name), shape))
        for name, width in {"gripper": 3, "felt": 2}.items():
            array = check_array(f"trial {name}", getattr(self, name), (None, width), finite=False)
            object.__setattr__(self, name, array)

    @property
    def finished(self) -> bool:
        """Whether every phase ended as planned."""
        return self.stop_reason == "finished"

    @property
    def steady(self) -> tuple[float, float]:
        """When the shake was what it was to become [s]: its last step, or all of it; an empty time if there is none."""
        if self.steps:
            return self.steps[-1].begin, self.steps[-1].end
        return (float(self.shake_times[0]), float(self.shake_times[-1])) if len(self.shake_times) else (0.0, 0.0)

    def save(self, path: Path | str) -> None:
        """Write the trial, without the frames' pixels, to an .npz."""
        said = {name: getattr(self, name) for name in ("phases", "stop_reason", "failure")}
        words = json.dumps(said | {"steps": [asdict(step) for step in self.steps]})
        names = ("phase_times", "shake_times", "commanded", "measured", "gripper", "frame_times", "felt")
        write_npz(path, "trial", SCHEMA, words=words, **{name: getattr(self, name) for name in names})

    @classmethod
    def load(cls, path: Path | str) -> Trial:
        """Read a trial written by `save`.

        Raises:
            InputError: missing, truncated or of another kind.
        """
        with understood(path):
            arrays: dict[str, Any] = read_npz(path, "trial", SCHEMA)
            words = json.loads(str(arrays.pop("words")))
            rows: list[dict[str, Any]] = words.pop("steps")
            made: list[dict[str, Any]] = [
                {k: tuple(v) if isinstance(v, list) else v for k, v in r.items()} for r in rows
            ]
            steps = tuple(Step(**row) for row in made)
            return cls(phases=tuple(words.pop("phases")), steps=steps, **words, **arrays)
