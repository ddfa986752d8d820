"""Print, as JSON, what a suite decides with one constant multiplied: python -m evaluation.decisions ROOM FOLDER MODULE
NAME FACTOR. It is a process of its own because a module is imported once."""

import json
import sys
from pathlib import Path

from evaluation.constants import Constant, arrange


def main(room: str, folder: str, module: str, name: str, factor: str) -> None:
    """Move the constant, then import the suite, and with it Anther."""
    arrange(Constant(module, name), float(factor))
    from evaluation.decisions import suite  # noqa: PLC0415

    print(json.dumps(suite(room).decide(Path(folder), module)))


if __name__ == "__main__":
    main(*sys.argv[1:])
