"""Where the weights of the mask networks lie on disk, and how to get them. Nothing is ever downloaded from here."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from dataclasses import dataclass
from pathlib import Path

from anther.errors import InputError, MissingExtra, bad_input

DETECTORS, OUTLINERS = ("grounding-dino", "mm-grounding-dino"), ("sam2", "sam2_video")
"""`model_type` in config.json. The published SAM 2 folders call themselves sam2_video and serve single images too."""

INSTALL = "pip install 'anther[segmentation]'"

DOWNLOADS = {
    DETECTORS: "hf download IDEA-Research/grounding-dino-tiny --exclude '*.bin' --local-dir {}/grounding-dino"
    "   # 689 MB, Apache-2.0",
    OUTLINERS: "hf download facebook/sam2.1-hiera-small --exclude '*.pt' --local-dir {}/sam2   # 184 MB, Apache-2.0",
}
"""How to get a network that is missing; the braces stand for the models folder. Sizes and licences: model cards."""


@dataclass(frozen=True, slots=True)
class Models:
    """The folders of the two networks, each with config.json and *.safetensors."""

    detector: Path
    outliner: Path

    def fingerprint(self) -> str:
        """Return a text that changes when other weights are put there: their configs, file sizes and dates."""
        digest = hashlib.blake2b(digest_size=16)
        for folder in (self.detector, self.outliner):
            digest.update((folder / "config.json").read_bytes())
            for path in sorted(folder.glob("*.safetensors")):
                facts = path.stat()
                digest.update(f"{path.name} {facts.st_size} {facts.st_mtime_ns}".encode())
        return digest.hexdigest()


def find_models(folder: Path) -> Models:
    """Find Grounding DINO and SAM 2 in a folder, at most two levels below it, by what their config.json says.

    Raises:
        MissingExtra: torch or transformers is not installed.
        InputError: weights are missing (the message says how to get them), or there are several of a kind.
    """
    missing = [name for name in ("torch", "transformers") if importlib.util.find_spec(name) is None]
    if missing:
        raise MissingExtra(f"masks: Grounding DINO and SAM 2 need {' and '.join(missing)}. Install with: {INSTALL}")
    kinds = [
        (path.parent, _model_type(path)) for depth in ("", "*/", "*/*/") for path in folder.glob(f"{depth}config.json")
    ]
    found = {
        wanted: [f for f, kind in kinds if kind in wanted and any(f.glob("*.safetensors"))] for wanted in DOWNLOADS
    }
    lacking = [command.format(folder) for wanted, command in DOWNLOADS.items() if not found[wanted]]
    if lacking:
        raise InputError(
            f"masks: {folder} lacks weights (a folder with config.json and *.safetensors each). Anther downloads "
            "nothing by itself; get them once with\n  "
            + "\n  ".join(lacking)
            + f"\nand name the folder: --models {folder}. After that no network is needed (HF_HUB_OFFLINE=1 is fine)."
        )
    for folders in found.values():
        if len(folders) > 1:
            raise bad_input(
                "models",
                given=f"{len(folders)} networks of one kind: {', '.join(map(str, sorted(folders)))}",
                allowed="one Grounding DINO and one SAM 2",
                do="Move the others to a folder of their own.",
            )
    return Models(found[DETECTORS][0], found[OUTLINERS][0])


def _model_type(path: Path) -> str:
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    return str(config.get("model_type", "")) if isinstance(config, dict) else ""
