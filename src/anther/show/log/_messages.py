"""What a trial says, as messages of Foxglove's schemas.

The file under a log: it takes all that is written, and where the disk does not, it says so and raises nothing.
"""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from foxglove import Channel, Context, open_mcap
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import (
    CameraCalibration,
    CompressedImage,
    FrameTransform,
    FrameTransforms,
    JointState,
    JointStates,
    Quaternion,
    Timestamp,
    Vector3,
)
from foxglove.messages import Log as Event
from foxglove.messages import LogLevel as Level

from anther import __version__
from anther.core.geometry import Array, Intrinsics, inverse, pose7, transform
from anther.core.opencv import cv2
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.pollination.execution import Step, Trial
from anther.pollination.grasp import Grasp
from anther.pollination.shake import ShakePlan
from anther.robot.devices import ArmSample, Frame, GripperState, JointTrajectory, Robot, SafetyLimits
from anther.show import scene
from anther.show.log import _scene
from anther.show.style import ROBOT_COLOR


class LogFile:
    """Attributes: `size` [bytes]; `error`: why no more is written, "" if nothing is wrong; `broken`: the disk is why.

    Args:
        path: of the file.
        opened: opens it for writing bytes, unbuffered.
    """

    largest = 256_000_000
    """A log grows no further than about this [bytes]; a simulated trial makes 3 MB."""

    def __init__(self, path: Path, opened: Callable[[Path], Any]) -> None:
        self.size, self.error, self.broken, self._whole, self._raw = 0, "", False, 0, None
        try:
            self._raw = opened(path)
        except OSError as error:
            self._fail(error)

    @property
    def full(self) -> bool:
        """Whether nothing should be added."""
        if not self.error and self.size > self.largest:
            self.error = f"it would grow beyond {self.largest / 1e6:.0f} MB"
        return bool(self.error)

    def write(self, data: bytes | bytearray) -> int:
        """Write bytes, or lose them; return how many there were."""
        if self._raw is None:
            return len(data)
        left = memoryview(data)
        try:
            while left:
                done = self._raw.write(left)
                if not done:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
                self.size += done
                left = left[done:]
        except OSError as error:
            self._fail(error)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Return the place: the writer only asks where it is."""
        return self.size

    def flush(self) -> None:
        """Note that what was written so far ends with a whole record."""
        self._whole = self.size

    def close(self) -> None:
        """Close the file."""
        if self._raw is not None:
            with suppress(OSError):
                self._raw.close()

    def _fail(self, error: OSError) -> None:
        """Keep what was whole, and write no more."""
        self.error, self.broken = error.strerror or str(error), True
        if self._raw is not None:
            with suppress(OSError):
                self._raw.truncate(self._whole)
            self.size = self._whole
            self.close()
            self._raw = None


WORLD, FLANGE, WRIST, SIDE, PLANT = "world", "flange", "wrist_camera", "side_camera", "plant"
NUMBER, TEXT = {"type": "number"}, {"type": "string"}
GRIPPER = {"asked_m": NUMBER, "opening_m": NUMBER, "force_n": NUMBER, "held": {"type": "boolean"}}
FORCE = {"force_n": NUMBER}
STEP = {"steady_s": NUMBER, "amplitude_m": NUMBER, "frequency_hz": NUMBER,
        "flower_acceleration_median_ms2": NUMBER, "share_of_limit": NUMBER, "closest_limit": TEXT,
        "decided": TEXT}  # fmt: skip
PLAN = {"amplitude_m": NUMBER, "frequency_hz": NUMBER, "duration_s": NUMBER, "press_n": NUMBER,
        "direction": {"type": "array", "items": NUMBER}, "grasp_arc_length_m": NUMBER, "reason": TEXT}  # fmt: skip


class Scribe:
    """Writes an MCAP file. One thread at a time may use it."""

    def __init__(self, file: LogFile) -> None:
        options = MCAPWriteOptions(profile="", chunk_size=2**18, disable_seeking=True, compression_threads=0)
        self._context, self._file = Context(), file
        self._writer = open_mcap(file, context=self._context, writer_options=options)
        self._channels: dict[str, Channel] = {}
        self._robot: Robot | None = None
        self._limits: SafetyLimits | None = None
        self._static: dict[str, FrameTransform] = {}
        self._drawn, self._photographed, self._nodes = -math.inf, False, np.zeros((0, 3))
        self._T_flange_cam = np.eye(4)
        self._count = 0

    def meet(self, robot: Robot, limits: SafetyLimits, T_flange_cam: Array) -> None:
        """Learn what shows where arm and cameras are; before "cell" is written."""
        self._robot, self._limits, self._T_flange_cam = robot, limits, T_flange_cam

    def write(self, when: float, what: str, value: Any) -> int:
        """Write one thing, said at `when` [s since 1970]; return how many messages that were.

        It is what the cases name, or a stage of `runs.FILES`; of anything else only the name is written.
        """
        before = self._count
        match what, value:
            case "cell", float():
                self._cell(when, value)
            case "arm", ArmSample():
                self._arm(when, value)
            case "motion", JointTrajectory():
                self._scene(when, "motion", scene.motion(value, self._forward))
            case "gripper", (asked, GripperState() as state):
                self._gripper(when, asked, state)
            case (("wrist_camera" | "side_camera"), Frame()):
                self._photographed |= what == WRIST
                self._image(when, what, value.rgb)
            case "step", Step():
                self._step(when, value)
            case (("stopped" | "failure"), _):
                self._event(when, Level.Error, what, str(value))
            case "lost", int():
                self._event(when, Level.Warning, "log", f"the log left out {value} messages: its queue was full")
            case "phase", str():
                self._event(when, Level.Info, "phase", value)
            case _:
                self._stage(when, what, value)
        return self._count - before

    def flush(self) -> None:
        """Let what was written so far be readable, also if this process is killed."""
        self._writer.flush()
        self._file.flush()

    def close(self) -> None:
        """End the file with its index."""
        self._writer.close()
        self._file.close()

    def _forward(self, joints: Array) -> Array:
        assert self._limits is not None
        return self._limits.forward(joints)

    def _cell(self, when: float, epoch: float) -> None:
        """Say where the cameras are and what they see, and when the robot's clock was zero [s since 1970]."""
        self._writer.write_metadata("anther", {"version": __version__, "robot_clock_zero_s": repr(epoch)})
        robot = self._robot
        assert robot is not None
        for name, camera in ((WRIST, robot.wrist_camera), (SIDE, robot.side_camera)):
            if camera is not None:
                self._put(f"/{name}/calibration", calibration(name, camera.intrinsics, when), when)
        if self._limits is not None and self._limits.keep_out:
            self._scene(when, "keep_out", scene.keep_out(self._limits.keep_out))
        self._stand(when, FLANGE, WRIST, self._T_flange_cam)
        if robot.T_world_side_camera is not None:
            self._stand(when, WORLD, SIDE, robot.T_world_side_camera)

    def _arm(self, when: float, sample: ArmSample) -> None:
        self._put("/joints/measured", joints(sample.measured, when), when)
        self._put("/joints/commanded", joints(sample.commanded, when), when)
        if math.isfinite(sample.force):
            self._json("/arm/force", FORCE, {"force_n": sample.force}, when)
        if not 0 <= when - self._drawn < 0.1 and self._limits is not None:
            self._drawn = when
            place = self._limits.forward(sample.measured[None])[0]
            self._put("/tf", FrameTransforms(transforms=[moved(WORLD, FLANGE, place, when)]), when)
            balls = self._limits.outline(sample.measured[None])[0]
            self._scene(when, "arm", scene.outline(balls[::3]))  # they overlap

    def _gripper(self, when: float, asked: float | None, state: GripperState) -> None:
        told = {"opening_m": state.opening, "force_n": state.force}
        said: dict[str, Any] = {name: value for name, value in told.items() if math.isfinite(value)}
        said |= {"held": bool(state.is_gripping)}
        self._json("/gripper", GRIPPER, said if asked is None else {"asked_m": asked} | said, when)

    def _step(self, when: float, step: Step) -> None:
        said = {
            "steady_s": step.end - step.begin,
            "amplitude_m": max(step.amplitudes),
            "frequency_hz": step.frequencies[int(np.argmax(step.amplitudes))],
            "share_of_limit": step.used,
            "closest_limit": step.binds,
            "decided": step.decided,
        }
        felt = {"flower_acceleration_median_ms2": step.median} if math.isfinite(step.median) else {}
        self._json("/steps", STEP, said | felt, when)
        self._event(when, Level.Info, "step", step.decided)

    def _stage(self, when: float, what: str, value: Any) -> None:
        """Write a stage's result: what it found in the scene, and that it is done."""
        said = "done"
        match value:
            case Capture():
                self._views(when, value)
            case Cloud():
                plant, *others = scene.cloud(value)
                self._put("/cloud", _scene.points(plant, stamp(when), WORLD), when)
                for other in others:
                    topic = "/" + other.name.replace(" ", "_")
                    self._put(topic, _scene.points(other, stamp(when), WORLD), when)
            case Skeleton():
                self._nodes = value.nodes
                self._stand(when, WORLD, PLANT, transform(np.eye(3), value.nodes[0]))
                self._scene(when, "skeleton", *scene.organs(value))
            case Stem():
                self._scene(when, "stem", scene.main_stem(self._nodes[value.node_ids]))
            case Flowers():
                self._scene(when, "flowers", scene.flowers(value))
            case [Grasp() as best, *others] if what == "grasp":
                rest = [scene.grasps("other grasps", others, ROBOT_COLOR)] if others else []
                self._scene(when, "grasp", scene.grasps("grasp", [best]), *rest)
            case ShakePlan():
                self._scene(when, "shake", scene.shaking(value))
                self._json("/plan", PLAN, plan(value), when)
                said = value.reason
            case Trial():
                said = value.stop_reason
            case str():
                said = value
        self._event(when, Level.Info, what, said)

    def _views(self, when: float, capture: Capture) -> None:
        """Show the views of a capture, 0.2 s apart, if the wrist camera was not heard while it took them."""
        if self._photographed or capture.rgb is None:
            return
        for number, (rgb, place) in enumerate(zip(capture.rgb, capture.T_world_cam, strict=True)):
            then = when - 0.2 * (capture.views - number)
            self._image(then, WRIST, rgb)
            flange = place @ inverse(self._T_flange_cam)
            self._put("/tf", FrameTransforms(transforms=[moved(WORLD, FLANGE, flange, then)]), then)

    def _image(self, when: float, name: str, rgb: Any) -> None:
        done, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 80])
        assert done
        image = CompressedImage(timestamp=stamp(when), frame_id=name, data=data.tobytes(), format="jpeg")
        self._put(f"/{name}/image", image, when)

    def _stand(self, when: float, parent: str, child: str, T_parent_child: Array) -> None:
        """Note a frame that stands still on another; all of them are one message."""
        self._static[child] = moved(parent, child, T_parent_child, when)
        self._put("/tf_static", FrameTransforms(transforms=list(self._static.values())), when)

    def _scene(self, when: float, name: str, *layers: scene.Layer) -> None:
        self._put(f"/scene/{name}", _scene.update(name, layers, stamp(when), WORLD), when)

    def _event(self, when: float, level: Level, name: str, message: str) -> None:
        self._put("/events", Event(timestamp=stamp(when), level=level, name=name, message=message), when)

    def _json(self, topic: str, fields: dict[str, Any], said: dict[str, Any], when: float) -> None:
        """Write a message of a schema of our own, where Foxglove has none."""
        if topic not in self._channels:
            schema = {"title": f"anther{topic.replace('/', '.')}", "type": "object", "properties": fields}
            self._channels[topic] = Channel(topic, schema=schema, context=self._context)
        self._log(topic, said, when)

    def _put(self, topic: str, message: Any, when: float) -> None:
        """Write a message of one of Foxglove's schemas."""
        if topic not in self._channels:
            schema = message.get_schema()
            self._channels[topic] = Channel(topic, schema=schema, message_encoding="protobuf", context=self._context)
        self._log(topic, message.encode(), when)

    def _log(self, topic: str, message: Any, when: float) -> None:
        self._channels[topic].log(message, log_time=round(1e9 * when))
        self._count += 1


