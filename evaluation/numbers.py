"""Fill the measured numbers of README and guides from the JSON of the runs that measured them.

    python -m evaluation.numbers            # every page; prints those that changed

In a page a number stands between two comments, of which the first names the file under docs/results, the metric and
its format:

    <!--long/shaking plan_ms2:.1f-->5.4<!--/-->
"""

import re
from pathlib import Path

from anther.core.files import read_json, write_text

RESULTS = Path("docs/results")
NUMBER = re.compile(r"<!--(?P<file>[\w/]+) (?P<metric>\w+):(?P<format>[^>]*?)-->[^<]*<!--/-->")


def pages() -> list[Path]:
    """Return the pages with numbers: README and docs/*.md."""
    return [Path("README.md"), *sorted(Path("docs").glob("*.md"))]


def filled(text: str) -> str:
    """Return a page's text with its numbers as they were measured last.

    Raises:
        KeyError: a result has no such metric.
    """

    def number(found: re.Match[str]) -> str:
        value = read_json(RESULTS / f"{found['file']}.json")["metrics"][found["metric"]]
        return f"<!--{found['file']} {found['metric']}:{found['format']}-->{value:{found['format']}}<!--/-->"

    return NUMBER.sub(number, text)


def main() -> None:
    """Fill all pages."""
    for page in pages():
        before = page.read_text(encoding="utf-8")
        if (after := filled(before)) != before:
            write_text(page, after)
            print(page)


if __name__ == "__main__":
    main()
