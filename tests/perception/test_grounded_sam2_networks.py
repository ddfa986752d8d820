"""Grounding DINO and SAM 2: tiny random weights run the real code; image and box steps against other computations."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from lazy import Lazy
from PIL import Image

from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, look_at
from anther.perception.capture import Capture
from anther.perception.masks import FLOWER, PLANT
from anther.perception.masks.by_words import Params, find_models, segment

if find_spec("torch") is None or find_spec("transformers") is None:
    pytest.skip("needs the extra anther[segmentation]", allow_module_level=True)
torch, transformers, tensors = Lazy("torch"), Lazy("transformers"), Lazy("safetensors.torch")
parts, made = Lazy("anther.perception.masks._networks"), Lazy("made_networks")
WORDS = ("leaves.", "stem.", "flower.")
HEIGHT, WIDTH = 48, 80


def cpu() -> Any:
    return torch.device("cpu")


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """One thread of the processor, also where there is a GPU: what is compared is computed alike."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch.cuda, "is_available", lambda: False)
        yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.save_tiny_sam3(made.save_tiny_grounded_sam2(tmp_path_factory.mktemp("models")))


@pytest.fixture(scope="module")
def networks(models: Path) -> Any:
    return parts.GroundedSam2.load(find_models(models), score=0.0, most=5)


@pytest.fixture(scope="module")
def images() -> Any:
    """Smooth coloured patches."""
    coarse = np.random.default_rng(0).integers(0, 255, (3, 6, 10, 3), dtype=np.uint8)
    return np.stack([cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC) for image in coarse])


def test_dots_part_the_words() -> None:
    #                     [CLS] lea ##ves .  stem  .   flower  .  [SEP]
    ids = torch.tensor([101, 200, 201, 1012, 202, 1012, 203, 1012, 102])
    assert parts.words_of_tokens(ids).tolist() == [-1, 0, 0, -1, 1, -1, 2, -1, -1]


def found(logits: list[list[float]], boxes: list[list[float]], **options: Any) -> tuple[Any, Any]:
    """Chosen boxes and words for tokens [CLS] a1 a2 . b ."""
    words = torch.tensor([-1, 0, 0, -1, 1, -1])
    rows = torch.full((len(logits), 8), float("-inf"))  # the detector pads the text like this
    rows[:, :6] = torch.tensor(logits)
    options = {"size": (100, 200), "score": 0.5, "most": 10} | options
    corners, word = parts.chosen_boxes(rows, torch.tensor(boxes), words, **options)
    return corners.tolist(), word.tolist()


def test_a_box_belongs_to_the_words_of_its_best_token() -> None:
    middle = [0.5, 0.5, 0.5, 0.4]
    corners, word = found(
        [[9, -9, 1, 9, 0.5, 9], [9, -9, -9, 9, 2, 9], [9, -1, -2, 9, -3, 9]],  # special tokens do not count
        [middle, [0.25, 0.5, 0.1, 0.2], middle],
    )
    assert word == [1, 0]  # best first; the third stays below the score
    np.testing.assert_allclose(corners, [[40, 40, 60, 60], [50, 30, 150, 70]], rtol=1e-5)


def test_boxes_end_at_the_image_and_are_limited() -> None:
    logits, boxes = [[0, k, 0, 0, 0, 0] for k in (1.0, 3.0, 2.0)], [[0.0, 1.0, 0.2, 0.2 * k] for k in (1, 2, 3)]
    corners, word = found(logits, boxes, most=2)
    assert word == [0, 0]
    np.testing.assert_allclose(corners, [[0, 80, 20, 100], [0, 70, 20, 100]], atol=1e-4)


def test_no_boxes() -> None:
    assert found([[0, -1, -1, 0, -1, 0]], [[0.5, 0.5, 0.1, 0.1]]) == ([], [])


@pytest.mark.parametrize("side", [32, 160], ids=["smaller", "larger"])
def test_images_are_prepared_as_pillow_would(images: Any, side: int) -> None:
    ours = (
        parts.normalised(images, (side, side), cpu(), parts.GroundedSam2.mean, parts.GroundedSam2.std)
        .numpy()
        .transpose(0, 2, 3, 1)
    )
    other = [np.asarray(Image.fromarray(i).resize((side, side), Image.Resampling.BILINEAR)) / 255 for i in images]
    other = (np.stack(other) - parts.GroundedSam2.mean) / parts.GroundedSam2.std
    one_grey_level = 1 / 255 / min(parts.GroundedSam2.std)  # Pillow rounds once more, between rows and columns
    assert np.abs(ours - other).max() < 1.01 * one_grey_level


