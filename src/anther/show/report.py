"""The report: one self-contained HTML file about a run, for a grower's engineer."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from anther.core.files import write_text
from anther.core.geometry import Array
from anther.history.fruit_set import worth
from anther.plant.limits import PEAKS, like_breeze
from anther.plant.model import LEARNED, Material
from anther.pollination.escalation import WORDS
from anther.pollination.grasp import OBSTACLE_CLEARANCE, STEM_CLEARANCE
from anther.pollination.shake import ShakePlan
from anther.pollination.shake.choice import PRESS
from anther.show.pictures.plant import draw_layers
from anther.show.pictures.report import draw_decision, draw_motion, draw_response_map, draw_steps, draw_views
from anther.show.results import FILM, RunResults, watched_words
from anther.show.run_scene import layers_of
from anther.show.style import NARROW, NOT_MEASURED, STYLE, quantity

SPREADS = {"youngs": "youngs_spread"} | {name: spread for name, spread in LEARNED.items() if name != "scanned_youngs"}
"""Attribute of `plant.Material` -> its spread."""

PALETTE = (
    "#2f7d4f", "#6fae7b", "#b7cf8b", "#e3c567", "#d98f4e", "#b3594a", "#8a5a83", "#5b6fa8", "#4f97a6", "#8fa39a",
    "#c4b59d", "#7a7a7a",
)  # fmt: skip


def write_report(path: Path, results: RunResults) -> None:
    """Write the report of a run to one HTML file that needs nothing else."""
    title = escape(f"Anther: {results.title}")
    parts = ((name, section(results)) for name, section in SECTIONS.items())
    sections = "".join(f"<section><h2>{escape(name)}</h2>{body}</section>" for name, body in parts if body)
    footer = "Lengths in metres unless marked; poses are x, y, z, qx, qy, qz, qw in the arm's base frame."
    write_text(
        path,
        f"<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>{title}</title><style>{STYLE}</style><main><h1>{title}</h1>"
        f"<p class=soft>{escape(results.subtitle)}</p>{_verdict(results)}{sections}"
        f"<footer>{footer}</footer></main></html>",
    )


def _image(draw: Callable[[bool], Figure], alt: str) -> str:
    """Return a figure as an embedded picture, drawn (narrow or not) for a desk's screen and for a phone's."""
    wide, narrow = (_embed(draw(on_phone), 2.0 if on_phone else 1.0) for on_phone in (False, True))
    media = f"<source media='(max-width:{NARROW}px)' srcset='{narrow}'>"
    return f"<picture>{media}<img alt='{escape(alt)}' src='{wide}'></picture>"


def _embed(figure: Figure, finer: float) -> str:
    """Return a figure as a PNG within an address, and free its memory."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110 * finer, bbox_inches="tight", pad_inches=0.05)
    figure.clear()
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _table(header: list[str], rows: list[list[str]], text_columns: int = 1, chosen: int | None = None) -> str:
    """Return rows of text, `chosen` marked; the first columns and "Why" or "Then" are aligned left, others right.

    On a phone each row is a card, whose values have their column's name beside them.
    """
    align = ["" if i < text_columns or name in ("Why", "Then") else " class=n" for i, name in enumerate(header)]
    head = "".join(f"<th{a}>{escape(h)}</th>" for a, h in zip(align, header, strict=True))
    body = "".join(
        f"<tr{' class=chosen' if i == chosen else ''}>"
        + "".join(
            f"<td{a}{f' data-name={chr(34)}{escape(h)}{chr(34)}' if h and i else ''}>{escape(c)}</td>"
            for i, (a, h, c) in enumerate(zip(align, header, row, strict=True))
        )
        + "</tr>"
        for i, row in enumerate(rows)
    )
    return f"<div class=wide><table class=cards><tr>{head}</tr>{body}</table></div>"


