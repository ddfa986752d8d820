"""What every evaluation shares: its options, its cases, its progress and its results.

    args = options(__doc__, quick="two plants", jobs="plants at a time", out="runs/loads", own={"--plants": (24, "")})
    rows = run_cases(one_plant, cases, args.out, args.jobs, crashed)
    finish(args, metrics(rows), "What became of them.", markdown(heads, lines))

Results are a flat JSON file {metric: number} (--json), tables on standard output, progress on standard error.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args

from rich.console import Console, RenderableType
from rich.progress import track

from anther.core.files import replacing, write_json, write_text
from anther.history import sweep
from anther.history.sweep import Function, Job
from anther.plant import Crop
from evaluation.tables import say

Row = dict[str, Any]
T = TypeVar("T")
DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))
"""Real plants and references; no part of Anther."""
CROPS: tuple[Crop, ...] = ("tomato", "pepper")
FOLDER = "folder"
"""Key of a row under which the folder is that its function wrote into."""
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a process that is to keep to one core."""
HIDDEN = argparse.SUPPRESS
"""The help of an option that only the script itself uses."""


def options(
    description: str | None,
    *,
    quick: str,
    seed: tuple[int, str] | None = None,
    jobs: str = "",
    out: str = "",
    done: bool = False,
    figure: str = "",
    figures: str = "",
    data: str = "",
    own: Mapping[str, Any] = MappingProxyType({}),
) -> argparse.Namespace:
    """Return what the command line asks for: --json, --quick, and those of the others that a script has.

    Args:
        description: the script's docstring.
        quick: what --quick does.
        seed: the default of --seed, and of what it is the seed.
        jobs: of what --jobs are done at a time.
        out: the default of --out, where finished cases are kept.
        done: whether there is --done, a file for cases that are too many for one day.
        figure: what is drawn into the file of --figure.
        figures: what is drawn into the folder of --figures.
        data: the folder within `DATA` that --data stands for.
        own: options of the script: "--name" -> (default or type, help) or (default or type, help, choices); a default
            of False makes a switch, a tuple takes several. Or a mapping of what argparse takes.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help=quick)
    shared: dict[str, Any] = {"--seed": seed, "--jobs": jobs and (1, f"{jobs} at a time")}
    shared["--out"] = out and (Path(out), "where what is done is kept")
    shared["--done"] = done and (Path, "take what was done before from this file, and add what is new to it")
    shared["--figure"] = figure and (Path, f"draw {figure} into this file")
    shared["--figures"] = figures and (Path, f"draw {figures} into this folder")
    shared["--data"] = data and (DATA / data, "folder of the real data")
    for name, asked in {**shared, **own}.items():
        if asked:
            parser.add_argument(name, **(asked if isinstance(asked, Mapping) else _argument(*asked)))
    return parser.parse_args()


def _argument(default: Any, words: str, choices: Collection[Any] | None = None) -> dict[str, Any]:
    """Return what argparse takes for an option of this default or type."""
    if default is False:
        return {"action": "store_true", "help": words}
    if isinstance(default, type):
        return {"type": default, "help": words, "choices": choices}
    if isinstance(default, tuple):
        return {"nargs": "*", "default": default, "type": type((*default, "")[0]), "help": words, "choices": choices}
    return {"type": type(default), "default": default, "help": words, "choices": choices}


def plants_named(words: Iterable[str]) -> list[tuple[Crop, int]]:
    """Return (species, seed) of plants such as tomato-10.

    Raises:
        SystemExit: a word that is no such plant.
    """
    found = []
    for word in words:
        name, _, seed = word.partition("-")
        species = next((crop for crop in get_args(Crop) if crop == name), None)
        if species is None or not seed.isdigit():
            raise SystemExit(f"--plants: got {word}; allowed: tomato-SEED or pepper-SEED. Example: pepper-10.")
        found.append((species, int(seed)))
    return found


def by_turns(count: int, first: int) -> list[tuple[Crop, int]]:
    """Return (species, seed) of `count` plants, tomatoes and peppers by turns, from a seed on."""
    return [(CROPS[k % 2], first + k // 2) for k in range(count)]


def finish(args: argparse.Namespace, metrics: Mapping[str, Any], *parts: RenderableType) -> None:
    """Print lines and tables, and write the metrics to the file of --json."""
    say(parts)
    if args.json:
        write_json(args.json, metrics)


def save(figure: Any, path: Path, dpi: int = 110) -> None:
    """Write a matplotlib figure, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi)


