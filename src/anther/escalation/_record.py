"""A watched shake for the record: what each look showed, and the plan as it was carried out.

F flowers, K tones, M members.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from anther.escalation._foresight import Foresight
from anther.escalation._knowledge import WORDS, Known, Look
from anther.execution import Step
from anther.geometry import Array
from anther.shake import ShakePlan
from anther.shake.observables import semi_major
from anther.shake.params import FLOWER_SPREAD


def shares(amplitudes: Array, told: Sequence[Known], limits: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return by kind the load of tones with these amplitudes [m] at once, over what the plant may bear."""
    each = [{k: a * one.loads[k] / may[k] for k in may} for a, one, may in zip(amplitudes, told, limits, strict=True)]
    return {kind: float(sum(one[kind] for one in each)) for kind in each[0]}


def noted(
    tones: Array,
    look: Look,
    told: Sequence[Known],
    loads: Mapping[str, float],
    when: tuple[float, float],
    decided: str,
    seconds: float,
) -> Step:
    """Return what a look showed and what was decided from it, for the record.

    Args:
        tones: (K,) of the foresight [Hz].
        look: what was seen.
        told: what is known of each of its tones.
        loads: see `shares`.
        when: its begin and end [s].
        decided: in words.
        seconds: that measuring and deciding took [s].
    """
    amplitudes = np.abs(look.commanded)
    felt = np.sqrt(sum((a * one.flowers) ** 2 for a, one in zip(amplitudes, told, strict=True)))
    return Step(
        *when,
        tuple(tones[look.tones].tolist()),
        tuple(amplitudes.tolist()),
        tuple(look.direction.tolist()),
        tuple(np.where(told[0].seen, felt, np.nan).tolist()),
        {WORDS[kind]: load for kind, load in loads.items()},
        decided,
        seconds,
    )


def carried_out(plan: ShakePlan, foresight: Foresight, steps: Sequence[Step]) -> ShakePlan:
    """Return a plan as it was carried out: the last step, and what the plant as believed would do in it."""
    last, tones = steps[-1], foresight.tones
    tone, amplitude = int(np.abs(tones - last.frequencies[0]).argmin()), last.amplitudes[0]
    direction = np.array(last.direction)
    members = foresight.of(tone, direction)[:, foresight.where["flowers"]]
    size = amplitude * semi_major(members)
    spread = np.quantile(np.log(np.maximum(size, 1e-12)), [0.05, 0.95], axis=0).T
    logs = np.log(np.maximum(size[0], 1e-12))[:, None]
    wide = np.exp(logs + [-1, 1] * np.hypot(spread - logs, 1.645 * FLOWER_SPREAD))
    omega2 = (2 * np.pi * tones[tone]) ** 2
    return replace(
        plan,
        direction=direction,
        frequency=float(tones[tone]),
        amplitude=amplitude,
        duration=last.end - last.begin,
        predicted_amplitude=size[0],
        predicted_amplitude_interval=wide,
        predicted_acceleration=omega2 * size[0],
        predicted_acceleration_interval=omega2 * wide,
        reason=f"{plan.reason} Watched on the way: {' '.join(step.decided for step in steps)}",
    )
