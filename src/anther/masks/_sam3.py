"""SAM 3 outlines everything that fits a word, without boxes between. Import it late: torch takes seconds.

Dimensions: B images, H x W pixels, Q queries of the network, K masks in an image.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import transformers
from numpy.typing import NDArray

from anther.masks._networks import (
    chosen_device,
    full_size,
    load_network,
    load_part,
    normalised,
    sides,
    told_when_memory_is_full,
)

SAM3_MEAN = SAM3_STD = (0.5, 0.5, 0.5)
"""Of red, green, blue, 0..1, as in SAM 3's image processor."""

TEXT_LENGTH = 32
"""Tokens that SAM 3's processor pads every text to."""


class Sam3:
    """The network, ready to run.

    Attributes:
        device: where it runs.
    """

    def __init__(self, network: Any, tokenizer: Any, *, score: float, most: int) -> None:
        self.device = torch.device(network.device)
        self._network, self._tokenizer = network, tokenizer
        self._score, self._most = score, most

    @classmethod
    def load(cls, folders: Sequence[Path], *, device: str, score: float, most: int) -> Sam3:
        """Read the network.

        Args:
            folders: of SAM 3.
            device: "auto", "cpu" or "cuda".
            score: least score of a mask, 0..1.
            most: so many of the best masks for each of the words in an image.

        Raises:
            InputError: no such device; a file is missing, damaged, or does not fit the network.
        """
        network = load_network(transformers.Sam3Model, folders[0], chosen_device(device))
        return cls(network, load_part(transformers.AutoTokenizer, folders[0]), score=score, most=most)

    @torch.inference_mode()
    def find(self, images: NDArray[Any], words: Sequence[str]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return for each image (B, H, W, 3) uint8 its masks (K, H, W) bool and (K,) which of the words each fits.

        Raises:
            InputError: the batch is too large for the GPU's memory.
        """
        found: list[list[NDArray[Any]]] = [[] for _ in images]
        with told_when_memory_is_full(len(images)):
            side = sides(self._network.config.vision_config.image_size)
            pixels = normalised(images, side, self.device, SAM3_MEAN, SAM3_STD)
            seen = self._network.get_vision_features(pixel_values=pixels)
            for word in words:
                for image, masks in enumerate(self._outlines(seen, word, images.shape[:3])):
                    found[image].append(masks)
        return [(np.concatenate(masks), np.repeat(np.arange(len(words)), list(map(len, masks)))) for masks in found]

    def _outlines(self, seen: Any, word: str, shape: tuple[int, ...]) -> list[NDArray[np.bool_]]:
        """Return the masks (K, H, W) of each of the B images for one word. The score: transformers' own decoding."""
        text = self._tokenizer(
            [word.rstrip(".")] * shape[0],
            padding="max_length",
            max_length=TEXT_LENGTH,
            truncation=True,
            return_tensors="pt",
        ).to(self.device)
        answer = self._network(vision_embeds=seen, input_ids=text.input_ids, attention_mask=text.attention_mask)
        masks = []
        for score, values in zip(
            answer.pred_logits.sigmoid() * answer.presence_logits.sigmoid(), answer.pred_masks, strict=True
        ):
            kept = torch.argsort(score, descending=True, stable=True)[: self._most]
            masks.append(full_size(values[kept[score[kept] >= self._score]].sigmoid() - 0.5, (shape[1], shape[2])))
        return masks
