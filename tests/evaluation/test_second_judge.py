"""The frame of finite elements against beam theory, and the two judges of a small plant against each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from straight_plant import BASE, straight_plant, with_blade

from anther.pollination.shake.observables import semi_major
from anther.sim import plant_mechanics
from anther.sim.pieces import TWISTING, mass_properties
from anther.sim.plant import Organ, SimPlant
from evaluation.judge.frame_chain import HingedPlant
from evaluation.judge.frame_fe import AT, NO_LUMPS, Beams, Frame, Lumps, Shake, hysteretic_response, modal_response
from evaluation.judge.frame_plant import FramedPlant
from evaluation.judge.second_judge import FREQUENCIES, bare_params, difference, loss_factor, lossy_motion, weighted
from evaluation.prediction.shaken_plant import Params, ShakenPlant

LENGTH, RADIUS, YOUNGS, DENSITY = 0.5, 0.004, 1e9, 1000.0
AREA, SECOND = np.pi * RADIUS**2, np.pi / 4 * RADIUS**4
BEND, LINE = YOUNGS * SECOND, DENSITY * AREA
UP, ALONG = np.eye(3)[2], np.eye(3)[0]


def rod(
    points: Any, radius: Any = RADIUS, *, oval: float = 1.0, over_twist: float = 1.5, damping: float = 0.05
) -> Beams:
    """Return a polyline of (n + 1, 3) points; `radius` is a number or a function of the share of its n elements."""
    points = np.asarray(points, dtype=float)
    n = len(points) - 1
    share = (np.arange(n)[:, None] + AT) / n
    r: Any = radius(share) if callable(radius) else np.full(share.shape, radius)
    tangent = np.diff(points, axis=0) / np.linalg.norm(np.diff(points, axis=0), axis=1)[:, None]
    across = np.cross(tangent, np.eye(3)[np.argmin(np.abs(tangent), axis=1)])
    bend = YOUNGS * np.pi / 4 * r**4
    return Beams(
        nodes=points,
        ends=np.stack([np.arange(n), np.arange(n) + 1], axis=1),
        across=across / np.linalg.norm(across, axis=1)[:, None],
        stretch=YOUNGS * np.pi * r**2,
        bend=np.stack([bend * oval, bend / oval], axis=-1),
        twist=bend / over_twist,
        mass=DENSITY * np.pi * r**2,
        spin=np.full((n, len(AT), 2), 0.01 * DENSITY * SECOND),  # slender: theory has none
        damping_ratio=np.full(n, damping),
    )


def straight(n: int, axis: Any = ALONG, length: float = LENGTH) -> Any:
    return np.linspace(0, length, n + 1)[:, None] * axis


def pushed(frame: Frame, force: Any) -> Any:
    """Return the last node's displacement and rotation (6,) under a force and moment (6,) on it."""
    load = np.zeros(frame.mass.shape[0])
    load[-6:] = force
    free = frame.free()
    return np.linalg.solve(frame.stiffness[free][:, free].toarray(), load[free])[-6:]


def test_a_cantilever_bends_about_each_axis_of_its_section_and_twists_as_theory_says() -> None:
    frame = Frame(rod(straight(3), oval=2.0), gravity=0)
    first, second = frame.beams.frames[0, 1:]
    assert pushed(frame, np.r_[first, 0, 0, 0])[:3] @ first == pytest.approx(LENGTH**3 / 3 / (BEND / 2))
    assert pushed(frame, np.r_[second, 0, 0, 0])[:3] @ second == pytest.approx(LENGTH**3 / 3 / (BEND * 2))
    assert pushed(frame, np.r_[0, 0, 0, ALONG])[3] == pytest.approx(LENGTH / (BEND / 1.5))


def test_a_cantilevers_first_frequencies_are_those_of_theory() -> None:
    omega = Frame(rod(straight(8)), gravity=0).modes(200)[0]
    theory = np.array([1.87510, 1.87510, 4.69409, 4.69409]) ** 2 / LENGTH**2 * np.sqrt(BEND / LINE)
    assert omega[:4] == pytest.approx(theory, rel=2e-4)


def test_a_cone_swings_as_kirchhoff_found() -> None:
    """A cone that ends in a point: omega = 8.7189 sqrt(EI / m) / L^2 with EI and m of its base."""
    frame = Frame(rod(straight(30), lambda s: RADIUS * (1 - s)), gravity=0)
    assert frame.modes(50)[0][0] == pytest.approx(8.7189 / LENGTH**2 * np.sqrt(BEND / LINE), rel=2e-3)


