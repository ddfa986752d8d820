"""From what the networks find to labels, files and messages; the networks themselves are stood in for."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from grown_plants import grown
from hypothesis import given
from hypothesis import strategies as st

from anther.cli.main import main
from anther.core.errors import InputError, MissingExtra, StageFailure
from anther.core.geometry import Intrinsics, look_at
from anther.perception.capture import Capture
from anther.perception.masks import BACKGROUND, FLOWER, PLANT, Masks
from anther.perception.masks.by_words import Params, find_models, label_views, paint, segment
from anther.sim.capture import capture_from_poses, orbit_poses
from anther.sim.plant import Organ
from anther.sim.render import d455

WIDTH, HEIGHT = 32, 24
SOURCE = "Grounding DINO and SAM 2"


class Rectangles:
    """Finds the same rectangles (rows, columns, words) in every image, or what `of_view` says for its brightness."""

    class device:
        type = "cpu"

    def __init__(self, *found: tuple[slice, slice, str], of_view: dict[int, list[int]] | None = None) -> None:
        self.found, self.of_view, self.asked = found, of_view, []

    def find(self, images: Any, words: Sequence[str]) -> list[tuple[Any, Any]]:
        self.asked.append(len(images))
        return [self._find(image, words) for image in images]

    def _find(self, image: Any, words: Sequence[str]) -> tuple[Any, Any]:
        chosen = range(len(self.found)) if self.of_view is None else self.of_view[int(image[0, 0, 0])]
        masks = np.zeros((len(chosen), *image.shape[:2]), dtype=bool)
        for mask, k in zip(masks, chosen, strict=True):
            mask[self.found[k][0], self.found[k][1]] = True
        return masks, np.array([words.index(self.found[k][2]) for k in chosen], dtype=int)


LEAF = (slice(2, 20), slice(4, 30), "leaves.")
STEM = (slice(0, 24), slice(15, 17), "stem.")
BLOSSOM = (slice(5, 9), slice(6, 10), "flower.")
EVERYTHING = (slice(0, 24), slice(0, 32), "flower.")


def views(count: int = 1) -> Capture:
    """Grey views, each with its number as grey level."""
    rgb = np.ones((count, HEIGHT, WIDTH, 3), dtype=np.uint8) * np.arange(count, dtype=np.uint8)[:, None, None, None]
    poses = np.stack([look_at([1.0, 0.1 * k, 0.3], [0, 0, 0]) for k in range(count)])
    camera = Intrinsics(width=WIDTH, height=HEIGHT, fx=30, fy=30, cx=15.5, cy=11.5)
    return Capture(np.ones((count, HEIGHT, WIDTH)), camera, poses, rgb)


def labelled(*found: tuple[slice, slice, str]) -> Any:
    return label_views(np.zeros((1, HEIGHT, WIDTH, 3), dtype=np.uint8), Rectangles(*found), Params())[0]


def test_words_decide_the_label_and_small_lies_on_large() -> None:
    for order in ([LEAF, STEM, BLOSSOM], [BLOSSOM, STEM, LEAF]):
        labels = labelled(*order)
        assert (labels[BLOSSOM[:2]] == FLOWER).all()
        assert (labels == FLOWER).sum() == 16
        assert (labels == PLANT).sum() == 18 * 26 + 6 * 2 - 16
        assert labels[23, 0] == BACKGROUND


def test_a_flower_that_covers_everything_does_not_hide_the_leaves() -> None:
    assert (labelled(EVERYTHING, LEAF)[LEAF[:2]] == PLANT).all()


def test_other_words_can_be_asked_for() -> None:
    words = Params(plant=("pepper plant.",), flower=())
    rgb = np.zeros((1, HEIGHT, WIDTH, 3), dtype=np.uint8)
    labels = label_views(rgb, Rectangles((slice(0, 3), slice(0, 3), "pepper plant.")), words)
    assert (labels == PLANT).sum() == 9


def test_equal_masks_keep_the_order_in_which_they_were_found() -> None:
    image = np.zeros((2, 2), dtype=np.uint8)
    paint(image, np.ones((2, 2, 2), dtype=bool), np.array([PLANT, FLOWER], dtype=np.uint8))
    assert (image == FLOWER).all()


def test_batches_cover_every_view_once_and_progress_says_so() -> None:
    networks = Rectangles(LEAF, BLOSSOM, of_view={0: [0], 1: [], 2: [1], 3: [0, 1], 4: []})
    rgb, reported = views(5).rgb, []
    assert rgb is not None
    labels = label_views(rgb, networks, Params(), batch=2, progress=lambda *done: reported.append(done))
    assert networks.asked == [2, 2, 1]
    assert reported == [(2, 5), (4, 5), (5, 5)]
    assert [(PLANT in v, FLOWER in v) for v in labels] == [
        (True, False),
        (False, False),
        (False, True),
        (True, True),
        (False, False),
    ]


@given(st.text(max_size=12))
def test_words_are_one_phrase_each_or_refused(text: str) -> None:
    try:
        words = Params(plant=(text,)).plant[0]
    except InputError:
        return
    assert words == words.lower()
    assert words.index(".") == len(words) - 1 > 0
    assert "?" not in words


@pytest.mark.parametrize("words", ["leaves", "Leaves.", ".", " .", "leaves. stem.", "leaf?.", ""])
def test_words_the_detector_would_misread_are_refused(words: str) -> None:
    with pytest.raises(InputError, match=r"As 'leaves\.'"):
        Params(plant=(words,))


def test_bad_numbers_are_refused() -> None:
    for bad in ({"score": 1.2}, {"most": 0}, {"batch": -1}, {"plant": ()}):
        with pytest.raises(InputError):
            Params(**bad)


def weights(folder: Path, kind: str) -> Path:
    """A folder that looks like a network's."""
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({"model_type": kind}))
    (folder / "model.safetensors").write_bytes(b"numbers")
    return folder


