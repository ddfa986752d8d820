"""What a run folder holds: every stage's result that was reached, read back for the report and the viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from anther.core.choices import Crop
from anther.core.errors import bad_input
from anther.core.files import existing, read_object
from anther.core.runs import FILES
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.masks import Masks
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.perception.stem.confidence import doubt
from anther.plant.model import PlantModel
from anther.plant.visit import Result, TruthRecord, Visit, median
from anther.pollination.execution import Trial
from anther.pollination.grasp import Grasp, load_grasps
from anther.pollination.response import Response
from anther.pollination.shake import ShakePlan
from anther.show.style import quantity

PARAMS, TIMING, ARM = "00_params.json", "timing.json", "arm.json"
"""What the run was asked for; time and memory of each stage; the arm and gripper of a cell file, its keep-out boxes."""
EXECUTED, FILM, SUMMARY = "09_executed_shake.json", "09_shake.webp", "trial.json"
"""The shake as it was carried out; its end, as the side camera saw it; the visit in numbers."""


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
        seconds, cpu_seconds: stage -> time it took, processor time [s].
        peak_mb: stage -> the most memory the process held [MB].
        attempts: what was tried before something else, and why it was not that.
        shake: as it was planned.
        executed: as it was carried out; other than planned where it was watched.
        trial: the execution's record.
        visit: what was done and what came of it (trial.json), or None for an offline reconstruction.
        numbers: (J,) what the file of an imported skeleton calls each node; None: they are numbered from 0.
    """

    folder: Path
    params: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    cpu_seconds: dict[str, float] = field(default_factory=dict)
    peak_mb: dict[str, float] = field(default_factory=dict)
    attempts: tuple[str, ...] = ()
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
    visit: Visit | None = None
    numbers: NDArray[Any] | None = None

    @property
    def title(self) -> str:
        """What the report is called."""
        if self.visit is None:
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
        parts = [self.params.get("started", ""), f"Anther {self.params.get('anther', '')}", self.folder.name]
        if self.visit is not None:
            parts.append(f"{self.arm}{', simulated' if self.simulated or self.visit.simulated_as else ''}")
        return " · ".join(map(str, parts))

    @property
    def shaken(self) -> ShakePlan | None:
        """The shake as it was carried out, or as planned."""
        return self.executed or self.shake

    @property
    def grasp(self) -> Grasp | None:
        """The grasp that was carried out, or else the best one."""
        return next(iter(self.grasps), None) if self.shaken is None else self.shaken.grasp

    @property
    def held_rank(self) -> int | None:
        """Which of the grasps, from 0, was carried out or planned; None where none of them was."""
        if self.shaken is None:
            return None
        held = self.shaken.grasp.T_world_flange  # the shake was chosen among those that were not tried yet
        return next((i for i, g in enumerate(self.grasps) if np.allclose(g.T_world_flange, held)), None)

    @property
    def crop(self) -> Crop | None:
        """What was shaken, if it is known."""
        name = self.params.get("plant")
        return name if name in get_args(Crop) else None

    @property
    def headline(self) -> str:
        """The result of the trial in a few words."""
        return "" if self.visit is None else self.visit.result_words

    @property
    def result(self) -> Result:
        """The result of the trial."""
        return "failed" if self.visit is None else self.visit.result

    def answers(self) -> tuple[Finding, ...]:
        """Return whether it was held, harmed, and whether the flowers moved; nothing where nobody asked.

        In simulation the truth says it; of a real plant gripper and side camera do, as far as they can.
        """
        v = self.visit
        if v is None or v.held is None:
            return ()
        between = ""
        if v.truth is not None:
            organ = str((v.grasp and v.grasp.organ) or "nothing").replace("_", " ")
            slip = v.truth.true_slip
            slipped = f"it slipped {1000 * slip:.1f} mm" if np.isfinite(slip) else "not shaken"
            between = f"simulated: {organ} between the pads, {slipped}"
        elif v.grip is not None:
            between = f"the pads stood {1000 * v.grip.opening:.1f} mm apart, with {v.grip.force:.0f} N"
        return (
            Finding("Was the main stem held?", v.held, "yes" if v.held else "no", between),
            Finding("Was the plant harmed?", v.unharmed, *_harm(v.truth)),
            Finding("Did the flowers move?", v.flowers_moved, *_moved(v)),
        )

    def headline_facts(self) -> list[tuple[str, str]]:
        """Return (name, value) pairs that sum up the trial."""
        facts: list[tuple[str, str]] = []
        grasp = self.visit and self.visit.grasp
        if grasp and grasp.organ:
            facts.append(("organ grasped", grasp.organ.replace("_", " ")))
        if grasp and grasp.arc_length is not None:
            facts.append(("grasp height along the stem", f"{100 * grasp.arc_length:.0f} cm"))
        if self.shaken is not None:
            how = "shake, planned" if self.executed is None else "shake, executed"
            facts.append((how, f"{quantity(self.shaken.amplitude, 'm')} at {quantity(self.shaken.frequency, 'Hz')}"))
        if self.visit is not None:
            motions = {"predicted": self.visit.predicted_amplitude, "measured": self.visit.measured_amplitude}
            medians = {how: median(amplitude) for how, amplitude in motions.items()}
            known = {how: value for how, value in medians.items() if value is not None}
            facts += [(f"{how} flower amplitude (median)", quantity(value, "m")) for how, value in known.items()]
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


