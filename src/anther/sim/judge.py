"""The judge: what really happened in the cell, from its log and the plant's truth alone. No stage sees this.

A verdict has three parts: the main stem was held, the plant was not harmed, its flowers moved.
T log samples, K plant segments, F flowers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.stats import norm

from anther.core.errors import FailureKind
from anther.core.geometry import Array, inverse, transform_each
from anther.core.oscillation import fit_swing
from anther.plant.limits import moved
from anther.sim.cell import NEIGHBOUR, Cell, CellLog
from anther.sim.pieces import by_kind, of_flower_stalks
from anther.sim.plant import Organ
from anther.sim.truth import DOSE_EXPONENT, DOSE_MEASURES, HALF_DOSE, TOLERANCE, tolerances

BEARERS = {
    "stem": "stem or branches",
    "pedicel": "pedicels",
    "base": "bases of petioles, peduncles and midribs",
    "leaf": "leaf bases under the leaves' load",
}
"""The kinds of `truth.TOLERANCE` in words."""


@dataclass(frozen=True, slots=True, eq=False)
class Harm:
    """What a plant bore, and what it bears.

    Attributes:
        loads: kind of `truth.TOLERANCE` -> the peak of it: bending strain [-] of "stem", "pedicel" and "base",
            acceleration [m/s2] of "leaf".
        limits: what this plant bears of each, in the same units.
        pedicels: (F,) peak of the bending strain of each flower's pedicel [-]; empty: not known one by one.
        peduncles: (F,) the same of what carries that pedicel up to stem or branch, 0 where nothing does; likewise.
    """

    loads: Mapping[str, float]
    limits: Mapping[str, float]
    pedicels: Array = field(default_factory=lambda: np.zeros(0))
    peduncles: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def flowers_lost(self) -> int:
        """How many flowers hang on a pedicel or a peduncle that was bent further than this plant's bear."""
        peduncles = self.peduncles if len(self.peduncles) else np.zeros(len(self.pedicels))
        return int(lost_flowers(self.pedicels, peduncles, self.limits).sum()) if len(self.pedicels) else 0

    @property
    def passed(self) -> tuple[str, ...]:
        """The kinds of which this plant bore more than it bears."""
        return tuple(kind for kind, load in self._deciding.items() if not load <= self.limits[kind])

    @property
    def probability(self) -> float:
        """That a plant of which nothing is known but its loads is harmed: one of its limits is below its load."""
        return 1 - float(np.prod([1 - TOLERANCE[kind].share_below(load) for kind, load in self._deciding.items()]))

    @property
    def _deciding(self) -> dict[str, float]:
        """The loads that harm: of the pedicels the first beyond a sixth of the flowers, at least one of several.

        Without a shake a third of the flowers sets no fruit (facts: pollination 6).
        """
        loads, count = dict(self.loads), len(self.pedicels)
        if count:
            spared = min(count - 1, max(1, int(1 / 6 * count)))
            loads["pedicel"] = float(np.sort(self.pedicels)[::-1][spared])
        return loads

    @property
    def words(self) -> str:
        """What was passed and by how much, "" if nothing; of pedicels the worst is told."""
        return ", ".join(
            f"{BEARERS[kind]}: {_size(kind, self.loads[kind])}, this plant bears {_size(kind, self.limits[kind])}"
            for kind in self.passed
        )


def _size(kind: str, load: float) -> str:
    return f"{load / 9.81:.2f} g" if kind == "leaf" else f"{load:.2%}"


def lost_flowers(pedicels: Array, peduncles: Array, limits: Mapping[str, float]) -> NDArray[np.bool_]:
    """Return (..., F) which flowers hang on stalks that were bent, by (..., F) strains, further than a plant bears."""
    return ~((pedicels <= limits["pedicel"]) & (peduncles <= limits["base"]))


def pollen_freed(acceleration: Array) -> tuple[float, float, float]:
    """Return the mean share of pollen that leaves the flowers: its 5 %, 50 % and 95 % quantile over what is not known.

    A flower frees a^n / (a^n + h^n) of its pollen; h and n are drawn from `truth.HALF_DOSE` and `truth.DOSE_EXPONENT`,
    one pair for all flowers of a plant. How long it is shaken does not count: this is the most one acceleration frees.

    Args:
        acceleration: (F,) peak acceleration of each flower [m/s2]; NaN where unknown, which is left out.

    Returns:
        NaN, all three, if no flower is known.
    """
    known = acceleration[np.isfinite(acceleration)]
    if len(known) == 0:
        return np.nan, np.nan, np.nan
    low, middle, high = np.quantile(_pollen_shares(known).mean(axis=1), [0.05, 0.5, 0.95])
    return float(low), float(middle), float(high)