def _verdict(results: RunResults) -> str:
    if results.visit is None:
        return ""
    headline = results.headline[:1].upper() + results.headline[1:]
    why = results.visit.message or ""
    colour = {True: "yes", False: "no", None: "soft"}
    cells = "".join(
        f"<div class=answer><span>{escape(a.question)}</span><b class={colour[a.good]}>{escape(a.said)}</b>"
        f"<span>{escape(a.why)}</span></div>"
        for a in results.answers()
    )
    answers = f"<div class=answers>{cells}</div>" if cells else ""
    facts = "".join(f"<div><b>{escape(v)}</b><span>{escape(k)}</span></div>" for k, v in results.headline_facts())
    return (
        f"<section class='verdict {results.result}'><h2>{escape(headline)}</h2>"
        f"<p>{escape(why)}</p>{answers}<div class=facts>{facts}</div></section>"
    )


def _views(results: RunResults) -> str:
    if results.capture is None:
        return ""
    text = f"{results.capture.views} RGB-D views. "
    if results.masks is not None:
        text += f"Green: pixels taken for plant; magenta: flowers ({results.masks.source})."
    capture = results.capture
    picture = _image(lambda narrow: draw_views(capture, results.masks, narrow), "camera views with masks")
    return f"<p>{escape(text)}</p>{picture}"


def _plant(results: RunResults) -> str:
    if results.cloud is None:
        return ""
    parts = [f"{len(results.cloud.points):,} points"]
    if results.skeleton is not None:
        parts.append(f"a skeleton of {len(results.skeleton.nodes)} nodes")
    if results.stem is not None:
        sure = results.stem.confidence
        believed = "" if sure is None else f" (right with a probability of {sure:.0%})"
        parts.append(f"a main stem {results.stem.arc_length[-1]:.2f} m long{believed}")
    if results.flowers is not None:
        parts.append(f"{len(results.flowers.positions)} flowers")
    text = f"<p>{escape(', '.join(parts))}.</p>"
    stem = results.stem
    if results.skeleton is None or stem is None:
        return text
    layers = layers_of(results)
    alt = "cloud, skeleton, main stem, flowers, gripper and grasp"
    return text + _image(lambda narrow: draw_layers(layers, results.grasp, narrow=narrow), alt)


def _grasp(results: RunResults, most: int = 5) -> str:
    """Return the table of the best grasps, and of the one that was carried out."""
    if not results.grasps:
        return ""
    held = results.held_rank
    listed = [(rank, g) for rank, g in enumerate(results.grasps) if rank < most or rank == held]
    rows = [
        [
            f"{rank + 1}{' (carried out)' if rank == held else ''}",
            f"{g.arc_length:.3f} m",
            f"{1000 * g.stem_diameter:.1f} mm",
            f"{1000 * g.clearance:.0f} mm",
            "unknown" if g.confidence is None else f"{g.confidence:.0%}",
            " ".join(f"{x:.3f}" for x in g.pose7),
            g.reason,
        ]
        for rank, g in listed
    ]
    header = ["Rank", "Height along stem", "Stem diameter", "Clearance", "Confidence", "Flange pose", "Why"]
    text = "<p>Confidence is the probability that the main stem closes between the pads, whatever is beside it."
    meaning = (
        "Clearance is the least distance of the open gripper, on its way in, from anything. Where it is negative the "
        "gripper pushes leaves, petioles or flowers aside, so deep at most; they give way, and the rank pays for them. "
        f"From the stem it keeps {1e3 * STEM_CLEARANCE:.0f} mm, from pot and bench {1e3 * OBSTACLE_CLEARANCE:.0f} mm."
    )
    if any(g.clearance < 0 for _, g in listed):
        text += f" {meaning}"
    text += f"</p>{_list(results.attempts)}"
    return f"{text}{_table(header, rows, chosen=None if held is None else min(held, most))}"


