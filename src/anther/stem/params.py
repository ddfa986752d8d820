"""What makes a path the main stem."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters


@dataclass(frozen=True, slots=True)
class Params:
    """What makes a path the main stem (paper P10, P11). What else is judged by stands as constants beside its use.

    Attributes:
        tip: where the main stem ends [m], by who knows better; None: it is found.
        alpha: exponent of the mean radius in the path score S.
    """

    tip: tuple[float, float, float] | None = None
    alpha: float = 2.0

    def __post_init__(self) -> None:
        check_parameters(self, places=("tip",))
