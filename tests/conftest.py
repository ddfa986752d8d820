"""Shared fixtures. Real data is read from the folder ANTHER_DATA, by default ../shared/data beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does
settings.register_profile("busy machines", deadline=None)  # an example that takes long is no failure
settings.load_profile("busy machines")

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real plants and reference trajectories; tests that need it are skipped without it."""
    if not DATA.is_dir():
        pytest.skip(f"real data not found at {DATA}; set ANTHER_DATA to its folder")
    return DATA