def _pollen_shares(acceleration: Array) -> Array:
    """Return (200, F, 21) the share of pollen that (F,) accelerations free, by half dose and exponent."""
    middles = (np.arange(200) + 0.5) / 200
    half = HALF_DOSE.median * np.exp(HALF_DOSE.sigma * norm.ppf(middles))
    ratio = (acceleration / half[:, None])[..., None] ** np.linspace(DOSE_EXPONENT.low, DOSE_EXPONENT.high, 21)
    return ratio / (1 + ratio)


@cache
def _mean_pollen_share() -> tuple[Array, Array]:
    """Return ln of accelerations and the share of pollen that they free, its mean over all doses."""
    logs = np.linspace(np.log(1e-3), np.log(1e4), 321)
    return logs, _pollen_shares(np.exp(logs)).mean(axis=(0, 2))


def net_fruit(
    felt: Array,
    hertz: ArrayLike,
    lost: ArrayLike,
    bent: Mapping[str, ArrayLike],
    slipped: ArrayLike = False,
    measure: str | None = "acceleration",
) -> Array:
    """Return (...) what shakes were worth, in the fruit of the whole plant: at most 1.

    That is the mean share of pollen freed over the flowers, its mean over all that is not known of the dose, less the
    share of flowers lost. A stem or fork that stays bent loses them all; a petiole or a leaf that stays bent costs half
    of what one leaf of ten makes, a stem that slips through the pads its bark: a judgement. A shake that slipped frees
    nothing. Velocity and jerk are to first order those of a sine: acceleration over, and times, 2 pi f.

    Args:
        felt: (..., F) peak acceleration of each flower [m/s2]; NaN, where unknown, is none.
        hertz: (...) frequency of the shake [Hz].
        lost: (...) share of the flowers on pedicels or peduncles that stay bent.
        bent: kind of `truth.TOLERANCE` -> (...) whether such an organ stays bent; pedicels are in `lost`.
        slipped: (...) whether the stem slipped through the pads.
        measure: of motion that frees pollen, of `truth.DOSE_MEASURES`; None: their mean, each as probable as it is.
    """
    # where every measure frees the same, so that the half dose of one is that of all [Hz]: the geometric middle of the
    # 5 and 30 Hz at which tomato flowers answer (KAKEN 19KT0040); a guess
    middle = 12.0
    parts = [DOSE_MEASURES[measure]._replace(probability=1.0)] if measure else DOSE_MEASURES.values()
    motion = np.log(np.maximum(np.nan_to_num(felt), 1e-12))
    ratio = np.log(np.asarray(hertz, dtype=np.float64) / middle)[..., None]
    freed = sum(share * np.interp(motion + power * ratio, *_mean_pollen_share(), left=0.0) for power, share in parts)
    gain = np.sum(freed, axis=-1) / max(np.shape(felt)[-1], 1)
    slips = np.asarray(slipped, dtype=bool)
    cost = sum(0.05 * np.asarray(bent[kind]) for kind in ("base", "leaf")) + 0.1 * slips
    return np.where(slips, 0.0, gain) - np.where(bent["stem"], 1.0, lost) - cost


LETS_GO = 2.0
"""A string that is pulled so many times as hard as it hangs slides through its clips or off its hook: a guess."""
LEAF_BAND = 5.0
"""Up to which a leaf is taken to follow quasi-statically [Hz]."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The truth about a trial.

    Attributes:
        held: the main stem was held through the shake, and nothing pushed, struck or slipped.
        failure: what became of the hold, or else "damaged"; None if it was held and not harmed.
        reason: why, in words, or what was held.
        organ_grasped: name of the organ between the pads most of the time, "" if none.
        grasp_height: height of the held point above the soil [m]; NaN if nothing was held.
        slip: largest wander of the held point between the pads [m]; NaN if nothing was held.
        push: largest force on the plant before closing [N], leaves included.
        harm: the loads that the plant bore, what it bears, and how probable harm was.
        flower_amplitude: (F,) semi-major axis of each flower's swing at the shake's frequency, over the middle 60 % of
            the shake [m]: as `anther.pollination.response` measures it. Of a plant with a string for each of its
            stems, here and below, those of the first: the others are another visit's.
        flower_acceleration_peak: (F,) the largest in a period, its median over the periods of that part [m/s2].
        effort: largest share of a motor's torque limit that the arm used.
        held_beside: names of other organs that were between the pads with what is held.
    """

    held: bool
    failure: FailureKind | None
    reason: str
    organ_grasped: str
    grasp_height: float
    slip: float
    push: float
    harm: Harm
    flower_amplitude: Array
    flower_acceleration_peak: Array
    effort: float
    held_beside: tuple[str, ...] = ()

    @property
    def unharmed(self) -> bool:
        """Whether the plant bears every load that it bore."""
        return not self.harm.passed

    @property
    def flowers_moved(self) -> bool:
        """Whether half of the flowers or more felt what a breeze gives them, `plant.limits.MOVED`, or more."""
        return bool(moved(self.flower_acceleration_peak))

    @property
    def success(self) -> bool:
        """All three: held, unharmed, flowers moved."""
        return self.held and self.unharmed and self.flowers_moved


