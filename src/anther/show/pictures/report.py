"""The report's figures: views, response map, motion, the shake step by step. Narrow ones are for a phone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from anther.core.opencv import cv2
from anther.perception.capture import Capture
from anther.perception.masks import FLOWER, PLANT, Masks
from anther.pollination.execution import Step
from anther.pollination.response import Response
from anther.pollination.shake import ShakePlan
from anther.show.style import GREEN, INK, MAGENTA, ORANGE

mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "figure.facecolor": "white"})

NARROW = 3.6
"""Width of a figure for a phone [inches]."""


def draw_views(capture: Capture, masks: Masks | None, narrow: bool = False) -> Figure:
    """Return a contact sheet of eight views, evenly picked, with the mask outlined."""
    chosen = np.unique(np.linspace(0, capture.views - 1, 8).round().astype(int))
    columns, width = (2, NARROW) if narrow else (4, 11)
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(width, 0.61 * width / columns * rows))
    dark = {"facecolor": "black", "alpha": 0.5, "pad": 1.5, "lw": 0}
    for place, view in enumerate(chosen):
        axes = figure.add_axes(
            (place % columns / columns + 0.003, 1 - (place // columns + 1) / rows + 0.006, 0.976 / columns, 0.98 / rows)
        )
        axes.imshow(overlay(capture, masks, int(view)))
        axes.set_axis_off()
        axes.text(0.02, 0.04, f"{view}", transform=axes.transAxes, color="white", fontsize=8, bbox=dark)
    return figure


def overlay(capture: Capture, masks: Masks | None, view: int) -> NDArray[Any]:
    """Return one view, smaller and upright, the plant's outline in green and flowers in magenta."""
    size = (capture.intrinsics.width // 3, capture.intrinsics.height // 3)
    picture = capture.rgb[view] if capture.rgb is not None else _depth_colours(capture.depth[view])
    picture = cv2.resize(np.ascontiguousarray(picture), size, interpolation=cv2.INTER_AREA)
    up = capture.T_world_cam[view, 2, :2]  # of the world, in the image: to the right and down
    turns = round(float(np.arctan2(up[0], -up[1])) / (np.pi / 2))  # quarters from the image's own up, clockwise
    if masks is None:
        return np.rot90(picture, turns)
    labels = cv2.resize(np.ascontiguousarray(masks.labels[view]), size, interpolation=cv2.INTER_NEAREST)
    for label, colour in ((PLANT, (60, 230, 110)), (FLOWER, (255, 60, 220))):
        outline, _ = cv2.findContours((labels == label).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outline, -1, colour, 1)
    return np.rot90(picture, turns)


def _depth_colours(depth: NDArray[Any]) -> NDArray[Any]:
    """Colour a depth image, near is bright; black where there is no reading."""
    read = depth > 0
    if not read.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(depth[read], [2, 98])
    shade = np.clip((far - depth) / max(far - near, 1e-6), 0, 1)
    colours = (mpl.colormaps["viridis"](shade)[..., :3] * 255).astype(np.uint8)
    colours[~read] = 0
    return colours


def draw_response_map(shake: ShakePlan, executed: ShakePlan | None = None, narrow: bool = False) -> Figure:
    """Draw mean flower acceleration over grip height and frequency, with the planned and the executed shake marked."""
    figure = Figure(figsize=(NARROW, 4.2) if narrow else (10, 3.9), layout="constrained")
    _draw_response_map(figure, figure.subplots(), shake, executed, narrow)
    return figure


def _draw_response_map(
    figure: Figure, axes: Any, shake: ShakePlan, executed: ShakePlan | None = None, narrow: bool = False
) -> None:
    """Draw the response map into axes, with its colours beside it, or below."""
    response = shake.response_map
    allowed = np.where(response.acceleration > 0, response.acceleration, np.nan)
    axes.set_facecolor("#d9dedb")
    mesh = axes.pcolormesh(response.frequencies, 100 * response.arc_length, allowed, shading="nearest", cmap="viridis")
    marked = [("planned", shake, "o")] + ([("executed", executed, "x")] if executed is not None else [])
    for name, one, mark in marked:
        at = (one.frequency, 100 * one.grasp.arc_length)
        axes.plot(*at, mark, mfc="none", color="black", ms=12, mew=4)
        axes.plot(*at, mark, mfc="none", color="white", ms=11, mew=2, label=name)
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, facecolor="#777777", labelcolor="white")
    axes.set(xscale="log", xlabel="frequency [Hz]", ylabel="grip height along the stem [cm]")
    ticks = [f for f in (1, 2, 3, 5, 10, 20, 30, 50) if response.frequencies[0] <= f <= response.frequencies[-1]]
    axes.set_xticks(ticks, [str(f) for f in ticks])
    axes.minorticks_off()
    label = "mean flower acceleration\nat the largest allowed shake [m/s²]"
    figure.colorbar(mesh, ax=axes, label=label, location="bottom" if narrow else "right")
    words = "grey: no shake that is allowed\nand large enough to be trusted" if narrow else GREY
    axes.set_title(words, fontsize=9, loc="left", pad=26 if narrow else 6)


