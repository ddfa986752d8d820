"""Renew the lock files and the table of licences from what is installed: `make lock`.

A lock has a package a line, with its version and the hashes of all files of that version, so that every platform
installs what was tried here and nothing else. The packages are those that the file names: to add one, write its name
into the file and install it; `--no-deps` installs no other. Needs the index that PIP_INDEX_URL names, by default PyPI.
"""

import os
import re
import sys
import urllib.error
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from make_env import release_files

ROOT = Path(__file__).parents[1]
LOCKS = {
    "requirements.lock": "core",
    "requirements-dev.lock": "tests",
    "requirements-torch.lock": "tests",
    "requirements-site.lock": "site",
}
LICENCES = ROOT / "docs" / "licences.md"
LINE = re.compile(r"(?P<name>[A-Za-z0-9][\w.-]*)(?:==(?P<version>[^\s;]+))?\s*(?:;\s*(?P<when>[^\\]*[^\s\\]))?\s*\\?")
PYPI = "https://pypi.org/simple"


class Pin(NamedTuple):
    """A line of a lock: the normal form of its name, its version, and the marker that says when it counts, or ""."""

    name: str
    version: str
    when: str


def pins(text: str) -> Iterator[Pin]:
    """Yield the pins of a lock."""
    for line in text.splitlines():
        found = LINE.fullmatch(line)
        if found:
            yield Pin(normal(found["name"]), found["version"] or "", found["when"] or "")


def normal(name: str) -> str:
    """Return a package's name as indices write it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def hashes(pin: Pin, indices: list[str]) -> list[str]:
    """Return the SHA-256 of every file of a release, in order; of the first index that has it."""
    begin = re.compile(
        rf"{pin.name.replace('-', '[-_.]+')}-{re.escape(pin.version)}(?:-.*|\.tar\.\w+|\.zip)", re.IGNORECASE
    )
    for index in indices:
        try:
            found = {sha for name, _, sha in release_files(index, pin.name) if begin.fullmatch(name)}
        except urllib.error.URLError as error:
            print(f"lock: {index} cannot be asked for {pin.name}: {error}", file=sys.stderr)
            continue
        if found:
            return sorted(found)
    return []


def renewed(text: str) -> str:
    """Return a lock with the versions that are installed, and their hashes; what is not installed stays as it is."""
    comments = [line for line in text.splitlines() if line.startswith(("#", "--extra-index-url "))]
    indices = [os.environ.get("PIP_INDEX_URL") or PYPI]
    indices += [line.split()[1] for line in comments if not line.startswith("#")]
    known = {
        name: shas.split() for name, shas in re.findall(r"^([^\s=]+==[^\s;]+).*\\\n((?:\s+--hash=.*\n?)+)", text, re.M)
    }

    def entry(pin: Pin) -> str:
        installed = "" if "+" in pin.version else version(pin.name).partition("+")[0]
        pin = pin._replace(version=installed or pin.version)
        found = [f"--hash=sha256:{sha}" for sha in hashes(pin, indices)]
        found = found or [word for word in known.get(f"{pin.name}=={pin.version}", ()) if word != "\\"]
        if not found:
            sys.exit(f"lock: no file of {pin.name}=={pin.version} on {', '.join(indices)}. Check name and index.")
        when = f"; {pin.when}" if pin.when else ""
        return " \\\n    ".join([f"{pin.name}=={pin.version}{when}", *found])

    with ThreadPoolExecutor(8) as pool:
        return "\n".join([*comments, *pool.map(entry, sorted(pins(text)))]) + "\n"


def version(name: str) -> str:
    """Return the version that is installed, or ""."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def licence(name: str) -> str:
    """Return what an installed package's metadata say: an SPDX expression, else its classifiers, else its own words.

    Of a licence that is told by its text alone it is the first line, or that it is a BSD licence.
    """
    package = metadata.distribution(name)

    def field(key: str) -> list[str]:
        return package.metadata.get_all(key) or []

    classes = {words.split(" :: ")[-1] for words in field("Classifier") if words.startswith("License :: ")}
    classified = ", ".join(sorted(classes - {"OSI Approved"}))
    said = next(filter(None, [*field("License-Expression"), classified, *field("License")]), "").strip()
    texts = [file for file in package.files or () if re.search(r"\.dist-info/.*(LICEN[CS]E|COPYING)", str(file))]
    if not said and texts:
        said = texts[0].read_text().strip()
    if "Redistribution and use in source and binary forms" in " ".join(said.split()):
        return "BSD, by its text"
    return " ".join(said.splitlines()[0].split()).replace("|", "/") if said else "not said"


def table(locks: dict[str, str], before: str) -> str:
    """Return docs/licences.md; of a package that is not installed it says what it said before.

    Args:
        locks: name of a lock's file -> its text.
        before: the page as it was.
    """
    rows: dict[str, str] = dict(re.findall(r"^\| ([^ ]+) \|.*\| ([^|]+) \|$", before, re.M))
    part: dict[str, tuple[str, str]] = {}
    for file, text in locks.items():
        for pin in pins(text):
            part.setdefault(pin.name, (pin.version.partition("+")[0], LOCKS[file]))
    for name in part:
        rows[name] = licence(name) if version(name) else rows.get(name, "not installed where this was made")
    head = before.partition("| package |")[0]
    lines = [f"| {name} | {number} | {where} | {rows[name]} |" for name, (number, where) in sorted(part.items())]
    return head + "\n".join(["| package | version | for | licence |", "|---|---|---|---|", *lines]) + "\n"


def main() -> None:
    """Write the locks and the table, and say what is installed and in none of them."""
    locks = {name: renewed((ROOT / name).read_text()) for name in LOCKS}
    for name, text in locks.items():
        (ROOT / name).write_text(text)
    LICENCES.write_text(table(locks, LICENCES.read_text()))
    named = {pin.name for text in locks.values() for pin in pins(text)} | {"anther", "pip"}
    strangers = {normal(package.metadata["Name"]) for package in metadata.distributions()} - named
    if strangers:
        print(f"lock: installed, but in no lock: {', '.join(sorted(strangers))}")


if __name__ == "__main__":
    main()
