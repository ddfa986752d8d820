"""What a run folder holds: every stage's result that was reached, read back for the report and the viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import bad_input
from anther.core.files import existing, read_object
from anther.core.runs import FILES
from anther.history import Result, TrialRecord, read_record, result_of, result_words
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.masks import Masks
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.perception.stem.confidence import doubt
from anther.plant.limits import Crop
from anther.plant.model import PlantModel
from anther.pollination.execution import Trial
from anther.pollination.grasp import Grasp, load_grasps
from anther.pollination.response import Response
from anther.pollination.shake import ShakePlan
from anther.show.style import quantity

PARAMS, TIMING = "00_params.json", "timing.json"
"""What the run was asked for; the time each stage took."""
EXECUTED, FILM, SUMMARY, VISIT = "09_executed_shake.json", "09_shake.webp", "trial.json", "visit.json"
"""The shake as it was carried out; its end, as the side camera saw it; the trial in numbers; what the history keeps."""


class Finding(NamedTuple):
    """One of the three questions about a trial, its answer in a few words, and the numbers behind it.

    `good` is whether it is what was wanted; None where it never came to that.
    """

    question: str
    good: bool | None
    said: str
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class RunResults:
    """The results in a run folder. A stage that was not reached is None.

    Attributes:
        folder: the run's folder.
        params: what the run was asked for (00_params.json).
        summary: the verdict (trial.json), or None for an offline reconstruction.
        seconds: stage -> time it took [s].
        costs: "cpu_s" and "peak_mb" -> stage -> processor time [s] and most memory [MB], as far as they were kept.
        shake: as it was planned.
        executed: as it was carried out; other than planned where it was watched.
        trial: the execution's record.
        visit: what the history keeps of the trial (visit.json).
        numbers: (J,) what the file of an imported skeleton calls each node; None: they are numbered from 0.
    """

    folder: Path
    params: dict[str, Any] = field(default_factory=dict)
    summary: dict[str, Any] | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    costs: dict[str, dict[str, float]] = field(default_factory=dict)
    capture: Capture | None = None
    masks: Masks | None = None
    cloud: Cloud | None = None
    skeleton: Skeleton | None = None
    stem: Stem | None = None
    flowers: Flowers | None = None
    grasps: tuple[Grasp, ...] = ()
    plant: PlantModel | None = None
    shake: ShakePlan | None = None
    executed: ShakePlan | None = None
    trial: Trial | None = None
    response: Response | None = None
    visit: TrialRecord | None = None
    numbers: NDArray[Any] | None = None

    @property
    def title(self) -> str:
        """What the report is called."""
        if self.summary is None:
            return f"reconstruction of {Path(str(self.params.get('capture', self.folder))).name}"
        label = self.params.get("label")
        return f"{self.params.get('plant', 'plant')}, {label or 'seed ' + str(self.params.get('seed', '?'))}"

    @property
    def arm(self) -> str:
        """Name of the arm; runs of older versions have none: a Sawyer's."""
        return str(self.params.get("arm") or "sawyer")

    @property
    def simulated(self) -> bool:
        """Whether it was in the simulated cell."""
        return self.params.get("cell", "simulated") == "simulated"

    @property
    def subtitle(self) -> str:
        """When and with what."""
        return f"{self.params.get('started', '')} · Anther {self.params.get('anther', '')} · {self.folder.name}"

    @property
    def shaken(self) -> ShakePlan | None:
        """The shake as it was carried out, or as planned."""
        return self.executed or self.shake

    @property
    def grasp(self) -> Grasp | None:
        """The grasp that was carried out, or else the best one."""
        return next(iter(self.grasps), None) if self.shaken is None else self.shaken.grasp

    @property
    def crop(self) -> Crop | None:
        """What was shaken, if it is known."""
        name = self.params.get("plant")
        return name if name in ("tomato", "pepper") else None

    @property
    def headline(self) -> str:
        """The result of the trial in a few words."""
        s = self.summary or {}
        return result_words(held_unharmed(s), s.get("flowers_moved"), s.get("failure"))

    @property
    def result(self) -> Result:
        """The result of the trial."""
        s = self.summary or {}
        return result_of(held_unharmed(s), s.get("flowers_moved"))

    def answers(self) -> tuple[Finding, ...]:
        """Return whether it was held, harmed, and whether the flowers moved; nothing for older runs.

        In simulation the truth says it; of a real plant gripper and side camera do, as far as they can.
        """
        s = self.summary or {}
        if "held" not in s:
            return ()
        opening, slip, between = s.get("grip_opening_m"), s.get("true_slip_m"), ""
        if s["unharmed"] is not None:
            organ = str(s.get("organ_grasped") or "nothing").replace("_", " ")
            slipped = "not shaken" if slip is None or not np.isfinite(slip) else f"it slipped {1000 * slip:.1f} mm"
            between = f"simulated: {organ} between the pads, {slipped}"
        elif opening is not None:
            between = f"the pads stood {1000 * opening:.1f} mm apart, with {s['grip_force_n']:.0f} N"
        return (
            Finding("Was the main stem held?", s["held"], "yes" if s["held"] else "no", between),
            Finding("Was the plant harmed?", s["unharmed"], *_harm(s)),
            Finding("Did the flowers move?", s["flowers_moved"], *_moved(s)),
        )

    def headline_facts(self) -> list[tuple[str, str]]:
        """Return (name, value) pairs that sum up the trial."""
        facts: list[tuple[str, str]] = []
        summary = self.summary or {}
        if summary.get("organ_grasped"):
            facts.append(("organ grasped", str(summary["organ_grasped"]).replace("_", " ")))
        if summary.get("grasp_arc_length_m") is not None:
            facts.append(("grasp height along the stem", f"{100 * summary['grasp_arc_length_m']:.0f} cm"))
        if self.shaken is not None:
            how = "shake, planned" if self.executed is None else "shake, executed"
            facts.append((how, f"{quantity(self.shaken.amplitude, 'm')} at {quantity(self.shaken.frequency, 'Hz')}"))
        for key in ("predicted", "measured"):
            value = summary.get(f"{key}_flower_amplitude_median_m")
            if value is not None:
                facts.append((f"{key} flower amplitude (median)", quantity(value, "m")))
        return facts

    def notes(self) -> list[str]:
        """Return what the stages want the user to know, in order."""
        stages = (self.cloud, self.skeleton, self.stem, self.flowers, self.shake, self.response)
        notes = [str(note) for stage in stages for note in getattr(stage, "notes", ())]
        return notes + [note for note in self.doubts() if note not in notes]

    def doubts(self) -> list[str]:
        """Return a line for the main stem and for the best grasp if their confidence is low."""
        stem = () if self.stem is None else doubt(self.stem.confidence)
        return [*stem, *(note for grasp in self.grasps[:1] for note in doubt(grasp.confidence, "best grasp"))]


