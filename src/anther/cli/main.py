"""The command line: `anther COMMAND ...`. Exit code 0: done; 1: the trial failed; 2: bad input, or it never began.

A command is a module of `anther.cli`: its docstring and `Args` are its help, `run(args)` does it, returns the exit
code (None is 0), and raises an `AntherError` where something given is wrong or a stage cannot go on.
"""

from __future__ import annotations

import atexit
import gc
import io
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import partial
from importlib import import_module
from signal import SIGTERM, default_int_handler, signal
from threading import current_thread, main_thread
from types import ModuleType
from typing import Any

PATIENCE = 2.0  # s

COLLECT_EVERY = 100_000
"""Garbage is looked for after so many new objects: Python's 700 costs a fifth of the time of `anther skeletonize`."""

CONTROL = re.compile(r"(\x1b\[[0-9;]*m)|[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Colours (group 1), and all else that a terminal obeys but tabs and the ends of lines."""

COMMANDS = {
    "trial": "see, grasp and shake one plant, in the simulated cell or a real one, measure it, write a report",
    "sweep": "many trials or reconstructions from a table, on all cores or a cluster; goes on after any stop",
    "cell": "a real robot's cell: check its parts, enable them, jog a joint",
    "reconstruct": "RGB-D views of a plant -> cloud, skeleton, main stem, flowers, grasp",
    "skeletonize": "point cloud -> skeleton, main stem, grasp",
    "traits": "a folder of point clouds -> a table of traits: stem, internodes, leaves, angles; goes on after a stop",
    "plan": "choose the shake for a skeleton or run and explain it: limits, runner-up, every flower, response map",
    "shake": "shake a skeleton with the elastic-rod model; print the flower's motion",
    "respond": "map how flowers answer shakes of a skeleton or run, over grip height and frequency",
    "identify": "bench measurements of a stem -> density, stiffness, damping, with uncertainty",
    "calibrate": "images of a board and flange poses -> where the camera sits on the flange, and how well it is known",
    "history": "list the trials, filter them, export them as CSV or Parquet",
    "outcome": "record how many flowers of a plant or visit set fruit",
    "fruit-set": "what the counts of fruit set teach of the dose-response, and what they do not",
    "serve": "pages of the history for a browser or a phone: today, failures, trends, robots, plants; read-only",
    "view": "open a run or a skeleton in the 3-D viewer, write it to one HTML file, or show a trial as it happens",
    "export": "a run's skeleton -> PLY, SWC, GraphML, MTG (OpenAlea) or glTF, by the file's suffix",
    "import-capture": "COLMAP, RealSense or ROS bags, MCAP -> a capture folder; fused PLY -> a cloud",
    "convert-kinect": "Kinect turntable frames -> a capture folder",
    "samples": "write small sample inputs for the commands above",
    "doctor": "what is installed, what is missing and how to get it",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code; without `argv`, that of this process, which ends with it."""
    if argv is None:
        gc.set_threshold(COLLECT_EVERY)
        _print_plainly()
        atexit.register(_leave_garbage)
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in {"-h", "--help"}:
        rows = "\n".join(f"  {name:16}{text}" for name, text in COMMANDS.items())
        ends = "anther COMMAND --help tells a command's options, --help-all also the parameters of its stages."
        print(f"usage: anther COMMAND [options]\n\n{rows}\n\n{ends}")
        return 0 if words else 2
    if words[0] == "--version":
        from anther import __version__

        print(f"anther {__version__}")
        return 0
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # many small matrices: threads only get in each other's way
    if words[0] not in COMMANDS:
        print(f"anther: no command '{words[0]}'; allowed: {', '.join(COMMANDS)}. See: anther --help", file=sys.stderr)
        return 2
    with _terminated_as_interrupted():
        return _run(words[0], words[1:])


def plain(text: str) -> str:
    """Return a text that colours a terminal at most: a label or a file's name could move its cursor, or more."""
    return CONTROL.sub(lambda found: found[1] or ascii(found[0])[1:-1], text)


class _Plain(io.TextIOWrapper):
    def write(self, text: str, /) -> int:
        return super().write(plain(text))


def _print_plainly() -> None:
    """Let standard output have `plain` text alone, and spell out what its encoding has no sign for."""
    out = sys.stdout
    if isinstance(out, io.TextIOWrapper):
        how: dict[str, Any] = {name: getattr(out, name) for name in ("encoding", "line_buffering", "write_through")}
        sys.stdout = _Plain(out.detach(), errors="backslashreplace", **how)


def _leave_garbage() -> None:
    """Collect nothing at the end: all memory goes back as it is. But RoboPlan's bindings would call it a leak."""
    if "roboplan" not in sys.modules:
        gc.freeze()


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """A service that is stopped (SIGTERM) ends as with Ctrl-C: the arm at rest, the pads open, all recorded."""
    if current_thread() is not main_thread():
        yield
        return
    before = signal(SIGTERM, default_int_handler)
    try:
        yield
    finally:
        signal(SIGTERM, before)


@contextmanager
def _compiling_told(name: str) -> Iterator[None]:
    """Say so when a command that brought numba compiles after `PATIENCE`; it takes a minute, and is kept."""
    if "numba" not in sys.modules:
        yield
        return
    from numba.core import event

    begin, told = time.monotonic(), list[str]()

    class Once(event.Listener):
        def on_start(self, event: Any) -> None:
            if not told and time.monotonic() - begin > PATIENCE:
                told.append(name)
                print(f"anther {name}: compiling for this machine, once; about a minute ...", file=sys.stderr)

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Once()):
        yield


def _run(name: str, words: list[str]) -> int:
    import tyro

    from anther.core.errors import AntherError, missing_extra

    try:
        command = _module(name)
        asked = ["--help" if word == "--help-all" else word for word in words]
        parse = partial(tyro.cli, command.Args, prog=f"anther {name}", description=command.__doc__, args=asked)
        if asked == words and {"-h", "--help"} & set(words):
            _short_help(name, parse)
        args = parse()
        with _compiling_told(name):
            return int(command.run(args) or 0)
    except (AntherError, ImportError) as error:
        told = error if isinstance(error, AntherError) else missing_extra(error)
        if told is None:
            raise
        print(plain(f"anther {name}: {told}"), file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"anther {name}: not enough memory ({error}). Give a smaller cloud or capture.", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        place, why = error.filename or "a file or device", error.strerror or error
        print(
            plain(f"anther {name}: {place}: {why}. Check the path, its rights and the disk's space."), file=sys.stderr
        )
        return 2
    except KeyboardInterrupt:
        print(f"anther {name}: interrupted; finished stages are kept.", file=sys.stderr)
        return 130


OWN = ("positional arguments", "options")


def _short_help(name: str, parse: Callable[[], Any]) -> None:
    """Print the help that `parse` prints without the parameters of the stages, name their groups, and end likewise."""
    encoding = (sys.stdout.encoding or "utf-8").lower()  # tyro draws boxes in "utf-8" only
    said = io.TextIOWrapper(io.BytesIO(), encoding, errors="replace")
    try:
        with redirect_stdout(said):
            parse()
    finally:
        said.seek(0)
        head, *groups = re.split(r"(?m)^(?=╭─ )", said.read())
        titled = {group[3:].split(" ─")[0]: group for group in groups}
        print(head + "".join(titled[title] for title in OWN if title in titled), end="")
        more = [title.removesuffix(" options") for title in titled if title not in (*OWN, "subcommands")]
        if more:
            print(f"Parameters of {', '.join(more)}: anther {name} --help-all")


def _module(name: str) -> ModuleType:
    """Import only the chosen command, so that the others cost nothing."""
    return import_module(f"anther.cli.{name.replace('-', '_')}")


if __name__ == "__main__":
    sys.exit(main())