def test_a_twisting_rod_with_a_disc_and_a_massive_arm_swing_as_their_inertia_says() -> None:
    disc = Lumps(np.array([4]), np.array([1e-3]), np.zeros((1, 3)), np.diag([2e-3, 0, 0])[None])
    omega, shapes = Frame(rod(straight(4)), disc, gravity=0).modes(30)
    twist = int(np.argmax(np.abs(shapes[-3])))
    assert omega[twist] == pytest.approx(np.sqrt(BEND / 1.5 / LENGTH / 2e-3), rel=1e-3)
    arm = replace(disc, mass=np.array([0.5]), arm=np.array([[0, 0.2, 0]]), inertia=np.zeros((1, 3, 3)))
    heavy, one = Frame(rod(straight(4)), arm, gravity=0), np.zeros(30)
    one[-3] = 1.0
    assert one @ (heavy.mass @ one) == pytest.approx(0.5 * 0.2**2)


@pytest.mark.parametrize(("share", "stands"), [(0.99, True), (1.01, False)])
def test_a_column_stands_up_to_greenhills_height(share: float, stands: bool) -> None:
    height = share * (7.8373 * BEND / LINE / 9.81) ** (1 / 3)
    frame = Frame(rod(straight(20, UP, height)))
    if stands:
        assert frame.modes(1)[0][0] > 0
    else:
        with pytest.raises(ValueError, match="weight"):
            frame.modes(1)


@pytest.mark.parametrize(("share", "stands"), [(0.99, True), (1.01, False)])
def test_a_blade_with_a_weight_at_its_end_tips_over_at_prandtls_load(share: float, stands: bool) -> None:
    """A narrow cantilever on edge: P = 4.0126 sqrt(EI GJ) / L^2; its moments couple twist with bending."""
    beams = rod(straight(24), over_twist=12)
    across = np.tile(np.eye(3)[1], (24, 1))
    thin, tall, twist = BEND, 1e4 * BEND, BEND / 12
    beams = replace(beams, across=across, bend=np.broadcast_to([tall, thin], (24, len(AT), 2)), mass=beams.mass * 1e-6)
    load = share * 4.0126 * np.sqrt(thin * twist) / LENGTH**2
    weight = Lumps(np.array([24]), np.array([load / 9.81]), np.zeros((1, 3)), 1e-6 * np.eye(3)[None])
    if stands:
        assert Frame(beams, weight).modes(1)[0][0] > 0
    else:
        with pytest.raises(ValueError, match="weight"):
            Frame(beams, weight).modes(1)


def test_weight_on_an_arm_turns_as_a_pendulum_and_topples_when_it_stands() -> None:
    """A rod that only twists, with a mass below it: m g d beside GJ / L."""
    for side in (-1, 1):
        lump = Lumps(np.array([2]), np.array([0.05]), np.array([[0, 0, 0.02 * side]]), np.zeros((1, 3, 3)))
        stiff = Frame(rod(straight(2)), lump).stiffness.toarray()[-3, -3]
        bare = Frame(rod(straight(2)), replace(lump, arm=np.zeros((1, 3)))).stiffness.toarray()[-3, -3]
        assert stiff - bare == pytest.approx(-side * 0.05 * 9.81 * 0.02)


def test_an_l_frame_gives_as_unit_loads_say() -> None:
    corner = np.concatenate([straight(4), LENGTH * ALONG + straight(4, np.eye(3)[1], 0.3)[1:]])
    give = pushed(Frame(rod(corner), gravity=0), np.r_[UP, 0, 0, 0])[2]
    theory = LENGTH**3 / 3 / BEND + 0.3**3 / 3 / BEND + 0.3**2 * LENGTH / (BEND / 1.5)
    assert give == pytest.approx(theory, rel=1e-6)


def test_a_resonance_is_as_high_as_damping_allows_in_both_models() -> None:
    frame, shake = Frame(rod(straight(12, UP), damping=0.03), NO_LUMPS, gravity=0), Shake(6, ALONG)
    first = frame.modes(30, shake.held)[0][:1] / 2 / np.pi
    modal, material = (
        np.abs(x[6 * 12, 0])
        for x in (
            modal_response(frame, shake, first * 1.0001, damped_below=60),
            hysteretic_response(frame, shake, first),
        )
    )
    assert modal == pytest.approx(1.566 / 2 / 0.03, rel=0.02)  # 1.566: a cantilever's first mode, participation x tip
    assert material == pytest.approx(modal, rel=0.02)


def judged(plant: SimPlant, hertz: Any) -> tuple[Any, Any]:
    """Return the flowers' amplitudes by the simulation and by the frame, per metre of grip."""
    fine = Params(plant=plant_mechanics.Params(0.004, stiffest=3000, foliage=3000, twist_every=1))
    shaken = ShakenPlant(plant, BASE + 0.25 * UP, ALONG, fine)
    frame = FramedPlant(plant, shaken.point, ALONG, size=0.02, twisting=TWISTING)
    found = semi_major(frame.flowers(modal_response(frame.frame, frame.shake, hertz, damped_below=60)))
    return semi_major(shaken.linear(hertz)), found


