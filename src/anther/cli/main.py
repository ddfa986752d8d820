"""The command line: `anther COMMAND ...`. Exit code 0: done; 1: the trial failed; 2: bad input, or it never began.

A command is two modules. That of `anther.cli.args` is light: its docstring and `Args` are its help. That of
`anther.cli`, imported once the words are understood and the files there, does it: `run(args)` returns the exit code
(None is 0), and raises an `AntherError` where something given is wrong or a stage cannot go on.
"""

from __future__ import annotations

import atexit
import gc
import io
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from keyword import iskeyword
from signal import SIGTERM, default_int_handler, signal
from threading import current_thread, main_thread
from types import ModuleType
from typing import Any, get_type_hints

CONTROL = re.compile(r"(\x1b\[[0-9;]*m)|[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Colours (group 1), and all else that a terminal obeys but tabs and the ends of lines."""

COMMANDS = {
    "trial": "see, grasp and shake one plant, in the simulated cell or a real one, measure it, write a report",
    "row": "along a simulated greenhouse row: map it, visit its stems in a shift; goes on after any stop",
    "sweep": "many trials or reconstructions from a table, on all cores or a cluster; goes on after any stop",
    "cell": "a real robot's cell: check its parts, enable them, jog a joint",
    "reconstruct": "RGB-D views of a plant -> cloud, skeleton, main stem, flowers, grasp",
    "skeletonize": "point cloud -> skeleton, main stem, grasp",
    "traits": "a folder of point clouds -> tables of traits: stem, limbs, hulls, colours, growth; goes on after a stop",
    "plan": "choose the shake for a skeleton or run and explain it; or simulate one shake, or map all",
    "identify": "bench measurements of a stem -> density, stiffness, damping, with uncertainty",
    "calibrate": "images of a board and flange poses -> where the camera sits on the flange, and how well it is known",
    "history": "list the trials, filter and export them; record and learn fruit set; show all on pages",
    "view": "open a run or a skeleton in the 3-D viewer, write it for other programs, or show a trial as it happens",
    "import": "Kinect frames, COLMAP, RealSense or ROS bags, MCAP -> a capture folder; fused PLY -> a cloud",
    "doctor": "what is installed, what is missing and how to get it; small sample inputs to try the rest with",
}
ACTIONS = {
    "import": {"share": "a copy of a capture to give away: no names, places or texts, faces masked, calibration kept"},
    "doctor": {"samples": "write small sample inputs for the other commands"},
    "history": {
        "outcome": "record how many flowers of a plant or visit set fruit",
        "fruit-set": "what the counts of fruit set teach of the dose-response, and what they do not",
        "serve": "pages for a browser or a phone: today, failures, trends, robots, plants; read-only",
    },
}
"""Command -> what else it does, each with options of its own: `anther history outcome ...`."""
SHORT = {"samples": ["doctor", "samples"], "capture": ["import"]}
"""Word -> what it stands for: `anther samples`, `anther capture share`."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code; without `argv`, that of this process, which ends with it."""
    if argv is None:
        gc.set_threshold(100_000)  # Python's 700 costs a fifth of the time of `anther skeletonize`
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
    words = [*SHORT.get(words[0], words[:1]), *words[1:]]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # many small matrices: threads only get in each other's way
    if words[0] not in COMMANDS:
        print(f"anther: no command '{words[0]}'; allowed: {', '.join(COMMANDS)}. See: anther --help", file=sys.stderr)
        return 2
    own = 2 if words[1:] and words[1] in ACTIONS.get(words[0], ()) else 1
    with _treat_termination_as_interrupt():
        return _run(" ".join(words[:own]), words[own:])


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
def _treat_termination_as_interrupt() -> Iterator[None]:
    """A service that is stopped (SIGTERM) ends as with Ctrl-C: the arm at rest, the pads open, all recorded."""
    if current_thread() is not main_thread():
        yield
        return
    before = signal(SIGTERM, default_int_handler)
    try:
        yield
    finally:
        signal(SIGTERM, before)


def do(name: str, words: list[str]) -> int:
    """Do one command, and return its exit code; errors are raised."""
    args = _parse(name, words)
    return int(_module(name).run(args) or 0)


def _run(name: str, words: list[str]) -> int:
    from anther.core.errors import AntherError, missing_extra

    try:
        return do(name, words)
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


def _parse(name: str, words: list[str]) -> Any:
    """Return what a command is asked; nothing heavy is imported unless a stage's parameter is among it."""
    import tyro

    from anther.cli.args import shared

    module = _module(name, "args.")
    asked, stages = module.Args, shared.stages(module.Args)
    short, more = bool({"-h", "--help"} & set(words)), list[str]()
    if short:
        asked, more = shared.shortened(asked)
    elif "--help-all" in words or any(_is_of_stage(word, asked, stages) for word in words):
        asked = shared.tuned(asked)
    words = ["--help" if word == "--help-all" else word for word in words]
    try:
        args = tyro.cli(asked, prog=f"anther {name}", description=_description(name, module.__doc__ or ""), args=words)
    finally:
        if short and more:
            print(f"Options of {', '.join(more)}: anther {name} --help-all")
    _check_given(args)
    return args


def _is_of_stage(word: str, args: type, stages: dict[str, Any]) -> bool:
    """Return whether a word may be a parameter of a stage: by its prefix, or where it has none as no other option."""
    known = {each.name.replace("_", "-") for each in fields(args)}
    for name, stage in stages.items():
        option = word.startswith("--") and word[2:].split("=", maxsplit=1)[0].replace("_", "-") not in known
        if re.match(rf"(--)?{name}[.:]", word) or (stage.metadata["flat"] and option):
            return True
    return False


def _description(name: str, text: str) -> str:
    """Return a command's help, with what else it does."""
    actions = "".join(f"\n\n`anther {name} {action}`: {does}." for action, does in ACTIONS.get(name, {}).items())
    return text + actions


def _check_given(args: Any) -> None:
    """Raise InputError where a file or folder that is read does not exist; a trial to be shown live may begin later."""
    from anther.cli.args.shared import EXISTS

    for name, hint in get_type_hints(type(args), include_extras=True).items():
        value = getattr(args, name)
        if EXISTS in getattr(hint, "__metadata__", ()) and not getattr(args, "live", False):
            from anther.core.files import existing  # NumPy

            for path in value if isinstance(value, tuple) else (value,):
                if path is not None:
                    existing(path)


def _module(name: str, where: str = "") -> ModuleType:
    """Import only the chosen command (`where` "args.": only what it is asked), so that the others cost nothing."""
    last = name.rsplit(maxsplit=1)[-1].replace("-", "_")
    return import_module(f"anther.cli.{where}{f'{last}_' if iskeyword(last) else last}")


if __name__ == "__main__":
    sys.exit(main())
