"""The numbered examples run from an empty folder and print what they promise."""

from __future__ import annotations

import functools
import io
import re
import runpy
import tempfile
from contextlib import chdir, redirect_stdout
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
SLOW = {"02_cloud_to_grasp"}


@functools.cache
def output(example: Path) -> str:
    said = io.StringIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        chdir(folder),
        redirect_stdout(said),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("sys.argv", [str(example)])
        runpy.run_path(str(example), run_name="__main__")
    return said.getvalue()


@pytest.mark.parametrize(
    "example",
    [pytest.param(path, id=path.stem, marks=pytest.mark.slow if path.stem in SLOW else ()) for path in EXAMPLES],
)
def test_an_example_runs_and_is_short(example: Path):
    assert output(example).strip()
    assert len(example.read_text().splitlines()) <= 45
    assert example.read_text().startswith('"""')


def test_the_tuning_fork_agrees_with_its_formulas():
    said = output(EXAMPLES[2])
    found = re.search(r"frequencies: \[(.*)\] Hz \(rods\), ([\d.]+) Hz", said)
    assert found is not None
    assert [float(f) for f in found[1].split()] == pytest.approx([float(found[2])] * 4, rel=1e-3)
    damping = re.search(r"ratio: ([\d.]+) \(modes\), ([\d.]+) \(bandwidth\), ([\d.]+) \(formula\)", said)
    assert damping is not None
    assert [float(damping[k]) for k in (1, 2)] == pytest.approx([float(damping[3])] * 2, rel=0.01)
    rows = re.findall(r"^ *[\d.]+ +([\d.]+) at +(-?\d+) deg +([\d.]+) at +(-?\d+) deg$", said, flags=re.MULTILINE)
    assert len(rows) == 8
    for a, phase, b, other in rows:
        assert float(a) == pytest.approx(float(b), rel=0.01)
        assert abs(float(phase) - float(other)) <= 3


def test_small_shakes_follow_linear_theory_and_large_ones_do_not():
    rows = [[float(n) for n in line.split()] for line in output(EXAMPLES[3]).splitlines()[-4:]]
    assert [row[0] for row in rows] == [1.5, 2.5, 3.0, 4.0]
    for _, linear, smallest, *_, largest in rows:
        assert smallest == pytest.approx(linear, rel=0.02)
        assert largest != pytest.approx(linear, rel=0.02)
