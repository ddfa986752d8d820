"""What the report says of one trial does not contradict itself."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_viewer import shaken

from anther.core.geometry import Intrinsics, look_at
from anther.perception import Capture
from anther.plant.visit import TruthRecord, Visit
from anther.pollination.execution import Step
from anther.pollination.response import Response
from anther.show import report
from anther.show.pictures.report import draw_steps, overlay
from anther.show.report import write_report
from anther.show.results import PARAMS, RunResults, read_run

NAN = float("nan")
F = 6
LAST = Step(0.5, 1.5, (4.0,), (0.002,), (0.0, 1.0, 0.0), (NAN, 6.0, *[NAN] * 4), {"slip": 0.5}, "Held.", 0.1)


def trial(folder: Path, **more: Any) -> RunResults:
    """A run whose plan was raised from 5 mm to 8 mm, and whose first flower alone was followed to the end."""
    results = shaken(folder)
    assert results.shake is not None
    assert results.trial is not None
    seen = np.arange(F) == 0
    size, none = np.where(seen, 0.004, NAN), np.full(F, NAN)
    at_most = np.where(np.arange(F) == 2, 0.0005, NAN)
    times = np.linspace(0, 1, 20)
    tracks = np.tile(0.004 * np.sin(25 * times)[:, None, None], (1, F, 3))
    response = Response(
        times,
        tracks,
        size,
        0.1 * size,
        none,
        none,
        none,
        none,
        np.where(seen, 3.0, NAN),
        at_most,
        np.ones((F, 3)),
        seen,
    )
    done = replace(results.shake, amplitude=0.008)
    stepped = replace(results.trial, steps=(LAST,))
    return replace(results, executed=done, trial=stepped, response=response, **more)


def page_of(results: RunResults, *, drawn: bool = False) -> str:
    """Return the report; its pictures take most of the time, and are drawn only where they are looked at."""
    path = results.folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        if not drawn:
            patch.setattr(report, "_image", lambda draw, alt: "")
        write_report(path, results)
    return path.read_text(encoding="utf-8")


def said(results: RunResults, section: str) -> list[list[str]]:
    """Return the rows of the tables in a section of the report, each its cells, without markup."""
    page = page_of(results)
    begin = page.index(f"<h2>{section}</h2>")
    part = page[begin : page.index("</section>", begin)]
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", part)
    return [[unescape(re.sub("<[^>]+>", "", c)) for c in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", r)] for r in rows]


def test_plan_and_execution_stand_in_one_table_in_one_unit(tmp_path: Path) -> None:
    rows = said(trial(tmp_path), "The shake")
    assert rows[0] == ["", "Planned", "Executed"]
    assert ["Amplitude of the grip", "5.00 mm", "8.00 mm"] in rows
    assert ["Frequency", "4.00 Hz", "4.00 Hz"] in rows
    alone = said(replace(trial(tmp_path), executed=None), "The shake")
    assert alone[0] == ["", "Planned"]


def test_a_flower_has_amplitude_and_acceleration_from_the_same_look(tmp_path: Path) -> None:
    rows = {row[0]: row[2::2] for row in said(trial(tmp_path), "How the flowers moved") if row[0][:6] == "Flower"}
    assert rows["Flower 1"] == ["4.00 mm ± 0.40", "3.00 m/s²"]
    of_the_step = 1e3 * 6.0 / (2 * np.pi * 4.0) ** 2
    assert rows["Flower 2"] == [f"{of_the_step:.2f} mm (last step)", "6.00 m/s² (last step)"]
    assert rows["Flower 3"] == ["less than 0.500 mm", "less than 0.316 m/s²"]
    assert rows["Flower 4"] == ["not measured", "not measured"]


def test_the_grasp_that_was_carried_out_is_marked_though_others_were_tried_before(tmp_path: Path) -> None:
    """A later plan chooses among the grasps that are left: its index is not the rank."""
    results = trial(tmp_path, attempts=("the grasp 20 cm up the stem is left for the next: nothing",))
    assert results.shake is not None
    held = results.shake.grasp
    other = np.array(held.T_world_flange)
    other[:3, 3] += 0.05
    results = replace(results, grasps=(replace(held, T_world_flange=other), held))
    assert [row[0] for row in said(results, "The grasp")] == ["Rank", "1", "2 (carried out)"]
    assert "is left for the next: nothing</li>" in page_of(results)


def test_what_a_negative_clearance_means_is_said_where_there_is_one(tmp_path: Path) -> None:
    results = trial(tmp_path)
    assert results.shake is not None
    grasp = results.shake.grasp
    for clearance, told in ((0.005, False), (-0.015, True)):
        page = page_of(replace(results, grasps=(replace(grasp, clearance=clearance),)))
        assert ("pushes leaves, petioles or flowers aside" in page) == told


@pytest.mark.parametrize("true", [None, 13.4])
def test_measured_and_true_are_explained_in_simulation_alone(true: float | None, tmp_path: Path) -> None:
    zeros = dict.fromkeys((f.name for f in fields(TruthRecord)), 0.0)
    truth = (
        TruthRecord(
            **zeros
            | {
                "harmed": "",
                "true_held_beside": "",
                "flowers_lost": 0,
                "true_flower_acceleration_peak": (true,),
                "true_flower_acceleration_median": true,
                "true_flower_acceleration_least": true,
            }
        )
        if true
        else None
    )
    page = page_of(trial(tmp_path, visit=Visit("tomato", "1", held_unharmed=True, truth=truth)))
    assert ("Measured is what the side camera tells" in page) == (true is not None)


@pytest.mark.parametrize(
    ("timing", "header"),
    [
        ({}, ["Stage", "Time", "Share"]),
        (
            {"cpu_seconds": {"cloud": 3.5, "stem": 0.5}, "peak_mb": {"cloud": 800}},
            ["Stage", "Time", "Share", "Processor time", "Most memory"],
        ),
        ({"cpu_seconds": {"cloud": 3.5, "stem": 0.5}}, ["Stage", "Time", "Share", "Processor time"]),
    ],
)
def test_processor_time_and_memory_have_a_column_where_they_are_known(
    timing: dict[str, Any], header: list[str], tmp_path: Path
) -> None:
    (tmp_path / PARAMS).write_text("{}")
    (tmp_path / "timing.json").write_text(json.dumps({"seconds": {"cloud": 2.0, "stem": 1.0}} | timing))
    results = read_run(tmp_path)
    assert results.seconds == {"cloud": 2.0, "stem": 1.0}
    rows = said(results, "Where the time went")
    assert rows[0] == header
    assert rows[-1][:2] == ["total", "3.0 s"]
    if len(header) > 3:
        assert rows[-1][3] == "4.00 s"


def test_each_picture_is_there_for_a_desk_and_for_a_phone(tmp_path: Path) -> None:
    page = page_of(trial(tmp_path), drawn=True)
    assert page.count("<picture>") == page.count("<source media='(max-width:640px)'") >= 3
    assert 'data-name="Predicted acceleration"' in page, "a card of a phone names its values"


def test_what_a_simulated_cell_file_lacked_is_told_with_its_arm(tmp_path: Path) -> None:
    visit = Visit("tomato", "1", held_unharmed=True)
    assert "The cell that was simulated" not in page_of(trial(tmp_path, visit=visit))
    notes = ("no machine is contacted: arm, gripper and cameras are simulated", "wrist camera: no intrinsics")
    asked = {"cell": "/home/me/mine.toml", "arm": "sawyer"}
    page = page_of(trial(tmp_path, visit=replace(visit, simulated_as=notes), params=asked))
    assert "As mine.toml says, with its sawyer." in page
    assert all(f"<li>{note}</li>" in page for note in notes)
    assert "sawyer, simulated</p>" in page


@pytest.mark.filterwarnings("error:constrained_layout")
def test_steps_keep_their_width_on_a_phone_beside_long_names_of_limits() -> None:
    """A legend wider than the picture leaves its axes no room."""
    steps = [replace(LAST, loads={word: 0.9}) for word in ("the bending of branch bases", "the bending of pedicels")]
    figure = draw_steps(steps, 0.0, narrow=True)
    figure.canvas.draw()
    width = figure.bbox.width
    assert all(axes.get_window_extent().width > 0.6 * width for axes in figure.axes)
    assert all(axes.get_legend().get_window_extent().x1 <= width for axes in figure.axes)


@pytest.mark.parametrize("turned", [0.0, 90.0, 180.0, -90.0])
def test_views_are_drawn_upright_however_the_camera_lies(turned: float) -> None:
    """The red upper edge of what a level camera sees stays the upper edge."""
    about = np.eye(4)
    about[:3, :3] = Rotation.from_euler("z", turned, degrees=True).as_matrix()
    T_world_cam = look_at([0.0, 0, 0.5], [1.0, 0, 0.4]) @ about
    seen = np.zeros((90, 90, 3), np.uint8)
    seen[:30] = 200, 0, 0
    rgb = np.rot90(seen, round(turned / 90))  # in a camera that is turned clockwise, counter-clockwise
    capture = Capture(
        np.ones((1, 90, 90), np.float32), Intrinsics(90, 90, 80.0, 80.0, 45.0, 45.0), T_world_cam[None], rgb[None]
    )
    picture = overlay(capture, None, 0)
    assert picture[:8, :, 0].min() > 150
    assert picture[-8:, :, 0].max() < 50
