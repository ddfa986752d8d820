"""The errors Anther raises. Each message says what was given, what is allowed and what to do."""

from __future__ import annotations

import re
from typing import Any, Literal

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

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with both arguments: a failure in a worker process reaches the one that waits for it."""
        return type(self), (self.kind, str(self))


EXTRA_OF = {
    **dict.fromkeys(("embreex", "mujoco", "pinocchio", "coal", "roboplan", "airo_models"), "cell"),
    **dict.fromkeys(("foxglove", "mcap"), "log"),
    "viser": "view",
    "cv2": "images",
}
"""Module -> the extra that brings it, of those that whole rooms cannot do without."""


PACKAGE_OF = {"libgomp.so.1": "libgomp1", "libGL.so.1": "libgl1", "libglib-2.0.so.0": "libglib2.0-0"}
"""System library that wheels do not bring -> the package of Debian and Ubuntu that does."""


def missing_extra(error: ImportError) -> MissingExtra | None:
    """Return what says how to get what an import did not find; None where that is not known."""
    module = (error.name or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError):
        if module not in EXTRA_OF:
            return None
        return MissingExtra(
            f"this needs {module}, which is not installed. Run: pip install 'anther[{EXTRA_OF[module]}]'"
        )
    library = re.match(r"(lib\S+\.so\S*): cannot open shared object file", str(error))
    if library is None:
        return None
    package = PACKAGE_OF.get(library[1], f"the package with {library[1]}")
    found = f"this needs the system library {library[1]}, which is not installed"
    return MissingExtra(f"{found}. On Debian or Ubuntu: apt-get install {package}")


def bad_input(what: str, *, given: object, allowed: str, do: str) -> InputError:
    """Return an `InputError` that says what was given, what is allowed and what to do next."""
    return InputError(f"{what}: got {given}; allowed: {allowed}. {do}")
