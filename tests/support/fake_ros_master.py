"""A ROS 1 master of one page, for tests on machines without ROS: it knows who says and who hears what."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

DEBIAN = "/usr/bin/python3"  # what Debian's ROS is installed for
NO_ROSCORE = "roscore is not installed: apt-get install python3-roslaunch python3-rospy"


def has_roscore() -> bool:
    return shutil.which("roscore") is not None


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


@contextmanager
def debian_roscore() -> Iterator[str]:
    """Run ROS' own master; gives its address."""
    port = free_port()
    uri, quiet = f"http://127.0.0.1:{port}", subprocess.DEVNULL
    with subprocess.Popen(
        [DEBIAN, "/usr/bin/rosmaster", "--core", "-p", str(port)], stdout=quiet, stderr=quiet
    ) as core:
        for _ in range(100):
            if _answers(uri):
                break
            time.sleep(0.1)
        try:
            yield uri
        finally:
            core.terminate()


def _answers(uri: str) -> bool:
    try:
        return ServerProxy(uri).getPid("/test")[0] == 1  # type: ignore[index]
    except OSError:
        return False


class AnyPath(SimpleXMLRPCRequestHandler):
    rpc_paths = ()


class FakeMaster:
    """Attributes: `uri`; `parameters`."""

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}
        self._readers: dict[str, list[str]] = defaultdict(list)
        self._writers: dict[str, list[str]] = defaultdict(list)
        self._server = SimpleXMLRPCServer(("127.0.0.1", 0), AnyPath, logRequests=False, allow_none=True)
        for method in ("registerSubscriber", "registerPublisher", "unregisterSubscriber", "unregisterPublisher"):
            self._server.register_function(getattr(self, f"_{method}"), method)
        self._server.register_function(self._get_param, "getParam")
        self.uri = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def _registerSubscriber(self, caller: str, topic: str, kind: str, uri: str) -> list[Any]:
        self._readers[topic].append(uri)
        return [1, "", self._writers[topic]]

    def _registerPublisher(self, caller: str, topic: str, kind: str, uri: str) -> list[Any]:
        self._writers[topic].append(uri)
        for reader in self._readers[topic]:
            threading.Thread(target=self._tell, args=(reader, topic), daemon=True).start()
        return [1, "", self._readers[topic]]

    def _unregisterSubscriber(self, caller: str, topic: str, uri: str) -> list[Any]:
        self._readers[topic] = [u for u in self._readers[topic] if u != uri]
        return [1, "", 1]

    def _unregisterPublisher(self, caller: str, topic: str, uri: str) -> list[Any]:
        self._writers[topic] = [u for u in self._writers[topic] if u != uri]
        return [1, "", 1]

    def _get_param(self, caller: str, key: str) -> list[Any]:
        return [1, "", self.parameters[key]] if key in self.parameters else [-1, f"no parameter {key}", 0]

    def _tell(self, reader: str, topic: str) -> None:
        with suppress(OSError):
            ServerProxy(reader).publisherUpdate("/master", topic, self._writers[topic])
