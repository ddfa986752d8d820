"""What shakes were truly worth, and the oracle that knows the plant: tables of toy rows, and one small linear plant."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from straight_plant import straight_plant

from anther.pollination.shake import VIBRATING_GRIPPER, arm_shaker
from anther.pollination.shake.observables import semi_major
from anther.sim.judge import Harm, net_fruit
from anther.sim.truth import Truth, tolerances
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.tables import say
from evaluation.trials import oracle
from evaluation.trials.oracle import MEASURES
from evaluation.trials.shaking_table import metrics, net, report

PLANT, LIMITS = straight_plant(), tolerances("tomato", 0)
SOFT = Truth(pad_stiffness=1e4, pad_rotation=0.5)
MACHINES = {"arm": arm_shaker(), "motor": VIBRATING_GRIPPER}


@pytest.fixture(scope="module")
def grips() -> dict[str, list[oracle.Shakes]]:
    """The oracle's grid on a small plant, by machine."""
    return {name: list(oracle.tried(PLANT, SOFT, machine, (0.3, 0.6))) for name, machine in MACHINES.items()}


WEAK = {kind: 0.1 * limit for kind, limit in LIMITS.items()}
CASES = [(machine, limits) for machine in MACHINES for limits in (LIMITS, WEAK)]


@pytest.mark.parametrize(("machine", "limits"), CASES)
def test_no_shake_of_its_grid_is_worth_more_than_the_oracles(
    grips: dict[str, list[oracle.Shakes]], machine: str, limits: dict[str, float]
) -> None:
    found = oracle.best(grips[machine], limits)
    for name, one in found.items():
        most = max(shakes.net(limits, MEASURES[name]).max() for shakes in grips[machine])
        assert one.net(MEASURES[name]) == pytest.approx(most), "one flower or all, the rule is the same"
    rng = np.random.default_rng(0)
    for shakes, (name, measure) in product(grips[machine], MEASURES.items()):
        for a, q, d in rng.integers(0, shakes.amplitude.shape, (10, 3)).tolist():
            grip, amplitude, hertz = held(shakes, d), shakes.amplitude[a, q, d], float(shakes.hertz[q, 0])
            felt = amplitude * semi_major(grip.linear([hertz]))[0] * (2 * np.pi * hertz) ** 2
            assert felt == pytest.approx(shakes.felt[a, q, d], rel=1e-6), "one shake along its own direction"
            strain = amplitude * semi_major(grip.bending([hertz]))[0]
            loads = {kind: load[a, q, d] for kind, load in shakes.loads.items()}
            harm = Harm(loads, limits, *grip.flower_stalks(strain))
            bent = {kind: harm.loads[kind] > limits[kind] for kind in limits}
            slipped = bool(shakes.slipped[a, q, d])
            net = net_fruit(felt, hertz, harm.flowers_lost / 1, bent, slipped, measure)
            assert net <= (found[name].net(measure) if name in found else 0.0) + 1e-9


_grips: dict[tuple[float, ...], ShakenPlant] = {}


def held(shakes: oracle.Shakes, d: int) -> ShakenPlant:
    """The plant, held where these shakes hold it and moved along one of their directions."""
    direction = shakes.directions[d]
    key = (*shakes.point.tolist(), *direction.tolist())
    if key not in _grips:
        _grips[key] = ShakenPlant(PLANT, shakes.point, direction, oracle.CUT, SOFT)
    return _grips[key]


def test_a_gentle_shake_does_in_simulation_what_it_promises(grips: dict[str, list[oracle.Shakes]]) -> None:
    shakes = grips["motor"][1]
    promised = shakes.outcome((0, 20, 2), LIMITS)
    done = oracle.simulated(held(shakes, 2), promised)
    assert done.felt == pytest.approx(promised.felt, rel=0.05)
    assert done.harm.pedicels == pytest.approx(promised.harm.pedicels, rel=0.1)
    assert done.harm.loads["stem"] == pytest.approx(promised.harm.loads["stem"], rel=0.1)
    half = oracle.simulated(held(shakes, 2), promised, 0.5)
    assert half.felt == pytest.approx(done.felt / 2, rel=0.05)
    assert half.harm.loads["leaf"] == promised.harm.loads["leaf"] / 2


