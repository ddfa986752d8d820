"""The report: one self-contained HTML file about a run, for a grower's engineer."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from anther.core.files import write_text
from anther.core.geometry import Array
from anther.history.fruit_set import worth
from anther.plant.limits import like_breeze
from anther.plant.model import LEARNED, Material
from anther.pollination.response import Response
from anther.show.pictures.plant import draw_plant
from anther.show.pictures.report import draw_motion, draw_response_map, draw_steps, draw_views
from anther.show.results import FILM, RunResults, watched_words
from anther.show.style import STYLE

SPREADS = {"youngs": "youngs_spread"} | {name: spread for name, spread in LEARNED.items() if name != "scanned_youngs"}
"""Attribute of `plant.Material` -> its spread."""

PALETTE = (
    "#2f7d4f", "#6fae7b", "#b7cf8b", "#e3c567", "#d98f4e", "#b3594a", "#8a5a83", "#5b6fa8", "#4f97a6", "#8fa39a",
    "#c4b59d", "#7a7a7a",
)  # fmt: skip


SHOWN = 5
"""Grasps that are listed, besides the one that was carried out."""


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


def _image(figure: Figure, alt: str) -> str:
    """Return a figure as an embedded PNG, and free its memory."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    figure.clear()
    return f"<img alt='{escape(alt)}' src='data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}'>"


def _table(header: list[str], rows: list[list[str]], text_columns: int = 1, chosen: int | None = None) -> str:
    """Return rows of text, `chosen` marked; the first columns and "Why" or "Then" are aligned left, others right."""
    align = ["" if i < text_columns or name in ("Why", "Then") else " class=n" for i, name in enumerate(header)]
    head = "".join(f"<th{a}>{escape(h)}</th>" for a, h in zip(align, header, strict=True))
    body = "".join(
        f"<tr{' class=chosen' if i == chosen else ''}>"
        + "".join(f"<td{a}>{escape(c)}</td>" for a, c in zip(align, row, strict=True))
        + "</tr>"
        for i, row in enumerate(rows)
    )
    least = 110 * len(header)  # px; narrower screens scroll the table, not the page
    return f"<div class=wide><table style='min-width:{least}px'><tr>{head}</tr>{body}</table></div>"


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
    picture = _image(draw_views(results.capture, results.masks), "camera views with masks")
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
    if results.skeleton is None or results.stem is None:
        return text
    grasp = results.shake.grasp if results.shake is not None else next(iter(results.grasps), None)
    figure = draw_plant(results.cloud, results.skeleton, results.stem, grasp, flowers=results.flowers)
    return text + _image(figure, "cloud, skeleton, main stem and grasp")


def _grasp(results: RunResults) -> str:
    if not results.grasps:
        return ""
    held = None if results.shaken is None else results.shaken.grasp_index
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
        for rank, g in enumerate(results.grasps)
        if rank < SHOWN or rank == held
    ]
    header = ["Rank", "Height along stem", "Stem diameter", "Clearance", "Confidence", "Flange pose", "Why"]
    return _table(header, rows, chosen=None if held is None else min(held, SHOWN))


def _shake(results: RunResults) -> str:
    shake = results.shake
    if shake is None:
        return ""
    limits = [
        [name, f"{value:.3g}", f"{limit:.3g}", like_breeze(name, limit, results.crop), f"{100 * share:.0f} %"]
        for name, value, limit, share in shake.limits
    ]
    picture = _image(draw_response_map(shake), "flower response over grip height and frequency")
    header = ["Limit", "Planned", "Allowed", "Allowed is as in a breeze of", "Used"]
    heading = "<h2 style='margin-top:16px'>How close each limit is</h2>"
    return f"<p>{escape(shake.reason)}</p>{picture}{heading}{_table(header, limits)}"


