"""Where the weights of the mask networks lie on disk, and how to get them. Nothing is ever downloaded from here."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anther.errors import InputError, MissingExtra, bad_input

Method = Literal["grounded-sam2", "sam3"]
"""Ways from words to masks: Grounding DINO and SAM 2 (the paper's), or SAM 3 alone."""

INSTALL = "pip install 'anther[segmentation]'"


@dataclass(frozen=True, slots=True)
class Network:
    """A published network.

    Attributes:
        name: what it is called.
        model_types: `model_type` in its config.json.
        download: the command that brings its weights; the braces stand for the models folder.
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


def find_models(folder: Path, method: Method = "grounded-sam2") -> tuple[Path, ...]:
    """Find what a method needs in a folder, at most two levels below it, by what config.json says.

    Returns:
        the folder of each of the method's networks, with config.json and *.safetensors.

    Raises:
        MissingExtra: torch or transformers is not installed.
        InputError: weights are missing (the message says how to get them), or there are several of a kind.
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
