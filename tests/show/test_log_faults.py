"""Whatever a log's disk does, the trial goes on, what is missing is counted, and the rest can be read."""

from __future__ import annotations

import errno
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS, fake_robot
from made_log import done, kept_in, readable, spoken, tapped, wait_until
from mcap.records import Message

from anther.cli.run_folder import EARLIER, LOG, TrialLog
from anther.core.errors import InputError, StageFailure
from anther.core.runs import Run
from anther.robot.devices import Frame
from anther.show.log import Log
from anther.show.log.live import Tail


class Disk(FileIO):
    """A file on a disk with room for so many bytes, whose every write first waits for `free`."""

    def __init__(self, path: Path, room: float = float("inf")) -> None:
        super().__init__(path, "wb")
        self.room, self.free = room, threading.Event()
        self.free.set()

    def write(self, data: Any) -> int:
        self.free.wait()
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = super().write(memoryview(data)[: int(min(self.room, len(data)))])
        self.room -= done
        return done


def on_disk(path: Path, room: float = float("inf"), **options: Any) -> tuple[Log, Disk]:
    disks: list[Disk] = []

    def opened(at: Path) -> Disk:
        disks.append(Disk(at, room))
        return disks[0]

    return Log(path, opened=opened, **options), disks[0]


def test_a_full_queue_drops_counts_and_says_so(tmp_path: Path) -> None:
    """Nothing is written until the trial is over: the trial does not wait for it."""
    book, gate = Log(tmp_path / "log.mcap", waiting=50), threading.Event()
    written = book._scribe.write

    def late(*words: Any) -> int:
        gate.wait()
        return written(*words)

    book._scribe.write = late  # type: ignore[method-assign]
    robot = tapped(book)
    trial = done(book, robot)
    assert trial.finished
    dropped = book._dropped
    assert dropped > 100
    gate.set()
    wait_until(lambda: not book._queue)
    book.told("phase", "afterwards")
    kept = book.close()
    assert kept.dropped == dropped
    assert kept.error == "more was said at once than could be written"
    found = kept_in(tmp_path / "log.mcap")
    said = [re.search(rb"the log left out (\d+) messages", message.data) for _, message in found["/events"]]
    assert sum(int(words[1]) for words in said if words) == dropped
    assert spoken(found, "afterwards")


@pytest.mark.parametrize("room", [0, 3, 3000, 200_000])
def test_a_full_disk_ends_the_log_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    monkeypatch.setattr(Log, "_flushes_every", 0.0)
    book, _ = on_disk(tmp_path / "log.mcap", room)
    robot = tapped(book)
    rng = np.random.default_rng(0)
    for k in range(5):  # each second, noise that cannot be made smaller
        for i in range(20):
            book.say("side_camera", Frame(0.0, rng.integers(0, 255, (60, 80, 3), np.uint8), np.zeros((1, 1))), k + i)
        wait_until(lambda: book._file.broken or (not book._queue and book._safe == book._messages))
    trial = done(book, robot)
    kept = book.close()
    assert trial.finished
    assert kept.error == os.strerror(errno.ENOSPC)
    assert kept.dropped > 0
    assert kept.size == (tmp_path / "log.mcap").stat().st_size <= room
    assert kept.messages == readable(tmp_path / "log.mcap")
    assert (kept.messages > 10) == (room == 200_000)


def test_a_folder_that_may_not_be_written_costs_only_the_log(tmp_path: Path) -> None:
    def opened(_: Path) -> Any:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    book = Log(tmp_path / "log.mcap", opened=opened)
    assert done(book, tapped(book)).finished
    kept = book.close()
    assert kept.error == os.strerror(errno.EROFS)
    assert kept.messages == 0 < kept.dropped