@pytest.fixture
def models(tmp_path: Path) -> Path:
    weights(tmp_path / "models" / "IDEA-Research" / "grounding-dino-tiny", "grounding-dino")
    weights(tmp_path / "models" / "sam2", "sam2_video")
    return tmp_path / "models"


def test_models_are_found_by_what_they_are(models: Path) -> None:
    (models / "notes").mkdir()
    (models / "notes" / "config.json").write_text("[not json")
    weights(models / "another", "clip")
    assert [found.name for found in find_models(models)] == ["grounding-dino-tiny", "sam2"]
    weights(models / "sam3", "sam3_video")
    assert find_models(models, "sam3") == (models / "sam3",)


def test_missing_weights_get_the_commands_that_bring_them(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    with pytest.raises(InputError) as nothing:
        find_models(folder)
    message = str(nothing.value)
    for part in (
        "hf download IDEA-Research/grounding-dino-tiny",
        "689 MB",
        "hf download facebook/sam2.1",
        "Apache-2.0",
    ):
        assert part in message
    places = re.findall(r"--local-dir (\S+)", message)
    weights(Path(places[0]), "grounding-dino")  # where the first command would put it
    with pytest.raises(InputError) as half:
        find_models(folder)
    assert "grounding-dino-tiny" not in str(half.value)
    weights(Path(places[1]), "sam2_video")
    assert find_models(folder) == (Path(places[0]), Path(places[1]))
    with pytest.raises(InputError, match=r"hf download facebook/sam3 .*SAM License"):
        find_models(folder, "sam3")


def test_a_folder_without_numbers_is_no_model(models: Path) -> None:
    (models / "sam2" / "model.safetensors").unlink()
    with pytest.raises(InputError, match=r"facebook/sam2\.1"):
        find_models(models)


def test_two_of_a_kind_are_refused(models: Path) -> None:
    weights(models / "sam2-large", "sam2")
    with pytest.raises(InputError, match="2 folders of SAM 2"):
        find_models(models)


def test_missing_extra_says_how_to_install(models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtra, match=r"needs torch\. Install with: pip install 'anther\[segmentation\]'"):
        find_models(models)


def stand_in(monkeypatch: pytest.MonkeyPatch, networks: Any) -> list[Any]:
    """Let `networks` be what is loaded from the weights; return the list of loadings."""
    loaded = []
    module = type(sys)("anther.perception.masks._networks")
    module.GroundedSam2 = type("Loader", (), {"load": lambda *a, **k: loaded.append(k) or networks})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "anther.perception.masks._networks", module)
    return loaded


