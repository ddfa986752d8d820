"""A ROS 1 node in plain Python: XML-RPC to the master, TCPROS between nodes. No ROS is needed on this machine.

Protocols: wiki.ros.org/ROS/Technical%20Overview, ROS/Master_API, ROS/Slave_API, ROS/TCPROS. Messages are packed and
unpacked by rosbags. ROS 1 knows no passwords: whoever is in its network can command its robots. Keep it apart.
"""

from __future__ import annotations

import importlib
import os
import select
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any
from urllib.parse import urlparse
from xmlrpc.client import Error as XmlRpcError
from xmlrpc.client import ServerProxy, Transport
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from anther.core.errors import MissingExtra, bad_input
from anther.robot.devices import DeviceError
from anther.robot.drivers._streamed import prioritize_thread

PATIENCE = 3.0
"""The master and other nodes answer within this, or they are not there [s]."""


Receive = Callable[[Any], None]


def typestore(definitions: Mapping[str, str]) -> Any:
    """Return rosbags' store of ROS 1's messages and of further ones, {"package/msg/Name": definition}.

    Raises:
        MissingExtra: rosbags is not installed.
    """
    try:
        typesys: Any = importlib.import_module("rosbags.typesys")
    except ImportError as error:
        raise MissingExtra("ROS 1: rosbags is not installed. Run: pip install 'anther[sawyer]'.") from error
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    for name, text in definitions.items():
        store.register(typesys.get_types_from_msg(text, name))
    return store


