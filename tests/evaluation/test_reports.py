"""Inputs that people reported elsewhere, each with the right value of its README (evaluation/robustness/reports.py).

Those that need a folder beside the checkout are skipped without it. The URDFs (16) are the arm's to read.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from evaluation.robustness import reports


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A copy of the inputs, which is also the current folder."""
    if not reports.REPORTS.is_dir():
        pytest.skip(f"reported inputs not found at {reports.REPORTS}; set ANTHER_REPORTS to their folder")
    with reports.in_copy() as place:
        yield place


KINDS = [pytest.param(name, marks=[pytest.mark.slow] if name in reports.SLOW else []) for name in reports.KINDS]


@pytest.mark.parametrize("name", KINDS)
def test_a_reported_input_is_taken_rightly_or_refused_as_its_readme_allows(
    folder: Path, tmp_path: Path, name: str
) -> None:
    assert reports.judged(name, tmp_path) in ("right", "refused")