def _shake(results: RunResults) -> str:
    shake, executed = results.shake, results.executed
    if shake is None:
        return ""
    both = [("Planned", shake)] + ([("Executed", executed)] if executed is not None else [])
    compared: tuple[tuple[str, Callable[[ShakePlan], str]], ...] = (
        ("Grip height along the stem", lambda plan: f"{100 * plan.grasp.arc_length:.0f} cm"),
        ("Amplitude of the grip", lambda plan: quantity(plan.amplitude, "m")),
        ("Frequency", lambda plan: quantity(plan.frequency, "Hz")),
        ("Direction", lambda plan: " ".join(f"{x:+.2f}" for x in plan.direction)),
        ("Force of the pads", lambda plan: quantity(plan.press, "N")),
        ("Median flower, predicted", lambda plan: quantity(float(np.median(plan.predicted_acceleration)), "m/s2")),
    )
    rows = [[name, *(told(plan) for _, plan in both)] for name, told in compared]
    if executed is not None and results.trial is not None and len(results.trial.shake_times):
        lasted = float(np.ptp(results.trial.shake_times))
        rows.append(["Duration", quantity(shake.duration, "s"), quantity(lasted, "s")])
    text = _table(["", *(name for name, _ in both)], rows) + f"<p>{escape(f'The plan. {shake.reason}')}</p>"
    alt = "flower response over grip height and frequency"
    picture = _image(lambda narrow: draw_response_map(shake, executed, narrow), alt)
    if shake.weighed is not None:
        words = "what the shake is worth by its amplitude: pollen freed, flowers lost, organs bent"
        picture += "<h2 style='margin-top:16px'>What it is worth</h2>"
        picture += _image(lambda narrow: draw_decision(shake, executed, narrow), words)
    header = ["Limit", "Planned", "Executed", "Allowed", "Allowed is as in a breeze of", "Used by the plan"]
    heading = "<h2 style='margin-top:16px'>How close each limit is</h2>"
    return f"{text}{picture}{heading}{_table(header, _limits(results, shake))}"


def _limits(results: RunResults, shake: ShakePlan) -> list[list[str]]:
    """Return a row for each limit: what was planned, what was done as far as that is known, and what is allowed."""
    done, reached = results.executed, dict[str, float]()
    if done is not None:
        reached |= {
            "grip amplitude [m]": done.amplitude,
            "grip speed [m/s]": 2 * np.pi * done.frequency * done.amplitude,
        }
    steps = () if results.trial is None else results.trial.steps
    names = {WORDS[kind]: name for kind, name in (PEAKS | {"grip_force": PRESS}).items()}
    allowed = {name: limit for name, _, limit, _ in shake.limits}
    for words, share in steps[-1].loads.items() if steps else ():
        if names.get(words) in allowed:
            reached[names[words]] = share * allowed[names[words]]
    rows = []
    for name, planned, limit, share in shake.limits:
        label, unit = name.removesuffix("]").split(" [")
        unit = "-" if unit.startswith("share") else unit
        breeze = like_breeze(name, limit, results.crop)
        done_ = quantity(reached[name], unit) if name in reached else ""
        rows.append([label, quantity(planned, unit), done_, quantity(limit, unit), breeze, f"{100 * share:.0f} %"])
    return rows


def _steps(results: RunResults) -> str:
    """Return how a watched shake was raised, or why the plan alone was carried out."""
    if results.visit is None or not results.visit.shaken:
        return ""
    text = f"<p>Watched: {escape(watched_words(results.visit))}</p>"
    if results.trial is None or not results.trial.steps:
        return text
    steps, start = results.trial.steps, float(results.trial.shake_times[0])
    alt = "commanded, measured and allowed, step by step"
    picture = _image(lambda narrow: draw_steps(steps, start, narrow), alt)
    rows = [
        [
            f"{step.begin - start:.1f} to {step.end - start:.1f} s",
            ", ".join(
                f"{1e3 * a:.2f} mm at {f:.3g} Hz" for a, f in zip(step.amplitudes, step.frequencies, strict=True)
            ),
            quantity(step.median, "m/s2"),
            f"{np.isfinite(step.flowers).sum()} of {len(step.flowers)}",
            f"{step.used:.0%}, {step.binds}",
            f"{step.seconds:.2f} s",
            step.decided,
        ]
        for step in steps
    ]
    header = ["When", "Commanded", "Flowers (median)", "Flowers measured", "Closest limit", "Deciding took", "Then"]
    return text + picture + _table(header, rows, text_columns=2)