def _steps(results: RunResults) -> str:
    """Return how a watched shake was raised, or why the plan alone was carried out."""
    if results.visit is None or not results.visit.shaken:
        return ""
    text = f"<p>Watched: {escape(watched_words(results.visit))}</p>"
    if results.trial is None or not results.trial.steps:
        return text
    steps, start = results.trial.steps, float(results.trial.shake_times[0])
    target = results.params.get("params", {}).get("escalation", {}).get("target")
    picture = _image(draw_steps(steps, start, target), "commanded, measured and allowed, step by step")
    rows = [
        [
            f"{step.begin - start:.1f} to {step.end - start:.1f} s",
            ", ".join(
                f"{1e3 * a:.2f} mm at {f:.3g} Hz" for a, f in zip(step.amplitudes, step.frequencies, strict=True)
            ),
            _number(step.median),
            f"{np.isfinite(step.flowers).sum()} of {len(step.flowers)}",
            f"{step.used:.0%} {step.binds}",
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
    picture = _image(draw_motion(shake, response), "predicted and measured flower motion")
    measured = response.felt(results.trial.steps if results.trial else ())
    rows = [
        [
            f"Flower {i + 1}",
            f"{_milli(shake.predicted_amplitude[i])} ({1e3 * low:.2f} to {1e3 * high:.2f})",
            _measured(response, i),
            _number(shake.predicted_acceleration[i]),
            _number(measured[i]),
        ]
        for i, (low, high) in enumerate(shake.predicted_amplitude_interval)
    ]
    low, high = shake.predicted_amplitude_interval.T
    held = response.visible & (response.amplitude >= low) & (response.amplitude < high)
    felt = np.where(np.isfinite(measured), measured, shake.predicted_acceleration)
    text = f"<p>{held.sum()} of {response.visible.sum()} measured amplitudes lie within the predicted interval.</p>"
    text += f"<p>{escape(worth(felt, results.crop or ''))}</p>"
    text += _beside(results, measured)
    header = ["", "Predicted (nine in ten)", "Measured", "Predicted acceleration", "Measured acceleration"]
    film = results.folder / FILM
    if film.is_file():
        told = base64.b64encode(film.read_bytes()).decode()
        alt = "the end of the shake, at half its speed"
        picture += f"<p><img class=film alt='{alt}' src='data:image/gif;base64,{told}'></p>"
    return text + picture + _table(header, rows)


def _beside(results: RunResults, measured: Array) -> str:
    """Return the median flower as predicted, measured and, in simulation, as it truly moved."""
    shake, truth = results.shaken, results.visit and results.visit.truth
    assert shake is not None
    seen = measured[np.isfinite(measured)]
    cells = {"Predicted": _number(float(np.median(shake.predicted_acceleration)))}
    cells[f"Measured ({len(seen)} of {len(measured)} flowers)"] = (
        _number(float(np.median(seen))) if len(seen) else "nothing"
    )
    if truth and truth.true_flower_acceleration_median is not None:
        cells["True (simulated; all flowers)"] = _number(truth.true_flower_acceleration_median)
    return _table(["Median flower", *cells], [["peak acceleration", *cells.values()]])


def _measured(response: Response, flower: int) -> str:
    """Return a flower's measured amplitude with its deviation, or what is known instead."""
    if np.isfinite(response.at_most[flower]):
        return f"less than {_milli(response.at_most[flower])}"
    value = _milli(response.amplitude[flower])
    return value if not response.visible[flower] else f"{value} ± {1e3 * response.amplitude_std[flower]:.2f}"


LEARNED_ROWS = (
    ("Young's modulus of the stem", "youngs", 1e-6, "MPa"),
    ("Damping ratio", "damping_ratio", 1.0, ""),
    ("Bending over twisting stiffness", "bend_over_twist", 1.0, ""),
    ("True over scanned radius", "radius_scale", 1.0, ""),
    ("True over modelled flower motion", "response_gain", 1.0, ""),
)
"""Name, attribute of `plant.Material`, factor to the shown unit, unit."""


def _learned(results: RunResults) -> str:
    """Return what was believed of the plant before and after the shake, each with nine in ten."""
    visit = results.visit
    if visit is None or visit.believed is None or visit.material is None:
        return ""
    if visit.material == visit.believed:
        return "<p>Nothing: no flower's motion could be measured, or the shake had no one frequency.</p>"
    rows = [
        [name, *(_belief(m, attribute, factor, unit) for m in (visit.believed, visit.material))]
        for name, attribute, factor, unit in LEARNED_ROWS
    ]
    why = visit.material_reason or ""
    text = f"<p>Believed before: {escape(why)}. The next shake of this plant begins with what is believed after.</p>"
    return text + _table(["Quantity", "Before (nine in ten)", "After (nine in ten)"], rows)


def _belief(material: Material, attribute: str, factor: float, unit: str) -> str:
    middle, spread = factor * getattr(material, attribute), getattr(material, SPREADS[attribute])
    low, high = (middle * np.exp(sign * 1.645 * spread) for sign in (-1, 1))
    return f"{middle:.3g} ({low:.3g} to {high:.3g}) {unit}".strip()


def _milli(value: float) -> str:
    return f"{1000 * value:.2f} mm" if np.isfinite(value) else "not measurable"


def _number(value: float) -> str:
    return f"{value:.1f} m/s²" if np.isfinite(value) else "not measurable"


def _notes(results: RunResults) -> str:
    notes = results.notes()
    return "<ul>" + "".join(f"<li>{escape(n)}</li>" for n in notes) + "</ul>" if notes else ""


def _timing(results: RunResults) -> str:
    seconds = results.seconds
    total = sum(seconds.values())
    if not total:
        return ""
    colour = dict(zip(seconds, PALETTE * 2, strict=False))
    bar = "".join(f"<i style='width:{100 * s / total:.2f}%;background:{colour[k]}'></i>" for k, s in seconds.items())
    rows = "".join(
        f"<tr><td><span class=key style='background:{colour[k]}'></span>{escape(k)}</td>"
        f"<td class=n>{s:.1f} s</td><td class=n>{100 * s / total:.0f} %</td>"
        f"<td class=n>{_number(results.cpu_seconds.get(k), 1)}</td>"
        f"<td class=n>{_number(results.peak_mb.get(k), 0)}</td></tr>"
        for k, s in seconds.items()
    )
    head = "<tr><th>stage</th><th>time</th><th></th><th>CPU [s]</th><th>peak memory [MB]</th></tr>"
    last = f"<tr><td>total</td><td class=n>{total:.1f} s</td><td></td></tr>"
    return f"<div class=bar>{bar}</div><table>{head}{rows}{last}</table>"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


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
    "What to know": _notes,
    "Where the time went": _timing,
    "Parameters": _parameters,
}
"""Heading -> what is written below it; nothing of stages that were not reached."""
