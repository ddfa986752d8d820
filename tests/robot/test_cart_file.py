"""A cell on rails and the rows of a house in files: what is read, and what is refused with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from anther.core.errors import InputError
from anther.robot.arm.sawyer import SAWYER
from anther.robot.cells import read_cell
from anther.robot.cells.rows import RowOfFile, Side, read_rows

GOOD = """
[[row]]
name = "12"
[row.left]
hooks = [0.4, 0.8, 1.3]
[row.right]
hooks = []

[[row]]
name = "13"
[row.left]
hooks = [0.5]
[row.right]
hooks = [0.3, 0.7]
"""


def rows_file(folder: Path, text: str) -> Path:
    path = folder / "rows.toml"
    path.write_text(text)
    return path


def test_rows_are_read(tmp_path: Path) -> None:
    first, second = read_rows(rows_file(tmp_path, GOOD))
    assert first == RowOfFile("12", Side([0.4, 0.8, 1.3]), Side([]))
    assert second.right.hooks == [0.3, 0.7]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[row.right]\nhooks = []", "", r"line 2.*row\.0.*without its right side.*nothing grows"),
        ("[0.4, 0.8, 1.3]", "[0.4, 1.3, 0.8]", r"line 5.*hook 3 at 0.8 m after one at 1.3 m.*Sort"),
        ("[0.4, 0.8, 1.3]", "[0.4, 0.4]", r"line 5.*hook 2 at 0.4 m"),
        ('name = "13"', 'name = "12"', r"line 10.*two rows called '12'.*Rename"),
        ("[0.4, 0.8, 1.3]", "[]", r"line 2.*a row without hooks"),
        ("[0.4, 0.8, 1.3]", '["a"]', r"line 5.*left\.hooks.*of a number"),
        ('name = "12"', "nam = 12", r"line 3.*unknown key 'nam'.*Did you mean name"),
        (GOOD, "house = 3", r"no \[\[row\]\]"),
    ],
)
def test_a_wrong_row_is_refused_with_its_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read_rows(rows_file(tmp_path, GOOD.replace(old, new)))
    assert "\n" not in str(caught.value)


BEHIND = [3.0, *SAWYER.neutral[1:].tolist()]
CELL = """
[arm]
driver = "sawyer-ros1"
master = "http://sawyer.local:11311"
[gripper]
driver = "rethink"
[wrist_camera]
driver = "realsense"
T_flange_cam = [0.09, 0.0, 0.03, 0.0, 0.0, 0.70710678, 0.70710678]
[workspace]
lower = [0.32, -0.40, -0.48]
upper = [1.12, 0.40, 0.52]
[region]
lower = [0.47, -0.25, -0.30]
upper = [0.97, 0.25, 0.45]
[arm_space]
lower = [-0.6, -1.1, -0.47]
upper = [1.2, 1.1, 1.4]
[cart]
driver = "wheels:Cart"
travel = [0.0, 60.0]
lift = [0.0, 2.0]
corridor = 0.8
"""


def cell_file(folder: Path, text: str = CELL) -> Path:
    (folder / "wheels.py").write_text("class Cart:\n    def __init__(self, port: str = '') -> None: ...\n")
    path = folder / "cell.toml"
    path.write_text(text)
    return path


def test_a_cart_has_its_ends_and_keeps_the_arm_off_the_other_row(tmp_path: Path) -> None:
    cell = read_cell(cell_file(tmp_path))
    limits = cell.cart_limits()
    assert limits is not None
    assert cell.cart is not None
    np.testing.assert_allclose(limits.lower, [0, 0])
    np.testing.assert_allclose(limits.upper, [60, 2])
    np.testing.assert_allclose(limits.stowed, SAWYER.ready)
    other = cell.safety_limits().keep_out[-1]
    assert other.contains(np.array([[-0.45, 0.5, 0.3]])).all()
    assert not other.contains(np.array([[-0.35, 0.5, 0.3]])).any()
    assert not other.contains(np.array([[0.45, 0.0, 0.3]])).any()


def test_a_cell_without_a_cart_has_none(tmp_path: Path) -> None:
    cell = read_cell(cell_file(tmp_path, CELL.partition("[cart]")[0]))
    assert cell.cart is None
    assert cell.cart_limits() is None


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("travel = [0.0, 60.0]\n", "", r"line 19.*no 'travel'"),
        ("[0.0, 60.0]", "[60.0, 0.0]", r"travel: got \[60.0, 0.0\].*Swap"),
        ("[0.0, 2.0]", "[2.0, 2.0]", r"lift: got"),
        ("corridor = 0.8", "corridor = 800", r"corridor: got 800"),
        ("corridor = 0.8", f"corridor = 0.8\nstowed = {BEHIND}", r"line 23.*corridor.*where it is stowed.*keep-out"),
        ("corridor = 0.8", "corridor = 0.8\nstowed = [0.0, 1.0]", r"stowed.*7 joints"),
        ('"wheels:Cart"', '"wheels"', r"line 20.*cart.driver"),
        ("corridor = 0.8", "corridor = 0.8\nprot = 3", r"line 24.*unknown key 'prot'.*Did you mean port"),
    ],
)
def test_a_wrong_cart_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_cell(cell_file(tmp_path, CELL.replace(old, new)))
