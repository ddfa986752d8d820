"""What watches a standing or moving arm: every reading is held against the limits."""

from __future__ import annotations

import numpy as np

from anther.devices import ArmSample, DeviceError, SafetyLimits, Watch
from anther.errors import StageFailure

STILL = 2e-3
"""A command that has travelled further than this [rad] must show in the readings."""


class Watchdog:
    """Holds every reading of a moving arm against the limits, then shows it to whoever else watches.

    Attributes:
        lost: why the arm's readings are not to be believed; empty while they are.
    """

    def __init__(self, limits: SafetyLimits, watch: Watch | None) -> None:
        self.lost = ""
        self._limits, self._watch = limits, watch
        self._last: ArmSample | None = None
        self._fresh, self._travelled = 0.0, 0.0

    def __call__(self, sample: ArmSample) -> None:
        self._check_fresh(sample)
        limits = self._limits
        gap = float(np.abs(sample.measured - sample.commanded).max())
        if not gap <= limits.tracking:
            raise DeviceError(f"the arm does not follow: {gap:.3g} rad behind; allowed: <= {limits.tracking:g}.")
        if sample.force > limits.contact_force:
            felt = f"contact force: got {sample.force:.3g} N; allowed: <= {limits.contact_force:g}"
            raise StageFailure("collision", f"{felt}. The arm presses on something: look what it is.")
        if self._watch:
            self._watch(sample)

    def _check_fresh(self, sample: ArmSample) -> None:
        """Raise where the clock stands, or the joints read the same to the last bit while the command travels."""
        last, self._last = self._last, sample
        if last is None:
            self._fresh = sample.time
            return
        if not sample.time > last.time:
            self._distrust(f"the clock of the readings stands at {sample.time:.3f} s")
        if np.array_equal(sample.measured, last.measured):
            self._travelled += float(np.abs(sample.commanded - last.commanded).max())
            age = sample.time - self._fresh
            if age > self._limits.stale_after and self._travelled > STILL:
                self._distrust(f"the joints read the same for {age:.2f} s of motion")
        else:
            self._fresh, self._travelled = sample.time, 0.0

    def _distrust(self, why: str) -> None:
        self.lost = f"joint readings are stale: {why}. The arm holds; check its connection and start anew."
        raise DeviceError(self.lost)
