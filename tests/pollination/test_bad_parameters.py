"""No parameter of a stage may be NaN, infinite, negative, or so small or large that a stage never ends."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from anther.cli.main import main
from anther.core.errors import InputError
from anther.perception import cloud, masks, skeleton, stem
from anther.perception.cloud import Cloud, _registration
from anther.perception.skeleton import skeletonize
from anther.plant import model as plant
from anther.pollination import pipeline, shake

STAGES: list[Any] = [
    cloud.Params(), _registration.Params(), masks.Params(), skeleton.Params(), plant.Params(),
]  # fmt: skip


@pytest.mark.parametrize("params", STAGES, ids=lambda p: type(p).__module__)
def test_no_number_may_be_nan_infinite_or_negative(params: Any) -> None:
    names = [f.name for f in fields(params) if type(getattr(params, f.name)) in (int, float)]
    assert names
    for name in names:
        for value in (float("nan"), float("inf"), -1.0):
            with pytest.raises(InputError):
                replace(params, **{name: value})


def test_all_stages_of_the_pipeline_are_in_the_table() -> None:
    whole = pipeline.Params()
    held = {type(getattr(whole, f.name)) for f in fields(whole) if is_dataclass(getattr(whole, f.name))}
    apart = {
        "anther.pollination.shake.params",
        "anther.pollination.escalation._option",
        "anther.perception.masks.by_words",
    }  # checked one by one
    apart |= {"anther.perception.stem", "anther.pollination.grasp"}  # they hold a place and a shape, no number
    assert {kind.__module__ for kind in held - {type(params) for params in STAGES}} == apart


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (skeleton.Params, "voxel", 0.0), (skeleton.Params, "spacing", 0.0),
        (skeleton.Params, "recentre", 1_000_000), (shake.Params, "most_amplitude", 0.0),
        (shake.Params, "most_amplitude", float("inf")), (masks.Params, "ground_radius", 10.0),
    ],
)  # fmt: skip
def test_what_would_never_end_or_mean_nothing(kind: Any, name: str, value: Any) -> None:
    with pytest.raises(InputError, match=name.replace("_", "[_ ]")):
        kind(**{name: value})


def test_voxels_are_neither_finer_nor_coarser_than_the_plant_allows() -> None:
    points = Cloud(np.random.default_rng(0).uniform(0, 1, (500, 3)) * [0.05, 0.05, 0.6])
    for voxel in (1e-5, 0.5):
        with pytest.raises(InputError, match="voxel: got"):
            skeletonize(points, skeleton.Params(voxel=voxel))


@pytest.mark.parametrize("value", ["-1", "0", "nan"])
def test_the_command_line_refuses_them(capsys, value: str) -> None:
    try:
        code = main(["skeletonize", "a.ply", f"--params.voxel={value}"])
    except SystemExit as stop:
        code = stop.code
    said = capsys.readouterr()
    assert code == 2
    assert "voxel" in said.err + said.out
    assert "Traceback" not in said.err + said.out


def test_numbers_in_tuples_are_checked_too() -> None:
    with pytest.raises(InputError, match="tip"):
        stem.Params(tip=(0.02, float("nan"), 0.0))
