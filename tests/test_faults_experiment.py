"""What `experiments/faults.py` stands on: its shake in pieces is one that `execute` takes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from fault_machines import Pieces
from made_foresight import made_plan

from anther.execution import Watched


def test_its_pieces_are_a_watched_shake_that_comes_to_rest() -> None:
    plan = made_plan()
    watched = Pieces(plan)
    assert {name for name in (*dir(Watched), *Watched.__annotations__) if name[0] != "_"} <= set(dir(watched))
    assert watched.frame_rate((15.0, 30.0, 60.0, 90.0)) > 2 * plan.tones.frequencies.max()
    watched_from: Any = None
    piece = watched.begin(watched_from)
    sample: Any = SimpleNamespace(time=0.0)
    sizes = [piece.amplitudes]
    while sizes[-1].any():
        piece = watched.go_on(piece, [], [sample])
        sizes.append(piece.amplitudes)
    assert len(watched.steps) == len(sizes) - 1 == 3
    assert all(np.abs(size).max() <= watched.lines[0].reach for size in sizes)