def test_the_judges_agree_on_a_small_plant() -> None:
    plant = with_blade(straight_plant(leaf=0.004), BASE + np.array([0.03, 0.13, 0.4]), [0.2, 0.1, 1.0], segment=23)
    assert weighted(*judged(plant, np.array([0.8, 2.0, 4.0, 9.0, 15.0, 30.0]))).max() < 0.03


def leaning_plant() -> SimPlant:
    """A branched plant of strong taper whose heavy leaf, to one side, twists and bends the stem."""
    plant = with_blade(straight_plant(leaf=0.004), BASE + np.array([0.03, 0.13, 0.4]), [0.2, 0.1, 1.0], segment=23)
    return replace(plant, radius_end=0.8 * plant.radius_end)


def test_the_judge_is_its_own_pieces_in_the_frames_code() -> None:
    """Equal pieces and loss factors: masses, gravity, order of hinges are alike. Without their order they are not."""
    plant, params = leaning_plant(), plant_mechanics.Params(0.025, stiffest=3000, foliage=3000, twist_every=1)
    shaken = ShakenPlant(plant, BASE + 0.25 * UP, ALONG, Params(plant=params))
    judged = shaken.linear(FREQUENCIES, loss_factor=loss_factor(plant))
    ordered, at_once = (
        lossy_motion(HingedPlant(plant, shaken.point, ALONG, params, ordered=ordered)) for ordered in (True, False)
    )
    assert difference(judged, ordered)[FREQUENCIES < 10].max() < 0.001
    assert difference(judged, ordered).max() < 0.01  # the hinges' own 0.02 mm count on a pedicel of 15 mm
    assert difference(judged, at_once).max() > 0.03


def test_ever_shorter_pieces_become_the_frame() -> None:
    plant = leaning_plant()
    whole = lossy_motion(FramedPlant(plant, BASE + 0.25 * UP, ALONG, size=0.005, twisting=TWISTING))
    eight, four, two, one = (
        lossy_motion(HingedPlant(plant, BASE + 0.25 * UP, ALONG, bare_params(mm))) for mm in (8.0, 4.0, 2.0, 1.0)
    )
    errors = [difference(cut, whole).max() for cut in (eight, four, two, one)]
    assert np.divide(errors[1:], errors[:-1]) == pytest.approx(0.5, abs=0.1)  # of first order in their length
    assert difference(2 * one - two, whole).max() < 0.02


def test_a_tapered_rods_mass_is_where_its_volume_is() -> None:
    plant = straight_plant()
    plant = replace(plant, radius_end=0.4 * plant.radius_start)
    mass, centre, inertia = mass_properties(plant, np.arange(len(plant.start)))
    s = (np.arange(20000) + 0.5) / 20000
    area = (1 - 0.6 * s) ** 2 / ((1 - 0.6 * s) ** 2).sum()
    middle, length = area @ s, plant.length[0]
    assert centre[0] == pytest.approx(plant.start[0] + middle * length * UP)
    round_axis = mass[0] ** 2 / (plant.density[0] * np.pi * length) / 2
    across = mass[0] * length**2 * (area @ (s - middle) ** 2) + round_axis / 2
    assert inertia[0] == pytest.approx([across, across, round_axis, 0, 0, 0], rel=1e-6)


def test_the_judges_agree_on_a_tied_plant() -> None:
    hertz = np.array([0.8, 2.0, 4.0, 9.0])
    free, tied = (replace(straight_plant(leaf=0.004), tie=tie) for tie in (None, (17, 40.0)))
    ours, found = judged(tied, hertz)
    assert weighted(ours, found).max() < 0.03
    assert weighted(judged(free, hertz)[1], found).max() > 0.3  # the tie counts, or this says nothing


def test_joints_foot_and_oval_sections_act_where_the_truth_says() -> None:
    plant = straight_plant()
    point, push = plant.stem_centreline()[0][10], np.zeros(6)
    push[0] = 1.0

    def give(changed: Any) -> float:
        return float(pushed_at_head(FramedPlant(changed, point, ALONG, size=0.02, twisting=(Organ.STEM,))))

    def pushed_at_head(framed: FramedPlant) -> float:
        load, free = np.zeros(framed.frame.mass.shape[0]), framed.frame.free()
        dof = 6 * framed.mesh.node_beside(19, 1.0)
        load[dof] = 1.0
        return np.linalg.solve(framed.frame.elastic[free][:, free].toarray(), load[free])[dof - 6]

    base, height = give(plant), 0.5
    assert give(replace(plant, foot=20.0)) - base == pytest.approx(height**2 / 20, rel=1e-3)
    joint = np.zeros(len(plant.start))
    joint[10] = 0.02
    assert give(replace(plant, joint_compliance=joint)) - base == pytest.approx(0.02 * 0.25**2, rel=1e-3)
    wide = np.tile(np.log(4.0) * ALONG, (len(plant.start), 1))
    wide[20:] = 0.0
    assert give(replace(plant, oval=wide)) == pytest.approx(base / 2, rel=1e-6)
