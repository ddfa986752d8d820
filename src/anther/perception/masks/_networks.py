"""The mask networks, without torchvision. Import it late: torch and transformers take seconds.

Grounding DINO finds boxes for words, and SAM 2 outlines what they hold; SAM 3 outlines everything that fits a word.
Dimensions: B images, H x W pixels, Q queries of the detector, T text tokens, K boxes or masks in an image.
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

from anther.core.errors import InputError, bad_input


def load_network(kind: Any, folder: Path) -> Any:
    """Return a network, of its class in transformers, with the weights in a folder, on the GPU where there is one.

    Raises:
        InputError: a file is missing or damaged, or the weights are of another network.
    """
    with _quietly():
        network, notes = load_part(kind, folder, use_safetensors=True, output_loading_info=True)
    missing = notes["missing_keys"]
    if missing:  # they would be random numbers
        raise bad_input(
            str(folder),
            given=f"weights that lack {len(missing)} of the network's, such as {min(missing)}",
            allowed=f"weights of {kind.__name__}",
            do="Download them again.",
        )
    return network.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def load_part(kind: Any, folder: Path, **options: Any) -> Any:
    """Return what a class of transformers reads from a folder: a tokenizer, an image processor, a network.

    Raises:
        InputError: a file is missing, damaged or of another kind.
    """
    try:
        return kind.from_pretrained(folder, local_files_only=True, **options)
    except (OSError, ValueError, RuntimeError, SafetensorError) as error:
        raise InputError(f"{folder}: {kind.__name__} cannot be read ({error}). Download the folder again.") from error


def normalised(
    images: NDArray[Any], size: tuple[int, int], device: torch.device, mean: tuple[float, ...], std: tuple[float, ...]
) -> Tensor:
    """Return images (B, H, W, 3) uint8 as SAM 2 and SAM 3 want them: (B, 3, height, width), resized and normalised.

    Their official image processors need torchvision. This resizes as they do: bilinear with antialiasing, rounded to
    grey levels, aspect ratio not kept. `size` [px], `mean` and `std` (0..1) are those of the network's training.
    """
    pixels = torch.tensor(np.asarray(images), device=device).permute(0, 3, 1, 2).float()
    pixels = functional.interpolate(pixels, size, mode="bilinear", antialias=True).round().clamp(0, 255) / 255
    return (pixels - pixels.new_tensor(mean)[:, None, None]) / pixels.new_tensor(std)[:, None, None]


def full_size(values: Tensor, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return masks (K, H, W) of the image's size from a network's (K, h, w): bilinear, then positive or not."""
    larger = functional.interpolate(values[:, None], size, mode="bilinear", align_corners=False)
    return (larger[:, 0] > 0).cpu().numpy()


def sides(size: Any) -> tuple[int, int]:
    """Return height and width from a config's image size, which is one number or two."""
    return (int(size), int(size)) if isinstance(size, int) else (int(size[0]), int(size[1]))


@contextmanager
def told_when_memory_is_full(views: int) -> Iterator[None]:
    """Turn torch's error into one that advises.

    Raises:
        InputError: that many views at a time do not fit the GPU's memory.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise bad_input(
            "batch",
            given=f"{views} views at a time: {str(error).splitlines()[0]}",
            allowed="what fits the GPU's memory",
            do="Choose a smaller batch, smaller models, or hide the GPU: CUDA_VISIBLE_DEVICES= (empty).",
        ) from error


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep transformers from drawing bars and from warning that a video network is read for single images."""
    log = transformers.utils.logging
    before = log.get_verbosity()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        yield
    finally:
        log.set_verbosity(before)
        log.enable_progress_bar()


