"""What makes a path the main stem."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters, check_range


@dataclass(frozen=True, slots=True)
class Params:
    """What makes a path the main stem (paper P10, P11). What else is judged by stands as constants beside its use.

    Attributes:
        tip: where the main stem ends [m], by who knows better; None: it is found.
        alpha: exponent of the mean radius in the path score S.
        turn: a step that turns from the growth axis by more than this is not stem-like [degrees].
        fork_share: a branch forks the stem when it is at least this share as thick as the stem beyond it and rises at
            least this share as high (docs/reports/skeletons.md: branches 0.65, 0.85 or more; petioles that thick rise
            0.48 or less),
        fork_angle: and on the whole leans from the vertical by less than this [degrees].
    """

    tip: tuple[float, float, float] | None = None
    alpha: float = 2.0
    turn: float = 45.0
    fork_share: float = 0.6
    fork_angle: float = 50.0

    def __post_init__(self) -> None:
        check_parameters(self, places=("tip",))
        check_range("turn", self.turn, 1, 180, "degrees")
        check_range("fork_angle", self.fork_angle, 0, 180, "degrees")
