"""A tomato of Helios on its string: what it weighs, that it hangs as it was put, how it swings, what rides on what."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import eigh

from anther.core.errors import MissingExtra
from anther.sim.pieces import Params
from anther.sim.plant import GRAVITY, Organ, SimPlant
from anther.sim.plant_mechanics import alone, mujoco
from anther.sim.row_plants import Place, held_by_string
from evaluation.perception.helios import Trained, train_helios
from evaluation.trials.helios_row import hanging_helios

PLACE = Place(np.array([0.5, 0.1, 0.9]), np.array([0.44, -0.1, 3.2]), np.array([-1.0, 0.0, 0.0]))


def test_without_helios_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyhelios", None)
    with pytest.raises(MissingExtra, match=r"anther\[evaluation\]"):
        train_helios(1, 2.0)


@cache
def trained() -> Trained:
    pytest.importorskip("pyhelios", reason="pyhelios3d is not installed: pip install 'anther[evaluation]'")
    return train_helios(1, 1.9)


@cache
def plant() -> SimPlant:
    pytest.importorskip("pyhelios", reason="pyhelios3d is not installed: pip install 'anther[evaluation]'")
    return held_by_string(hanging_helios(3, PLACE))


def test_what_is_trained_is_one_stem_with_leaves_and_trusses() -> None:
    grown = trained()
    assert grown.stem.nodes[-1, 2] > 1.9
    bases = np.array([limb.nodes[0] for limb in (*grown.petioles, *grown.peduncles)])
    gap = np.linalg.norm(bases[:, None] - grown.stem.nodes, axis=2).min(axis=1)
    assert gap.max() < 0.001, "there are no side shoots"
    leaf = float(np.median([sum(part.area for part in limb.leaflets) for limb in grown.petioles]))
    assert 0.01 < leaf < 0.1
    assert all(len(limb.leaflets) == 9 for limb in grown.petioles)
    assert {len(limb.flowers) + len(limb.fruits) for limb in grown.peduncles} == {6}


def test_it_hangs_on_what_it_weighs_and_stays_there() -> None:
    weight = GRAVITY * float((plant().mass + plant().lump_mass).sum())
    (twine,) = plant().twines
    assert weight < twine.tension < 1.25 * weight
    assert 10 < weight < 60, "1 to 6 kg"
    assert twine.hook[2] == pytest.approx(PLACE.hook[2])
    np.testing.assert_allclose(twine.hook[:2], PLACE.hook[:2], atol=0.06)
    mechanics = alone(plant(), Params())
    data = mujoco.MjData(mechanics.model)
    for _ in range(250):
        mujoco.mj_step(mechanics.model, data)
    assert data.time == pytest.approx(0.5), "it did not become unstable"
    assert np.abs(data.qpos).max() < 1e-6


def test_its_stem_swings_as_a_pulled_beam_of_the_same_masses() -> None:
    """Against finite differences of a clamped beam under tension, a bead at each segment's end; limbs are rigid."""
    youngs, stem, (twine,) = 1e8, plant().stem_segments(), plant().twines
    rigid = replace(plant(), youngs=np.where(plant().organ == Organ.STEM, youngs, 1e14))
    beads = -np.diff(plant().carried(plant().mass + plant().lump_mass)[stem], append=0.0)
    z, below = np.append(plant().start[0, 2], plant().end[stem, 2]), stem <= twine.segment
    h, radius = np.diff(z), plant().radius_start[stem]
    pull = twine.tension * below - GRAVITY * np.cumsum(beads[::-1])[::-1]
    slope = np.diff(np.eye(len(z)), axis=0) / h[:, None]
    turn = np.diff(slope, axis=0, prepend=0.0)
    between = (h + np.append(0.0, h[:-1])) / 2
    K = slope.T @ np.diag(pull * h) @ slope + turn.T @ np.diag(youngs * np.pi / 4 * radius**4 / between) @ turn
    held = below.sum()
    K[held, held] += twine.tension / (twine.hook[2] - z[held])
    expected = np.sqrt(eigh(K[1:, 1:], np.diag(beads), eigvals_only=True)[0]) / (2 * np.pi)
    assert alone(rigid, Params(twisting=())).frequencies[0] == pytest.approx(expected, rel=0.1)


def test_what_is_seen_rides_on_the_segment_beside_it() -> None:
    """Tubes lie around their segments; blades, petals and fruit within their size; and all go where segments go."""
    rides = plant().vertex_segment
    on, stem = rides >= 0, np.zeros(len(rides), dtype=bool)
    stem[np.unique(plant().faces[plant().face_organ == Organ.STEM])] = True
    a, b = plant().start[rides], plant().end[rides]
    share = np.einsum("ni,ni->n", plant().vertices - a, b - a) / np.sum((b - a) ** 2, axis=1)
    away = np.linalg.norm(plant().vertices - a - np.clip(share, 0, 1)[:, None] * (b - a), axis=1)
    assert away[on & stem].max() < 1.01 * plant().radius_start[0]
    farthest = {Organ.PETIOLE: 0.004, Organ.RACHIS: 0.004, Organ.LEAF: 0.25, Organ.PEDUNCLE: 0.07, Organ.FLOWER: 0.05}
    for organ, most in farthest.items():
        of = np.unique(plant().faces[plant().face_organ == organ])
        assert len(of) > 100
        assert away[of[on[of]]].max() < most, organ.name
    turned = np.tile(np.eye(4), (len(plant().start), 1, 1))
    chosen = int(plant().flower_segment[0])
    turned[chosen, 2, 3] = 0.1
    moved = plant().posed_vertices(turned) - plant().vertices
    petals = np.unique(plant().faces[plant().face_organ == Organ.FLOWER])
    risen = petals[moved[petals, 2] > 0.099]
    centre = plant().flower_position[0]
    assert len(risen) > 20
    assert np.linalg.norm(plant().vertices[risen] - centre, axis=1).max() < 0.05


def test_every_flower_is_where_its_petals_are() -> None:
    petals = plant().vertices[np.unique(plant().faces[plant().face_organ == Organ.FLOWER])]
    gap = np.linalg.norm(petals[:, None] - plant().flower_position, axis=2)
    assert len(plant().flower_segment) % 6 == 0, "trusses of six"
    assert gap.min(axis=0).max() < 0.02, "no flower without petals"
    assert gap.min(axis=1).max() < 0.05, "no petals without a flower"
