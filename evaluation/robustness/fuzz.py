"""Spoil inputs and options of every command, in seeded ways, and count what must never happen.

python -m evaluation.robustness.fuzz --quick                    300 inputs
python -m evaluation.robustness.fuzz --count 100000             for a night; goes on where it stopped

A traceback is any exception that reaches the top, or an exit code other than 0, 1 and 2; a hang takes more than
20 s; over memory takes more than 4 GB; silently wrong is a change that had to be refused or to make no difference, and
did not, and any NaN in a result; half-written is a temporary file left behind. The files are small and the commands run
in one process, which is started again when it dies or does not come back. `trial` and `row` are tried up to their
first view.
"""

from __future__ import annotations

import io
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from anther.cli import row_visit
from anther.cli.main import main as anther
from anther.core import StageFailure
from anther.sim import simulated_cell
from evaluation.harness import HIDDEN, finish, options
from evaluation.robustness import fuzz_inputs
from evaluation.robustness.fuzz_inputs import COMMAND_LINES, KNOWN, VALUES, Known
from evaluation.tables import markdown

PATIENCE, LOST = 20, 90
"""Seconds after which a command is told to stop, and after which a process that does not is killed."""
MEMORY = 4e9
FRESH = 5000
"""Inputs after which a new process goes on, so that the memory which one takes is not another's."""
TAIL = 2**20
"""The last outcome of a log lies in so many bytes of its end."""
HOLDS = {
    "tracebacks": "a traceback",
    "hangs": f"a hang: more than {PATIENCE} s",
    "over_memory": f"more than {MEMORY / 1e9:.0f} GB",
    "silent_wrong": "an odd value taken without a word, or NaN in a result",
    "half_written": "a result half written",
}


class Hang(BaseException):
    """A command took longer than PATIENCE."""


@dataclass(frozen=True)
class Outcome:
    """What became of one input: its number, the command, what was spoilt, how it ended, and which of HOLDS it broke."""

    number: int
    words: list[str]
    what: str
    code: int | None
    broke: str = ""
    said: str = ""


@contextmanager
def patience(seconds: int) -> Iterator[None]:
    """Raise `Hang` in what takes longer."""

    def late(_: int, __: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def no_cell(*_: Any, **__: Any) -> None:
    """Stand in for the simulated cell: a visit ends before its first view."""
    raise StageFailure("unreachable", "no cell here")


def run(words: list[str]) -> tuple[int | None, str, str]:
    """Return (exit code, or None for a traceback or hang; standard output; standard error or traceback)."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            with patience(PATIENCE):
                return anther(words), out.getvalue(), err.getvalue()
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else 1, out.getvalue(), err.getvalue()
        except Hang:
            return None, out.getvalue(), "hang"
        except BaseException:
            return None, out.getvalue(), traceback.format_exc()


def spoilt(number: int, base: Path, folder: Path) -> tuple[list[str], str, Known | None]:
    """Prepare input `number` in a folder; return (words, what was spoilt, what must come of it if that is known)."""
    rng = np.random.default_rng([7, number])
    shutil.copytree(base, folder)
    if number % 10 == 0:
        known = KNOWN[(number // 10) % len(KNOWN)]
        line = next(line for line in COMMAND_LINES if line.startswith(known.line))
        path = folder / known.file
        path.write_bytes(known.change(path.read_bytes()))
        return shlex.split(line), f"known: {known.file}", known
    words = shlex.split(COMMAND_LINES[int(rng.integers(0, len(COMMAND_LINES)))])
    files = [p for w in words[1:] for p in ((folder / w).rglob("*") if (folder / w).is_dir() else [folder / w])]
    files = sorted(p for p in files if p.is_file())
    if not files or rng.random() < 0.25:
        return *_odd_option(words, fuzz_inputs.options_of(folder, words[0]), rng), None
    path = files[int(rng.integers(0, len(files)))]
    return words, f"{path.relative_to(folder)}: {fuzz_inputs.spoil(path, rng)}", None


def _odd_option(words: list[str], options: list[str], rng: np.random.Generator) -> tuple[list[str], str]:
    if not options or rng.random() < 0.2:
        at = int(rng.integers(1, len(words))) if len(words) > 1 else 1
        words = [*words[:at], *words[at + 1 :]] if rng.random() < 0.5 else [*words, "x"]
        return words, "words"
    option, value = options[int(rng.integers(0, len(options)))], VALUES[int(rng.integers(0, len(VALUES)))]
    return [*words, option, value], f"{option} {value}"


@cache
def answer(line: tuple[str, ...], base: Path) -> Any:
    """What a command says of the inputs as they are."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(base, folder, dirs_exist_ok=True)
        os.chdir(folder)
        code, out, err = run(list(line))
        os.chdir(base)
    assert code == 0, f"{line}: {code} {err}"
    return fuzz_inputs.plain_answer(out)


def examine(number: int, base: Path) -> Outcome:
    """Run one input and judge it."""
    with tempfile.TemporaryDirectory() as above:
        folder = Path(above) / "case"
        words, what, known = spoilt(number, base, folder)
        wanted = answer(tuple(words), base) if known is not None and not known.refused else None
        os.chdir(folder)
        try:
            code, out, err = run(words)
        finally:
            os.chdir(base)
        left = [path for path in folder.rglob(".*") if path.is_file()]
    said = (err or out)[-1500:]
    wrong = known is not None and known.refused != (code == 2)
    wrong |= wanted is not None and fuzz_inputs.plain_answer(out) != wanted
    wrong |= code == 0 and "--json" in words and not fuzz_inputs.is_finite(out)
    broke = ""
    if err == "hang":
        broke = "hangs"
    elif code not in (0, 1, 2) or "Traceback" in err + out:
        broke = "tracebacks"
    elif "not enough memory" in err or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 > MEMORY:
        broke = "over_memory"
    elif left:
        broke, said = "half_written", str(left[0].name)
    elif wrong:
        broke = "silent_wrong"
    return Outcome(number, words, what, code, broke, said if broke else "")


def work(base: Path, first: int, last: int, log: Path) -> None:
    """Examine inputs first to last - 1; one line of the log an input."""
    resource.setrlimit(resource.RLIMIT_AS, (int(4 * MEMORY), int(4 * MEMORY)))  # mapped, not used, of numba and Embree
    simulated_cell.build = row_visit.build_row = no_cell
    with log.open("a", encoding="utf-8") as stream:
        for number in range(first, last):
            stream.write(json.dumps(asdict(examine(number, base))) + "\n")
            stream.flush()


def supervised(base: Path, first: int, last: int, log: Path) -> None:
    """Let a process work, and start another behind the input at which it died or stood still."""
    while first < last:
        words = ["--work", str(base), str(first), str(min(last, first + FRESH)), "--out", str(log.parent)]
        command = [sys.executable, "-m", "evaluation.robustness.fuzz", *words]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        seen, since = first, time.monotonic()
        while process.poll() is None and time.monotonic() - since < LOST:
            time.sleep(1)
            if (done := first_undone(log, first)) > seen:
                seen, since = done, time.monotonic()
        stuck = process.poll() is None
        process.kill()
        _, err = process.communicate()
        first, ended_well = first_undone(log, first), process.returncode == 0
        if first < last and not ended_well:
            lost = Outcome(first, [], "the process", None, "hangs" if stuck else "tracebacks", err[-1500:])
            with log.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(asdict(lost)) + "\n")
            first += 1


