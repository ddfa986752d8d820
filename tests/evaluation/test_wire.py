"""From a stem to its neighbours through their wire: it sags as it must, and a tighter one passes less on."""

from __future__ import annotations

import numpy as np
import pytest

from anther.rods import equilibrium
from evaluation.house.wire import DRAWN, STEEL, passed_on, span

MIDDLE = {name: sum(bounds) / 2 for name, bounds in DRAWN.items()} | {"weight": 50.0}


def test_a_span_rests_where_its_plants_pull_it() -> None:
    here = span(MIDDLE)
    assert np.abs(equilibrium(here.rods, here.clamp) - here.rods.nodes).max() < 1e-5
    wire = here.rods.nodes[np.asarray(here.rods.youngs) == STEEL]
    count = int(MIDDLE["span"] / MIDDLE["pitch"])
    evenly = count * 50.0 * MIDDLE["span"] / (8 * MIDDLE["pull"])  # sag of a wire under a load that is spread evenly
    assert -wire[:, 2].min() == pytest.approx(evenly, rel=0.05)


def test_a_wire_that_pulls_harder_passes_less_on() -> None:
    hertz = np.array([12.0, 24.0])
    loose, tight = (passed_on(span(MIDDLE | {"pull": pull}), hertz).max() for pull in (500.0, 20_000.0))
    assert 0 < tight < loose / 3