def stamp(when: float) -> Timestamp:
    """Return a time [s since 1970] as Foxglove has it."""
    return Timestamp(*divmod(round(1e9 * when), 10**9))


def joints(q: Array, when: float) -> JointStates:
    """Return joint angles (J,) [rad], named j0, j1, ..."""
    states = [JointState(name=f"j{i}", position=float(x)) for i, x in enumerate(q)]
    return JointStates(timestamp=stamp(when), joints=states)


def moved(parent: str, child: str, T_parent_child: Array, when: float) -> FrameTransform:
    """Return a pose (4, 4) of a frame in another."""
    x, y, z, qx, qy, qz, qw = pose7(T_parent_child).tolist()
    return FrameTransform(
        timestamp=stamp(when),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def calibration(name: str, camera: Intrinsics, when: float) -> CameraCalibration:
    """Return what a pinhole camera sees; its images have no distortion."""
    matrix = camera.matrix
    K, P = matrix.ravel().tolist(), np.column_stack([matrix, np.zeros(3)]).ravel().tolist()
    R = np.eye(3).ravel().tolist()
    width, height = camera.width, camera.height
    return CameraCalibration(timestamp=stamp(when), frame_id=name, width=width, height=height, K=K, R=R, P=P)


def plan(shake: ShakePlan) -> dict[str, Any]:
    """Return a shake in numbers."""
    return {
        "amplitude_m": shake.amplitude,
        "frequency_hz": shake.frequency,
        "duration_s": shake.duration,
        "press_n": shake.press,
        "direction": shake.direction.tolist(),
        "grasp_arc_length_m": shake.grasp.arc_length,
        "reason": shake.reason,
    }