def judge(
    cell: Cell,
    shake: tuple[float, float] | None,
    frequency: float,
    steady: tuple[float, float] | None = None,
) -> Verdict:
    """Judge what happened since the cell was built.

    Args:
        cell: after the trial.
        shake: begin and end of the shake on the cell's clock [s], None if it never shook.
        frequency: of the shake [Hz].
        steady: when it was what it was to become, of which the flowers' motion is told; None: all of it.
    """
    log = cell.log()
    shaking = (log.times >= shake[0]) & (log.times <= shake[1]) if shake else np.zeros(len(log.times), dtype=bool)
    holding = shaking if shake else _find_closed(log, shake)
    segment, share = _find_grasped(log, holding)
    organ, *beside = _organs(cell, log, holding, segment)
    slip, height = _slip(cell, log, shaking, segment)
    push, pull = _push(log, shake), string_pull(cell, log)
    poses = np.stack([cell.segment_poses(q) for q in log.qpos[shaking]]) if shake else None
    leaf = _leaf_acceleration(cell, log.times[shaking], poses)
    strains, *stalks = _strain(cell, log, shaking)
    harm = Harm(strains | {"leaf": leaf}, tolerances(cell.plant.species, cell.plant.seed), *stalks)
    dosed = slice(*np.searchsorted(log.times[shaking], steady or (-np.inf, np.inf)))
    amplitude, peak = _flower_motion(
        cell, log.times[shaking][dosed], None if poses is None else poses[dosed], frequency
    )
    effort = np.abs(log.torques / cell.arm.effort).max(axis=0)
    most_push = 2.0  # N that the robot may press on the plant before it closes
    most_slip = 0.005  # m that the held point may wander between the pads
    findings: list[tuple[bool, FailureKind, str]] = [
        (bool(np.any(log.contact_other == NEIGHBOUR)), "collision", "the robot touched another plant or its string"),
        (bool(np.any(log.contact_other < 0)), "collision", "the robot touched the pot or the bench"),
        (push > most_push, "collision", f"the plant was pushed with {push:.1f} N before the gripper closed"),
        (bool(effort.max() >= 0.999), "limits_exceeded", f"motor {effort.argmax()} was at its torque limit"),
        (pull > LETS_GO, "limits_exceeded", f"a string pulled with {pull:.1f} times what it hangs with"),
        (segment < 0, "nothing_grasped", "nothing was between the pads"),
        (organ != "stem", "branch_or_leaf_grasped", f"a {organ} was between the pads"),
        (shake is None, "nothing_grasped", "the plant was not shaken"),
        (not slip <= most_slip, "slipped", f"the stem slipped {1000 * slip:.1f} mm between the pads"),
        (share < 0.95, "slipped", f"the stem was held in {share:.0%} of the shake only"),
    ]
    failure: FailureKind | None = "damaged" if harm.passed else None
    reason = harm.words or f"the {organ} was held" + (f", with a {' and a '.join(beside)}" if beside else "")
    held = not any(found for found, _, _ in findings)
    for found, kind, why in reversed(findings):
        failure, reason = (kind, why) if found else (failure, reason)
    facts = (held, failure, reason, organ, height, slip, push, harm)
    return Verdict(*facts, amplitude, peak, float(effort.max()), tuple(beside))


