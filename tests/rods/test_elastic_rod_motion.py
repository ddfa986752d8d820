"""Moving rods: time stepping, frequency response, natural frequencies, peer references."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alike import check_kept
from made_rods import NO_GRAVITY, cantilever, random_tree

from anther.core.errors import InputError, StageFailure
from anther.rods import (
    Burst,
    Chirp,
    Clamp,
    Drive,
    Rods,
    SampledDrive,
    equilibrium,
    frequency_response,
    natural_frequencies,
    response_map,
    simulate,
    with_gravity_equilibrium,
)


def test_renumbering_changes_nothing():
    rods = random_tree(11, n=14)
    new_order = renumbering(rods.parent, 4)
    place = np.argsort(new_order)
    other = replace(
        rods,
        nodes=rods.nodes[new_order],
        parent=np.where(rods.parent[new_order] < 0, -1, place[rods.parent[new_order]]),
        edge_radius=rods.edge_radius[new_order],
        youngs=rods.youngs[new_order],
    )
    assert np.any(place != np.arange(14))
    runs = [
        simulate(r, Clamp([0]), Drive(node, (1, 1, 0), 1e-3, 20), 0.1, 1e-3, gravity=NO_GRAVITY, tolerance=1e-10)
        for r, node in ((rods, 7), (other, int(place[7])))
    ]
    np.testing.assert_allclose(runs[1].positions[:, place], runs[0].positions, atol=1e-10)


def renumbering(parent, seed):
    rng, done, order = np.random.default_rng(seed), {0}, [0]
    while len(order) < len(parent):
        ready = [j for j in range(len(parent)) if j not in done and parent[j] in done]
        order.append(int(rng.choice(ready)))
        done.add(order[-1])
    return np.array(order)


def test_natural_frequencies_of_a_cantilever():
    rods = cantilever(50)
    hertz, modes, _ = natural_frequencies(rods, Clamp.root(rods), 6, gravity=NO_GRAVITY)
    speed = np.sqrt(2e8 * 3e-3**2 / 4 / 1100)
    expected = np.array([1.87510, 4.69409, 7.85476]) ** 2 * speed / (2 * np.pi * 0.3**2)
    np.testing.assert_allclose(hertz[::2], expected, rtol=3e-3)
    np.testing.assert_allclose(hertz[::2], hertz[1::2], rtol=1e-6)
    assert modes.shape == (6, 51, 3)


def test_undamped_motion_keeps_its_energy():
    rods = cantilever(20)
    run = simulate(rods, Clamp.root(rods), None, 2.0, 1e-3, start="scanned")
    swing = run.energy[0] - equilibrium_energy(rods)
    assert np.ptp(run.energy) < 1e-3 * swing
    assert np.ptp(run.positions[1500:, -1, 2]) > 0.9 * np.ptp(run.positions[:500, -1, 2])


def equilibrium_energy(rods: Rods) -> float:
    return simulate(rods, Clamp.root(rods), None, 2e-3, 1e-3).energy[0]


def test_midpoint_rule_is_of_second_order():
    rods = cantilever(8, viscous_time=2e-3)
    drive = SampledDrive(5, np.linspace(0, 0.2, 2001), np.zeros((2001, 3)) + pulse(np.linspace(0, 0.2, 2001)))
    ends = [
        simulate(rods, Clamp.root(rods), drive, 0.2, dt, tolerance=1e-11).positions[-1]
        for dt in (4e-3, 2e-3, 1e-3, 1.25e-4)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.25)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.25)


def pulse(t):
    return np.outer(5e-3 * np.sin(2 * np.pi * 5 * t) ** 3, [0, 1, 0])


def test_kelvin_voigt_damping_ratio():
    rods = cantilever(12)
    first = natural_frequencies(rods, Clamp.root(rods), 1, gravity=NO_GRAVITY)[0][0]
    ratio = 0.03
    soft = replace(rods, viscous_time=2 * ratio / (2 * np.pi * first))
    small = 0.01  # of gravity: the release stays linear
    run = simulate(soft, Clamp.root(soft), None, 6 / first, 1e-3, gravity=(0, 0, -9.81 * small), start="scanned")
    z = run.positions[:, -1, 2]
    late = z - np.mean(z[-int(1 / first / 1e-3) :])
    peaks = [late[i] for i in range(1, len(late) - 1) if late[i] > late[i - 1] and late[i] > late[i + 1]][:5]
    decay = np.log(peaks[0] / peaks[3]) / 3
    assert decay / np.sqrt(4 * np.pi**2 + decay**2) == pytest.approx(ratio, rel=0.1)


PEERS = [
    "cantilever_free_dt0.001",
    "branched_planar_x_2Hz",
    "branched_planar_x_10Hz",
    "branched_planar_x_10Hz_damped",
    "branched_planar_x_30Hz",
]


@pytest.mark.parametrize("name", PEERS)
def test_implicit_euler_agrees_with_the_peer_solver(data: Path, name: str):
    with np.load(data / "rod_reference" / f"{name}.npz") as stored:
        reference = {key: stored[key] for key in ("nodes0", "edges", "fixed_nodes", "traj")}
        setup = json.loads(str(stored["params"]))
    rods = peer_rods(reference, setup)
    grip = setup.get("drive_node")
    drive = None if grip is None else Drive(grip, (1, 0, 0), setup["amp"], setup["freq"])
    clamp = Clamp([n for n in reference["fixed_nodes"] if n != grip])
    steps = min(300, len(reference["traj"]) - 1)
    run = simulate(rods, clamp, drive, steps * setup["dt"], setup["dt"], integrator="implicit_euler", start="scanned")
    np.testing.assert_allclose(run.positions, reference["traj"][: steps + 1], atol=1e-6)


@pytest.mark.parametrize("name", ["cantilever_static_small", "cantilever_static_large"])
def test_static_equilibrium_agrees_with_the_peer_solver(data: Path, name: str):
    with np.load(data / "rod_reference" / f"{name}.npz") as stored:
        reference = {key: stored[key] for key in ("nodes0", "edges", "traj")}
        setup = json.loads(str(stored["params"]))
    settled = equilibrium(peer_rods(reference, setup), Clamp([0, 1]))
    np.testing.assert_allclose(settled, reference["traj"][-1], atol=1e-6)


def peer_rods(reference: dict, setup: dict) -> Rods:
    parent = np.full(len(reference["nodes0"]), -1)
    parent[reference["edges"][:, 1]] = reference["edges"][:, 0]
    drag = setup.get("damping_per_node_Ns_per_m") or 0.0
    return Rods(
        reference["nodes0"], parent, setup["r"], setup["E"], setup["rho"], node_drag=drag, discretisation="paper"
    )


@pytest.mark.parametrize("seed", [0, 7])
def test_the_hanging_shape_stays_still(seed):
    rods = random_tree(seed, n=25, lumped_mass=1e-3, youngs=5e8)
    clamp = Clamp.root(rods)
    assert np.abs(equilibrium(rods, clamp) - rods.nodes).max() > 1e-5
    hanging = with_gravity_equilibrium(rods, clamp)
    run = simulate(hanging, clamp, None, 0.2, 1e-3, start="scanned")
    assert np.abs(run.positions - rods.nodes).max() < 1e-8


@pytest.mark.parametrize("frequency", [4.0, 17.0])
def test_frequency_response_agrees_with_simulation(frequency):
    rods = random_tree(5, n=16, youngs=3e7, lumped_mass=2e-4, viscous_time=3e-3)
    clamp, grip = Clamp.root(rods), 4
    expected = frequency_response(rods, clamp, grip, (1, 0, 0), [frequency])[0]
    amplitude, settle = 1e-5, 12 / frequency
    drive = Drive(grip, (1, 0, 0), amplitude, frequency, ramp=6 / frequency)
    run = simulate(rods, clamp, drive, settle + 2 / frequency, 1 / frequency / 400, tolerance=1e-11)
    last = run.times >= settle - 1e-9
    phase = np.exp(-2j * np.pi * frequency * run.times[last][:-1])
    moves = (run.positions[last][:-1] - run.positions[0]) / amplitude
    found = 2j * np.tensordot(phase, moves, 1) / len(phase)
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(expected).max())


def test_response_map_is_many_frequency_responses():
    rods = random_tree(2, n=12, air_drag=0.05)
    clamp = Clamp.root(rods)
    ways = np.array([[1.0, 0, 0], [0, 2.0, 2.0]])
    both = response_map(rods, clamp, [5, 8], ways, [3.0, 30.0], observe=[11, 8])
    one = frequency_response(rods, clamp, 8, ways[1], [3.0, 30.0])
    assert both.shape == (2, 2, 2, 2, 3)
    np.testing.assert_allclose(both[:, 1, 1], one[:, [11, 8]], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one[:, 8], np.tile(ways[1] / np.sqrt(8), (2, 1)), atol=1e-12)


def test_a_grip_of_two_nodes_holds_the_direction_in_simulation_and_response_alike():
    rods = cantilever(12, youngs=5e7, viscous_time=3e-3)
    clamp, pads, frequency, amplitude = Clamp.root(rods), (5, 6), 9.0, 1e-5
    axis = np.array([0.0, 1.0, 0.0])
    expected = response_map(rods, clamp, [pads], axis[None], [frequency], observe=np.arange(len(rods.nodes)))[0, 0, 0]
    np.testing.assert_allclose(expected[list(pads)], np.tile(axis, (2, 1)), atol=1e-9)
    drive = Drive(pads[0], axis, amplitude, frequency, ramp=6 / frequency, also=pads[1:])
    run = simulate(rods, clamp, drive, 14 / frequency, 1 / frequency / 400, tolerance=1e-11)
    last = run.times >= 12 / frequency - 1e-9
    phase = np.exp(-2j * np.pi * frequency * run.times[last][:-1])
    moves = (run.positions[last][:-1] - run.positions[0]) / amplitude
    found = 2j * np.tensordot(phase, moves, 1) / len(phase)
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(expected).max())
    edge = run.positions[:, 6] - run.positions[:, 5]
    assert np.abs(edge - edge[0]).max() < 1e-12
    alone = frequency_response(rods, clamp, 5, axis, [frequency])[0]
    assert not np.allclose(alone[-1], expected[-1], rtol=0.05), "one node alone lets the rod turn in the grip"


def test_the_grip_force_of_a_slow_pull():
    rods = cantilever(40, viscous_time=5e-3)
    clamp = Clamp.root(rods)
    pull = SampledDrive(40, [0, 2.0], [[0, 0, 0], [0, 0, 1e-4]])
    run = simulate(rods, clamp, pull, 3.0, 5e-3, gravity=NO_GRAVITY)
    expected = 3 * 2e8 * np.pi * 3e-3**4 / 4 / 0.3**3 * 1e-4
    assert run.grip_force[-100:, 2].mean() == pytest.approx(expected, rel=0.02)


def test_hard_steps_are_split_and_hopeless_ones_refused(monkeypatch: pytest.MonkeyPatch):
    rods = cantilever(20, viscous_time=2e-3)
    clamp, drive = Clamp.root(rods), Drive(12, (0, 1, 1), 0.01, 30)
    easy = simulate(rods, clamp, drive, 0.05, 1e-3)
    monkeypatch.setattr("anther.rods._simulation.NEWTON_LIMIT", 4)
    hard = simulate(rods, clamp, drive, 0.05, 1e-3)
    assert easy.split_steps == 0
    assert hard.split_steps > 0
    assert np.abs(hard.positions - easy.positions).max() < 1e-3
    monkeypatch.setattr("anther.rods._simulation.NEWTON_LIMIT", 3)
    with pytest.raises(StageFailure, match=r"t = .* s with a residual"):
        simulate(rods, clamp, Drive(12, (1, 0, 0), 5.0, 300), 0.05, 1e-3)


def test_the_drive_pays_for_the_energy():
    rods = cantilever(20)
    run = simulate(rods, Clamp.root(rods), Drive(8, (0, 1, 1), 2e-3, 12, ramp=0.2), 1.0, 5e-4, gravity=NO_GRAVITY)
    gained = run.energy - run.energy[0]
    assert np.ptp(gained) > 1e-6
    assert np.abs(gained - run.work).max() < 0.02 * np.ptp(gained)


def three_d_network() -> Rods:
    """A 51-node stem and five branches of 7 edges, spiralling, 10 mm an edge: the 3-D network of the peers."""
    nodes, parent = [np.array([0, 0, 0.01 * k]) for k in range(51)], list(range(-1, 50))
    for k, base in enumerate((15, 20, 28, 35, 42)):
        turn = np.radians(137.5) * k
        way = np.array([np.cos(turn), np.sin(turn), 1]) / np.sqrt(2)
        for step in range(7):
            parent.append(len(nodes) - 1 if step else base)
            nodes.append(nodes[base] + 0.01 * (step + 1) * way)
    return Rods(np.array(nodes), np.array(parent), 3e-3, 2e8, 1000.0)


def test_a_violent_shake_of_the_3d_network():
    shake = Drive(20, (1, 0, 0), 5e-3, 30)
    damped = replace(three_d_network(), viscous_time=1e-4)
    run = simulate(damped, Clamp([0, 1]), shake, 0.5, 1e-3, start="scanned")
    assert run.split_steps == 0
    assert run.energy[-1] - run.energy[0] < run.work[-1]
    run = simulate(three_d_network(), Clamp([0, 1]), shake, 0.4, 1e-3, start="scanned")
    assert run.split_steps > 0
    assert run.energy[-1] - run.energy[0] == pytest.approx(run.work[-1], rel=0.05)


def test_the_predictor_does_not_change_the_result():
    rods, shake = replace(three_d_network(), viscous_time=1e-4), Drive(20, (1, 0, 0), 4e-3, 5)
    runs = [
        simulate(rods, Clamp([0, 1]), shake, 0.2, 1e-3, tolerance=1e-10, predictor=predictor)
        for predictor in ("inertia", "guess displacement", "none")
    ]
    np.testing.assert_allclose(runs[1].positions, runs[0].positions, atol=1e-9)
    np.testing.assert_allclose(runs[2].positions, runs[0].positions, atol=1e-9)
    assert len({run.newton_iterations for run in runs}) == 3
    default = simulate(rods, Clamp([0, 1]), shake, 0.2, 1e-3, tolerance=1e-10)
    np.testing.assert_array_equal(default.positions, runs[0].positions)
    adrift = [simulate(rods, Clamp([0, 1]), None, 0.05, 1e-3, predictor=p) for p in ("guess displacement", "none")]
    np.testing.assert_array_equal(adrift[0].positions, adrift[1].positions)


def test_the_guess_displacement_takes_four_nodes_on_either_side_along():
    """With any residual accepted, a step from rest ends where Newton starts."""
    rods, shake = three_d_network(), Drive(20, (1, 0, 0), 1e-6, 5, also=(21,))
    shares = np.zeros(len(rods.nodes))
    shares[16:26] = 0.2, 0.4, 0.6, 0.8, 1, 1, 0.8, 0.6, 0.4, 0.2
    shares[58:61] = 0.8, 0.6, 0.4  # the branch at node 20, of which node 61 is clamped; that at 15 is too far
    accept = {"gravity": NO_GRAVITY, "start": "scanned", "integrator": "implicit_euler", "tolerance": 1e9}
    for predictor, moved in (("guess displacement", shares), ("none", shares == 1)):
        run = simulate(rods, Clamp([0, 1, 61]), shake, 1e-3, 1e-3, predictor=predictor, **accept)
        went = np.outer(moved, shake.displacement(run.times)[1])
        np.testing.assert_allclose(run.positions[1] - run.positions[0], went, atol=1e-14)


def test_a_turning_grip_carries_the_rod_and_feels_its_moment():
    rods = cantilever(20, youngs=2e8, viscous_time=0.05)
    times = np.linspace(0, 0.5, 51)
    turns = np.zeros((51, 3))
    turns[:, 1] = np.clip(times / 0.3, 0, 1) * np.radians(-40)
    drive = SampledDrive(10, times, np.zeros((51, 3)), also=(11,), rotations=turns)
    run = simulate(rods, Clamp.root(rods), drive, 0.5, 1e-3, gravity=NO_GRAVITY)
    held = run.positions[-1, 11] - run.positions[-1, 10]
    wanted = np.array([np.cos(np.radians(40)), 0, np.sin(np.radians(40))]) * 0.3 / 20
    np.testing.assert_allclose(held, wanted, atol=1e-9)
    beyond = run.positions[-1, 20] - run.positions[-1, 11]
    np.testing.assert_allclose(beyond / np.linalg.norm(beyond), wanted / np.linalg.norm(wanted), atol=0.02)
    assert run.grip_moment[-1, 1] < -1e-4  # it takes a moment to keep the lower part bent
    about_its_axis = SampledDrive(10, times, np.zeros((51, 3)), also=(11,), rotations=turns[:, [1, 0, 2]])
    twisted = simulate(rods, Clamp.root(rods), about_its_axis, 0.5, 1e-3, gravity=NO_GRAVITY)
    GJ, free_length = 2e8 * np.pi * 3e-3**4 / 4 / 1.5, 0.3 / 20 * 10.5  # to the middle of the held edge
    assert twisted.grip_moment[-1, 0] == pytest.approx(GJ * np.radians(-40) / free_length, rel=0.06)


def test_pads_hold_the_edge_in_both_ways_to_the_answer():
    rods = random_tree(5, n=16, youngs=3e7, lumped_mass=2e-4, viscous_time=3e-3)
    below = int(rods.parent[9])
    expected = response_map(rods, Clamp.root(rods), [[9, below]], [(0, 1, 0)], [6.0], observe=np.arange(16))[0, 0, 0]
    drive = Drive(9, (0, 1, 0), 1e-5, 6.0, ramp=1.0, also=(below,))
    run = simulate(rods, Clamp.root(rods), drive, 2 + 2 / 6.0, 1 / 2400, tolerance=1e-11)
    last = run.times >= 2 - 1e-9
    phase = np.exp(-2j * np.pi * 6.0 * run.times[last][:-1])
    found = 2j * np.tensordot(phase, (run.positions[last][:-1] - run.positions[0]) / 1e-5, 1) / len(phase)
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(expected).max())


def test_hysteretic_damping_is_the_same_at_every_frequency():
    rods = cantilever(12)
    for hertz in (3.0, 30.0):
        viscous = replace(rods, viscous_time=0.1 / (2 * np.pi * hertz))
        wanted = frequency_response(viscous, Clamp.root(rods), 5, (0, 1, 0), [hertz])
        found = frequency_response(rods, Clamp.root(rods), 5, (0, 1, 0), [hertz], loss_factor=0.1)
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_waveforms():
    sweep = Chirp(3, (0, 0, 2), 2e-3, 2.0, 12.0, 3.0, ramp=0.5)
    t = np.linspace(0, 3, 30001)
    moves = sweep.displacement(t)
    np.testing.assert_array_equal(moves[:, :2], 0)
    middle = moves[5000:25000, 2]
    crossings = t[5000:25000][1:][np.diff(np.sign(middle)) != 0]
    hertz = 0.5 / np.diff(crossings)
    np.testing.assert_allclose(hertz, 2 + 10 / 3 * (crossings[1:] + crossings[:-1]) / 2, rtol=0.02)
    assert np.abs(sweep.displacement([3.0, 9.0])).max() < 1e-12
    burst = Burst(3, (1, 0, 0), 2e-3, 10.0, cycles=20, rest=0.5)
    wave = burst.displacement(np.linspace(0, 5, 50001))[:, 0]
    assert 1.9e-3 < wave.max() <= 2e-3
    np.testing.assert_allclose(wave[20000:25000], 0, atol=1e-12)
    np.testing.assert_allclose(wave[25000:45000], wave[:20000], atol=1e-12)
    with pytest.raises(InputError, match="shake ramp"):
        Chirp(3, (0, 0, 1), 1e-3, 1.0, 2.0, 1.0, ramp=0.6)


def test_trajectory_round_trip(tmp_path: Path):
    rods = cantilever(6)
    run = simulate(rods, Clamp.root(rods), Drive(3, (0, 1, 0), 1e-3, 5), 0.02, 1e-3, record_every=5)
    assert len(run.times) == 5
    check_kept(run, tmp_path / "run.npz")


def test_bad_nodes_grips_and_times_are_refused():
    rods = cantilever(5)
    clamp = Clamp.root(rods)
    with pytest.raises(InputError, match="not clamped"):
        simulate(rods, clamp, Drive(0, (1, 0, 0), 1e-3, 5), 0.1, 1e-3)
    with pytest.raises(InputError, match="grip node"):
        frequency_response(rods, clamp, 99, (1, 0, 0), [5.0])
    with pytest.raises(InputError, match="time step"):
        simulate(rods, clamp, None, 1.0, 0.0)
    with pytest.raises(InputError, match="predictor: got luck; allowed: inertia, guess displacement, none"):
        simulate(rods, clamp, None, 0.1, 1e-3, predictor="luck")
    with pytest.raises(InputError, match="direction"):
        Drive(3, (0, 0, 0), 1e-3, 5)
    folded = Rods([[0, 0, 0], [0, 0, 1], [0, 0, 0.5]], [-1, 0, 1], 1e-3, 1e8, 1e3)
    with pytest.raises(InputError, match="folds back"):
        simulate(folded, Clamp([0]), None, 0.1, 1e-3)


def test_many_in_threads_are_bit_for_bit_each_alone():
    rods = with_gravity_equilibrium(random_tree(3, n=20, viscous_time=1e-3), Clamp([0, 1, 2, 3]))
    shakes = [Drive(grip, (1, 0, 0), 1e-3, hertz) for grip in (5, 8) for hertz in (5, 20)]
    with ThreadPoolExecutor(3) as pool:
        many = [pool.submit(simulate, rods, Clamp.root(rods), shake, 0.1, 1e-3) for shake in shakes]
    for shake, run in zip(shakes, many, strict=True):
        alone = simulate(rods, Clamp.root(rods), shake, 0.1, 1e-3)
        np.testing.assert_array_equal(run.result().positions, alone.positions)
        np.testing.assert_array_equal(run.result().grip_force, alone.grip_force)


def test_a_step_that_went_too_far_goes_back_half_of_what_it_went():
    """Coarse steps of a stiff rod: a line search that goes back by more spends half as many iterations again."""
    rods = cantilever(6, length=0.5, youngs=1e9)
    found = simulate(rods, Clamp.root(rods), None, 2.0, 0.5, start="scanned")
    assert found.newton_iterations < 2500  # 1,920; 3,104 by going back by what the step would have been unclamped
