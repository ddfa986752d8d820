"""Grounding DINO finds boxes for words, SAM 2 outlines what they hold. Import it late: torch takes seconds.

Dimensions: B images, H x W pixels, Q queries of the detector, T text tokens, K boxes in an image.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import transformers
from numpy.typing import NDArray
from torch import Tensor

from anther.errors import bad_input
from anther.masks._networks import (
    chosen_device,
    full_size,
    load_network,
    load_part,
    normalised,
    sides,
    told_when_memory_is_full,
)

SAM2_MEAN, SAM2_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of red, green, blue, 0..1: ImageNet's, which SAM 2's image processor uses."""

SPECIAL_TOKENS, PHRASE_ENDS = (101, 102, 1012, 1029), (1012, 1029)
"""BERT's [CLS] [SEP] . ? in Grounding DINO's vocabulary; transformers has the same numbers in its model code."""

_BOXES_AT_A_TIME = 16  # bounds the memory of masks at full size: 59 MB at 1280 x 720


class GroundedSam2:
    """Both networks, ready to run.

    Attributes:
        device: where they run.
    """

    def __init__(
        self, detector: Any, tokenizer: Any, processor: Any, outliner: Any, *, score: float, most: int
    ) -> None:
        self.device = torch.device(detector.device)
        self._detector, self._tokenizer, self._processor = detector, tokenizer, processor
        self._outliner = outliner
        self._score, self._most = score, most

    @classmethod
    def load(cls, folders: Sequence[Path], *, device: str, score: float, most: int) -> GroundedSam2:
        """Read both networks.

        Args:
            folders: of Grounding DINO and of SAM 2.
            device: "auto", "cpu" or "cuda".
            score: least score of a box, 0..1.
            most: so many of the best boxes in an image.

        Raises:
            InputError: no such device; a file is missing, damaged, or does not fit the network.
        """
        grounding_dino, sam2 = folders
        where = chosen_device(device)
        return cls(
            load_network(transformers.AutoModelForZeroShotObjectDetection, grounding_dino, where),
            load_part(transformers.AutoTokenizer, grounding_dino),
            load_part(transformers.GroundingDinoImageProcessorPil, grounding_dino),
            load_network(transformers.Sam2Model, sam2, where),
            score=score,
            most=most,
        )

    def find(self, images: NDArray[Any], words: Sequence[str]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return for each image (B, H, W, 3) uint8 its masks (K, H, W) bool and (K,) which of the words each fits.

        Raises:
            InputError: the words are too many for the detector, or the batch too large for the GPU's memory.
        """
        with told_when_memory_is_full(len(images)):
            boxes = self.boxes(images, words)
            masks = self.outlines(images, [corners for corners, _ in boxes])
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
            chosen_boxes(logits, boxes, word_of_token, size=images.shape[1:3], score=self._score, most=self._most)
            for logits, boxes in zip(answer.logits, answer.pred_boxes, strict=True)
        ]

    @torch.inference_mode()
    def outlines(self, images: NDArray[Any], boxes: Sequence[Tensor]) -> list[NDArray[np.bool_]]:
        """Return for each image (B, H, W, 3) the mask (K, H, W) of the object in each of its boxes (K, 4) [px]."""
        height, width = images.shape[1:3]
        masks = [np.zeros((len(corners), height, width), dtype=bool) for corners in boxes]
        if not any(map(len, boxes)):
            return masks
        side = sides(self._outliner.config.prompt_encoder_config.image_size)
        features = self._outliner.get_image_embeddings(normalised(images, side, self.device, SAM2_MEAN, SAM2_STD))
        scale = torch.tensor([side[1] / width, side[0] / height] * 2, device=self.device)
        for image, corners in enumerate(boxes):
            here = [feature[image : image + 1] for feature in features]
            for start in range(0, len(corners), _BOXES_AT_A_TIME):
                part = slice(start, start + _BOXES_AT_A_TIME)
                answer = self._outliner(
                    image_embeddings=here, input_boxes=(corners[part] * scale)[None], multimask_output=False
                )
                masks[image][part] = full_size(answer.pred_masks[0, :, 0], (height, width))
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