def _find_closed(log: CellLog, shake: tuple[float, float] | None, time: float = 0.2) -> NDArray[np.bool_]:
    """(T,) whether the gripper was commanded below what it was when the arm last and when it next travelled.

    The arm travels with open pads, but how far they are open is the grasp's choice. It travels while a joint turns by
    0.01 rad in `time` [s]: on the way in by 0.02 to 0.06 rad. Shaking is no travelling.
    """
    rows, end = np.arange(len(log.times)), len(log.times) - 1
    ahead = np.searchsorted(log.times, log.times + time).clip(max=end)
    travels = np.abs(log.joints[ahead] - log.joints).max(axis=1) > 0.01
    if shake is not None:
        travels &= (log.times < shake[0] - time) | (log.times > shake[1])
    last = np.maximum.accumulate(np.where(travels, rows, 0))
    after = np.minimum.accumulate(np.where(travels, rows, end + 1)[::-1])[::-1]
    command = log.grip_command
    return command < np.minimum(command[last], command[np.where(after > end, last, after)]) - 1e-3


def _find_grasped(log: CellLog, when: NDArray[np.bool_]) -> tuple[int, float]:
    """Return the segment both pads press longest, -1 for none, and the share of samples in which both press any."""
    real = _find_pad_contacts(log, when)
    pads = [set(log.contact_sample[real & (log.contact_pad == pad)].tolist()) for pad in (0, 1)]
    both = pads[0] & pads[1]
    if not both:
        return -1, 0.0
    inside = real & np.isin(log.contact_sample, list(both))
    impulse = np.bincount(log.contact_other[inside], log.contact_force[inside])
    return int(np.argmax(impulse)), len(both) / max(int(when.sum()), 1)