class Node:
    """A node that is registered with a master until it is closed.

    Attributes:
        types: makes, packs and unpacks messages, from `typestore`.
    """

    def __init__(self, master: str, name: str, types: Any, host: str = "") -> None:
        """Begin.

        Args:
            master: such as "http://sawyer.local:11311".
            name: such as "/anther"; a node of the same name that runs elsewhere is ended by the master.
            types: from `typestore`.
            host: this machine's address as the robot sees it (ROS_IP); empty: that of the way to the master.

        Raises:
            InputError: no address of a master.
            DeviceError: no master there.
        """
        where = urlparse(master)
        if where.scheme != "http" or not where.hostname or not where.port:
            raise bad_input(
                "ROS master", given=f"'{master}'", allowed="http://HOST:PORT", do="Often the port is 11311."
            )
        self.types, self._name, self._at = types, name, master
        self._closed, self._lock = False, threading.Lock()
        self._subscribed: dict[str, tuple[str, Receive, set[str]]] = {}
        self._said: dict[str, Publisher] = {}
        self._own = host or _own_address(where.hostname, where.port, master)
        self._listener = socket.create_server((self._own, 0))
        self._slave: Any = SimpleXMLRPCServer((self._own, 0), _Quiet, logRequests=False, allow_none=True)
        for method in (self._publisherUpdate, self._requestTopic, self._getPid, self._getBusInfo):
            self._slave.register_function(method, method.__name__.removeprefix("_"))
        self.uri = f"http://{self._own}:{self._slave.server_address[1]}/"
        poll = 0.05  # a node that is closed has noticed it within this [s]
        threading.Thread(target=self._slave.serve_forever, args=(poll,), daemon=True).start()
        threading.Thread(target=self._accept, daemon=True).start()

    def subscribe(self, topic: str, kind: str, receive: Receive) -> None:
        """Call `receive` with every message of a topic, from another thread."""
        self._subscribed[topic] = (kind, receive, set())
        self._connect(topic, self._ask("registerSubscriber", topic, _ros_name(kind), self.uri))

    def publisher(self, topic: str, kind: str, *, latch: bool = False) -> Publisher:
        """Return what publishes a topic; with `latch` later readers are given the last message."""
        self._said[topic] = Publisher(self.types, topic, kind, self._name, latch=latch)
        self._ask("registerPublisher", topic, _ros_name(kind), self.uri)
        return self._said[topic]

    def parameter(self, key: str) -> Any:
        """Return a parameter of the server; None if it has none of that name."""
        code, _, value = self._call("getParam", key)
        return value if code == 1 else None

    def close(self) -> None:
        """Sign off and close all connections."""
        self._closed = True
        for topic in self._subscribed:
            with suppress(DeviceError):
                self._ask("unregisterSubscriber", topic, self.uri)
        for topic, publisher in self._said.items():
            publisher.close()
            with suppress(DeviceError):
                self._ask("unregisterPublisher", topic, self.uri)
        self._slave.shutdown()
        self._slave.server_close()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _ask(self, method: str, *words: Any) -> Any:
        code, said, value = self._call(method, *words)
        if code != 1:
            raise DeviceError(f"ROS master {self._at} refuses {method}: {said}.")
        return value

    def _call(self, method: str, *words: Any) -> Any:
        try:
            return getattr(ServerProxy(self._at, _Hasty(), allow_none=True), method)(self._name, *words)
        except (OSError, XmlRpcError, ValueError) as error:
            raise DeviceError(_no_master(self._at, error)) from error

    def _connect(self, topic: str, publishers: list[str]) -> None:
        """Listen to the publishers of a topic that are not listened to yet."""
        with self._lock:
            known = self._subscribed[topic][2]
            fresh = [uri for uri in publishers if uri not in known]
            known.update(fresh)
        for uri in fresh:
            threading.Thread(target=self._listen, args=(topic, uri), daemon=True).start()

    def _listen(self, topic: str, uri: str) -> None:
        """Hear one publisher until it is gone; then it may be connected to anew."""
        kind, receive, known = self._subscribed[topic]
        try:
            ask = ServerProxy(uri, _Hasty(), allow_none=True)
            code, _, place = ask.requestTopic(self._name, topic, [["TCPROS"]])  # type: ignore[misc]
            if code != 1:  # type: ignore[comparison-overlap]
                return
            with socket.create_connection((place[1], place[2]), PATIENCE) as line, prioritize_thread():  # type: ignore[index]
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                _write_header(
                    line,
                    {"callerid": self._name, "topic": topic, "tcp_nodelay": "1"} | _describe_type(self.types, kind),
                )
                if "error" in _read_header(line):
                    return
                line.settimeout(None)
                while not self._closed:
                    receive(self.types.deserialize_ros1(_read(line), kind))
        except (
            Exception
        ):  # rosbags raises whatever the bytes provoke; what is no longer heard is stale, and that is told
            return
        finally:
            with self._lock:
                known.discard(uri)

    def _accept(self) -> None:
        while not self._closed:
            with suppress(OSError):
                line, _ = self._listener.accept()
                threading.Thread(target=self._greet, args=(line,), daemon=True).start()

    def _greet(self, line: socket.socket) -> None:
        line.settimeout(PATIENCE)
        try:
            asked = _read_header(line)
            publisher = self._said.get(asked.get("topic", ""))
            if publisher is None:
                raise ValueError("no such topic here")
            publisher.welcome(line, asked)
        except (OSError, ValueError, struct.error) as error:
            with suppress(OSError):
                _write_header(line, {"error": str(error)})
            line.close()

    # the slave's interface, by the protocol's names
    def _publisherUpdate(self, caller: str, topic: str, publishers: list[str]) -> list[Any]:
        del caller
        if topic in self._subscribed:
            self._connect(topic, publishers)
        return [1, "", 0]

    def _requestTopic(self, caller: str, topic: str, protocols: list[Any]) -> list[Any]:
        del caller, protocols
        if topic not in self._said:
            return [0, f"{self._name} does not publish {topic}", []]
        return [1, "", ["TCPROS", self._own, self._listener.getsockname()[1]]]

    def _getPid(self, caller: str) -> list[Any]:
        del caller
        return [1, "", os.getpid()]

    def _getBusInfo(self, caller: str) -> list[Any]:
        del caller
        return [1, "", []]