def held_unharmed(summary: dict[str, Any]) -> bool:
    """Return whether a trial held the plant and, as far as anybody knows, did not harm it, by its trial.json."""
    return bool(summary.get("held") and summary["unharmed"] is not False)


def _harm(s: dict[str, Any]) -> tuple[str, str]:
    if s["unharmed"] is None:
        return "not known", ""
    said = "no" if s["unharmed"] else f"yes: {s['harmed']}"
    strains = ", ".join(f"{s[f'true_{kind}_strain']:.2%} in {kind}s" for kind in ("stem", "pedicel", "base"))
    loads = f"strain {strains}, leaves {quantity(s['true_leaf_acceleration_ms2'], 'm/s2')}"
    return said, f"simulated: harm has a probability of {s['harm_probability']:.1%}; {loads}"


def _moved(s: dict[str, Any]) -> tuple[str, str]:
    measured = s.get("felt_flower_acceleration_median_ms2")
    if measured is not None:
        count = s["felt_flowers"]
        why = f"measured by the side camera: median {measured:.1f} m/s² over {count} flower{'s' * (count != 1)}"
        return "yes" if s["flowers_moved"] else "hardly", why
    felt, least = (s.get(f"true_flower_acceleration_{which}_ms2") for which in ("median", "least"))
    if felt is None or least is None:
        return "not known" if s["flowers_moved"] is None else "no", ""
    shares = f"{s['share_above_5_ms2']:.0%} above 5 and {s['share_above_10_ms2']:.0%} above 10 m/s²"
    freed = f"pollen freed {s['pollen_freed_median']:.1%} ({s['pollen_freed_low']:.1%} to {s['pollen_freed_high']:.1%})"
    said = "yes" if s["flowers_moved"] else "hardly"
    return said, f"simulated: median {felt:.1f} m/s², least {least:.1f}; {shares}; {freed}"


