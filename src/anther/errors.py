"""The errors Anther raises. Each message says what was given, what is allowed and what to do."""

from __future__ import annotations

from typing import Literal

FailureKind = Literal[
    "no_plant_found",
    "no_stem_found",
    "no_flowers_found",
    "no_grasp_found",
    "unreachable",
    "collision",
    "branch_or_leaf_grasped",
    "nothing_grasped",
    "slipped",
    "limits_exceeded",
    "damaged",
    "no_convergence",
    "device_fault",
    "interrupted",
]
"""Why a trial did not succeed. `trial.json` holds one of these, or null."""


class AntherError(Exception):
    """Base of every error a user can meet. The command line prints it and exits with code 2."""


class InputError(AntherError, ValueError):
    """Something given to Anther is wrong: a file, a shape, a unit, an option."""


class MissingExtra(AntherError, ImportError):
    """An optional dependency is not installed. The message holds the exact install command."""


class StageFailure(AntherError):
    """A stage understood its input but cannot go on, and says why.

    Attributes:
        kind: one of `FailureKind`, recorded in `trial.json`.
    """

    def __init__(self, kind: FailureKind, message: str) -> None:
        super().__init__(message)
        self.kind: FailureKind = kind

    def __reduce__(self) -> tuple[type[StageFailure], tuple[FailureKind, str]]:
        """Pickle with both arguments: a failure in a worker process reaches the one that waits for it."""
        return type(self), (self.kind, str(self))


def bad_input(what: str, *, given: object, allowed: str, do: str) -> InputError:
    """Return an `InputError` that says what was given, what is allowed and what to do next."""
    return InputError(f"{what}: got {given}; allowed: {allowed}. {do}")
