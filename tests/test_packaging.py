"""The wheel and the source archive hold what they must, and the wheel runs by itself, outside the repository."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

from anther.cli.sample_data import SAMPLES
from anther.core.errors import EXTRA_OF

ROOT = Path(__file__).parents[1]
LOCKS = [path.name for path in ROOT.glob("requirements*.lock")]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    return Path(next(iter(WheelBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"]))))


def test_the_wheel_has_all_of_the_package_and_nothing_else(wheel: Path) -> None:
    assert wheel.stat().st_size < 5e6
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        info = next(name for name in names if name.endswith("/METADATA"))
        text = archive.read(info).decode()
        entries = archive.read(info.replace("METADATA", "entry_points.txt")).decode()
    sources = {str(p.relative_to(ROOT / "src")) for p in (ROOT / "src").rglob("*.py*") if p.suffix in {".py", ".pyi"}}
    assert sources <= names
    assert "anther/py.typed" in names
    assert all(any(name.startswith(f"anther/cli/sample_data/{sample}") for name in names) for sample in SAMPLES)
    strangers = {name for name in names if not name.startswith(("anther/", "anther-"))}
    assert not strangers
    assert not [name for name in names if "__pycache__" in name or "/.venv" in name]
    assert "anther = anther.cli.main:main" in entries
    for line in ("Author: The Anther developers", "Classifier: Typing :: Typed", "Requires-Python: >=3.11"):
        assert line in text
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.mark.slow
def test_the_source_archive_can_be_tested(tmp_path: Path) -> None:
    (path,) = SdistBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with tarfile.open(path) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    needed = ["pyproject.toml", "README.md", "LICENSE", "Makefile", *LOCKS,
              "src/anther/py.typed", "src/anther/cli/sample_data/plant.ply", "tests/conftest.py", "docs/README.md",
              "examples/01_shake_a_cantilever.py", "tools/make_env.py"]  # fmt: skip
    assert not set(needed) - names
    assert not [name for name in names if name.startswith((".venv", "runs/")) or "__pycache__" in name]


def test_the_image_has_what_the_source_archive_has() -> None:
    """.dockerignore leaves out all but what it names."""
    ignored, *kept = (ROOT / ".dockerignore").read_text().splitlines()
    assert ignored == "*"
    names = {line.removeprefix("!") for line in kept if line.startswith("!")}
    for wanted in tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["sdist"][
        "include"
    ]:
        name = wanted.removeprefix("/")
        assert name in names or f"*{Path(name).suffix}" in names, wanted


def test_the_wheel_runs_outside_the_repository(wheel: Path, tmp_path: Path) -> None:
    """Its files alone are found first; the packages it needs are those of this environment."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    (tmp_path / "home").mkdir()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "COLUMNS": "200"}

    code = """if True:
        import anther
        from anther.cli.main import main
        print(anther.__file__)
        for words in ("--version", "samples s", "view s/skeleton.swc --to plant.glb"):
            assert main(words.split()) == 0, words
    """
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path / "home",
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    where, version, *_ = done.stdout.splitlines()
    assert where.startswith(str(tmp_path))
    assert version.startswith("anther 0.")
    assert "nodes" in done.stdout


CORE = [
    "samples samples",
    "skeletonize samples/plant.ply --units m --up z --out tree",
    "plan samples/skeleton.swc --frequencies 3 --out plan",
    "plan samples/skeleton.swc --map --heights 2 --frequencies 2 --out map",
    "view samples/skeleton.swc --to plant.glb",
    "history",
]
NEEDY = {
    "trial --plant tomato": "cell",
    "view samples/skeleton.swc --to scene.html": "view",
    "reconstruct samples/capture --out seen": "images",
}


@pytest.mark.slow
def test_the_core_works_without_extras_and_names_the_one_that_is_missing(tmp_path: Path) -> None:
    program = f"""
import importlib.metadata, json, sys
away, found = {sorted(EXTRA_OF)!r} + ["pin"], importlib.metadata.distribution
sys.modules |= dict.fromkeys(away)
def distribution(name):
    if name in away:
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)
importlib.metadata.distribution = distribution
from anther.cli.main import main
print(json.dumps([main(words.split()) for words in {[*CORE, *NEEDY]!r}]))
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    codes = json.loads(done.stdout.splitlines()[-1])
    assert dict(zip(CORE, codes, strict=False)) == dict.fromkeys(CORE, 0), done.stderr
    assert codes[len(CORE) :] == [2, 2, 2]
    for extra in NEEDY.values():
        assert f"pip install 'anther[{extra}]'" in done.stderr