def outcomes(log: Path) -> list[dict[str, Any]]:
    """Read the log, but for a line that is still being written."""
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True) if log.exists() else []
    return [json.loads(line) for line in lines if line.endswith("\n")]


def first_undone(log: Path, first: int) -> int:
    """Return the number after the last one in the log, of which the end alone is read: it is asked every second."""
    if not log.exists():
        return first
    with log.open("rb") as stream:
        stream.seek(max(log.stat().st_size - TAIL, 0))
        lines = [line for line in stream.read().splitlines(keepends=True)[-3:] if line.endswith(b"\n")]
    return max([first, *(json.loads(line)["number"] + 1 for line in lines[-1:])])


def metrics(rows: list[dict[str, Any]]) -> dict[str, int]:
    """Count what was found."""
    counts = {"inputs": len(rows), **{name: sum(row["broke"] == name for row in rows) for name in sorted(HOLDS)}}
    return counts | {"refused": sum(row["code"] == 2 for row in rows), "done": sum(row["code"] == 0 for row in rows)}


def main() -> None:
    """Run, print what was found, and write the metrics."""
    own = {
        "--count": (5000, "of inputs"),
        "--first": (0, "number of the first input: a seed"),
        "--work": {"nargs": 3, "help": HIDDEN},
    }
    args = options(__doc__, quick="300 inputs", out="runs/fuzz", own=own)
    log = args.out.resolve() / "fuzz.jsonl"
    if args.work:
        return work(Path(args.work[0]), int(args.work[1]), int(args.work[2]), log)
    log.parent.mkdir(parents=True, exist_ok=True)
    last = args.first + (300 if args.quick else args.count)
    with tempfile.TemporaryDirectory() as base:
        fuzz_inputs.write_inputs(Path(base))
        supervised(Path(base), first_undone(log, args.first), last, log)
    rows = outcomes(log)
    found = metrics(rows)
    others = found["inputs"] - found["refused"] - found["done"] - sum(found[name] for name in HOLDS)
    lines = [
        ("all", found["inputs"]),
        ("refused with one line", found["refused"]),
        ("accepted: it made no difference, or a valid one", found["done"]),
        ("a failure that was told", others),
        *((f"must not be: {words}", found[name]) for name, words in HOLDS.items()),
    ]
    table = markdown(("what became of an input", "inputs"), [(words, f"{count:,}") for words, count in lines])
    broken = (
        f"{row['broke']}: input {row['number']}: anther {shlex.join(row['words'])} [{row['what']}] {row['said'][-700:]}"
        for row in rows
        if row["broke"]
    )
    return finish(args, found, *broken, table)


if __name__ == "__main__":
    main()