GREY = "grey: no shake that is allowed and large enough to be trusted"


def draw_motion(shake: ShakePlan, response: Response, narrow: bool = False) -> Figure:
    """Return the best-seen flower's track and, per flower, predicted against measured amplitude."""
    figure = Figure(figsize=(NARROW, 5.2) if narrow else (11, 3.4), layout="constrained")
    left, right = figure.subplots(2, 1) if narrow else figure.subplots(1, 2, width_ratios=[3, 2])
    _draw_track(left, shake, response)
    draw_amplitudes(right, shake, response)
    return figure


def draw_amplitudes(axes: Any, shake: ShakePlan, response: Response) -> None:
    """Draw predicted amplitude with its interval, and measured amplitude with its deviation or its bound."""
    index = np.arange(len(shake.predicted_amplitude))
    low, high = 1000 * shake.predicted_amplitude_interval.T
    middle = 1000 * shake.predicted_amplitude
    span = [np.maximum(middle - low, 0), np.maximum(high - middle, 0)]
    axes.bar(index - 0.2, middle, 0.38, color=GREEN, label="predicted")
    axes.errorbar(index - 0.2, middle, span, fmt="none", ecolor=INK, capsize=3, lw=1)
    found, error, bound = (1000 * x for x in (response.amplitude, response.amplitude_std, response.at_most))
    axes.bar(index + 0.2, np.nan_to_num(found), 0.38, color=ORANGE, label="measured")
    axes.errorbar(index + 0.2, found, error, fmt="none", ecolor=INK, capsize=3, lw=1)
    if np.isfinite(bound).any():
        axes.plot(index + 0.2, bound, "v", mfc="none", color=ORANGE, label="moved less than this")
    axes.set(xlabel="flower", ylabel="amplitude [mm]", xticks=index, xticklabels=[str(i + 1) for i in index])
    axes.tick_params(axis="x", labelsize=9 if len(index) <= 12 else 6)  # numbers of two digits touch on a phone
    axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)