def _motion(results: RunResults) -> str:
    shake, response = results.shaken, results.response
    if shake is None or response is None:
        return ""
    picture = _image(lambda narrow: draw_motion(shake, response, narrow), "predicted and measured flower motion")
    steps = () if results.trial is None else results.trial.steps
    measured = response.flower_acceleration(steps)
    rows = [
        [
            f"Flower {i + 1}",
            f"{quantity(shake.predicted_amplitude[i], 'm')} ({1e3 * low:.2f} to {1e3 * high:.2f})",
            amplitude,
            quantity(shake.predicted_acceleration[i], "m/s2"),
            acceleration,
        ]
        for i, ((low, high), (amplitude, acceleration)) in enumerate(
            zip(shake.predicted_amplitude_interval, _measured_rows(results, measured), strict=True)
        )
    ]
    low, high = shake.predicted_amplitude_interval.T
    held = response.visible & (response.amplitude >= low) & (response.amplitude < high)
    felt = np.where(np.isfinite(measured), measured, shake.predicted_acceleration)
    text = f"<p>{held.sum()} of {response.visible.sum()} measured amplitudes lie within the predicted interval.</p>"
    text += f"<p>{escape(worth(felt, results.crop or ''))}</p>"
    text += _medians(results, measured)
    header = ["", "Predicted (nine in ten)", "Measured", "Predicted acceleration", "Measured acceleration"]
    return text + picture + _film(results) + _table(header, rows)


def _film(results: RunResults) -> str:
    film = results.folder / FILM
    if not film.is_file():
        return ""
    data = base64.b64encode(film.read_bytes()).decode()
    alt = "the end of the shake, at half its speed"
    return f"<p><img class=film alt='{alt}' src='data:image/{film.suffix[1:]};base64,{data}'></p>"


def _medians(results: RunResults, measured: Array) -> str:
    """Return the median flower as predicted, measured and, in simulation, as it truly moved; and why these differ."""
    shake, truth = results.shaken, results.visit and results.visit.truth
    assert shake is not None
    seen = measured[np.isfinite(measured)]
    cells = {"Predicted": quantity(float(np.median(shake.predicted_acceleration)), "m/s2")}
    of = f"Measured ({len(seen)} of {len(measured)} flowers)"
    cells[of] = quantity(float(np.median(seen)), "m/s2") if len(seen) else NOT_MEASURED
    why = ""
    if truth and truth.true_flower_acceleration_median is not None:
        cells["True (simulated; all flowers)"] = quantity(truth.true_flower_acceleration_median, "m/s2")
        why = f"<p class=soft>{MEASURED_AND_TRUE}</p>"
    return _table(["Median flower", *cells], [["peak acceleration", *cells.values()]]) + why


MEASURED_AND_TRUE = (
    "Measured is what the side camera tells: the motion across its line of sight, of the flowers that it followed, at "
    "the shake's frequency. True is what the simulator moved: in all three directions, with all overtones, all "
    "flowers. What comes towards the camera, overtones and hidden flowers are in the second alone, which is mostly "
    "the larger one."
)


def _measured_rows(results: RunResults, felt: Array) -> Iterator[tuple[str, str]]:
    """Yield each flower's measured amplitude and acceleration (F,) [m/s2] in words, from one and the same source.

    A flower that was lost after the last step has what that step says; of a single frequency, its amplitude follows.
    """
    response, shake = results.response, results.shaken
    assert response is not None
    assert shake is not None
    squared = (2 * np.pi * shake.frequency) ** 2
    steps = () if results.trial is None else results.trial.steps
    alone = bool(steps) and len(steps[-1].frequencies) == 1
    for i, acceleration in enumerate(felt.tolist()):
        if response.visible[i]:
            amplitude = f"{quantity(response.amplitude[i], 'm')} ± {1e3 * response.amplitude_std[i]:.2f}"
            yield amplitude, quantity(acceleration, "m/s2")
        elif acceleration > 0:
            size = f"{quantity(acceleration / squared, 'm')} (last step)" if alone else "see acceleration"
            yield size, f"{quantity(acceleration, 'm/s2')} (last step)"
        else:
            most = float(response.at_most[i])
            at_most = (quantity(most, "m"), quantity(squared * most, "m/s2"))
            yield tuple(f"less than {x}" if np.isfinite(most) else x for x in at_most)  # type: ignore[misc]


