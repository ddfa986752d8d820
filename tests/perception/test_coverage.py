"""What is said of the depth of a plant: nothing, what is lost, and what would help."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anther.cli.cell import _describe_camera
from anther.cli.sample_data import write_samples
from anther.core.geometry import Intrinsics
from anther.perception.capture import Capture
from anther.perception.cloud import fuse
from anther.perception.coverage import describe_depth
from anther.perception.masks import Masks, green_pixels, segment
from anther.robot.devices import Frame

PLANT = np.zeros((60, 80), bool)
PLANT[10:50, 20:60] = True
ADVICE = ("0.3 m", "sheet close behind", "preset", "D405")


def view(share: float, distance: float) -> np.ndarray:
    """A depth image in which a share of the plant has a reading, and all of what is behind it."""
    depth = np.where(PLANT, 0.0, 3.0).astype(np.float32)
    rows, columns = np.nonzero(PLANT)
    read = round(share * len(rows))
    depth[rows[:read], columns[:read]] = distance
    return depth


@pytest.mark.parametrize(("share", "advised"), [(1.0, False), (0.75, False), (0.5, True), (0.1, True)])
def test_advice_is_given_where_little_of_the_plant_has_depth(share: float, advised: bool) -> None:
    said = describe_depth(view(share, 0.6), PLANT, 640.0)
    assert f"{share:.0%} of the plant" in said
    assert [word in said for word in ADVICE] == [advised] * len(ADVICE)
    assert bool(describe_depth(view(share, 0.6), PLANT, 640.0, only_poor=True)) == advised


def test_thinner_parts_are_measured_from_nearer_and_with_a_longer_lens() -> None:
    def thinnest(distance: float, focal: float) -> float:
        return float(describe_depth(view(1.0, distance), PLANT, focal).partition("parts under ")[2].split()[0])

    assert thinnest(0.6, 640) == pytest.approx(2 * thinnest(0.3, 640), abs=0.1)
    assert thinnest(0.6, 1280) == pytest.approx(thinnest(0.3, 640), abs=0.1)
    assert thinnest(0.6, 640) == pytest.approx(8.4, abs=0.1)  # nine pixels


def test_who_is_near_already_is_not_sent_nearer_and_who_sees_nothing_is_told_so() -> None:
    assert "come to" not in describe_depth(view(0.4, 0.25), PLANT, 640.0)
    blind = describe_depth(view(0.0, 0.6), PLANT, 640.0)
    assert "covers 0%" in blind
    assert "come to 0.3 m" in blind
    assert describe_depth(view(0.4, 0.6), np.zeros_like(PLANT), 640.0) == ""


def test_a_cloud_says_so_of_a_capture_that_lost_half_of_the_plant(tmp_path: Path) -> None:
    write_samples(tmp_path)
    capture = Capture.load(tmp_path / "capture")
    plant = segment(capture).labels
    striped = capture.depth.copy()
    striped[:, :, np.arange(striped.shape[2]) // 8 % 2 == 0] = 0
    for depth, labels, poor in ((capture.depth, plant * (capture.depth > 0), False), (striped, plant, True)):
        cloud = fuse(replace(capture, depth=depth), Masks(labels.astype(np.uint8), "test"))
        assert bool([note for note in cloud.notes if "depth covers" in note]) == poor


class GreenCamera:
    """A camera before a green plant of which half has depth."""

    intrinsics = Intrinsics(80, 60, 640.0, 640.0, 39.5, 29.5)

    def read(self) -> Frame:
        rgb = np.where(PLANT[..., None], np.array([60, 130, 50]), np.array([150, 150, 150])).astype(np.uint8)
        return Frame(0.0, rgb, view(0.5, 0.6))

    def start(self, rate: float) -> None:
        del rate

    def stop(self) -> list[Frame]:
        return [self.read()]


def test_a_check_of_a_cell_says_what_its_camera_measures_of_the_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anther.cli.cell.time.sleep", lambda _: None)
    assert np.array_equal(green_pixels(GreenCamera().read().rgb), PLANT)
    said = _describe_camera(GreenCamera())  # type: ignore[arg-type]
    assert "50% of the plant" in said[-1]
    assert "sheet" in said[-1]