def test_a_disk_that_hangs_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Log, "_patience", 0.2)
    book, disk = on_disk(tmp_path / "log.mcap")
    robot = tapped(book)
    disk.free.clear()
    try:
        assert done(book, robot).finished
        kept = book.close()
        assert kept.error is not None
        assert "took longer" in kept.error
        book.say("phase", "too late")
    finally:
        disk.free.set()
        book._thread.join()


def test_a_log_grows_no_further_than_it_may(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anther.show.log._messages.LogFile.largest", 2000)
    book = Log(tmp_path / "log.mcap")
    robot = tapped(book)
    wait_until(lambda: book._safe > 0)
    assert done(book, robot).finished
    kept = book.close()
    assert kept.error is not None
    assert "grow beyond" in kept.error
    assert kept_in(tmp_path / "log.mcap")["/tf_static"]  # and it ends as it should


def test_what_cannot_be_drawn_is_counted_and_the_rest_goes_on(tmp_path: Path) -> None:
    book = Log(tmp_path / "log.mcap")
    tapped(book)
    book.say("side_camera", Frame(float("nan"), np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2))), float("nan"))
    book.say("side_camera", Frame(0.0, np.zeros((2, 0, 3), np.uint8), np.zeros((2, 0))), 0.0)
    book.told("phase", "afterwards")
    kept = book.close()
    assert kept.dropped == 2
    assert kept.error is not None
    assert "side_camera" in kept.error
    assert spoken(kept_in(tmp_path / "log.mcap"), "afterwards")


KILLED = """
import os, signal, sys, time
from pathlib import Path
from anther.show.log import Log
book = Log(Path(sys.argv[1]))
for k in range(200):
    book.told("phase", f"phase {k}")
while book._safe < 200:
    time.sleep(0.01)
print("ready", flush=True)
book.told("phase", "lost")
time.sleep(60)
"""


def test_the_log_of_a_killed_process_can_be_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGKILL)
    tail = Tail(path)
    assert sum(isinstance(record, Message) for record in tail.records()) in (200, 201)
    assert not tail.ended


@pytest.mark.parametrize("data", [b"no mcap file", b"\x89MCAP0\r\n" + b"\x06" + 8 * b"\xff", b"\x89MCAP0\r\n\x06" + struct.pack("<Q", 9) + b"123456789"])  # fmt: skip # noqa: E501
def test_what_is_no_log_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "log.mcap").write_bytes(data)
    with pytest.raises(InputError, match=r"log\.mcap"):
        list(Tail(tmp_path / "log.mcap").records())


def test_a_trial_without_the_library_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name == "anther.show.log" or name.startswith("anther.show.log.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with Run(tmp_path, quiet=True) as run, TrialLog(run, wanted=True) as book:
        assert book.tap(fake_robot(), LIMITS, np.eye(4), time.time).arm is not None
        told = book.close(None, None)
    assert "anther[log]" in told["log_error"]
    assert "anther[log]" in capsys.readouterr().err


def test_a_trial_notes_what_its_log_lost_and_keeps_that_of_an_earlier_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / LOG).write_text("of an earlier process")
    with Run(tmp_path, quiet=True) as run, TrialLog(run, wanted=True) as book:
        run.told("phase", "open")
        told = book.close(StageFailure("no_plant_found", "no plant"), None)
    assert told == {"log_messages": 2, "log_dropped": 0, "log_error": None}
    assert (tmp_path / EARLIER).read_text() == "of an earlier process"
    assert spoken(kept_in(tmp_path / LOG), "no plant")
    assert not capsys.readouterr().err
    with Run(tmp_path, quiet=True) as run, TrialLog(run, wanted=False) as book:
        assert book.close(None, None) == {"log_messages": 0, "log_dropped": 0, "log_error": None}
    monkeypatch.setattr("anther.show.log._messages.LogFile.largest", -1)
    with Run(tmp_path, quiet=True) as run, TrialLog(run, wanted=True) as book:
        run.told("phase", "open")
        assert book.close(None, None)["log_dropped"] == 1
    assert "1 of 1 messages are missing" in capsys.readouterr().err