class Publisher:
    """What is said on one topic, and to whom. Made by `Node.publisher`."""

    def __init__(self, types: Any, topic: str, kind: str, name: str, *, latch: bool) -> None:
        self._types, self._topic, self._kind, self._name, self._latch = types, topic, kind, name, latch
        self._lines: list[socket.socket] = []
        self._last, self._lock = b"", threading.Lock()

    @property
    def readers(self) -> int:
        """How many listen."""
        return len(self._lines)

    def publish(self, message: Any) -> None:
        """Send a message to all readers; one that does not take it within 20 ms is given up."""
        self.send(self.packet(message))

    def packet(self, message: Any) -> bytes:
        """Return a message as it is sent."""
        body = bytes(self._types.serialize_ros1(message, self._kind))
        return struct.pack("<I", len(body)) + body

    def send(self, packet: bytes) -> None:
        """Send what `packet` made, as `publish` does."""
        with self._lock:
            self._last = packet if self._latch else b""
            for line in list(self._lines):
                self._send(line, packet)

    def welcome(self, line: socket.socket, asked: Mapping[str, str]) -> None:
        """Take a reader, by its header.

        Raises:
            ValueError: it expects another message.
        """
        own = _describe_type(self._types, self._kind)
        if asked.get("md5sum") not in ("*", own["md5sum"]):
            raise ValueError(f"{self._topic} is {own['type']} {own['md5sum']}, not {asked.get('md5sum')}")
        _write_header(line, own | {"callerid": self._name, "latching": str(int(self._latch)), "topic": self._topic})
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.setblocking(False)
        with self._lock:
            self._lines.append(line)
            if self._last:
                self._send(line, self._last)

    def close(self) -> None:
        """Let all readers go."""
        with self._lock:
            while self._lines:
                self._lines.pop().close()

    def _send(self, line: socket.socket, packet: bytes) -> None:
        """Send a packet at once: to a socket with a timeout Python first waits, in which a command can grow old."""
        sent = 0
        try:
            while sent < len(packet):
                try:
                    sent += line.send(packet[sent:])
                except BlockingIOError:
                    if not select.select([], [line], [], 0.02)[1]:
                        raise
        except OSError:
            self._lines.remove(line)
            line.close()


class _Hasty(Transport):
    """Gives up after `PATIENCE`."""

    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = PATIENCE
        return connection


class _Quiet(SimpleXMLRPCRequestHandler):
    rpc_paths = ()  # other nodes post to / and to /RPC2


def _own_address(host: str, port: int, master: str) -> str:
    try:
        with socket.create_connection((host, port), PATIENCE) as line:
            return line.getsockname()[0]
    except OSError as error:
        raise DeviceError(_no_master(master, error)) from error


def _no_master(master: str, error: Exception) -> str:
    return f"no ROS master answers at {master} ({error}). Is the robot on, its cable plugged in, its name known here?"


def _ros_name(kind: str) -> str:
    return kind.replace("/msg/", "/")


def _describe_type(types: Any, kind: str) -> dict[str, str]:
    definition, digest = types.generate_msgdef(kind, ros_version=1)
    return {"type": _ros_name(kind), "md5sum": digest, "message_definition": definition}


def _write_header(line: socket.socket, fields: Mapping[str, str]) -> None:
    items = [f"{key}={value}".encode() for key, value in fields.items()]
    body = b"".join(struct.pack("<I", len(item)) + item for item in items)
    line.sendall(struct.pack("<I", len(body)) + body)


def _read_header(line: socket.socket) -> dict[str, str]:
    body, fields = _read(line), dict[str, str]()
    while body:
        (size,) = struct.unpack_from("<I", body)
        key, _, value = body[4 : 4 + size].decode("utf-8", "replace").partition("=")
        fields[key], body = value, body[4 + size :]
    return fields


def _read(line: socket.socket) -> bytes:
    """Return the body of a packet.

    Raises:
        OSError: the other side is gone.
        ValueError: too long.
    """
    (size,) = struct.unpack("<I", _exactly(line, 4))
    if size > 2**22:  # bytes: states and commands of robots are shorter by far
        raise ValueError(f"a message of {size} bytes")
    return _exactly(line, size)


def _exactly(line: socket.socket, size: int) -> bytes:
    parts = bytearray()
    while len(parts) < size:
        part = line.recv(size - len(parts))
        if not part:
            raise ConnectionResetError("the other side is gone")
        parts += part
    return bytes(parts)