def test_masks_return_to_the_images_size_as_opencv_would_do_it() -> None:
    logits = np.random.default_rng(1).normal(size=(2, 16, 16)).astype(np.float32)
    masks = parts.full_size(torch.tensor(logits), (HEIGHT, WIDTH))
    other = np.stack([cv2.resize(part, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR) for part in logits])
    assert masks.shape == (2, HEIGHT, WIDTH)
    sure = np.abs(other) > 1e-4
    assert ((other > 0) == masks)[sure].all()
    assert sure.mean() > 0.99


class KnownOutliner:
    """A SAM 2 that fills each box it is asked about, at its own low resolution."""

    config = SimpleNamespace(prompt_encoder_config=SimpleNamespace(image_size=256))

    def get_image_embeddings(self, pixels: Any) -> list[Any]:
        assert pixels.shape[1:] == (3, 256, 256)
        return [pixels.mean(dim=(1, 2, 3))[:, None], torch.arange(len(pixels))[:, None]]

    def __call__(self, *, image_embeddings: list[Any], input_boxes: Any, multimask_output: bool) -> Any:
        assert not multimask_output
        assert all(len(e) == 1 for e in image_embeddings)
        at = (torch.arange(64) + 0.5) * 4  # centres of the mask's pixels in the 256 px image
        x0, y0, x1, y1 = (c[..., None, None] for c in input_boxes[0].unbind(-1))
        inside = (at > x0) & (at < x1) & (at[:, None] > y0) & (at[:, None] < y1)
        return SimpleNamespace(pred_masks=(2.0 * inside - 1)[None, :, None])


def test_boxes_go_to_the_outliner_and_masks_come_back_in_image_pixels(networks: Any, images: Any) -> None:
    known = parts.GroundedSam2(SimpleNamespace(device=cpu()), None, None, KnownOutliner(), score=0.1, most=50)
    boxes = [torch.tensor([[10.0, 6.0, 50.0, 30.0]] * 17), torch.zeros((0, 4)), torch.tensor([[0.0, 0.0, 80.0, 48.0]])]
    masks = known.outlines(images, boxes)
    assert [m.shape for m in masks] == [(17, HEIGHT, WIDTH), (0, HEIGHT, WIDTH), (1, HEIGHT, WIDTH)]
    for mask in (masks[0][0], masks[0][16]):  # of the first and of the second portion
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        np.testing.assert_allclose([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], [10, 6, 50, 30], atol=1)
    assert masks[2].all()
    assert [len(m) for m in known.outlines(images, [torch.zeros((0, 4))] * 3)] == [0, 0, 0]


def test_boxes_agree_with_the_official_decoding(networks: Any, models: Path, images: Any) -> None:
    folder = models / "grounding-dino"
    processor = transformers.GroundingDinoProcessor(
        transformers.GroundingDinoImageProcessorPil.from_pretrained(folder),
        transformers.AutoTokenizer.from_pretrained(folder),
    )
    network = transformers.GroundingDinoForObjectDetection.from_pretrained(folder)
    every = parts.GroundedSam2.load(find_models(models), score=0.0, most=900).boxes(images, WORDS)
    for image, (ours, _) in zip(images, every, strict=True):
        asked = processor(images=[image], text=" ".join(WORDS), return_tensors="pt")
        with torch.inference_mode():
            answer = network(**asked)
        official = processor.post_process_grounded_object_detection(
            answer, asked.input_ids, threshold=0.0, target_sizes=[(HEIGHT, WIDTH)]
        )[0]["boxes"].clamp(min=0)
        official = torch.minimum(official, torch.tensor([WIDTH, HEIGHT] * 2))
        distance = torch.cdist(ours, official).amin(dim=1)
        assert len(ours) == len(official) == 12
        assert distance.max() < 0.01


def test_masks_agree_with_the_whole_network_run_on_one_image(networks: Any, models: Path, images: Any) -> None:
    """Here a batch is encoded once and each image's boxes are decoded in portions."""
    boxes = [corners for corners, _ in networks.boxes(images, WORDS)]
    ours = networks.outlines(images, boxes)
    whole = transformers.Sam2Model.from_pretrained(models / "sam2")
    scale = torch.tensor([made.SIDE / WIDTH, made.SIDE / HEIGHT] * 2)
    for image, corners, masks in zip(images, boxes, ours, strict=True):
        with torch.inference_mode():
            answer = whole(
                pixel_values=parts.normalised(
                    image[None], (made.SIDE, made.SIDE), cpu(), parts.GroundedSam2.mean, parts.GroundedSam2.std
                ),
                input_boxes=(corners.cpu() * scale)[None],
                multimask_output=False,
            )
        other = parts.full_size(answer.pred_masks[0, :, 0], (HEIGHT, WIDTH))
        assert (other != masks).mean() < 1e-3
        assert 0.01 < masks.mean() < 0.99


