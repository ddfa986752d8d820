"""One owner for an arm on a machine: locks that follow the arm, not its spelling, and that every user may take."""

from __future__ import annotations

import importlib
import os
import re
import socket
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from anther.robot.devices import DeviceError

FOLDERS = (Path("/run/lock"), Path("/tmp"))
"""Where locks lie: in the first that every user of the machine may write to. Nothing in a process's environment changes
it, or two processes would not meet."""
HERE = "127.0.0.1"
TRIES = 10
GONE = "the lock {} comes and goes. Look who removes it."


def addresses(place: str) -> list[str]:
    """Return what an arm's place is called whatever its spelling: one name for each address of its host.

    Host names are resolved, and every address of this machine is `HERE`; a name that nobody knows stands for itself.

    Args:
        place: "http://sawyer.local:11311/", "192.168.1.20", "ur.local"; or other words, which stand for themselves.
    """
    url = urlsplit(place if "//" in place else f"//{place}")
    with suppress(ValueError):  # of the port
        if url.hostname and " " not in place:
            port = url.port or {"http": 80, "https": 443}.get(url.scheme)
            path = url.path.strip("/")
            end = (f":{port}" if port else "") + (f"/{path}" if path else "")
            return sorted({f"{host}{end}" for host in _resolve(url.hostname)})
    return [place.strip("/")]


def _resolve(host: str) -> set[str]:
    host = host.rstrip(".")
    try:
        found = {str(entry[4][0]) for entry in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except (OSError, UnicodeError):
        return {host}
    return {HERE if _is_here(address) else address for address in found}


def _is_here(address: str) -> bool:
    """Return whether an address is one of this machine: only there a socket can be bound."""
    if ip_address(address.partition("%")[0]).is_loopback:
        return True
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))
    except OSError:
        return False
    return True


@contextmanager
def own_arm(arm: str, folder: Path | None = None) -> Iterator[None]:
    """Own an arm within the block. Its locks end with the process, however that ends.

    Args:
        arm: its place, see `addresses`; whoever has one of them has the arm.
        folder: of the lock files; None: the machine's, see `FOLDERS`.

    Raises:
        DeviceError: another process owns it, or a lock cannot be had.
    """
    with ExitStack() as stack:
        for name in addresses(arm):
            stack.callback(os.close, _lock(name, folder or _folder()))
        yield


def _folder() -> Path:
    """Return the first of `FOLDERS` that everybody may write to: the same for every user."""
    for folder in FOLDERS:
        with suppress(OSError):
            everybody = folder.stat().st_mode & stat.S_IWOTH
            if everybody and not os.statvfs(folder).f_flag & os.ST_RDONLY:
                return folder
    do = "Make one of them, with mode 1777."
    raise DeviceError(f"no folder for the arms' locks: allowed: {' or '.join(map(str, FOLDERS))}. {do}")


def _lock(name: str, folder: Path) -> int:
    """Return an open, locked file that stands for a name and has the number of this process in it."""
    fcntl: Any = importlib.import_module("fcntl")
    path = folder / f"anther-{re.sub(r'[^A-Za-z0-9.-]+', '-', name)}.lock"
    for _ in range(TRIES):
        handle = _open(path)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                owner = os.pread(handle, 40, 0).decode(errors="replace").strip()
                who = f"another process, number {owner if owner.isdecimal() else 'unknown'}"
                raise DeviceError(f"the arm {name} is commanded by {who}. Wait until it ends, or end it.") from error
            if _same(handle, path):
                os.ftruncate(handle, 0)
                os.pwrite(handle, str(os.getpid()).encode(), 0)
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # somebody removed it meanwhile
    raise DeviceError(GONE.format(path))


def _open(path: Path) -> int:
    """Return a lock file, open; it is made where it is missing, for every user.

    An existing one is opened as such, for in /tmp Linux lets nobody open another user's file with O_CREAT
    (fs.protected_regular). No link is followed: what it leads to would be overwritten.
    """
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    for _ in range(TRIES):  # two processes may make and remove it at the same time
        try:
            handle = os.open(path, flags)
        except FileNotFoundError:
            with suppress(FileExistsError):
                handle = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
                os.fchmod(handle, 0o666)  # whatever the umask
                return handle
            continue
        except OSError as error:
            raise DeviceError(f"the lock {path} cannot be opened ({error.strerror}). Remove it.") from error
        status = os.fstat(handle)
        if stat.S_ISREG(status.st_mode) and status.st_nlink <= 1:
            return handle
        os.close(handle)
        raise DeviceError(f"the lock {path} is no file of its own. Remove it.")
    raise DeviceError(GONE.format(path))


def _same(handle: int, path: Path) -> bool:
    """Return whether the path still leads to the open file."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(handle), path.lstat())
    return False