def test_result_is_kept_per_images_weights_and_parameters(
    models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = stand_in(monkeypatch, Rectangles(LEAF, BLOSSOM))
    cache, capture = tmp_path / "capture" / "masks", views(2)
    first = segment(capture, models, cache=cache)
    assert (first.source, len(loaded)) == (SOURCE, 1)
    again = segment(capture, models, Params(batch=2), cache=cache)  # how, not what
    np.testing.assert_array_equal(again.labels, first.labels)
    assert len(loaded) == 1
    other_image = np.array(capture.rgb)
    other_image[1, 3, 3, 0] += 1
    segment(Capture(capture.depth, capture.intrinsics, capture.T_world_cam, other_image), models, cache=cache)
    segment(capture, models, Params(score=0.3), cache=cache)
    segment(capture, models, Params(flower=("flower.", "petal.")), cache=cache)
    assert len(loaded) == 4
    (models / "sam2" / "model.safetensors").write_bytes(b"other numbers")
    segment(capture, models, cache=cache)
    assert len(loaded) == 5
    segment(capture, models)
    assert len(loaded) == 6


def test_a_damaged_cache_is_made_again(models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = stand_in(monkeypatch, Rectangles(LEAF))
    segment(views(), models, cache=tmp_path)
    (kept,) = tmp_path.glob("grounded-sam2-*.npz")
    kept.write_bytes(kept.read_bytes()[:40])
    segment(views(), models, cache=tmp_path)
    assert len(loaded) == 2
    assert Masks.load(kept).source == SOURCE


def test_nothing_found_is_said(models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, Rectangles())
    with pytest.raises(StageFailure, match=r"found 0 pixels of leaves\. stem\. flower\.") as nothing:
        segment(views(3), models)
    assert nothing.value.kind == "no_plant_found"


def test_colour_is_needed(models: Path) -> None:
    grey = views()
    with pytest.raises(InputError, match="without colour"):
        segment(Capture(grey.depth, grey.intrinsics, grey.T_world_cam), models)


def test_commands_say_at_once_that_weights_are_missing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    views().save(tmp_path / "capture")
    options = ["--masks", "grounded-sam2", "--models", str(tmp_path / "none"), "--out", str(tmp_path / "run")]
    for command in (["reconstruct", str(tmp_path / "capture")], ["trial"]):
        assert main([*command, *options]) == 2
        assert "hf download IDEA-Research/grounding-dino-tiny" in capfd.readouterr().err
        assert not (tmp_path / "run").exists()


class Truth:
    """Networks that see what is there: leaf, stem and flower pixels of a simulated capture, view after view."""

    class device:
        type = "cpu"

    def __init__(self, organ: Any) -> None:
        self.organ = list(organ)

    def find(self, images: Any, words: Sequence[str]) -> list[tuple[Any, Any]]:
        return [self._find(self.organ.pop(0), words) for _ in images]

    def _find(self, organ: Any, words: Sequence[str]) -> tuple[Any, Any]:
        leaves, flower = organ < Organ.FLOWER, organ == Organ.FLOWER
        return np.stack([leaves, flower]), np.array([words.index("leaves."), words.index("flower.")])


def test_reconstruct_with_the_networks_masks(models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poses = orbit_poses(6, (0.72, 0, -0.1), distance=0.6)
    capture, truth = capture_from_poses(
        grown("pepper", 1), poses, intrinsics=d455(424, 240), rng=np.random.default_rng(1)
    )
    capture.save(tmp_path / "capture")
    loaded = stand_in(monkeypatch, Truth(truth.organ))
    command = ["reconstruct", str(tmp_path / "capture"), "--masks", "grounded-sam2", "--models", str(models)]
    assert main([*command, "--out", str(tmp_path / "run")]) == 0
    masks = Masks.load(tmp_path / "run" / "02_masks.npz")
    assert masks.source == SOURCE
    kept = segment(capture, models, cache=tmp_path / "capture" / "masks")
    assert len(loaded) == 1, "the networks' masks lie next to the capture for the next time"
    np.testing.assert_array_equal(kept.labels > BACKGROUND, truth.organ <= Organ.FLOWER)


def test_torch_is_not_imported_before_it_is_needed() -> None:
    code = (
        "import sys, anther.pollination.pipeline, anther.cli.trial, anther.perception.masks.by_words\n"
        "assert not {'torch', 'transformers'} & set(sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
