"""Grounding DINO and SAM 2 through transformers, without torchvision. Import it late: torch takes seconds.

Dimensions: B images, H x W pixels, Q queries of the detector, T text tokens, K boxes in an image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
import transformers
from numpy.typing import NDArray
from safetensors import SafetensorError
from torch import Tensor
from torch.nn import functional

from anther.errors import InputError, bad_input
from anther.masks.weights import Models

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of red, green and blue, 0..1: SAM 2 was trained on images normalised with these (its preprocessor_config.json)."""

SPECIAL_TOKENS, PHRASE_ENDS = (101, 102, 1012, 1029), (1012, 1029)
"""BERT's [CLS] [SEP] . ? in Grounding DINO's vocabulary; transformers has the same numbers in its model code."""

_BOXES_AT_A_TIME = 16  # bounds the memory of masks at full size: 59 MB at 1280 x 720


class GroundedSam2:
    """Boxes for words by Grounding DINO, outlined by SAM 2.

    Attributes:
        device: where the networks run.
    """

    def __init__(
        self, detector: Any, tokenizer: Any, processor: Any, outliner: Any, *, score: float, most_boxes: int
    ) -> None:
        self.device = torch.device(detector.device)
        self._detector, self._tokenizer, self._processor = detector, tokenizer, processor
        self._outliner = outliner
        self._score, self._most_boxes = score, most_boxes

    @classmethod
    def load(cls, models: Models, *, device: str, score: float, most_boxes: int) -> GroundedSam2:
        """Read both networks from their folders.

        Args:
            models: where they lie.
            device: "auto", "cpu" or "cuda".
            score: least score of a box, 0..1.
            most_boxes: of the best in an image.

        Raises:
            InputError: no such device; a file is missing, damaged, or does not fit the network.
        """
        if device == "cuda" and not torch.cuda.is_available():
            raise bad_input("device", given="cuda", allowed="a GPU that torch sees", do="Use auto or cpu.")
        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        with _quietly():
            detector = _load(transformers.AutoModelForZeroShotObjectDetection, models.detector).to(device)
            outliner = _load(transformers.Sam2Model, models.outliner).to(device)
            tokenizer = _read(transformers.AutoTokenizer, models.detector)
            processor = _read(transformers.GroundingDinoImageProcessorPil, models.detector)
        return cls(detector, tokenizer, processor, outliner, score=score, most_boxes=most_boxes)

    def find(self, images: NDArray[Any], words: Sequence[str]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return for each image (B, H, W, 3) uint8 its masks (K, H, W) bool and (K,) which of the words each fits.

        Raises:
            InputError: the words are too many for the detector, or the GPU's memory too small for the batch.
        """
        try:
            boxes = self.boxes(images, words)
            masks = self.outlines(images, [corners for corners, _ in boxes])
        except torch.OutOfMemoryError as error:
            raise bad_input(
                "batch",
                given=f"{len(images)} views at a time: {str(error).splitlines()[0]}",
                allowed="what fits the GPU's memory",
                do="Choose a smaller batch, smaller models or device cpu.",
            ) from error
        return [(mask, word.cpu().numpy()) for mask, (_, word) in zip(masks, boxes, strict=True)]

    @torch.inference_mode()
    def boxes(self, images: NDArray[Any], words: Sequence[str]) -> list[tuple[Tensor, Tensor]]:
        """Return for each image (B, H, W, 3) its boxes (K, 4) x0 y0 x1 y1 [px] and (K,) which words each fits."""
        text = self._tokenizer([" ".join(words)] * len(images), return_tensors="pt").to(self.device)
        word_of_token = words_of_tokens(text.input_ids[0].cpu())
        if int(word_of_token.max()) + 1 != len(words) or len(word_of_token) > self._detector.config.max_text_len:
            raise bad_input(
                "words",
                given=f"{len(words)} words, {len(word_of_token)} tokens",
                allowed=f"at most {self._detector.config.max_text_len} tokens, at least one in each",
                do="Use fewer or plainer words.",
            )
        seen = self._processor(images=list(images), return_tensors="pt").to(self.device)
        answer = self._detector(**seen, **text)
        return [
            chosen_boxes(logits, boxes, word_of_token, size=images.shape[1:3], score=self._score, most=self._most_boxes)
            for logits, boxes in zip(answer.logits, answer.pred_boxes, strict=True)
        ]

    @torch.inference_mode()
    def outlines(self, images: NDArray[Any], boxes: Sequence[Tensor]) -> list[NDArray[np.bool_]]:
        """Return for each image (B, H, W, 3) the mask (K, H, W) of the object in each of its boxes (K, 4) [px]."""
        height, width = images.shape[1:3]
        side = _sides(self._outliner.config.prompt_encoder_config.image_size)
        masks = [np.zeros((len(k), height, width), dtype=bool) for k in boxes]
        if not any(map(len, boxes)):
            return masks
        features = self._outliner.get_image_embeddings(normalised(images, side, self.device))
        scale = torch.tensor([side[1] / width, side[0] / height] * 2, device=self.device)
        for image, corners in enumerate(boxes):
            here = [feature[image : image + 1] for feature in features]
            for start in range(0, len(corners), _BOXES_AT_A_TIME):
                part = slice(start, start + _BOXES_AT_A_TIME)
                answer = self._outliner(
                    image_embeddings=here, input_boxes=(corners[part] * scale)[None], multimask_output=False
                )
                masks[image][part] = full_size(answer.pred_masks[0], (height, width))[:, 0].cpu().numpy()
        return masks


def words_of_tokens(ids: Tensor) -> Tensor:
    """Return which of the words each token (T,) belongs to; -1 for [CLS], [SEP] and the dots that end the words."""
    word = torch.cumsum(torch.isin(ids, torch.tensor(PHRASE_ENDS)), 0)
    return torch.where(torch.isin(ids, torch.tensor(SPECIAL_TOKENS)), -1, word)


def chosen_boxes(
    logits: Tensor, boxes: Tensor, word_of_token: Tensor, *, size: tuple[int, ...], score: float, most: int
) -> tuple[Tensor, Tensor]:
    """Return the best boxes (K, 4) x0 y0 x1 y1 [px] of one image and (K,) which words each fits best.

    A box fits words as well as its best token among theirs; the detector's own decoding joins the tokens of several
    words into one phrase instead ("leaves stem"), which would leave the label open.

    Args:
        logits: (Q, >= T) of each query for each token.
        boxes: (Q, 4) centre x, y, width, height as shares of the image.
        word_of_token: (T,) see `words_of_tokens`.
        size: height, width of the image [px].
        score: least score, 0..1.
        most: at most so many.
    """
    chance = logits[:, : len(word_of_token)].sigmoid()
    of_words = [chance[:, word_of_token == k].amax(dim=1) for k in range(int(word_of_token.max()) + 1)]
    best, word = torch.stack(of_words, dim=1).max(dim=1)
    kept = torch.argsort(best, descending=True, stable=True)[:most]
    kept = kept[best[kept] >= score]
    centre, half = boxes[kept, :2], boxes[kept, 2:] / 2
    corners = torch.cat([centre - half, centre + half], dim=1).clamp(0, 1)
    return corners * corners.new_tensor([size[1], size[0]] * 2), word[kept]


def normalised(images: NDArray[Any], size: tuple[int, int], device: torch.device) -> Tensor:
    """Return images (B, H, W, 3) uint8 as SAM 2 wants them: (B, 3, height, width), resized and normalised.

    The official image processor needs torchvision. This resizes as it does (bilinear with antialiasing, rounded to
    grey levels, aspect ratio not kept).
    """
    pixels = torch.tensor(np.asarray(images), device=device).permute(0, 3, 1, 2).float()
    pixels = functional.interpolate(pixels, size, mode="bilinear", antialias=True).round().clamp(0, 255) / 255
    mean, std = (pixels.new_tensor(v)[:, None, None] for v in (IMAGENET_MEAN, IMAGENET_STD))
    return (pixels - mean) / std


def full_size(logits: Tensor, size: tuple[int, int]) -> Tensor:
    """Return mask logits (K, 1, h, w) as masks (K, 1, H, W) of the image's own size: bilinear, then positive or not."""
    return functional.interpolate(logits, size, mode="bilinear", align_corners=False) > 0


def _sides(size: Any) -> tuple[int, int]:
    return (int(size), int(size)) if isinstance(size, int) else (int(size[0]), int(size[1]))


def _load(kind: Any, folder: Path) -> Any:
    """Return a network with the weights in a folder, all of them."""
    network, notes = _read(kind, folder, use_safetensors=True, output_loading_info=True)
    missing = notes["missing_keys"]
    if missing:  # they would be random numbers
        raise bad_input(
            str(folder),
            given=f"weights that lack {len(missing)} of the network's, such as {min(missing)}",
            allowed=f"weights of {kind.__name__}",
            do="Download them again.",
        )
    return network


def _read(kind: Any, folder: Path, **options: Any) -> Any:
    try:
        return kind.from_pretrained(folder, local_files_only=True, **options)
    except (OSError, ValueError, RuntimeError, SafetensorError) as error:
        raise InputError(f"{folder}: {kind.__name__} cannot be read ({error}). Download the folder again.") from error


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep transformers from drawing bars and from warning that a SAM 2 video folder is read for single images."""
    log = transformers.utils.logging
    before = log.get_verbosity()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        yield
    finally:
        log.set_verbosity(before)
        log.enable_progress_bar()
