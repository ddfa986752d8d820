"""Views that disagree are said to, with the likely cause, and what is made of them is trusted less."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anther.cli.sample_data import write_samples
from anther.core.errors import FailureKind, StageFailure
from anther.core.geometry import inverse
from anther.core.runs import Run
from anther.perception.capture import OPENGL_TO_OPENCV, Capture
from anther.perception.cloud import Cloud, fuse, likely_cause
from anther.perception.masks import Masks, segment
from anther.perception.skeleton import skeletonize
from anther.pollination.pipeline import Params, cause_named, perceive


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """The sample's six views, at half the size."""
    folder = tmp_path_factory.mktemp("samples")
    write_samples(folder)
    whole = Capture.load(folder / "capture")
    k = whole.intrinsics
    small = replace(k, width=k.width // 2, height=k.height // 2, fx=k.fx / 2, fy=k.fy / 2, cx=k.cx / 2, cy=k.cy / 2)
    assert whole.rgb is not None
    return Capture(whole.depth[:, ::2, ::2], small, whole.T_world_cam, whole.rgb[:, ::2, ::2])


@pytest.fixture(scope="module")
def masks(capture: Capture) -> Masks:
    return segment(capture)


def with_focal(capture: Capture, share: float) -> Capture:
    k = capture.intrinsics
    return replace(capture, intrinsics=replace(k, fx=share * k.fx, fy=share * k.fy))


def grey(capture: Capture) -> Capture:
    assert capture.rgb is not None
    level = capture.rgb.mean(axis=-1, keepdims=True).astype(np.uint8)
    return replace(capture, rgb=np.repeat(level, 3, axis=-1))


def test_views_that_agree_are_not_doubted(capture: Capture, masks: Masks, tmp_path: Path) -> None:
    cloud = fuse(capture, masks)
    assert cloud.seen_through == 0
    assert not [note for note in cloud.notes if "disagree" in note]
    assert likely_cause(capture) == ""


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_focal_length_20_percent_off_is_said_and_trusted_less(
    capture: Capture, masks: Masks, tmp_path: Path, share: float
) -> None:
    wrong = with_focal(capture, share)
    cloud = fuse(wrong, masks)
    assert cloud.seen_through > 0.12
    assert "the views disagree" in cloud.notes[0]
    assert f"instead of {wrong.intrinsics.fx:.0f} px" in cloud.notes[0]
    found = float(cloud.notes[0].split("focal length near ")[1].split(" px")[0])
    assert found == pytest.approx(capture.intrinsics.fx, rel=0.08)
    cloud.save(tmp_path / "cloud.ply")
    assert Cloud.load(tmp_path / "cloud.ply").seen_through == pytest.approx(cloud.seen_through)
    trusted, doubted = skeletonize(replace(cloud, seen_through=0.0)).confidence, skeletonize(cloud).confidence
    assert trusted is not None
    assert doubted is not None
    np.testing.assert_allclose(doubted, trusted * (1 - cloud.seen_through))


MISTAKES: dict[str, tuple[Callable[[Capture], Capture], str]] = {
    "OpenCV's axes": (lambda c: replace(c, T_world_cam=c.T_world_cam @ OPENGL_TO_OPENCV), "other convention"),
    "inverted": (lambda c: replace(c, T_world_cam=inverse(c.T_world_cam)), "inverted"),
    "inverted, OpenCV's axes": (
        lambda c: replace(c, T_world_cam=inverse(c.T_world_cam) @ OPENGL_TO_OPENCV),
        "inverted",
    ),
    "inverted, OpenGL's axes": (
        lambda c: replace(c, T_world_cam=inverse(c.T_world_cam @ OPENGL_TO_OPENCV) @ OPENGL_TO_OPENCV),
        "inverted",
    ),
    "images of half the size": (lambda c: with_focal(c, 2.0), "focal length near 160 px instead of 320 px"),
    "grey": (grey, "images are grey"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_the_likely_cause_is_named(capture: Capture, name: str) -> None:
    change, words = MISTAKES[name]
    assert words in likely_cause(change(capture))


@pytest.mark.parametrize(("name", "words"), [("OpenCV's axes", "other convention"), ("grey", "images are grey")])
def test_a_plant_that_is_not_found_has_its_cause(capture: Capture, tmp_path: Path, name: str, words: str) -> None:
    with pytest.raises(StageFailure, match=f"no.*plant|0 plant pixels.*{words}"):
        perceive(MISTAKES[name][0](capture), None, Run(tmp_path, quiet=True), Params())


def test_a_real_capture_agrees_and_with_a_wrong_focal_length_does_not(data: Path) -> None:
    from anther.perception.formats.kinect import read_kinect  # noqa: PLC0415

    whole = read_kinect(data / "captures" / "sorghum_kinect")
    few = replace(whole, depth=whole.depth[::2], T_world_cam=whole.T_world_cam[::2])
    found = segment(few)
    assert fuse(few, found).seen_through == 0
    wrong = fuse(with_focal(few, 0.8), found)
    assert wrong.seen_through > 0.12
    assert "focal length near" in wrong.notes[0]


@pytest.mark.parametrize(("times", "named"), [(0.1, "10 times"), (0.25, "4 times"), (4.0, "0.25 times")])
def test_depth_in_other_steps_is_named(capture: Capture, times: float, named: str) -> None:
    cause = likely_cause(replace(capture, depth=capture.depth * np.float32(times)))
    assert named in cause
    assert "depth_unit_scale_factor" in cause


@pytest.mark.parametrize("kind", ["no_plant_found", "no_stem_found", "no_grasp_found"])
def test_the_cause_is_named_wherever_the_views_first_fail(capture: Capture, kind: FailureKind) -> None:
    """Views with inverted poses may still give something that looks like a plant, and no grasp."""
    inverted = replace(capture, T_world_cam=inverse(capture.T_world_cam @ OPENGL_TO_OPENCV) @ OPENGL_TO_OPENCV)
    words = r"none is free\. They would agree if every pose were inverted"
    with pytest.raises(StageFailure, match=words), cause_named(inverted):
        raise StageFailure(kind, "none is free.")
    with pytest.raises(StageFailure) as failure, cause_named(capture):
        raise StageFailure(kind, "none is free.")
    assert str(failure.value) == "none is free."