def test_a_shake_that_costs_too_much_is_made_gentler_while_that_is_worth_more(
    grips: dict[str, list[oracle.Shakes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    shake = grips["motor"][0].outcome((-1, 20, 2), LIMITS)
    worth = {1.0: -0.4, 0.8: 0.2, 0.6: 0.5, 0.45: 0.4, 0.3: 0.9}
    done = {share: SimpleNamespace(net=lambda measure, value=value: value) for share, value in worth.items()}
    monkeypatch.setattr(oracle, "simulated", lambda grip, shake, share: done[share])
    tried = [one.net(None) for one in oracle.gentler(PLANT, SOFT, shake, None, 1e-6)]
    assert tried == [-0.4, 0.2, 0.5, 0.4], "it stops behind the best"
    assert len(list(oracle.gentler(PLANT, SOFT, shake, None, 0.7 * shake.amplitude))) == 2


def test_the_oracles_row_is_worth_the_best_that_was_done(grips: dict[str, list[oracle.Shakes]]) -> None:
    done = [grips["motor"][0].outcome((a, 20, 2), LIMITS) for a in (0, 5, 9)]
    found = oracle.told(done)
    trial = {key: value for key, value in found.items() if key != "best"}
    assert net(trial) == pytest.approx(found["best"]["acceleration"]) == max(one.net("acceleration") for one in done)
    assert all(net(trial, name) <= most + 1e-9 for name, most in found["best"].items())


def test_an_oracle_to_whom_all_is_harm_leaves_the_plant_alone(grips: dict[str, list[oracle.Shakes]]) -> None:
    weak = dict.fromkeys(LIMITS, 1e-9)
    assert not oracle.best(grips["arm"], weak)
    alone = oracle.told([grips["arm"][0].outcome((-1, 5, 2), weak)])
    assert alone["best"] == dict.fromkeys(MEASURES, 0.0)
    assert net(alone) == 0.0


@pytest.mark.parametrize("machine", MACHINES)
def test_the_machine_bounds_every_shake(grips: dict[str, list[oracle.Shakes]], machine: str) -> None:
    actuator = MACHINES[machine]
    for shakes in grips[machine]:
        most = oracle.reach(actuator, shakes.point, shakes.directions, shakes.hertz[:, 0])
        assert np.all(shakes.amplitude <= most + 1e-12)
        assert np.all((shakes.amplitude >= actuator.least_amplitude - 1e-12) | (shakes.amplitude == 0))
        assert shakes.amplitude[-1].max() == pytest.approx(most.max()), "as far as it goes"


def test_pads_without_friction_let_the_stem_slip() -> None:
    (firm,), (slick,) = (list(oracle.tried(PLANT, Truth(pad_friction=mu), arm_shaker(), (0.6,))) for mu in (1.0, 1e-6))
    assert slick.slipped[slick.amplitude > 0].all()
    assert not firm.slipped[0].all()
    assert slick.net(LIMITS, "acceleration").max() <= 0 < firm.net(LIMITS, "acceleration").max()


FELT = (10.0, 20.0, 30.0, 40.0)


def row(way: str, seed: int = 1, felt: tuple[float, ...] = FELT, **more: Any) -> dict[str, Any]:
    """A trial that went well but for what is given."""
    facts = {"held": True, "failure": None, "harmed": "", "flowers_lost": 0, "shake_frequency_hz": 20.0}
    motion = {"true_flower_acceleration_median_ms2": float(np.median(felt)), "true_stem_strain": 0.001}
    flowers = {"true_flower_acceleration_peak_ms2": list(felt)}
    return {"way": way, "species": "tomato", "seed": seed, **facts, **motion, **flowers, **more}


def best(seed: int, value: float, way: str = "oracle") -> dict[str, Any]:
    """An oracle's row that is worth as much by every measure."""
    return row(way, seed, best=dict.fromkeys(MEASURES, value))


UNSHAKEN = {"way": "escalated", "species": "tomato", "seed": 2, "success": False, "failure": "crashed"}


def test_the_table_says_what_shakes_were_worth_and_how_much_of_the_best() -> None:
    rows = [row("escalated"), UNSHAKEN, row("motor"), row("plan", flowers_lost=1), best(1, 0.8), best(2, 0.6)]
    table = metrics([*rows, best(1, 0.9, "oracle_motor")])
    worth = net(row("escalated"))
    assert table["net_fruit_arm"] == pytest.approx(worth / 2), "a plant that was not shaken counts as nothing"
    assert table["oracle_share"] == table["oracle_share_arm"] == pytest.approx(worth / 1.4), "a ratio of sums"
    assert table["oracle_share_motor"] == pytest.approx(worth / 0.9)
    assert table["oracle_share_plan"] == pytest.approx((worth - 1 / 4) / 0.8)
    assert table["regret_arm_acceleration"] == pytest.approx(0.7 - worth / 2)
    assert table["regret_arm"] == max(table[f"regret_arm_{name}"] for name in MEASURES)
    assert table["regret_motor_velocity"] > table["regret_motor_acceleration"] > table["regret_motor_jerk"]
    assert table["oracle_share_arm_low"] <= table["oracle_share_arm"] <= table["oracle_share_arm_high"]
    assert (table["flowers_lost"], table["flowers_lost_plan"]) == (0, 1 / 4)
    assert {"plan_ms2", "net_fruit_motor", "bent_arm", "bent_motor"} <= set(table)


@pytest.mark.parametrize(("harmed", "bent"), [("", 0), ("stem", 1), ("pedicel, base", 1), ("pedicel, leaf", 0)])
def test_stems_forks_and_bases_count_as_bent(harmed: str, bent: int) -> None:
    assert metrics([row("escalated", harmed=harmed)])["bent_arm"] == bent


def test_without_an_oracle_there_is_no_share() -> None:
    table = metrics([row("escalated")])
    assert not [key for key in table if key.startswith(("oracle", "regret"))]


def test_the_report_tells_the_worth_of_every_way(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    rows = [row("escalated"), best(1, 0.8)]
    say(report(rows, metrics(rows)))
    told = capsys.readouterr().out
    share = net(row("escalated")) / 0.8
    assert f"{share:.0%} ({share:.0%} to {share:.0%})" in told
    assert "crashed" not in told
