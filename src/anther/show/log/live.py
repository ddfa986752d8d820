"""Show a log while it is being written, to Foxglove's app: a WebSocket of this machine that only sends.

It reads the file, in a process of its own: who watches a trial can neither command it nor hold it up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import foxglove
import lz4.frame
import zstandard
from foxglove import Channel, Context, Schema
from foxglove.websocket import ChannelView, Client, ServerListener
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, McapRecord, Message
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import breakup_chunk

from anther.core.errors import bad_input

HOST = "127.0.0.1"
"""Who may watch: this machine."""
MAGIC = b"\x89MCAP0\r\n"
"""What the file begins with."""
LARGEST = 16_000_000
"""A record that is larger, packed or not, is damage [bytes]: a chunk and one message more are below 2 MB."""


class Tail:
    """Reads an MCAP file that is being written, as far as its records are whole.

    Args:
        path: of the file.

    Attributes:
        ended: whether its writer closed it.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.ended = path, False
        self._place, self._left, self._begun = 0, b"", False
        self._inode: int | None = None

    def replaced(self) -> bool:
        """Return whether the file is another one than it was, as of a trial that is done anew."""
        try:
            found = self.path.stat()
        except OSError:
            return False
        was, self._inode = self._inode, found.st_ino
        return was not in (None, found.st_ino) or found.st_size < self._place

    def records(self) -> Iterator[McapRecord]:
        """Yield the schemas, channels and messages that have come since the last call, in the order of the file.

        Raises:
            InputError: it is no MCAP file, or damaged, or may not be read.
        """
        data = self._left + self._more()
        if not self._begun and len(data) >= len(MAGIC):
            if not data.startswith(MAGIC):
                raise bad_input(str(self.path), given="another kind of file", allowed="MCAP", do="Is it the right one?")
            self._begun, data = True, data[len(MAGIC) :]
        begin, head = 0, 9  # bytes of a record's kind and length
        while self._begun and not self.ended and len(data) >= begin + head:
            kind, size = data[begin], int.from_bytes(data[begin + 1 : begin + head], "little")
            if size > LARGEST:
                raise self._damaged(f"a record of {size} bytes")
            end = begin + head + size
            if len(data) < end:
                break
            self.ended = kind == Opcode.DATA_END
            if kind == Opcode.CHUNK:
                yield from self._parts(data[begin + head : end])
            begin = end
        self._left = data[begin:]

    def _more(self) -> bytes:
        """Return the bytes that are new."""
        try:
            with self.path.open("rb") as stream:
                stream.seek(self._place)
                new = stream.read(2 * LARGEST)  # what is left comes with the next call
        except FileNotFoundError:  # it is to come
            return b""
        except OSError as error:
            do = "Check its rights."
            raise bad_input(str(self.path), given=error.strerror, allowed="a readable file", do=do) from error
        self._place += len(new)
        return new

    def _parts(self, content: bytes) -> list[McapRecord]:
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(content)))
            return breakup_chunk(replace(chunk, compression="", data=_unpack(chunk)))
        except Exception as error:  # zstd and mcap raise whatever the bytes provoke
            raise self._damaged(repr(error)) from error

    def _damaged(self, what: str) -> Exception:
        return bad_input(str(self.path), given=f"damaged: {what}", allowed="an MCAP file", do="Restore the file.")


def _unpack(chunk: Chunk) -> bytes:
    """Return what a chunk holds; a few bytes can stand for gigabytes, whatever size they state."""
    packed = BytesIO(chunk.data)
    match chunk.compression:
        case "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(packed).read(LARGEST + 1)
        case "lz4":
            data = lz4.frame.LZ4FrameFile(packed).read(LARGEST + 1)
        case _:
            data = chunk.data
    if len(data) > LARGEST:
        raise ValueError(f"a chunk of more than {LARGEST / 1e6:.0f} MB")
    return data


class Relay(ServerListener):
    """Sends records to whoever is connected. A newcomer is given the last message of every topic it subscribes to.

    Args:
        port: of the server; 0: any that is free.
        name: of what is shown.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, port: int, name: str) -> None:
        self._context = Context()
        self._schemas, self._channels = dict[int, Schema](), dict[int, Channel]()
        self._last = dict[str, tuple[Channel, Message]]()
        try:
            self._server = foxglove.start_server(
                name=name, host=HOST, port=port, capabilities=[], server_listener=self, context=self._context
            )
        except Exception as error:
            do = "Name another one with --port, or stop what has it."
            raise bad_input("port", given=f"{port} ({error})", allowed="one that is free", do=do) from error

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def send(self, record: McapRecord) -> None:
        """Send a message, or learn of a schema or a channel."""
        match record:
            case SchemaRecord():
                self._schemas[record.id] = Schema(name=record.name, encoding=record.encoding, data=record.data)
            case ChannelRecord() if record.id not in self._channels:
                self._channels[record.id] = Channel(
                    record.topic,
                    schema=self._schemas.get(record.schema_id),
                    message_encoding=record.message_encoding,
                    context=self._context,
                )
            case Message() if record.channel_id in self._channels:
                channel = self._channels[record.channel_id]
                self._last[channel.topic()] = (channel, record)
                channel.base.log(record.data, log_time=record.log_time)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Called by the server: what is drawn once shall be seen by who comes late, too."""
        if channel.topic in self._last:
            own, message = self._last[channel.topic]
            own.base.log(message.data, log_time=message.log_time)

    def forget(self) -> None:
        """Take back all channels: another file has its own."""
        for channel in self._channels.values():
            channel.close()
        self._schemas.clear()
        self._channels.clear()
        self._last.clear()

    def stop(self) -> None:
        """End the server."""
        self._server.stop()


def show(path: Path, port: int, *, ready: Callable[[int], None], over: Callable[[], bool] = lambda: False) -> None:
    """Serve a log as it grows, until `over`: also when it has ended, and when another takes its place.

    Args:
        path: of the log; it is waited for.
        port: of the server on this machine; 0: any that is free.
        ready: called with the port once it serves.
        over: asked again and again whether to stop.

    Raises:
        InputError: the port is taken; the file is no log, or damaged, or may not be read.
    """
    tail, relay = Tail(path), Relay(port, path.parent.name)
    try:
        ready(relay.port)
        while not over():
            if tail.replaced():
                tail = Tail(path)
                relay.forget()
            for record in tail.records():
                relay.send(record)
            time.sleep(0.1)
    finally:
        relay.stop()
