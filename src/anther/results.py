"""What a run folder holds: every stage's result that was reached, read back for the report and the viewer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anther.capture import Capture
from anther.cloud import Cloud
from anther.errors import bad_input
from anther.files import existing, read_json
from anther.flowers import Flowers
from anther.grasp import Grasp, load_grasps
from anther.masks import Masks
from anther.response import Response
from anther.runs import FILES
from anther.skeleton import Skeleton
from anther.stem import Stem
from anther.stem.confidence import doubt
from anther.store.records import TrialRecord
from anther.vibration import ShakePlan


@dataclass(frozen=True, slots=True, eq=False)
class RunResults:
    """The results in a run folder. A stage that was not reached is None.

    Attributes:
        folder: the run's folder.
        params: what the run was asked for (00_params.json).
        summary: the verdict (trial.json), or None for an offline reconstruction.
        seconds: stage -> time it took [s].
        visit: what the history keeps of the trial (visit.json).
    """

    folder: Path
    params: dict[str, Any] = field(default_factory=dict)
    summary: dict[str, Any] | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    capture: Capture | None = None
    masks: Masks | None = None
    cloud: Cloud | None = None
    skeleton: Skeleton | None = None
    stem: Stem | None = None
    flowers: Flowers | None = None
    grasps: tuple[Grasp, ...] = ()
    shake: ShakePlan | None = None
    response: Response | None = None
    visit: TrialRecord | None = None

    @property
    def title(self) -> str:
        """What the report is called."""
        if self.summary is None:
            return f"reconstruction of {Path(str(self.params.get('capture', self.folder))).name}"
        return f"{self.params.get('plant', 'plant')}, seed {self.params.get('seed', '?')}"

    @property
    def subtitle(self) -> str:
        """When and with what."""
        return f"{self.params.get('started', '')} · Anther {self.params.get('anther', '')} · {self.folder.name}"

    def headline_facts(self) -> list[tuple[str, str]]:
        """Return (name, value) pairs that sum up the trial."""
        facts: list[tuple[str, str]] = []
        summary = self.summary or {}
        if summary.get("organ_grasped"):
            facts.append(("organ grasped", str(summary["organ_grasped"]).replace("_", " ")))
        if summary.get("grasp_arc_length_m") is not None:
            facts.append(("grasp height along the stem", f"{100 * summary['grasp_arc_length_m']:.0f} cm"))
        if self.shake is not None:
            facts.append(("shake", f"{1000 * self.shake.amplitude:.2g} mm at {self.shake.frequency:.1f} Hz"))
        for key, name in (("predicted", "predicted flower amplitude"), ("measured", "measured flower amplitude")):
            value = summary.get(f"{key}_flower_amplitude_median_m")
            if value is not None:
                facts.append((name, f"{1000 * value:.2f} mm"))
        return facts

    def notes(self) -> list[str]:
        """Return what the stages want the user to know, in order."""
        stages = (self.cloud, self.skeleton, self.stem, self.flowers, self.shake, self.response)
        notes = [str(note) for stage in stages if stage is not None for note in getattr(stage, "notes", ())]
        return notes + [note for note in self.doubts() if note not in notes]

    def doubts(self) -> list[str]:
        """Return a line for the main stem and for the best grasp if their confidence is low."""
        stem = () if self.stem is None else doubt(self.stem.confidence)
        return [*stem, *(note for grasp in self.grasps[:1] for note in doubt(grasp.confidence, "best grasp"))]


def read_run(folder: Path | str) -> RunResults:
    """Read every result in a run folder.

    Raises:
        InputError: the folder is missing or is not a run folder, or a result in it cannot be read.
    """
    folder = existing(folder)
    if not (folder / "00_params.json").is_file():
        raise bad_input(
            "run", given=str(folder), allowed="a run folder (it holds 00_params.json)", do="Name one, e.g. runs/demo."
        )
    kinds: dict[str, Any] = {
        "capture": Capture, "masks": Masks, "cloud": Cloud, "skeleton": Skeleton, "stem": Stem, "flowers": Flowers,
        "shake plan": ShakePlan, "response": Response,
    }  # fmt: skip
    found = {
        stage.split()[0]: kind.load(folder / FILES[stage])
        for stage, kind in kinds.items()
        if (folder / FILES[stage]).exists()
    }
    grasps = folder / FILES["grasp"]
    timing = folder / "timing.json"
    summary, visit = folder / "trial.json", folder / "visit.json"
    return RunResults(
        folder=folder,
        params=read_json(folder / "00_params.json"),
        summary=read_json(summary) if summary.exists() else None,
        seconds=read_json(timing) if timing.exists() else {},
        grasps=tuple(load_grasps(grasps)) if grasps.exists() else (),
        visit=TrialRecord.of(read_json(visit)) if visit.exists() else None,
        **found,
    )