def _find_pad_contacts(log: CellLog, when: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (C,) which contacts are a pad's with the plant, of 0.2 N or more, and at these (T,) times."""
    firm = (log.contact_pad < 2) & (log.contact_other >= 0) & (log.contact_force > 0.2)
    return firm & when[log.contact_sample]


def _organs(cell: Cell, log: CellLog, when: NDArray[np.bool_], segment: int) -> list[str]:
    """Return the name of the organ held, "" if none, and of those pressed between the pads beside it.

    What only leans on a pad's outer side or edge is not between them; nor is what is pressed in fewer than a fifth of
    the samples.
    """
    if segment < 0:
        return [""]
    pressed = np.flatnonzero(_find_pad_contacts(log, when))
    sample, other, blade = (x[pressed] for x in (log.contact_sample, log.contact_other, log.contact_blade))
    times, row = np.unique(sample, return_inverse=True)
    flange = inverse(cell.flange_pose(log.qpos[times]))[row]
    across = np.einsum("ci,ci->c", flange[:, 1, :3], log.contact_point[pressed]) + flange[:, 1, 3]
    across -= cell.carriage_at(log.qpos[times])[row]
    between = np.abs(across) < log.opening[sample] / 2 + 0.001
    organ = np.where(blade, int(Organ.LEAF), cell.plant.organ[other])
    impulse = np.bincount(organ[other == segment], log.contact_force[pressed][other == segment])
    held = int(impulse.argmax())
    rest = [o for o in np.unique(organ[between]).tolist() if o != held]
    beside = [o for o in rest if len(np.unique(sample[between & (organ == o)])) >= 0.2 * when.sum()]
    return [Organ(o).name.lower() for o in (held, *beside)]


def _slip(cell: Cell, log: CellLog, shaking: NDArray[np.bool_], segment: int) -> tuple[float, float]:
    """Return the largest wander of the held point between the pads [m] and its height above the soil at rest."""
    samples = np.flatnonzero(shaking)
    if segment < 0 or len(samples) == 0:
        return np.nan, np.nan
    near = (log.contact_other == segment) & (log.contact_pad < 2) & (log.contact_sample >= samples[0])
    touch = log.contact_point[near & (log.contact_sample <= samples[0] + 50)]
    T_first = cell.segment_poses(log.qpos[samples[0]])[segment]
    rest = inverse(T_first) @ np.r_[touch.mean(axis=0), 1] if len(touch) else np.r_[cell.plant.start[segment], 1]
    held = [inverse(cell.pads_pose(q)) @ cell.segment_poses(q)[segment] @ rest for q in log.qpos[samples]]
    wander = np.linalg.norm(np.array(held)[:, :3] - held[0][:3], axis=1)
    return float(wander.max()), float(rest[2] - cell.plant.pot.soil_z)


def string_pull(cell: Cell, log: CellLog) -> float:
    """Return the hardest pull of a string of the plant, as a share of what it hangs with [-]; 0 without a string."""
    most = 0.0
    for pose in map(cell.segment_poses, log.qpos[::10] if cell.plant.twines else ()):  # 20 ms: they sway at 0.8 Hz
        for twine in cell.plant.twines:
            T, at = pose[twine.segment], cell.plant.end[twine.segment]
            way = np.linalg.norm(twine.hook - (T[:3, :3] @ at + T[:3, 3])) - np.linalg.norm(twine.hook - at)
            most = max(most, 1 + twine.stiffness * float(way) / twine.tension)
    return most


def _push(log: CellLog, shake: tuple[float, float] | None) -> float:
    """Return the largest sum of the robot's forces on the plant while open, until it closes for the last time [N]."""
    closed = _find_closed(log, shake)
    begins = np.flatnonzero(closed & np.diff(closed, prepend=False))
    open_ = ~closed & (np.arange(len(closed)) < (begins[-1] if len(begins) else len(closed)))
    before = (log.contact_other >= 0) & open_[log.contact_sample]
    return float(np.bincount(log.contact_sample[before], log.contact_force[before], minlength=1).max())


def _strain(cell: Cell, log: CellLog, shaking: NDArray[np.bool_]) -> tuple[dict[str, float], Array, Array]:
    """Return the peak bending strain during the shake: all that is added in stem and branches, the swing elsewhere; and
    that of each flower's pedicel (F,) and peduncle (F,).

    Keys: those of `by_kind`. A petiole that the gripper holds aside is bent, which it survives; what counts there is
    how the shake swings it.
    """
    if not shaking.any():
        still = np.zeros(len(cell.plant.flower_segment))
        return {"stem": 0.0, "pedicel": 0.0, "base": 0.0}, still, still
    plant, pieces, qpos = cell.plant, cell.mechanics.pieces, log.qpos[shaking]
    bent = np.max([cell.mechanics.strain(q) for q in qpos], axis=0)
    swung = np.max([cell.mechanics.strain(q) for q in qpos - qpos.mean(axis=0)], axis=0)
    parts = by_kind(plant, pieces, swung) | {"stem": by_kind(plant, pieces, bent)["stem"]}
    stalks = of_flower_stalks(plant, pieces, swung)
    return {kind: float(strain.max(initial=0)) for kind, strain in parts.items()}, *stalks


def _leaf_acceleration(cell: Cell, times: Array, poses: Array | None) -> float:
    plant = cell.plant
    base = plant.leaf_bases()
    if poses is None or len(times) < 20 or len(base) == 0:
        return 0.0
    dt = float(np.median(np.diff(times)))
    path = transform_each(poses[:, base], plant.start[base])
    slow = sosfiltfilt(butter(2, LEAF_BAND, fs=1 / dt, output="sos"), _acceleration(path, dt), axis=0)
    return float(np.linalg.norm(slow, axis=2).max())


def _flower_motion(cell: Cell, times: Array, poses: Array | None, frequency: float) -> tuple[Array, Array]:
    """Return the amplitude of each flower's swing and the peak of its acceleration, each (F,)."""
    plant, own = cell.plant, cell.plant.on_first_string()
    segment, place = plant.flower_segment[own], plant.flower_position[own]
    if poses is None or len(times) < 20:
        return np.full(len(segment), np.nan), np.full(len(segment), np.nan)
    path = transform_each(poses[:, segment], place)
    steady = slice(round(0.2 * len(times)), round(0.8 * len(times)))
    dt = float(np.median(np.diff(times)))
    size = np.linalg.norm(_acceleration(path, dt), axis=2)
    every = max(int(1 / (dt * 16 * frequency)), 1)  # 16 samples a period are plenty
    t, paths = times[steady][::every], np.swapaxes(path[steady][::every], 0, 1)
    amplitude = np.array([fit_swing(t, x, frequency).amplitude for x in paths])
    return amplitude, usual_peak(size[steady], 1 / (dt * frequency))


def usual_peak(size: Array, period: float) -> Array:
    """Return (F,) the median over the periods of `period` samples of the largest of (T, F): one jolt makes no peak."""
    samples = min(max(round(period), 1), len(size))
    periods = len(size) // samples
    return np.median(size[: periods * samples].reshape(periods, samples, -1).max(axis=1), axis=0)


def _acceleration(path: Array, dt: float) -> Array:
    """Second differences (T - 2, ...) of a path (T, ...)."""
    return (path[2:] - 2 * path[1:-1] + path[:-2]) / dt**2
