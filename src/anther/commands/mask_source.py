"""The choice between the masks of colour and geometry and those of pretrained networks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from anther.capture import Capture
    from anther.geometry import Box
    from anther.masks import Masks
    from anther.pipeline import FindMasks, Params
    from anther.runs import Advance

MaskSource = Literal["colour", "grounded-sam2", "sam3"]


def mask_finder(source: MaskSource, models: Path, params: Params, cache: Path | None) -> FindMasks | None:
    """Return what finds the masks, or None for the default of the pipeline.

    Args:
        source: what the user chose.
        models: folder of the networks' weights.
        params: of every stage.
        cache: folder that keeps the networks' masks, or None.

    Raises:
        MissingExtra: torch or transformers is not installed.
        InputError: weights are missing. Both are said before any other work is done.
    """
    if source == "colour":
        return None
    from anther.masks import by_words, without_ground

    by_words.find_models(models, source)

    def find(capture: Capture, workspace: Box | None, progress: Advance) -> Masks:
        seen = by_words.segment(capture, models, params.by_words, method=source, cache=cache, progress=progress)
        return without_ground(seen, capture, workspace, params.masks)

    return find