def test_sam3_agrees_with_the_whole_network_run_on_one_image(models: Path, images: Any) -> None:
    """Here a batch is encoded once for all words; the decoding is written anew."""
    ours = parts.Sam3.load(find_models(models, "sam3"), score=0.2, most=4).find(images, WORDS)
    whole = transformers.Sam3Model.from_pretrained(models / "sam3").eval()
    tokenizer = transformers.AutoTokenizer.from_pretrained(models / "sam3")
    for image, (masks, word) in zip(images, ours, strict=True):
        assert len(masks) == len(word) > 0
        for k, words in enumerate(("leaves", "stem", "flower")):
            text = tokenizer([words], padding="max_length", max_length=32, return_tensors="pt")
            with torch.inference_mode():
                answer = whole(
                    pixel_values=parts.normalised(image[None], (56, 56), cpu(), parts.Sam3.mean, parts.Sam3.std), **text
                )
            score = (answer.pred_logits[0].sigmoid() * answer.presence_logits[0].sigmoid()).numpy()
            best = [q for q in np.argsort(-score)[:4] if score[q] >= 0.2]
            other = [
                cv2.resize(answer.pred_masks[0, q].sigmoid().numpy(), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
                for q in best
            ]
            assert (word == k).sum() == len(best)
            if best:
                assert ((np.stack(other) > 0.5) != masks[word == k]).mean() < 2e-3


@pytest.mark.parametrize("method", ["grounded-sam2", "sam3"])
def test_the_whole_chain_from_a_folder_of_weights(models: Path, tmp_path: Path, images: Any, method: Any) -> None:
    poses = np.stack([look_at([1.0, 0.1 * k, 0.3], [0, 0, 0]) for k in range(3)])
    camera = Intrinsics(width=WIDTH, height=HEIGHT, fx=60, fy=60, cx=39.5, cy=23.5)
    capture, reported = Capture(np.ones(images.shape[:3]), camera, poses, images), []
    params = Params(score=0.0, most=6)
    masks = segment(capture, models, params, method=method, cache=tmp_path, progress=lambda *at: reported.append(at))
    assert masks.labels.shape == (3, HEIGHT, WIDTH)
    assert set(np.unique(masks.labels)) <= {0, PLANT, FLOWER}
    assert (masks.labels > 0).any(axis=(1, 2)).all()
    assert masks.source == {"grounded-sam2": "Grounding DINO and SAM 2", "sam3": "SAM 3"}[method]
    assert reported[-1] == (3, 3)
    batched = segment(capture, models, Params(score=0.0, most=6, batch=3), method=method)
    assert (batched.labels != masks.labels).mean() < 2e-3  # sums in another order
    kept = segment(capture, models, params, method=method, cache=tmp_path)
    np.testing.assert_array_equal(kept.labels, masks.labels)


def test_too_many_words_are_refused(networks: Any, images: Any) -> None:
    with pytest.raises(InputError, match="at most 256 tokens"):
        networks.boxes(images[:1], ["stem."] * 200)


def test_too_little_gpu_memory_is_said(networks: Any, images: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 3 GiB")

    monkeypatch.setattr(networks, "boxes", full)
    with pytest.raises(InputError, match="smaller batch"):
        networks.find(images, WORDS)


@pytest.mark.parametrize(
    ("part", "damage"),
    [
        ("grounding-dino", "cut"),
        ("grounding-dino", "lacking"),
        ("sam2", "lacking"),
        ("sam2", "other"),
        ("sam3", "lacking"),
    ],
)
def test_weights_that_are_no_good_are_refused(models: Path, tmp_path: Path, part: str, damage: str) -> None:
    shutil.copytree(models, tmp_path / "models")
    path = tmp_path / "models" / part / "model.safetensors"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:1000])
    elif damage == "other":
        tensors.save_file({"something": torch.zeros(3)}, path, metadata={"format": "pt"})
    else:
        numbers = tensors.load_file(path)
        del numbers[next(n for n in sorted(numbers) if "mask_decoder" in n or "decoder.layers.0" in n)]
        tensors.save_file(numbers, path, metadata={"format": "pt"})
    kind, method = (parts.Sam3, "sam3") if part == "sam3" else (parts.GroundedSam2, "grounded-sam2")
    with pytest.raises(InputError, match=rf"{part}.*[Dd]ownload"):
        kind.load(find_models(tmp_path / "models", method), score=0.2, most=5)
