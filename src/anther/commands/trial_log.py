"""The log of a trial, log.mcap in its folder, and what is said where there is none: a trial goes on without."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from anther.devices import Tap, untapped
from anther.errors import missing_extra
from anther.runs import Run

LOG, EARLIER = "log.mcap", "log_before.mcap"
"""The log, and that of the process which a run was gone on from."""


class TrialLog:
    """A context manager: what was said is on the disk when it ends. Attribute: `tap` listens to a cell's machines.

    Args:
        run: what it listens to.
        wanted: whether there is to be one.
    """

    def __init__(self, run: Run, *, wanted: bool) -> None:
        self.tap: Tap = untapped
        self._log, self._lacks = None, None
        if wanted:
            try:
                from anther.log import Log
            except ImportError as error:
                lacks = missing_extra(error)
                if lacks is None:
                    raise
                self._lacks = str(lacks)
                return
            self._log = Log(_place(run.folder))
            self.tap, run.told = self._log.tap, self._log.told

    def __enter__(self) -> TrialLog:
        return self

    def __exit__(self, *reason: object) -> None:
        if self._log is not None:
            self._log.close()

    def close(self, failure: object, verdict: Any) -> dict[str, Any]:
        """End the log with how the trial ended; warn if anything lacks; return what trial.json keeps of it."""
        if self._log is None:
            if self._lacks is not None:
                print(f"anther trial: no {LOG}: {self._lacks}", file=sys.stderr)
            return {"log_messages": 0, "log_dropped": 0, "log_error": self._lacks}
        if failure is not None or verdict is not None:
            self._log.told("verdict", str(failure) if verdict is None else verdict.reason or "success")
        kept = self._log.close()
        if kept.error is not None:
            lost = f"{kept.dropped} of {kept.messages + kept.dropped} messages are missing"
            print(f"anther trial: {LOG}: {kept.error}; {lost}. The trial was not held up.", file=sys.stderr)
        return {"log_messages": kept.messages, "log_dropped": kept.dropped, "log_error": kept.error}


def _place(folder: Path) -> Path:
    """Return where the log goes; one that is there is what led to a restart, and is kept."""
    place = folder / LOG
    try:
        if place.exists():
            place.replace(folder / EARLIER)
    except OSError:
        pass  # the log itself says what is wrong with the folder
    return place