def _learned(results: RunResults) -> str:
    """Return what was believed of the plant before and after the shake, each with nine in ten."""
    visit = results.visit
    if visit is None or visit.believed is None or visit.material is None:
        return ""
    if visit.material == visit.believed:
        return "<p>Nothing: no flower's motion could be measured, or the shake had no one frequency.</p>"
    # Name, attribute of `plant.Material`, factor to the shown unit, unit
    learned = (
        ("Young's modulus of the stem", "youngs", 1e-6, "MPa"),
        ("Damping ratio", "damping_ratio", 1.0, ""),
        ("Bending over twisting stiffness", "bend_over_twist", 1.0, ""),
        ("True over scanned radius", "radius_scale", 1.0, ""),
        ("Flower motion over the model's, with all of the above", "response_gain", 1.0, ""),
    )
    rows = [
        [name, *(_belief(m, attribute, factor, unit) for m in (visit.believed, visit.material))]
        for name, attribute, factor, unit in learned
    ]
    why = visit.material_reason or ""
    text = f"<p>Believed before: {escape(why)}. The next shake of this plant begins with what is believed after.</p>"
    return text + _table(["Quantity", "Before (nine in ten)", "After (nine in ten)"], rows)


def _belief(material: Material, attribute: str, factor: float, unit: str) -> str:
    middle, spread = factor * getattr(material, attribute), getattr(material, SPREADS[attribute])
    low, high = (middle * np.exp(sign * 1.645 * spread) for sign in (-1, 1))
    return f"{middle:.3g} ({low:.3g} to {high:.3g}) {unit}".strip()


def _notes(results: RunResults) -> str:
    return _list(results.notes())


def _cell(results: RunResults) -> str:
    """Return what was supposed of a cell file's machines where these were simulated."""
    lines = () if results.visit is None else results.visit.simulated_as
    cell = Path(str(results.params.get("cell", ""))).name
    head = f"As {cell} says, with its {results.arm}. What the file lacks is supposed, and told here."
    return f"<p>{escape(head)}</p>{_list(lines)}" if lines else ""


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>" if lines else ""


def _timing(results: RunResults) -> str:
    """Return a bar of the stages' times, and a table of them; with processor time and memory where these are known."""
    seconds = results.seconds
    total = sum(seconds.values())
    if not total:
        return ""
    colour = dict(zip(seconds, PALETTE * 2, strict=False))
    bar = "".join(f"<i style='width:{100 * s / total:.2f}%;background:{colour[k]}'></i>" for k, s in seconds.items())
    more = {name: values for name in COSTS if (values := getattr(results, name))}
    sums = [quantity(COSTS[name][2](values.values()), COSTS[name][1]) for name, values in more.items()]
    rows = [
        [k, f"{s:.1f} s", f"{100 * s / total:.0f} %"]
        + [quantity(values[k], COSTS[name][1]) if k in values else "" for name, values in more.items()]
        for k, s in seconds.items()
    ]
    table = _table(
        ["Stage", "Time", "Share", *(COSTS[n][0] for n in more)], [*rows, ["total", f"{total:.1f} s", "", *sums]]
    )
    for k in seconds:
        table = table.replace(
            f"<td>{escape(k)}</td>", f"<td><span class=key style='background:{colour[k]}'></span>{escape(k)}</td>"
        )
    return f"<div class=bar>{bar}</div>{table}"


COSTS = {"cpu_seconds": ("Processor time", "s", sum), "peak_mb": ("Most memory", "MB", max)}
"""Costs in timing.json -> heading, unit, and how stages make the whole."""


def _parameters(results: RunResults) -> str:
    rows = [[name, str(value)] for name, value in _flat(results.params)]
    if not rows:
        return ""
    return f"<details><summary>{len(rows)} values</summary>{_table(['Parameter', 'Value'], rows, 2)}</details>"


def _flat(values: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, value) of nested parameters."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


SECTIONS = {
    "What the camera saw": _views,
    "The plant in 3-D": _plant,
    "The grasp": _grasp,
    "The shake": _shake,
    "The shake, step by step": _steps,
    "How the flowers moved": _motion,
    "What was learned": _learned,
    "The cell that was simulated": _cell,
    "What to know": _notes,
    "Where the time went": _timing,
    "Parameters": _parameters,
}
"""Heading -> what is written below it; nothing of stages that were not reached."""
