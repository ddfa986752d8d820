"""A trial's log: what was said comes back, under Foxglove's names, from the file or live."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import lz4.frame
import numpy as np
import pytest
import zstandard
from fake_robot import FakeArm, FakeGripper
from made_log import done, kept_in, spoken, tapped, wait_until
from mcap.records import Message
from test_execution import GRASP, PLANNER
from websockets.sync.client import connect

from anther.cli.main import main
from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Intrinsics
from anther.perception.capture import Capture
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.pollination.execution import Step
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import ArmSample, DeviceError
from anther.show.log import Kept, Log
from anther.show.log._messages import joints
from anther.show.log.live import LARGEST, Tail, show

STEP = Step(1.0, 2.0, (2.0, 3.0), (0.001, 0.002), (0.0, 1.0, 0.0), (4.0, 6.0), {"base": 0.4}, "Raised to 3 mm.", 0.1)


def test_what_was_said_comes_back(tmp_path: Path) -> None:
    book, arm = Log(tmp_path / "log.mcap"), FakeArm()
    readings = list[ArmSample]()
    robot = tapped(book, arm)
    robot.arm.follow(PLANNER.move(arm.joints(), arm.joints() - 0.1), readings.append)
    trial = done(book, robot)
    assert trial.finished
    book.told("step", STEP)
    kept = book.close()
    found = kept_in(tmp_path / "log.mcap")
    assert kept == Kept(sum(len(rows) for rows in found.values()), 0, (tmp_path / "log.mcap").stat().st_size, None)

    names = {topic: rows[0][0] for topic, rows in found.items()}
    assert names == {
        "/joints/measured": "foxglove.JointStates",
        "/joints/commanded": "foxglove.JointStates",
        "/arm/force": "anther.arm.force",
        "/gripper": "anther.gripper",
        "/steps": "anther.steps",
        "/side_camera/image": "foxglove.CompressedImage",
        "/side_camera/calibration": "foxglove.CameraCalibration",
        "/wrist_camera/calibration": "foxglove.CameraCalibration",
        "/tf": "foxglove.FrameTransforms",
        "/tf_static": "foxglove.FrameTransforms",
        "/scene/arm": "foxglove.SceneUpdate",
        "/scene/motion": "foxglove.SceneUpdate",
        "/events": "foxglove.Log",
    }
    first = found["/joints/measured"][0][1]
    zero = first.log_time * 1e-9 - readings[0].time
    assert abs(zero - time.time()) < 3600
    for (_, message), reading in zip(found["/joints/measured"], readings, strict=False):
        assert message.log_time * 1e-9 - zero == pytest.approx(reading.time, abs=1e-5)
        assert message.data == joints(reading.measured, message.log_time / 1e9).encode()
    said = [json.loads(message.data) for _, message in found["/gripper"]]
    assert any(s.get("asked_m") == pytest.approx(GRASP.opening) for s in said)
    assert any(s["held"] and s["force_n"] == 8.0 for s in said)
    assert json.loads(found["/steps"][0][1].data)["share_of_limit"] == 0.4
    assert all(spoken(found, phase) for phase in trial.phases)
    assert spoken(found, STEP.decided)


def test_frames_come_back_fifteen_a_second_and_once(tmp_path: Path) -> None:
    book = Log(tmp_path / "log.mcap")
    camera = tapped(book).side_camera
    assert camera is not None
    camera.start(60)
    assert len(camera.recorded(0.0)) == 30
    assert len(camera.stop()) == 60
    book.close()
    images = [message for _, message in kept_in(tmp_path / "log.mcap")["/side_camera/image"]]
    assert len(images) == 15
    jpeg = images[0].data[images[0].data.index(b"\xff\xd8") :]
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == (6, 8, 3)


def test_what_stages_found_is_drawn(tmp_path: Path) -> None:
    book = Log(tmp_path / "log.mcap")
    tapped(book)
    nodes = np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2]], float)
    views = Capture(
        np.ones((3, 6, 8), np.float32), Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5), np.tile(np.eye(4), (3, 1, 1)),
        np.zeros((3, 6, 8, 3), np.uint8),
    )  # fmt: skip
    book.told("capture", views)
    book.told("skeleton", Skeleton(nodes, np.array([-1, 0, 1]), np.full(3, 0.004)))
    book.told("flowers", Flowers(nodes[1:], np.array([1, 2])))
    book.told("grasp", [GRASP])
    book.told("masks", object())
    book.told("failure", "cloud: no plant")
    assert book.close().dropped == 0
    found = kept_in(tmp_path / "log.mcap")
    for name in ("skeleton", "flowers", "grasp"):
        assert [schema for schema, _ in found[f"/scene/{name}"]] == ["foxglove.SceneUpdate"]
    times = [message.log_time for _, message in found["/wrist_camera/image"]]
    assert len(set(times)) == 3
    assert max(times) < found["/events"][0][1].log_time
    assert spoken(found, "no plant")
    assert spoken(found, "masks")


def test_a_machine_that_stops_is_told_and_raises_as_before(tmp_path: Path) -> None:
    def fault(_: int) -> None:
        raise DeviceError("a joint is hot")

    book = Log(tmp_path / "log.mcap")
    robot = tapped(book, FakeArm(fault=fault))
    with pytest.raises(DeviceError, match="a joint is hot"):
        robot.arm.follow(PLANNER.move(SAWYER.neutral, SAWYER.neutral - 0.1))
    book.close()
    assert spoken(kept_in(tmp_path / "log.mcap"), "a joint is hot")


def test_a_watcher_still_stops_the_arm(tmp_path: Path) -> None:
    book, arm = Log(tmp_path / "log.mcap"), FakeArm()

    def watch(_: ArmSample) -> None:
        raise StageFailure("collision", "ouch")

    with pytest.raises(StageFailure, match="ouch"):
        tapped(book, arm).arm.follow(PLANNER.move(arm.joints(), arm.joints() - 0.1), watch)
    book.close()


def test_a_watched_shake_tells_its_steps_as_they_are_made(tmp_path: Path) -> None:
    book, watched = Log(tmp_path / "log.mcap"), SimpleNamespace(steps=())
    tapped(book)
    book.told("watched", watched)
    for _ in range(3):
        watched.steps = (*watched.steps, STEP)
        book._look()
        book._look()
    book.close()
    assert len(kept_in(tmp_path / "log.mcap")["/steps"]) == 3


def test_a_file_is_read_as_it_grows(tmp_path: Path) -> None:
    whole, part = tmp_path / "log.mcap", tmp_path / "part.mcap"
    book = Log(whole)
    done(book, tapped(book))
    count = book.close().messages
    data, tail, seen = whole.read_bytes(), Tail(part), 0
    for end in [0, 3, 8, 20, *range(1000, len(data), 5003), len(data)]:
        part.write_bytes(data[:end])
        seen += sum(isinstance(record, Message) for record in tail.records())
    assert seen == count
    assert tail.ended


@pytest.mark.parametrize("stated", [0, 1, 2**40])
@pytest.mark.parametrize("packed", ["zstd", "lz4", ""])
def test_a_few_bytes_that_stand_for_many_are_refused(packed: str, stated: int, tmp_path: Path) -> None:
    def record(kind: int, content: bytes) -> bytes:
        return bytes([kind]) + struct.pack("<Q", len(content)) + content

    def text(words: str) -> bytes:
        return struct.pack("<I", len(words)) + words.encode()

    zeros = bytes(8 * LARGEST)  # records of kind 0 and length 0
    pack = {"zstd": zstandard.ZstdCompressor(level=1).compress, "lz4": lz4.frame.compress, "": bytes}
    data = pack[packed](zeros)
    chunk = struct.pack("<QQQI", 0, 0, stated, 0) + text(packed) + struct.pack("<Q", len(data)) + data
    (tmp_path / "log.mcap").write_bytes(b"\x89MCAP0\r\n" + record(1, text("") + text("")) + record(6, chunk))
    with pytest.raises(InputError, match=r"log\.mcap: got damaged: .*(16 MB|record of 1280)"):
        list(Tail(tmp_path / "log.mcap").records())


@contextmanager
def shown(path: Path) -> Iterator[int]:
    """Serve a log in a thread; give the port."""
    ports, over = list[int](), threading.Event()
    thread = threading.Thread(target=lambda: show(path, 0, ready=ports.append, over=over.is_set))
    thread.start()
    try:
        wait_until(lambda: bool(ports))
        yield ports[0]
    finally:
        over.set()
        thread.join()


def received(port: int, until: set[str], patience: float = 60.0) -> tuple[dict[str, Any], set[str]]:
    """Connect as Foxglove does, subscribe to everything; return what the server says of itself, and topics sent."""
    said, topics, seen, again = dict[str, Any](), dict[int, str](), set[str](), 20
    with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:  # type: ignore[list-item]
        while not until <= seen:
            message = socket.recv(timeout=patience)
            if isinstance(message, bytes):
                seen |= {topics[struct.unpack("<I", message[1:5])[0]]} if message[0] == 1 else set()
                continue
            told = json.loads(message)
            said = told if told["op"] == "serverInfo" else said
            new = told["channels"] if told["op"] == "advertise" else []
            topics |= {channel["id"]: channel["topic"] for channel in new}
            wanted = [channel["id"] for channel in new]
            if told["op"] == "status" and told["message"].startswith("Unknown channel ID: ") and again:
                # who connects just while a channel comes is told of it before the server knows that
                again, wanted = again - 1, [int(told["message"].split(": ")[1])]
                time.sleep(0.1)
            if wanted:
                asked = [{"id": number, "channelId": number} for number in wanted]
                socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
    return said, seen


def test_a_trial_is_seen_live_also_by_who_comes_late_and_commands_nothing(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with shown(path) as port:  # before the trial has begun
        book = Log(path)
        robot = tapped(book)
        said, _ = received(port, {"/tf_static", "/side_camera/calibration"})
        assert said["capabilities"] == []
        done(book, robot)
        book.close()
        received(port, {"/tf_static", "/joints/measured", "/events", "/side_camera/image", "/scene/arm"})


def test_a_trial_that_is_done_anew_is_seen_too(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    first = Log(path)
    done(first, tapped(first))
    first.close()
    with shown(path) as port:
        received(port, {"/events"})
        path.unlink()
        second = Log(path)
        second.told("step", STEP)
        second.close()
        try:
            _, seen = received(port, {"/steps"}, patience=10.0)
        except TimeoutError:  # who connects just while the channels change may be told of none: connect again
            _, seen = received(port, {"/steps"})
        assert "/steps" in seen


def test_a_port_that_is_taken_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(tmp_path / "log.mcap") as port:
        assert main(["view", str(tmp_path), "--live", "--port", str(port)]) == 2
        assert "--port" in capsys.readouterr().err
    assert main(["view", str(tmp_path), "--live", "--to", "x.html"]) == 2


def test_who_may_watch_is_told(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server looks at no origin: a page of any site, in a browser of this machine, is let in."""
    monkeypatch.setattr("anther.show.log.live.show", lambda path, port, ready: ready(port))
    assert main(["view", str(tmp_path), "--live"]) == 0
    assert "So may any page that a browser here has open." in capsys.readouterr().out
    with shown(tmp_path / "log.mcap") as port:
        address = f"ws://127.0.0.1:{port}"
        with connect(address, origin="http://evil.example", subprotocols=["foxglove.sdk.v1"]) as socket:  # type: ignore[arg-type, list-item]
            assert json.loads(socket.recv(timeout=60))["op"] == "serverInfo", "it looks now: let only the apps in"


def test_a_gripper_that_jams_is_told(tmp_path: Path) -> None:
    class Jammed(FakeGripper):
        def move(self, opening: float) -> Any:
            raise DeviceError("jammed")

    book = Log(tmp_path / "log.mcap")
    robot = tapped(book, gripper=Jammed())
    with suppress(DeviceError):
        robot.gripper.move(0.01)
    book.close()
    assert spoken(kept_in(tmp_path / "log.mcap"), "jammed")
