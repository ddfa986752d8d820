"""Fill the measured numbers of README, guides and reports from the JSON of the runs that measured them.

    python -m evaluation.numbers            # every page; prints those that changed

A number in a page stands between two comments. The first names the file under docs/results, the metric and its format:

    <!--long/shaking plan_ms2:.1f-->5.4<!--/-->

It never begins a line, where Markdown would take the comment for a block.

A block becomes a table of a quick run, docs/results/NAME.json, beside its campaign, docs/results/long/NAME.json. Its
head names the file and, after a comma, the metric that counts the cases and what a case is called. A row is a label and
one or more metrics with their formats; a metric that a run lacks shows as "–":

    <!-- compared: shaking, plants plants
    Median flower, arm [m/s²] = arm_ms2:.1f
    Tomatoes (95 % interval) = arm_tomato_ms2:.1f (arm_tomato_low:.1f to arm_tomato_high:.1f)
    -->
    <!-- end -->
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from anther.core.files import read_json, read_object, write_text
from evaluation.tables import METRIC, written

RESULTS = Path("docs/results")
NUMBER = re.compile(rf"<!--(?P<file>[\w/]+) {METRIC}-->[^<]*<!--/-->")
COMPARED = re.compile(
    r"(?P<head><!-- compared: (?P<file>\w+)(?:, (?P<count>\w+) (?P<cases>[^\n]+))?\n(?P<rows>.*?)-->\n).*?<!-- end -->",
    re.DOTALL,
)


def metrics_of(name: str, results: Path = RESULTS) -> Mapping[str, float]:
    """Return the numbers of a run that is filed."""
    return read_object(results / f"{name}.json")["metrics"]


def pages() -> list[Path]:
    """Return the pages with numbers: README, docs/*.md and docs/reports/*.md."""
    return [Path("README.md"), *sorted(Path("docs").glob("*.md")), *sorted(Path("docs/reports").glob("*.md"))]


def filled(text: str) -> str:
    """Return a page's text with the numbers and tables of the last runs.

    Raises:
        FileNotFoundError: no run has such a result.
        KeyError: a result has no such metric, or no run of a table has it.
    """

    def number(found: re.Match[str]) -> str:
        value = read_json(RESULTS / f"{found['file']}.json")["metrics"][found["metric"]]
        return f"<!--{found['file']} {found['metric']}:{found['format']}-->{value:{found['format']}}<!--/-->"

    return NUMBER.sub(number, COMPARED.sub(_compared, text))


def _compared(found: re.Match[str]) -> str:
    """Return a block with its table, the commands below it."""
    files = {"sample": RESULTS / f"{found['file']}.json", "campaign": RESULTS / "long" / f"{found['file']}.json"}
    runs = {name: read_json(path) for name, path in files.items() if path.exists()}
    if not runs:
        raise FileNotFoundError(f"{files['sample']}: no such result, nor {files['campaign']}")
    heads = [_head(name, run, found["count"], found["cases"]) for name, run in runs.items()]
    lines = [_row("", heads), _row("---", ["---"] * len(runs))]
    for row in found["rows"].strip().splitlines():
        label, _, cell = row.rpartition(" = ")
        lines.append(_row(label, _cells(cell, [run["metrics"] for run in runs.values()])))
    commands = [f"{name.capitalize()}: `{run['command']}`" for name, run in runs.items()]
    return f"{found['head']}\n" + "\n".join(lines) + "\n\n" + "\n\n".join(commands) + "\n\n<!-- end -->"


def _head(name: str, run: dict[str, Any], count: str | None, cases: str | None) -> str:
    """Return what a column is headed by: the run, its number of cases, its commit, its date."""
    size = [f"{run['metrics'][count]:,.0f} {cases}"] if count else []
    return f"{name}: {', '.join([*size, run['commit'], run['date']])}"


def _cells(cell: str, of_runs: list[dict[str, Any]]) -> list[str]:
    """Return a row's cell for each run."""
    if unknown := [key for key, _ in re.findall(METRIC, cell) if not any(key in metrics for metrics in of_runs)]:
        raise KeyError(f"no run has {', '.join(unknown)}")
    return [written(cell, metrics) for metrics in of_runs]


def _row(label: str, cells: list[str]) -> str:
    """Return a line of a Markdown table."""
    return f"| {' | '.join([label, *cells])} |"


def main() -> None:
    """Fill all pages."""
    for page in pages():
        before = page.read_text(encoding="utf-8")
        if (after := filled(before)) != before:
            write_text(page, after)
            print(page)


if __name__ == "__main__":
    main()