def progress(values: Iterable[T], words: str, total: int | None = None) -> Iterator[T]:
    """Yield values and draw how far it is on standard error."""
    total = len(values) if total is None and isinstance(values, Collection) else total
    yield from track(values, words, total, console=Console(stderr=True))


def git(*words: str) -> str:
    """Return what git says."""
    return subprocess.run(["git", *words], capture_output=True, text=True, check=True).stdout.strip()


def in_processes(function: Callable[[Any], T], cases: Sequence[Any], jobs: int, words: str) -> list[T]:
    """Return what a function makes of every case, several at a time; nothing is kept."""
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return list(progress(pool.map(function, cases), words, len(cases)))


def run_cases(
    function: Function,
    cases: Iterable[Mapping[str, Any]],
    out: Path,
    jobs: int,
    crashed: Callable[[str], Row],
    before: Path | None = None,
) -> list[Row]:
    """Return what a function made of every case, in their order. What was done before is not done again.

    Args:
        function: takes a case and an empty folder and returns its row; it stands in a module, which workers import.
        cases: as mappings.
        out: folder of the sweep; after a change of the code, delete it.
        jobs: cases at a time, a process each.
        crashed: reason -> what the row of a case holds whose function raised. It is said, and tried again next time:
            one trial's bug must not end a run of hours.
        before: file of cases done before, with the commit of each, one a line: they are not done again, whatever the
            code is now, and new ones are added. Their rows have no `FOLDER`.
    """
    asked = [dict(case) for case in cases]
    known = _read_done(before) if before and before.exists() else {}
    new = [case for case in asked if _key(case) not in known]
    commit = git("log", "-1", "--first-parent", "--format=%h", "--", "src") if before else ""
    done = sweep.run(function, new, out, workers=jobs, tries=1, again=True) if new else []
    for job in (job for job in done if job.result is None):
        print(f"crashed: {job.row}: {job.reason}")
    if before and new:
        added = [{"case": job.row, "commit": commit, "row": job.result} for job in done if job.result is not None]
        lines = known | {_key(line["case"]): line for line in added}
        before.parent.mkdir(parents=True, exist_ok=True)
        write_text(before, "".join(f"{json.dumps(lines[key])}\n" for key in sorted(lines)))
    made = dict(zip(map(_key, new), _rows(done, out, crashed), strict=True))
    return [made[_key(case)] if _key(case) in made else {**case, **known[_key(case)]["row"]} for case in asked]


def _key(case: Mapping[str, Any]) -> str:
    return json.dumps(case, sort_keys=True)


def _read_done(path: Path) -> dict[str, Any]:
    """Return by case what `run_cases` wrote of it."""
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return {_key(line["case"]): line for line in lines}


def kept(out: Path, crashed: Callable[[str], Row]) -> list[Row]:
    """Return what became of every case that was ever done in a sweep's folder; `crashed` as above."""
    return _rows([job for job in sweep.read(out) if job.state != "waiting"], out, crashed)


def _rows(jobs: list[Job], out: Path, crashed: Callable[[str], Row]) -> list[Row]:
    results = [crashed(str(job.reason)) if job.result is None else job.result for job in jobs]
    return [{**job.row, **row, FOLDER: str(out / "tasks" / job.key)} for job, row in zip(jobs, results, strict=True)]


def failed(reason: str) -> Row:
    """Return what stands for a trial whose program crashed."""
    return {"success": False, "failure": "crashed", "message": reason}


def lost(reason: str) -> Row:
    """Return what stands for a plant whose program crashed."""
    return {"lost": f"crashed: {reason}"}