def watched_words(s: dict[str, Any]) -> str:
    """Return in a line how the shake was raised, or why the plan alone was carried out."""
    if s["plan_alone_because"] is not None:
        return f"no, the plan alone was carried out: {s['plan_alone_because']}"
    felt = s["step_flower_acceleration_median_ms2"]
    seen = "no flower was measured" if felt is None else f"flowers measured {felt:.1f} m/s² (median)"
    return (
        f"{s['shake_steps']} steps in {s['shaking_seconds']:.1f} s; at the end {seen}, {s['step_share_of_limit']:.0%} "
        f"of the closest limit ({s['step_closest_limit']}). {s['shake_ended_by']}"
    )


def read_run(folder: Path | str) -> RunResults:
    """Read every result in a run folder.

    Raises:
        InputError: the folder is missing or is not a run folder, or a result in it cannot be read.
    """
    folder = existing(folder)
    if not (folder / PARAMS).is_file():
        allowed = f"a run folder (it holds {PARAMS})"
        raise bad_input("run", given=str(folder), allowed=allowed, do="Name one, e.g. runs/demo.")

    def there(name: str, read: Callable[[Path], Any], otherwise: Any = None) -> Any:
        return read(folder / name) if (folder / name).exists() else otherwise

    seconds, costs = _timing(there(TIMING, read_object, {}))
    tree, main = there(FILES["skeleton"], Skeleton.load), there(FILES["stem"], Stem.load)
    if tree is not None and main is not None and len(main.organ) != len(tree.nodes):
        given, allowed = f"organs of {len(main.organ)} nodes", f"of the {len(tree.nodes)} of {FILES['skeleton']}"
        raise bad_input(str(folder / FILES["stem"]), given=given, allowed=allowed, do="Find the stem again.")
    return RunResults(
        folder=folder,
        params=read_object(folder / PARAMS),
        summary=there(SUMMARY, read_object),
        seconds=seconds,
        costs=costs,
        grasps=tuple(there(FILES["grasp"], load_grasps, ())),
        capture=there(FILES["capture"], Capture.load),
        masks=there(FILES["masks"], Masks.load),
        cloud=there(FILES["cloud"], Cloud.load),
        skeleton=tree,
        stem=main,
        flowers=there(FILES["flowers"], Flowers.load),
        plant=there(FILES["plant model"], PlantModel.load),
        shake=there(FILES["shake plan"], ShakePlan.load),
        executed=there(EXECUTED, ShakePlan.load),
        trial=there(FILES["execution"], Trial.load),
        response=there(FILES["response"], Response.load),
        visit=there(VISIT, read_record),
    )


def _timing(read: dict[str, Any]) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Return stage -> seconds, and cost -> stage -> value, of timing.json.

    A stage has its seconds alone, or a table of them with its costs; costs may also be tables of their own.
    """
    costs = {name: dict(read[name]) if isinstance(read.get(name), dict) else {} for name in ("cpu_s", "peak_mb")}
    seconds = dict[str, float]()
    for stage, value in read.items():
        if stage in costs:
            continue
        seconds[stage] = value["seconds"] if isinstance(value, dict) else value
        if isinstance(value, dict):
            for name, stages in costs.items():
                stages.update({stage: value[name]} if value.get(name) is not None else {})
    return seconds, costs