class GroundedSam2:
    """Both networks, ready to run on a `device`.

    Attributes:
        mean, std: of red, green, blue, 0..1: ImageNet's, which SAM 2's image processor uses.
    """

    mean, std = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

    def __init__(
        self, detector: Any, tokenizer: Any, processor: Any, outliner: Any, *, score: float, most: int
    ) -> None:
        self.device = torch.device(detector.device)
        self._detector, self._tokenizer, self._processor = detector, tokenizer, processor
        self._outliner = outliner
        self._score, self._most = score, most

    @classmethod
    def load(cls, folders: Sequence[Path], *, score: float, most: int) -> GroundedSam2:
        """Read both networks; boxes have a `score`, 0..1, or more, and are the best `most` of an image."""
        grounding_dino, sam2 = folders
        return cls(
            load_network(transformers.AutoModelForZeroShotObjectDetection, grounding_dino),
            load_part(transformers.AutoTokenizer, grounding_dino),
            load_part(transformers.GroundingDinoImageProcessorPil, grounding_dino),
            load_network(transformers.Sam2Model, sam2),
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
        features = self._outliner.get_image_embeddings(normalised(images, side, self.device, self.mean, self.std))
        scale = torch.tensor([side[1] / width, side[0] / height] * 2, device=self.device)
        for image, corners in enumerate(boxes):
            here = [feature[image : image + 1] for feature in features]
            some = 16  # boxes at a time: their masks at full size take 59 MB at 1280 x 720
            for start in range(0, len(corners), some):
                part = slice(start, start + some)
                answer = self._outliner(
                    image_embeddings=here, input_boxes=(corners[part] * scale)[None], multimask_output=False
                )
                masks[image][part] = full_size(answer.pred_masks[0, :, 0], (height, width))
        return masks


def words_of_tokens(ids: Tensor) -> Tensor:
    """Return which of the words each token (T,) belongs to; -1 for [CLS], [SEP] and the dots that end the words."""
    ends = (1012, 1029)  # . and ?
    word = torch.cumsum(torch.isin(ids, torch.tensor(ends)), 0)
    special = (101, 102, 1012, 1029)  # BERT's [CLS] [SEP] . ? in Grounding DINO's vocabulary
    return torch.where(torch.isin(ids, torch.tensor(special)), -1, word)


def chosen_boxes(
    logits: Tensor, boxes: Tensor, word_of_token: Tensor, *, size: tuple[int, ...], score: float, most: int
) -> tuple[Tensor, Tensor]:
    """Return the best boxes (K, 4) x0 y0 x1 y1 [px] of one image and (K,) which words each fits best.

    A box fits words as well as its best token among theirs; the detector's own decoding joins the tokens of several
    words into one phrase instead ("leaves stem"), which would leave the label open.

    Args:
        logits: (Q, >= T) of each query for each token.
        boxes: (Q, 4) centre x, y, width, height as shares of the image, whose `size` is height, width [px].
        word_of_token: (T,) see `words_of_tokens`.
        score, most: least score, 0..1; greatest number.
    """
    chance = logits[:, : len(word_of_token)].sigmoid()
    of_words = [chance[:, word_of_token == k].amax(dim=1) for k in range(int(word_of_token.max()) + 1)]
    best, word = torch.stack(of_words, dim=1).max(dim=1)
    kept = torch.argsort(best, descending=True, stable=True)[:most]
    kept = kept[best[kept] >= score]
    centre, half = boxes[kept, :2], boxes[kept, 2:] / 2
    corners = torch.cat([centre - half, centre + half], dim=1).clamp(0, 1)
    return corners * corners.new_tensor([size[1], size[0]] * 2), word[kept]


class Sam3:
    """The network, ready to run on a `device`.

    Attributes:
        mean, std: of red, green, blue, 0..1, as in SAM 3's image processor.
    """

    mean = std = (0.5, 0.5, 0.5)

    def __init__(self, network: Any, tokenizer: Any, *, score: float, most: int) -> None:
        self.device = torch.device(network.device)
        self._network, self._tokenizer = network, tokenizer
        self._score, self._most = score, most

    @classmethod
    def load(cls, folders: Sequence[Path], *, score: float, most: int) -> Sam3:
        """Read the network; masks have a `score`, 0..1, or more, and are the best `most` for one of the words."""
        network = load_network(transformers.Sam3Model, folders[0])
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
            pixels = normalised(images, side, self.device, self.mean, self.std)
            seen = self._network.get_vision_features(pixel_values=pixels)
            for word in words:
                for image, masks in enumerate(self._outlines(seen, word, images.shape[:3])):
                    found[image].append(masks)
        return [(np.concatenate(masks), np.repeat(np.arange(len(words)), list(map(len, masks)))) for masks in found]

    def _outlines(self, seen: Any, word: str, shape: tuple[int, ...]) -> list[NDArray[np.bool_]]:
        """Return the masks (K, H, W) of each of the B images for one word. The score: transformers' own decoding."""
        tokens = 32  # that SAM 3's processor pads every text to
        text = self._tokenizer(
            [word.rstrip(".")] * shape[0],
            padding="max_length",
            max_length=tokens,
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
