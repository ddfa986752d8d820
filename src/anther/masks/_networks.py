"""What the mask networks share: reading weights, preparing images, masks at full size. Without torchvision.

Import it late: torch and transformers take seconds. Dimensions: B images, H x W pixels, K masks.
"""

from __future__ import annotations

from collections.abc import Iterator
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


def chosen_device(wanted: str) -> torch.device:
    """Return the device for "auto" (the GPU when there is one), "cpu" or "cuda".

    Raises:
        InputError: there is no such device.
    """
    if wanted == "cuda" and not torch.cuda.is_available():
        raise bad_input("device", given="cuda", allowed="a GPU that torch sees", do="Use auto or cpu.")
    return torch.device("cuda" if wanted != "cpu" and torch.cuda.is_available() else "cpu")


def load_network(kind: Any, folder: Path, device: torch.device) -> Any:
    """Return a network of transformers with the weights in a folder, all of them, ready to run.

    Args:
        kind: its class in transformers.
        folder: with config.json and *.safetensors.
        device: where it shall run.

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
    return network.to(device).eval()


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
    grey levels, aspect ratio not kept.

    Args:
        images: the images.
        size: height, width that the network was trained with [px].
        device: where the network runs.
        mean, std: of red, green, blue, 0..1, that the network was trained with.
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
    """Turn torch's error into one that says what to do.

    Raises:
        InputError: so many views at a time do not fit the GPU's memory.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise bad_input(
            "batch",
            given=f"{views} views at a time: {str(error).splitlines()[0]}",
            allowed="what fits the GPU's memory",
            do="Choose a smaller batch, smaller models or device cpu.",
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
