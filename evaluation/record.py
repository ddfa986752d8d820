"""Measure what reports show, and write it into them.

    python -m evaluation.record docs/reports/limits.md [MORE PAGES]

A report names the commands that make its numbers, each in a pair of markers:

    <!-- measured: python -m evaluation.judge.limits --plants 4 -->
    <!-- end -->

What the command prints, its tables as Markdown, goes between them with the commit, and its metrics into
docs/results/SCRIPT.json. The commit is the last that changed `src`, which is what is measured. What it has already made
is not made again, so that a run that was stopped goes on: to have it made again, empty the space between the markers.
Where a command fails the next is run all the same.
"""

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import time
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

from anther.core.files import read_json, write_json, write_text
from evaluation.harness import git

CODE = ("src", "evaluation", "tools")
MEASURED = re.compile(r"<!-- measured: (?P<command>[^\n]+) -->\n(?P<found>.*?)<!-- end -->", re.DOTALL)
KEPT = Path("build/measured")


def measure(command: str, commit: str) -> str:
    """Run a command of a report, keep its metrics; return what goes between its markers."""
    _, _, module, *options = shlex.split(command)  # python -m MODULE
    name = module.rpartition(".")[2]
    out, metrics = KEPT / commit / name, KEPT / commit / f"{name}.json"
    spec = find_spec(f"{module}.__main__") if Path(module.replace(".", "/")).is_dir() else find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    source = Path(spec.origin).read_text()
    own = ["--out", str(out)] if 'out="runs/' in source and "--out" not in options else []
    metrics.parent.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    said = subprocess.run(
        [sys.executable, "-m", module, *options, *own, "--json", str(metrics)],
        env=os.environ | {"COLUMNS": "1000"},  # no cell is broken over two lines
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    minutes = (time.perf_counter() - begin) / 60
    record = {
        "command": command,
        "commit": commit,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
        "metrics": read_json(metrics),
    }
    write_json(Path("docs/results") / f"{name}.json", record)
    shutil.rmtree(out, ignore_errors=True)  # what is kept for a run that goes on; another begins anew
    return f"\n`{command}` at {commit}, {record['date']}, {minutes:.1f} min:\n\n{markdown(said)}\n\n"


def markdown(said: str) -> str:
    """Return what a console was told: tables as they are, each other line a paragraph; no progress.

    toppra warns of a step that it then tries again, with all its matrices: what is told up to there is not a result.
    """
    said = re.split(r"^\[WARN\].*\n", said, flags=re.MULTILINE)[-1]
    lines = [re.sub(r" {2,}", " ", line.strip()) for line in said.splitlines() if "━" not in line]
    text = ""
    for line in filter(None, lines):
        row = line.startswith("|") and text.endswith("|")
        text += f"\n{line}" if row else f"\n\n{line}"
    return text.strip()


def record(page: Path, commit: str) -> list[str]:
    """Measure a page's commands anew, but those that this commit has measured; return those that failed."""
    failed = []
    for command, found in MEASURED.findall(page.read_text()):
        if f"` at {commit}," in found:
            continue
        print(f"{page.name}: {command}", flush=True)
        begin = f"<!-- measured: {command} -->\n"
        try:
            told = measure(command, commit)
        except subprocess.CalledProcessError:
            failed.append(command)
            continue
        write_text(page, page.read_text().replace(f"{begin}{found}<!-- end -->", f"{begin}{told}<!-- end -->"))
    return failed


def main(*pages: str) -> None:
    """Measure the commands of reports, at the last commit that changed `src`."""
    if changed := git("status", "--porcelain", "--", *CODE):
        sys.exit(f"Changed and in no commit:\n{changed}\nCommit it first: reports say which commit they are of.")
    commit = git("log", "-1", "--first-parent", "--format=%h", "--", "src")
    failed = [command for page in pages for command in record(Path(page), commit)]
    if failed:
        sys.exit("\n".join(["These failed, and what their pages show is as it was:", *failed]))


if __name__ == "__main__":
    main(*sys.argv[1:])
