"""One owner for an arm: whatever it is called, whoever asks, and whatever lies where its lock should."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from made_arm import CELL

from anther.robot.cells import _lock, own_arm, own_cell, read_cell
from anther.robot.cells._lock import addresses
from anther.robot.devices import DeviceError

HOLDS = """
import encodings.idna, os, sys, time
from pathlib import Path
from anther.robot.cells import own_arm
if len(sys.argv) > 2:
    os.setgid(int(sys.argv[2])), os.setuid(int(sys.argv[2]))
with own_arm("192.168.1.20", Path(sys.argv[1])):
    print("owned", flush=True)
    time.sleep(60)
"""


@contextmanager
def held_elsewhere(folder: Path, *user: int, **environment: str) -> Iterator[int]:
    """Hold an arm in another process, perhaps another user's, within the block; yield its number."""
    words = [sys.executable, "-c", HOLDS, str(folder), *map(str, user)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=os.environ | environment) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "owned\n"
        try:
            yield other.pid
        finally:
            other.kill()
            other.wait()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    tmp_path.chmod(0o1777)
    return tmp_path


def test_two_processes_cannot_own_one_arm_whatever_their_environment_says(folder: Path) -> None:
    with held_elsewhere(folder, TMPDIR=str(folder / "other"), HOME="/") as number:
        with pytest.raises(DeviceError, match=f"commanded by another process, number {number}"):
            own_arm("192.168.1.20", folder).__enter__()
        with own_arm("192.168.1.21", folder):
            pass
    with own_arm("192.168.1.20", folder):
        pass


def test_the_folder_of_the_locks_is_the_machines(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """The first that everybody may write to, whoever asks."""
    (folder / "private").mkdir(mode=0o755)
    monkeypatch.setenv("TMPDIR", str(folder / "private"))
    monkeypatch.setattr(_lock, "FOLDERS", (folder / "missing", folder / "private", folder))
    assert _lock._folder() == folder
    monkeypatch.setattr(_lock, "FOLDERS", (folder / "missing", folder / "private"))
    with pytest.raises(DeviceError, match="no folder for the arms' locks"):
        _lock._folder()


NAMES = {"robot": "10.1.2.3", "robot.farm.example": "10.1.2.3", "other": "10.1.2.4", "10.1.2.3": "10.1.2.3"}


@pytest.fixture
def resolver(monkeypatch: pytest.MonkeyPatch) -> None:
    """A network that knows `NAMES`, and this machine."""
    known = socket.getaddrinfo

    def found(host: str, *rest: object, **options: object) -> object:
        if host in ("localhost", "127.0.0.1", "127.0.1.1"):
            return known(host, *rest, **options)  # type: ignore[arg-type]
        if host not in NAMES:
            raise socket.gaierror("unknown")
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (NAMES[host], 0))]

    monkeypatch.setattr(socket, "getaddrinfo", found)


@pytest.mark.usefixtures("resolver")
@pytest.mark.parametrize(
    "same",
    [
        ("http://robot:11311", "http://robot:11311/", "http://ROBOT.farm.example:11311", "http://10.1.2.3:11311/"),
        ("robot", "Robot.farm.example.", "10.1.2.3", "10.1.2.3/"),
        ("http://localhost", "http://127.0.0.1:80", "http://127.0.1.1/"),
        ("unplugged.local", "Unplugged.local/"),
    ],
)
def test_an_arm_is_one_however_it_is_spelt(same: tuple[str, ...]) -> None:
    assert len({tuple(addresses(place)) for place in same}) == 1


@pytest.mark.usefixtures("resolver")
def test_different_arms_are_not_one() -> None:
    places = ("robot", "other", "http://robot:11311", "http://robot:11312", "unplugged.local", "/controller", "/two")
    assert len({tuple(addresses(place)) for place in places}) == len(places)


def test_this_machine_is_one_by_each_of_its_addresses() -> None:
    assert addresses("http://localhost:1") == addresses("http://127.0.0.1:1/") == ["127.0.0.1:1"]
    assert "127.0.0.1" in addresses(socket.gethostname())


def test_who_shares_one_of_several_addresses_is_another_owner(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_lock, "_resolve", lambda host: {"10.0.0.1", "192.168.1.20"} if host == "robot" else {host})
    with held_elsewhere(folder):
        with pytest.raises(DeviceError, match=r"the arm 192\.168\.1\.20 is commanded"):
            own_arm("robot", folder).__enter__()
        with own_arm("10.0.0.1", folder):  # it was let go again
            pass


def test_a_cells_arm_is_owned_by_its_address_whatever_its_driver(tmp_path: Path) -> None:
    for name in ("my_arm.py", "my_tools.py", "my_arm.urdf"):
        (tmp_path / name).write_text(CELL.with_name(name).read_text())
    (tmp_path / "my_arm2.py").write_text(CELL.with_name("my_arm.py").read_text())
    other = CELL.read_text().replace("my_arm:MyArm", "my_arm2:MyArm").replace('"192.168.1.30" ', '"192.168.1.30/"')
    (tmp_path / "second.toml").write_text(other)
    with own_cell(read_cell(CELL)), pytest.raises(DeviceError, match="commanded by another process"):
        own_cell(read_cell(tmp_path / "second.toml")).__enter__()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_lock_that_is_free_can_be_taken_by_every_user(folder: Path) -> None:
    """Whoever made it, with whatever umask; the folder is like /tmp."""
    umask = os.umask(0o077)
    try:
        with own_arm("192.168.1.20", folder):
            pass
    finally:
        os.umask(umask)
    for ancestor in folder.parents[:3]:
        ancestor.chmod(ancestor.stat().st_mode | 0o111)
    assert next(folder.glob("*.lock")).stat().st_mode & 0o777 == 0o666
    with (
        held_elsewhere(folder, 65534) as number,
        pytest.raises(DeviceError, match=f"number {number}"),
    ):
        own_arm("192.168.1.20", folder).__enter__()


@pytest.mark.parametrize("make", ["symlink_to", "hardlink_to", "mkdir", "fifo"])
def test_nothing_but_a_lock_is_written_to(folder: Path, make: str) -> None:
    victim, lock = folder / "victim", folder / "anther-192.168.1.20.lock"
    victim.write_text("keep me")
    if make == "fifo":
        os.mkfifo(lock)
    else:
        getattr(lock, make)(*([] if make == "mkdir" else [victim]))
    with pytest.raises(DeviceError, match=r"the lock .*anther-192\.168\.1\.20\.lock .*Remove it"):
        own_arm("192.168.1.20", folder).__enter__()
    assert victim.read_text() == "keep me"


def test_a_lock_that_was_removed_while_it_was_taken_is_none(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, handles = _lock._open, list[int]()

    def removed_once(path: Path) -> int:
        handles.append(opened(path))
        if len(handles) == 1:
            path.unlink()
        return handles[-1]

    monkeypatch.setattr(_lock, "_open", removed_once)
    with own_arm("192.168.1.20", folder):
        assert next(folder.glob("*.lock")).read_text() == str(os.getpid())
    assert len(handles) == 2
