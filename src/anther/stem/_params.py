"""What a person may know better of the main stem."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters


@dataclass(frozen=True, slots=True)
class Params:
    """What a person may know better. What makes a path the main stem stands as constants beside its use.

    Attributes:
        tip: where the main stem ends [m], by who knows better; None: it is found.
    """

    tip: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        check_parameters(self, places=("tip",))
