"""`anther doctor`: what is missing is named with the command that gets it; what is wrong gives exit code 1."""

from __future__ import annotations

import json
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement

from anther.cli import compile_all, doctor
from anther.cli.main import main
from anther.cli.sample_data import write_samples
from anther.core.compiling import COMPILED

EXTRAS = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of the tests themselves may be one that is only read."""
    monkeypatch.chdir(tmp_path)


def findings(capsys: pytest.CaptureFixture[str], code: int = 0) -> dict[str, dict[str, str]]:
    assert main(["doctor", "--json"]) == code
    return {finding["what"]: finding for finding in json.loads(capsys.readouterr().out)}


def test_a_whole_installation(capsys: pytest.CaptureFixture[str]) -> None:
    found = findings(capsys)
    assert {"Python", "Anther", "GPU", "compiled code", "cameras", "disk"} <= set(found)
    assert found["Anther"]["state"] == "ok"
    assert main(["doctor"]) == 0
    assert "compiled code" in capsys.readouterr().out


def test_every_extra_is_explained() -> None:
    assert set(doctor.FOR) == set(EXTRAS)


def test_an_extra_has_the_needs_of_those_that_it_names() -> None:
    needs = [Requirement(f"{need}; extra == '{name}'") for name, of in EXTRAS.items() for need in of]
    assert [str(need.specifier) for need in doctor._needs_of("images", needs)] == ["<5,>=4.11"]
    bags = {need.name for need in doctor._needs_of("bags", needs)}
    assert bags == {"opencv-python-headless", "rosbags", "mcap"}


def without(monkeypatch: pytest.MonkeyPatch, gone: str, version: str | None = None) -> None:
    """As if a package were not installed, or of another version."""
    real = metadata.version

    def found(name: str) -> str:
        if name.lower() != gone:
            return real(name)
        if version is None:
            raise metadata.PackageNotFoundError(name)
        return version

    monkeypatch.setattr(doctor.metadata, "version", found)


def test_a_missing_extra_has_its_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    without(monkeypatch, "rosbags")
    found = findings(capsys)["[bags]"]
    assert found["state"] == "absent"
    assert "rosbags" in found["found"]
    assert found["do"] == "pip install 'anther[bags]'"


@pytest.mark.parametrize("version", [None, "1.0"])
def test_a_missing_or_old_package_is_wrong(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], version: str | None
) -> None:
    without(monkeypatch, "scipy", version)
    found = findings(capsys, code=1)["Anther"]
    assert found["state"] == "wrong"
    assert "scipy" in found["found"]


def test_an_old_python_and_a_full_disk_are_wrong(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor.sys, "version_info", (3, 9, 0))
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda folder: SimpleNamespace(free=0.99e9))
    found = findings(capsys, code=1)
    assert [name for name in found if found[name]["state"] == "wrong"] == ["Python", "disk"]
    assert all(found[name]["do"] for name in ("Python", "disk"))


def test_compiled_code_that_may_not_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(doctor.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert findings(capsys)["compiled code"]["state"] == "absent"


def test_compiling_ahead_leaves_out_what_an_extra_is_missing_for_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lacking(module: str) -> None:
        raise ModuleNotFoundError(f"No module named '{module}'", name=module)

    monkeypatch.setattr(compile_all, "_work", lambda _: [("bags", lambda: lacking("mcap")), ("rest", lambda: None)])
    compile_all.compile_all()
    said = capsys.readouterr().out
    assert "left out: this needs mcap" in said
    assert "rest ... 0 kernels" in said
    monkeypatch.setattr(compile_all, "_work", lambda _: [("bags", lambda: lacking("anther.nowhere"))])
    with pytest.raises(ModuleNotFoundError):
        compile_all.compile_all()


@pytest.mark.slow
def test_after_compiling_ahead_nothing_is_left_to_compile(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compile_all.compile_all()
    write_samples(tmp_path)
    before = COMPILED.kernels
    for name, source in (("skeletonize", "plant.ply"), ("plan", "skeleton.swc")):
        assert main([name, str(tmp_path / source), "--out", str(tmp_path / name)]) == 0
    assert COMPILED.kernels == before
