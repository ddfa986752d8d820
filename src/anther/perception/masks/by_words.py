"""Masks of what words name, by pretrained networks: the paper's Grounding DINO and SAM 2, or SAM 3.

Needs the extra anther[segmentation] and weights on disk (docs/masks.md); nothing is ever downloaded from here. The
networks see single images: pot and soil that they take along are for geometry to remove. Dimensions: V views, B of them
at a time, K found in a view, H x W pixels.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.errors import InputError, MissingExtra, StageFailure, bad_input
from anther.perception.capture import Capture
from anther.perception.masks import FLOWER, LEAST_PIXELS, PLANT, Masks

Method = Literal["grounded-sam2", "sam3"]
"""Ways from words to masks: Grounding DINO and SAM 2 (the paper's), or SAM 3 alone."""

INSTALL = "pip install 'anther[segmentation]'"


@dataclass(frozen=True, slots=True)
class Network:
    """A published network.

    Attributes:
        name: what it is called.
        model_types: `model_type` in its config.json.
        download: the command that brings its weights; the braces are replaced by the models folder.
        facts: size and licence, from the model card.
    """

    name: str
    model_types: tuple[str, ...]
    download: str
    facts: str


# The published SAM 2 and SAM 3 call themselves "video" and serve single images too.
NETWORKS: dict[Method, tuple[Network, ...]] = {
    "grounded-sam2": (
        Network(
            "Grounding DINO",
            ("grounding-dino", "mm-grounding-dino"),
            "hf download IDEA-Research/grounding-dino-tiny --exclude '*.bin' --local-dir {}/grounding-dino",
            "689 MB, Apache-2.0",
        ),
        Network(
            "SAM 2",
            ("sam2", "sam2_video"),
            "hf download facebook/sam2.1-hiera-small --exclude '*.pt' --local-dir {}/sam2",
            "184 MB, Apache-2.0",
        ),
    ),
    "sam3": (
        Network(
            "SAM 3",
            ("sam3", "sam3_video"),
            "hf download facebook/sam3 --exclude '*.pt' --local-dir {}/sam3",
            "3.4 GB, SAM License; accept it on the model's page, then hf auth login",
        ),
    ),
}
"""What each method needs, in the order in which `find_models` returns the folders."""


@dataclass(frozen=True, slots=True)
class Params:
    """What is looked for, and when it counts as found.

    Attributes:
        plant: words whose objects become plant; lower case, each ending in "." (that is how Grounding DINO separates
            them). The paper uses "leaves".
        flower: words whose objects become flower.
        score: least score of a find, 0..1. transformers' decoding has 0.25 for Grounding DINO, 0.3 for SAM 3.
        most: number of the best finds in a view that count; bounds time and memory.
        batch: views at a time; None means 4 on a GPU, 1 on a CPU.
    """

    plant: tuple[str, ...] = ("leaves.", "stem.")
    flower: tuple[str, ...] = ("flower.",)
    score: float = 0.25
    most: int = 64
    batch: int | None = None

    def __post_init__(self) -> None:
        check_range("score", self.score, 0, 1)
        check_range("most finds", self.most, 1, 900)
        check_range("batch", self.batch or 1, 1, 64)
        if not self.plant:
            raise bad_input("plant words", given="none", allowed="one or more", do="For example: leaves. stem.")
        for words in (*self.plant, *self.flower):
            if words != words.lower() or not words[:-1].strip() or words[-1] != "." or set(".?") & set(words[:-1]):
                raise bad_input(
                    "words", given=f"'{words}'", allowed="lower case, one '.' at the end", do="As 'leaves.'."
                )


class Networks(Protocol):
    """What finds objects by words in images; `device` is a torch.device."""

    device: Any

    def find(self, images: NDArray[Any], words: Sequence[str]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return for each image (B, H, W, 3) its masks (K, H, W) bool and (K,) which of the words each fits."""
        ...


def segment(
    capture: Capture,
    models: Path,
    params: Params | None = None,
    *,
    method: Method = "grounded-sam2",
    cache: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Masks:
    """Return the plant and flower pixels of every view, as the networks see them.

    Args:
        capture: the views; colour is needed.
        models: folder that holds the networks' weights (`find_models`).
        params: see `Params`.
        method: which networks.
        cache: folder that keeps the result; a second call with the same images, weights and parameters reads it.
        progress: called with (views done, V).

    Raises:
        MissingExtra: torch or transformers is not installed.
        InputError: no colour, weights missing or not usable.
        StageFailure: `no_plant_found` when the networks find next to nothing.
    """
    params = params or Params()
    if capture.rgb is None:
        raise bad_input("masks", given="a capture without colour", allowed="colour images", do="Use --masks colour.")
    folders = find_models(models, method)
    kept = None if cache is None else cache / f"{method}-{_key(capture.rgb, folders, params)}.npz"
    masks = None if kept is None else _read(kept)
    source = " and ".join(network.name for network in NETWORKS[method])
    if masks is None:
        networks = load_networks(method, folders, params)
        batch = params.batch or (4 if networks.device.type == "cuda" else 1)
        masks = Masks(label_views(capture.rgb, networks, params, batch=batch, progress=progress), source)
        if kept is not None:
            with suppress(OSError):  # a capture on a read-only disk is segmented anew each time
                masks.save(kept)
    found = int((masks.labels > 0).sum())
    if found < LEAST_PIXELS:
        raise StageFailure(
            "no_plant_found",
            f"masks: {source} found {found} pixels of {' '.join((*params.plant, *params.flower))} in {capture.views} "
            f"views; at least {LEAST_PIXELS} are needed. Try other words or a score below {params.score:g}.",
        )
    return masks


def label_views(
    rgb: NDArray[Any],
    networks: Networks,
    params: Params,
    *,
    batch: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.uint8]:
    """Return the labels (V, H, W) of images (V, H, W, 3): what each of the words found, in `paint`'s order."""
    words = (*params.plant, *params.flower)
    label_of = np.array([PLANT] * len(params.plant) + [FLOWER] * len(params.flower), dtype=np.uint8)
    labels = np.zeros(rgb.shape[:3], dtype=np.uint8)
    for start in range(0, len(rgb), batch):
        for view, (masks, word) in enumerate(networks.find(rgb[start : start + batch], words), start):
            paint(labels[view], masks, label_of[word])
        if progress is not None:
            progress(min(start + batch, len(rgb)), len(rgb))
    return labels


def paint(image: NDArray[np.uint8], masks: NDArray[np.bool_], labels: NDArray[np.uint8]) -> None:
    """Write labels (K,) into `image` (H, W) where masks (K, H, W) are set, the smallest mask on top.

    So a flower lies on the leaf behind it, and a flower's mask that ran over the whole plant lies below its leaves.
    """
    for k in np.argsort(-masks.sum(axis=(1, 2)), kind="stable"):
        image[masks[k]] = labels[k]


def load_networks(method: Method, folders: Sequence[Path], params: Params) -> Networks:
    """Return the networks of `find_models`'s folders, ready to run; torch, an extra, takes seconds to import.

    Raises:
        InputError: weights are not usable.
    """
    if method == "sam3":
        from anther.perception.masks._networks import Sam3 as Chosen  # noqa: PLC0415
    else:
        from anther.perception.masks._networks import GroundedSam2 as Chosen  # noqa: PLC0415
    return Chosen.load(folders, score=params.score, most=params.most)


def find_models(folder: Path, method: Method = "grounded-sam2") -> tuple[Path, ...]:
    """Find what a method needs in a folder, at most two levels below it, by its config.json.

    Returns:
        the folder of each of the method's networks, with config.json and *.safetensors.

    Raises:
        MissingExtra: torch or transformers is not installed.
        InputError: weights are missing (the message explains how to get them), or there are several of a kind.
    """
    absent = [name for name in ("torch", "transformers") if importlib.util.find_spec(name) is None]
    if absent:
        raise MissingExtra(f"masks: {method} needs {' and '.join(absent)}. Install with: {INSTALL}")
    configs = [path for depth in ("", "*/", "*/*/") for path in folder.glob(f"{depth}config.json")]
    kinds = {path.parent: _model_type(path) for path in configs if any(path.parent.glob("*.safetensors"))}
    found = [[f for f, kind in kinds.items() if kind in network.model_types] for network in NETWORKS[method]]
    lacking = [network for network, folders in zip(NETWORKS[method], found, strict=True) if not folders]
    if lacking:
        names = " and ".join(network.name for network in lacking)
        commands = "\n".join(f"  {network.download.format(folder)}   # {network.facts}" for network in lacking)
        raise InputError(
            f"masks: {folder} lacks the weights (config.json and *.safetensors) of {names}. "
            f"Anther downloads nothing by itself; get them once with\n{commands}\n"
            f"and name the folder: --models {folder}. After that it works offline (HF_HUB_OFFLINE=1 is fine)."
        )
    for network, folders in zip(NETWORKS[method], found, strict=True):
        if len(folders) > 1:
            raise bad_input(
                "models",
                given=f"{len(folders)} folders of {network.name}: {', '.join(map(str, sorted(folders)))}",
                allowed="one",
                do="Move the others to a folder of their own.",
            )
    return tuple(folders[0] for folders in found)


def fingerprint(folders: Sequence[Path]) -> str:
    """Return a text that changes when other weights are put there: from their configs, file sizes and dates."""
    digest = hashlib.blake2b(digest_size=16)
    for folder in folders:
        digest.update((folder / "config.json").read_bytes())
        for path in sorted(folder.glob("*.safetensors")):
            facts = path.stat()
            digest.update(f"{path.name} {facts.st_size} {facts.st_mtime_ns}".encode())
    return digest.hexdigest()


def _model_type(path: Path) -> str:
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    return str(config.get("model_type", "")) if isinstance(config, dict) else ""


def _key(rgb: NDArray[Any], folders: Sequence[Path], params: Params) -> str:
    """Return a name for the masks of these images by these weights with these parameters."""
    settings = {name: value for name, value in asdict(params).items() if name != "batch"}
    digest = hashlib.blake2b(f"{settings} {rgb.shape} {fingerprint(folders)}".encode(), digest_size=8)
    digest.update(np.ascontiguousarray(rgb).data)
    return digest.hexdigest()


def _read(path: Path) -> Masks | None:
    """Return the kept masks; None when there are none, or when the file is damaged."""
    with suppress(InputError):
        return Masks.load(path)
    return None