def _draw_track(axes: Any, shake: ShakePlan, response: Response) -> None:
    """Draw the surest flower's displacement along the axis seen most clearly, without the plant's slow sway."""
    if not response.visible.any():
        axes.text(0.5, 0.5, "no flower could be measured", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    flower = int(np.nanargmax(response.amplitude / response.amplitude_std))
    good = np.isfinite(response.tracks[:, flower]).all(axis=1)
    period = max(round(1 / (shake.frequency * float(np.median(np.diff(response.times))))), 2)
    track = response.tracks[good, flower]
    track = track - uniform_filter1d(track, period, axis=0, mode="nearest")
    times = response.times[good] - response.times[good][0]
    swing = np.abs(np.exp(2j * np.pi * shake.frequency * times) @ track)
    clearest = int(np.argmax(swing / np.maximum(track.std(axis=0), 1e-9)))
    axes.plot(times, 1000 * track[:, clearest], ".-", color=ORANGE, lw=1, ms=4)
    for sign in (-1, 1):
        axes.axhline(sign * 1000 * shake.predicted_amplitude[flower], color=GREEN, ls="--", lw=1.2)
    axes.set(xlabel="time [s]", ylabel=f"displacement along {'xyz'[clearest]} [mm]")
    axes.set_title(f"flower {flower + 1} without slow sway: measured (dots),\npredicted amplitude (dashed)", fontsize=9)


def draw_plan(plan: ShakePlan) -> Figure:
    """Return a figure of four panels."""
    figure = Figure(figsize=(13, 7.2), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(1.1, 1.1, 0.8))
    _draw_response_map(figure, figure.add_subplot(grid[0, :]), plan)
    _draw_weighed(figure.add_subplot(grid[1, 0]), plan)
    _draw_flowers(figure.add_subplot(grid[1, 1]), plan)
    _draw_limits(figure.add_subplot(grid[1, 2]), plan)
    shake = f"{1e3 * plan.amplitude:.2g} mm at {plan.frequency:.3g} Hz, {plan.duration:.2g} s"
    figure.suptitle(f"{shake}, held {100 * plan.grasp.arc_length:.0f} cm up the stem", x=0.01, ha="left")
    return figure


def draw_decision(planned: ShakePlan, executed: ShakePlan | None, narrow: bool = False) -> Figure:
    """Return what the planned shake is worth by its amplitude and, of one that was watched, what it was in the end."""
    shown = [plan for plan in (planned, executed) if plan is not None and plan.weighed is not None]
    size = (NARROW, 3.0 * len(shown)) if narrow else (5.2 * len(shown), 3.2)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(*((len(shown), 1) if narrow else (1, len(shown))), squeeze=False).ravel()
    for axes, plan in zip(panels, shown, strict=True):
        _draw_weighed(axes, plan)
        axes.set_title("as planned" if plan is planned else "after the last look", loc="left", fontsize=9)
    return figure


def _draw_weighed(axes: Any, plan: ShakePlan) -> None:
    """Draw gain, loss and worth over the amplitude, and what was taken."""
    one = plan.weighed
    if one is None:
        axes.set_axis_off()
        return
    size = 1e3 * one.amplitude
    axes.fill_between(size, *one.interval.T, color=GREEN, alpha=0.2, lw=0, label="worth, nine members in ten")
    axes.plot(size, one.net, color=GREEN, lw=2, label="worth")
    axes.plot(size, one.gain, color=ORANGE, lw=1, label="pollen freed")
    axes.plot(size, one.lost, color=MAGENTA, lw=1, label="flowers lost")
    axes.plot(size, one.others, color=MAGENTA, lw=1, ls="--", label="organs bent, slip")
    axes.axvline(1e3 * plan.amplitude, color=INK, lw=1, ls=":")
    top = 1.9 * max(float(one.gain.max()), 0.1)  # with room for the legend
    axes.set(xlabel="amplitude of the grip [mm]", ylabel="share of the flowers", xlim=(0, None), ylim=(-0.2 * top, top))
    axes.legend(frameon=False, fontsize=7, loc="upper left", ncols=2)


def _draw_limits(axes: Any, plan: ShakePlan) -> None:
    names = [name.split(" [")[0] for name, *_ in plan.limits][::-1]
    shares = [100 * share for *_, share in plan.limits][::-1]
    axes.barh(names, shares, color=[MAGENTA if share > 90 else GREEN for share in shares])
    axes.axvline(100, color=INK, lw=1)
    axes.set(xlabel="used of what is allowed [%]", xlim=(0, 108))


def _draw_flowers(axes: Any, plan: ShakePlan) -> None:
    order = np.argsort(-plan.predicted_acceleration)
    middle, span = plan.predicted_acceleration[order], plan.predicted_acceleration_interval[order]
    error = np.abs(span.T - middle)
    index = np.arange(len(middle))
    axes.errorbar(index, middle, error, fmt="o", color=GREEN, ecolor=INK, capsize=3, lw=1)
    axes.set(xlabel="flower, by its acceleration", ylabel="predicted peak\nacceleration [m/s²]", ylim=(0, None))
    axes.set_xticks(index, [str(k + 1) for k in order], fontsize=9 if len(order) <= 12 else 6)


def draw_steps(steps: Sequence[Step], start: float, narrow: bool = False) -> Figure:
    """Return a figure of three panels over time: amplitude of each tone, flowers, share of each limit that was closest.

    The shake began at `start` [s], on the clock of the steps.
    """
    figure = Figure(figsize=(NARROW, 6.8) if narrow else (10, 5.4), layout="constrained")
    tones, flowers, limits = figure.subplots(3, 1, sharex=True)
    _draw_tones(tones, steps, start)
    middle = [(step.begin + step.end) / 2 - start for step in steps]
    most = [max((a for a in step.flowers if np.isfinite(a)), default=np.nan) for step in steps]
    flowers.plot(middle, most, "^-", color=MAGENTA, lw=1, label="most")
    flowers.plot(middle, [step.median for step in steps], "o-", color=ORANGE, label="median")
    flowers.set(ylabel="flowers\n[m/s²]", ylim=(0, None))
    _draw_use(limits, steps, start)
    limits.set(xlabel="time since the shake began [s]", xlim=(0, None))
    for axes in (tones, flowers, limits):
        beside: Any = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
        longest = max(len(str(label)) for label in axes.get_legend_handles_labels()[1])
        columns = 1 if longest > 14 else 2  # letters beside each other on a phone
        above: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": columns, "columnspacing": 1.0}
        axes.legend(frameon=False, **(above if narrow else beside))
    return figure


def _draw_tones(axes: Any, steps: Sequence[Step], start: float) -> None:
    """Draw each tone's amplitude: thick where the pads were steady, thin where it changed."""
    frequencies = sorted({f for step in steps for f in step.frequencies})
    colours = mpl.colormaps["viridis"](np.linspace(0, 0.85, len(frequencies)))
    times = [0.0, *(t - start for step in steps for t in (step.begin, step.end))]
    for frequency, colour in zip(frequencies, colours, strict=True):
        each = [1e3 * dict(zip(step.frequencies, step.amplitudes, strict=True)).get(frequency, 0.0) for step in steps]
        sizes = np.array([0.0, *np.repeat(each, 2)])
        moves = np.convolve(sizes > 0, np.ones(3), "same") > 0  # no line along the axis while it rests
        axes.plot(times, np.where(moves, sizes, np.nan), color=colour, lw=1, label=f"{frequency:.3g} Hz")
        for k in np.flatnonzero(each):
            axes.plot(times[2 * k + 1 : 2 * k + 3], [each[k]] * 2, color=colour, lw=4, solid_capstyle="butt")
    axes.set(ylabel="commanded\n[mm]", ylim=(0, None))


def _draw_use(axes: Any, steps: Sequence[Step], start: float) -> None:
    """Draw for each step how much of the closest limit was used; the colour says which it is."""
    names = list(dict.fromkeys(step.binds for step in steps))
    for name, colour in zip(names, mpl.colormaps["Set2"].colors * len(names), strict=False):  # type: ignore[attr-defined]
        near = [step for step in steps if step.binds == name]
        begins, spans = [step.begin - start for step in near], [step.end - step.begin for step in near]
        axes.bar(begins, [100 * step.used for step in near], spans, align="edge", color=colour, label=name or "none")
    axes.axhline(100, color=INK, lw=1)
    axes.set(ylabel="of the closest\nlimit [%]", ylim=(0, None))
