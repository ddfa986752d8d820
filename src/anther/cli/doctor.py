"""Say what is installed, what is missing and how to get it: versions, extras, GPU, compiled code, cameras, disk."""

from __future__ import annotations

import json
import os
import platform
import shutil
import sys
import tempfile
from contextlib import redirect_stdout
from importlib import metadata
from pathlib import Path
from typing import Literal, NamedTuple

from packaging.requirements import Requirement

from anther.cli.args.doctor import Args

FOR = {
    "images": "views of cameras: masks, clouds, row maps",
    "cell": "trials: an arm that moves, simulated or real",
    "view": "the 3-D viewer",
    "log": "the log of a trial, and its live view",
    "segmentation": "masks by Grounding DINO, SAM 2 and SAM 3",
    "bags": "RealSense and ROS bags, MCAP",
    "scans": "clouds in LAS, LAZ and E57",
    "phones": "recordings of Record3D",
    "realsense": "a RealSense camera",
    "sawyer": "a Sawyer over ROS 1",
    "ros2": "an arm or cart under ROS 2, where none is sourced",
    "ur": "a Universal Robots arm",
    "franka": "a Franka arm",
    "gripper": "a Robotiq gripper",
    "motor": "a motor in the gripper",
    "postgresql": "a history that several robots share",
    "parquet": "history as Parquet",
    "sweep": "many runs at once, on every core or a cluster",
    "serve": "pages of the history",
    "row": "which robot works which rows of a house",
    "evaluation": "plants of another generator",
}
"""Extra -> what it is for."""


class Examined(NamedTuple):
    """One thing that was looked at: its name, its state, what is there, and how to get or mend it.

    What is "absent" only some commands need; without what is "wrong" Anther does not work.
    """

    what: str
    state: Literal["ok", "absent", "wrong"]
    found: str
    do: str = ""


def run(args: Args) -> int:
    """Compile if that is asked, print the findings; return 1 if one of them is wrong."""
    if args.compile:
        from anther.cli.compile_all import compile_all

        with redirect_stdout(sys.stderr if args.json else sys.stdout):
            compile_all()
    core, extras = _requirements()
    looked = [_python(), _packages(core), *(_extra(name, needs) for name, needs in extras.items())]
    looked += [_gpu(), _examine_kernels(), _cameras(), _disk(Path.cwd())]
    if args.json:
        print(json.dumps([finding._asdict() for finding in looked], indent=2))
    else:
        for what, state, found, do in looked:
            print(f"{state:8}{what:16}{found}" + (f"\n{'':24}{do}" if do else ""))
    return int(any(finding.state == "wrong" for finding in looked))


def _python() -> Examined:
    found = f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    least = (3, 11)
    if sys.version_info[:2] < least:
        return Examined("Python", "wrong", found, f"Anther needs Python {least[0]}.{least[1]} or newer.")
    return Examined("Python", "ok", found)


def _requirements() -> tuple[list[Requirement], dict[str, list[Requirement]]]:
    """Return what Anther needs, and what each extra needs, as its installed metadata tells."""
    try:
        distribution = metadata.distribution("anther")
    except metadata.PackageNotFoundError:
        return [], {}
    needs = [Requirement(text) for text in distribution.requires or ()]
    names = distribution.metadata.get_all("Provides-Extra") or []
    core = [need for need in needs if need.marker is None or need.marker.evaluate({"extra": ""})]
    rest = [need for need in needs if need not in core]
    return core, {name: _needs_of(name, rest) for name in names}


def _needs_of(extra: str, needs: list[Requirement]) -> list[Requirement]:
    """Return those of the needs that are an extra's, with those of the extras of Anther that it names."""
    found = []
    for need in needs:
        if need.marker is not None and need.marker.evaluate({"extra": extra}):
            named = [_needs_of(name, needs) for name in need.extras] if need.name == "anther" else [[need]]
            found += [one for part in named for one in part]
    return found


def installed_version(package: str) -> str | None:
    """Return a package's version; None where it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _find_missing(needs: list[Requirement]) -> list[str]:
    """Return which packages are missing or of another version than is needed."""
    lacking = []
    for need in needs:
        version = installed_version(need.name)
        if version is None:
            lacking.append(need.name)
        elif not need.specifier.contains(version, prereleases=True):
            lacking.append(f"{need.name} {version} (needs {need.specifier})")
    return lacking


def _packages(needs: list[Requirement]) -> Examined:
    from anther import __version__

    lacking = _find_missing(needs)
    if not needs:
        return Examined("Anther", "wrong", f"{__version__}, not installed", "Install it: pip install anther")
    if lacking:
        return Examined("Anther", "wrong", f"{__version__}, without {', '.join(lacking)}", "pip install anther")
    return Examined("Anther", "ok", f"{__version__}, with all {len(needs)} packages it needs")


def _extra(name: str, needs: list[Requirement]) -> Examined:
    what, lacking = FOR.get(name, ""), _find_missing(needs)
    if not lacking:
        return Examined(f"[{name}]", "ok", what)
    found = f"{what}: not installed: {', '.join(lacking)}"
    return Examined(f"[{name}]", "absent", found, f"pip install 'anther[{name}]'")


def _gpu() -> Examined:
    if not Path("/proc/driver/nvidia/version").exists() and shutil.which("nvidia-smi") is None:
        return Examined("GPU", "absent", "no NVIDIA driver; only network masks gain by one")
    return Examined("GPU", "ok", "an NVIDIA driver; network masks use it where torch does")


def _examine_kernels() -> Examined:
    """Compiled code is kept in numba's folder: without one every first command of a process takes a minute."""
    from anther.core import libraries

    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(libraries.__file__).parent / "__pycache__"
    if named and Path(tempfile.gettempdir()) in folder.parents:
        do = "Set NUMBA_CACHE_DIR to a folder of your own that stays."
        return Examined("compiled code", "absent", f"kept in {folder}, which may not last", do)
    if not named and not libraries.may_write(folder):
        return Examined("compiled code", "ok", "kept in your cache folder")
    return Examined("compiled code", "ok", f"kept in {folder}")


def _cameras() -> Examined:
    """Name the video devices that Linux sees; a depth camera shows as several."""
    devices = sorted(Path("/sys/class/video4linux").glob("video*/name"))
    names = sorted({device.read_text(encoding="utf-8", errors="replace").strip() for device in devices})
    if names:
        return Examined("cameras", "ok", "; ".join(names))
    return Examined("cameras", "absent", "none; recorded views need none")


def _disk(folder: Path) -> Examined:
    free = shutil.disk_usage(folder).free
    found = f"{free / 1e9:.1f} GB free in {folder}"
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return Examined("disk", "wrong", f"{folder}: {error.strerror}", "Go to a folder that you may write.")
    least = 1e9  # that a few trials take [bytes]: one is some 60 MB
    if free < least:
        return Examined("disk", "wrong", found, f"Free some: {least / 1e9:g} GB hold a few trials.")
    return Examined("disk", "ok", found)