def _harm(truth: TruthRecord | None) -> tuple[str, str]:
    if truth is None:
        return "not known", ""
    said = f"yes: {truth.harmed}" if truth.harmed else "no"
    strains = {"stem": truth.true_stem_strain, "pedicel": truth.true_pedicel_strain, "base": truth.true_base_strain}
    words = ", ".join(f"{strain:.2%} in {kind}s" for kind, strain in strains.items())
    loads = f"strain {words}, leaves {quantity(truth.true_leaf_acceleration, 'm/s2')}"
    lost = f"{truth.flowers_lost} of {len(truth.true_flower_acceleration_peak)} flowers lost"
    return said, f"simulated: {lost}; harm has a probability of {truth.harm_probability:.1%}; {loads}"


def _moved(v: Visit) -> tuple[str, str]:
    if v.felt_flower_acceleration_median is not None:
        flowers = f"{v.felt_flowers} flower{'s' * (v.felt_flowers != 1)}"
        why = f"measured by the side camera: median {v.felt_flower_acceleration_median:.1f} m/s² over {flowers}"
        return "yes" if v.flowers_moved else "hardly", why
    t = v.truth
    if t is None or t.true_flower_acceleration_median is None:
        return "not known" if v.flowers_moved is None else "no", ""
    shares = f"{t.share_above_5_ms2:.0%} above 5 and {t.share_above_10_ms2:.0%} above 10 m/s²"
    freed = f"pollen freed {t.pollen_freed_median:.1%} ({t.pollen_freed_low:.1%} to {t.pollen_freed_high:.1%})"
    least = f"median {t.true_flower_acceleration_median:.1f} m/s², least {t.true_flower_acceleration_least:.1f}"
    return "yes" if v.flowers_moved else "hardly", f"simulated: {least}; {shares}; {freed}"


def watched_words(visit: Visit) -> str:
    """Return in a line how the shake was raised, or why the plan alone was carried out."""
    if visit.plan_alone_because is not None:
        return f"no, the plan alone was carried out: {visit.plan_alone_because}"
    duration, last = (visit.shake and visit.shake.duration) or 0.0, visit.last
    assert last is not None, "a shake is watched step by step"
    felt = median(last.flower_acceleration)
    seen = "no flower was measured" if felt is None else f"flowers measured {felt:.1f} m/s² (median)"
    return (
        f"{len(visit.steps)} steps in {duration:.1f} s; at the end {seen}, {last.share_of_limit:.0%} "
        f"of the closest limit ({last.closest_limit}). {visit.ended_by}"
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

    tree, main = there(FILES["skeleton"], Skeleton.load), there(FILES["stem"], Stem.load)
    if tree is not None and main is not None and len(main.organ) != len(tree.nodes):
        given, allowed = f"organs of {len(main.organ)} nodes", f"of the {len(tree.nodes)} of {FILES['skeleton']}"
        raise bad_input(str(folder / FILES["stem"]), given=given, allowed=allowed, do="Find the stem again.")
    timing = there(TIMING, read_object, {})
    return RunResults(
        folder=folder,
        params=read_object(folder / PARAMS),
        **{name: timing.get(name, {}) for name in ("seconds", "cpu_seconds", "peak_mb")},
        attempts=tuple(timing.get("attempts", ())),
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
        visit=there(SUMMARY, Visit.load),
    )
