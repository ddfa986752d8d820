"""The record of a trial: what was commanded and what happened."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import takewhile
from typing import Annotated

import numpy as np

from anther.core.errors import FailureKind, bad_input
from anther.core.geometry import Array
from anther.core.records import UNSAVED, Range, Record, Shape, Stored
from anther.robot.devices import Frame

PHASES = ("open", "reach", "approach", "close", "shake", "release", "retreat")
EARLY = "early reach"  # before these: the arm went to the grasp before it was told which shake (`early_reach`)


@dataclass(frozen=True, slots=True)
class Step(Record):
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

    begin: Annotated[float, Range(unit="s")]
    end: Annotated[float, Range(unit="s")]
    frequencies: Annotated[tuple[float, ...], Range(unit="Hz")]
    amplitudes: Annotated[tuple[float, ...], Range(unit="m")]
    direction: tuple[float, ...]
    flowers: Annotated[tuple[float, ...], Range(unit="m/s2")]
    loads: dict[str, float]
    decided: str
    seconds: Annotated[float, Range(unit="s")]

    def is_like(self, other: Step) -> bool:
        """Return whether the pads did the same in another step."""
        return (self.frequencies, self.amplitudes, self.direction) == (
            other.frequencies,
            other.amplitudes,
            other.direction,
        )

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
class Trial(Stored):
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

    KIND, SCHEMA, CALLED = "trial", 5, "trial"
    phases: tuple[str, ...]
    phase_times: Annotated[Array, Shape("P", 2), Range(unit="s")]
    shake_times: Annotated[Array, Shape("T"), Range(unit="s")]
    commanded: Annotated[Array, Shape("T", "J"), Range(unit="rad")]
    measured: Annotated[Array, Shape("T", "J"), Range(unit="rad")]
    gripper: Annotated[Array, Shape("G", 3, missing=True)]
    frame_times: Annotated[Array, Shape("N"), Range(unit="s")]
    stop_reason: str
    failure: FailureKind | None = None
    frames: Annotated[tuple[Frame, ...], UNSAVED] = field(default=(), repr=False)
    felt: Annotated[Array, Shape("R", 2, missing=True)] = field(default_factory=lambda: np.zeros((0, 2)))
    steps: tuple[Step, ...] = ()

    def _check(self) -> None:
        if len(self.phases) != len(self.phase_times):
            given, allowed = f"shape {self.phase_times.shape}", f"shape ({len(self.phases)}, 2)"
            raise bad_input("trial phase times", given=given, allowed=allowed, do="Check the array's axes.")

    @property
    def finished(self) -> bool:
        """Whether every phase ended as planned."""
        return self.stop_reason == "finished"

    @property
    def steady(self) -> tuple[float, float]:
        """When the shake was what it was to become [s]: its last steps alike, or all of it; empty if there is none."""
        if self.steps:
            same = takewhile(self.steps[-1].is_like, reversed(self.steps))
            return min(step.begin for step in same), self.steps[-1].end
        return (float(self.shake_times[0]), float(self.shake_times[-1])) if len(self.shake_times) else (0.0, 0.0)
