"""What is counted of a row that a camera saw: each hook once, and posts against the odometry's scale."""

from __future__ import annotations

import numpy as np
import pytest

from anther.perception import SeenRow
from evaluation.house.row_pass import by_posts, pairs


def test_a_hook_is_found_once_and_by_the_nearest() -> None:
    seen, true = np.array([0.98, 1.02, 1.4, 2.04]), np.array([1.0, 1.03, 2.0, 3.0])
    assert pairs(seen, true).tolist() == [[0, 0], [1, 1], [3, 2]]


def test_posts_take_a_wrong_scale_and_begin_out() -> None:
    true = np.array([0.5, 2.0, 4.5])
    read = 1.01 * true + 0.3
    none = np.full((3, 1), np.nan)
    seen = SeenRow(read, 0 * true, 0 * true, ((4, 1.01 * 1 + 0.3), (5, 1.01 * 4 + 0.3)), 0.0, 6.0, none, none)
    assert by_posts(seen, {4: 1.0, 5: 4.0}) == pytest.approx(true, abs=0.006)
    assert by_posts(seen, {9: 1.0}) is None
