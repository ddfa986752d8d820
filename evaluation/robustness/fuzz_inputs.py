"""Small inputs of every kind, and seeded ways to spoil them, for fuzz.py."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from anther.cli.main import COMMANDS, main
from anther.cli.sample_data import write_samples
from anther.core import Intrinsics
from anther.core.files import read_json, write_json
from anther.core.runs import FILES
from anther.history import record_trial
from anther.perception import Capture, Cloud, Skeleton, find_stem, write_skeleton
from anther.perception.flowers import assume_flowers
from anther.plant import TOMATO, Visit, build_plant
from anther.pollination import plan_grasps, save_grasps

SKELETONS = ("swc", "npz", "txt", "ply", "graphml", "mtg")
STEM = "--samples stem/samples.csv --profile stem/profile.csv --leaves stem/leaves.csv --trace stem/pluck1.csv --json"
RODS = "--radius 0.004 --youngs 1e9 --json"
COMMAND_LINES = (
    *(f"skeletonize plant.{suffix} --json --params.voxel 0.004" for suffix in ("ply", "pcd", "xyz", "npz", "csv")),
    *(f"plan tree.{s} --simulate --bare --grip 4 --flower 8 --duration 0.1 --dt 0.01 {RODS}" for s in SKELETONS),
    *(f"plan tree.{s} --map --heights 2 --frequencies 2 {RODS}" for s in SKELETONS),
    *(f"view tree.{s} --radius 0.004 --to o.{t}" for s, t in zip(SKELETONS, ("glb", *SKELETONS), strict=False)),
    "plan tree.swc --frequencies 2 --json",
    "plan run --frequencies 2 --json",
    "view run --to o.mtg", "view run --to o.html", "plan run --map --heights 2 --frequencies 2 --json",
    "traits clouds --out o --params.voxel 0.004",
    "reconstruct capture --out seen --params.cloud.voxel 0.004", "import views.mcap imported",
    "import turntable converted",
    "calibrate --images board --poses board/poses.csv --board charuco:7x5:30mm:22mm --intrinsics board/camera.json",
    f"identify {STEM}", "identify --density 1000 --profile stem/profile.csv --deflection stem/deflection.csv --json",
    "history history.sqlite", "history history.sqlite --export o.csv", "history history.sqlite --add run",
    "history fruit-set history.sqlite --json", "history outcome a --flowers 9 --fruit 4 --history history.sqlite",
    "trial --plant tomato --out trial", "row --simulate tomato --plants 2", "doctor",
)  # fmt: skip
"""What is run, each in a folder of its own with all inputs; one of its inputs or options is spoilt."""
NOT_TRIED = {"sweep", "cell"}
"""Worker processes, and machines: their input is tested by itself."""


def write_inputs(folder: Path) -> None:
    """Write small inputs of every kind: a stem with a branch, its cloud, run, captures, boards, tests, a history."""
    write_samples(folder)
    rng = np.random.default_rng(0)
    nodes = np.zeros((12, 3))
    nodes[:8, 2] = np.linspace(0, 0.28, 8)
    nodes[8:] = nodes[5] + np.outer(np.arange(1, 5), [0.02, 0.0, 0.02])
    tree = Skeleton(nodes, np.array([-1, 0, 1, 2, 3, 4, 5, 6, 5, 8, 9, 10]), np.linspace(5e-3, 2e-3, 12))
    edge, along, turn = rng.integers(1, 12, 1500), rng.random(1500), 2 * np.pi * rng.random(1500)
    around = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) * tree.radius[edge][:, None]
    points = nodes[tree.parent[edge]] + along[:, None] * (nodes - nodes[tree.parent])[edge] + around
    cloud = Cloud(points, colors=np.full((1500, 3), 90, np.uint8))
    _write_clouds(folder, cloud)
    (folder / "clouds").mkdir()
    cloud.save(folder / "clouds" / "plant.ply")
    for suffix in SKELETONS:
        write_skeleton(folder / f"tree.{suffix}", tree)
    _write_run(folder / "run", tree, cloud)
    _thin_captures(folder)
    for image in sorted((folder / "board").glob("*.png"))[5:]:
        image.unlink()
    rows = (folder / "board" / "poses.csv").read_text().splitlines()
    (folder / "board" / "poses.csv").write_text("\n".join(rows[:6]) + "\n")
    for k in range(3):
        record_trial(Visit("tomato", "abc"[k], held_unharmed=True, failure=None), folder / "history.sqlite")
    (folder / "options.json").write_text(json.dumps({name: _options(name) for name in COMMANDS}))


def _write_clouds(folder: Path, cloud: Cloud) -> None:
    points = cloud.points
    cloud.save(folder / "plant.ply")
    (folder / "plant.npz").unlink()
    np.savez(folder / "plant.npz", points=points, units="m", up=[0, 0, 1])
    rows = "\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in points) + "\n"
    head = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
    (folder / "plant.pcd").write_text(f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n{rows}")
    (folder / "plant.xyz").write_text(rows)
    (folder / "plant.csv").write_text("x,y,z\n" + rows.replace(" ", ","))


def _write_run(run: Path, tree: Skeleton, cloud: Cloud) -> None:
    stem = find_stem(tree)
    cloud.save(run / FILES["cloud"])
    tree.save(run / FILES["skeleton"])
    stem.save(run / FILES["stem"])
    flowers = assume_flowers(tree, stem)
    flowers.save(run / FILES["flowers"])
    save_grasps(run / FILES["grasp"], plan_grasps(stem, tree, cloud))
    build_plant(tree, stem, flowers, cloud, TOMATO).save(run / FILES["plant model"])
    write_json(run / "00_params.json", {"command": "trial", "plant": "tomato"})
    Visit("tomato", "z", held_unharmed=True, failure=None).save(run / "trial.json")


def _thin_captures(folder: Path) -> None:
    """Make the views so small that a command takes a moment."""
    whole = Capture.load(folder / "capture")
    camera, step = whole.intrinsics, 5
    depth, rgb = whole.depth[::2, ::step, ::step], whole.rgb[::2, ::step, ::step]
    small = Intrinsics(
        depth.shape[2], depth.shape[1], camera.fx / step, camera.fy / step, camera.cx / step, camera.cy / step
    )
    shutil.rmtree(folder / "capture")
    Capture(depth, small, whole.T_world_cam[::2], rgb).save(folder / "capture")


def _options(command: str) -> list[str]:
    said = io.StringIO()
    with redirect_stdout(said), suppress(SystemExit):
        main([command, "--help"])
    return sorted(set(re.findall(r"--[a-z][\w.-]*\w", said.getvalue())) - {"--help", "--port", "--out", "--to"})


VALUES = ("nan", "inf", "-inf", "-1", "0", "1e9", "1e-12", "99999999999999999999", "", "x", "²", "1,5", "None", "--")
TOKENS = (b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-300", b"9999999999", b"", b"abc", b"\xff", b"[", b"{", b'"', b",")
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")

Spoil = Callable[[bytes, np.random.Generator], bytes]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    spoilt = bytearray(data)
    for at in rng.integers(0, len(data), 1 + int(rng.integers(0, 20))):
        spoilt[at] = int(rng.integers(0, 256))
    return bytes(spoilt)


def _span(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    a, b = sorted(int(x) for x in rng.integers(0, len(data) + 1, 2))
    return a, b


def _cut_out(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:a] + data[b:]


def _twice(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:b] + data[a:b] + data[b:]


def _token(data: bytes, rng: np.random.Generator) -> bytes:
    """Another token in the place of one to three numbers."""
    for _ in range(int(rng.integers(1, 4))):
        found = list(NUMBER.finditer(data[:200_000]))
        if not found:
            return data + b"?"
        m = found[int(rng.integers(0, len(found)))]
        data = data[: m.start()] + TOKENS[int(rng.integers(0, len(TOKENS)))] + data[m.end() :]
    return data


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    a, b = (int(x) for x in rng.integers(0, len(lines), 2))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines if rng.random() < 0.5 else [*lines[:a], *lines[a + 1 :]])


def _json(data: bytes, rng: np.random.Generator) -> bytes:
    """A value of another kind, or a missing or further key, somewhere in a JSON file."""
    try:
        whole = json.loads(data)
    except ValueError:
        return _flip(data, rng)
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
            places.append((value, key))
            walk(value[key])

    walk(whole)
    if places:
        holder, key = places[int(rng.integers(0, len(places)))]
        others: tuple[Any, ...] = (None, True, -1, 1e308, "", "x", [], {}, [[]], [1, 2], {"a": 1}, 10**17)
        if isinstance(holder, dict) and rng.random() < 0.2:
            del holder[key]
        else:
            holder[key] = others[int(rng.integers(0, len(others)))]
    return json.dumps(whole).encode()


def _npz(data: bytes, rng: np.random.Generator) -> bytes:
    """An array of another type, shape or value, or none, in an .npz."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            arrays = dict(held)
        name = sorted(arrays)[int(rng.integers(0, len(arrays)))]
        a = arrays[name]
        ways: tuple[Callable[[], Any], ...] = (
            lambda: a.astype(str), lambda: a[..., None], lambda: a.ravel()[:-1], lambda: np.full(a.shape, np.nan),
            lambda: a * 0 - 1, lambda: a.astype(complex), lambda: np.zeros((0, *a.shape[1:])), lambda: a * 10**6,
            lambda: a[::-1], lambda: np.array("x"), lambda: a.astype(np.float16), lambda: a > 0,
        )  # fmt: skip
        if rng.random() < 0.1:
            del arrays[name]
        else:
            arrays[name] = ways[int(rng.integers(0, len(ways)))]()
    except Exception:  # strings cannot be multiplied, nothing is left to cut: bytes can always be flipped
        return _flip(data, rng)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


SPOILS: tuple[Spoil, ...] = (
    _flip, _cut_out, _twice, _token, _token, _token, _lines, lambda data, rng: data[: int(rng.integers(0, len(data)))],
    lambda data, rng: b"", lambda data, rng: rng.bytes(500),
)  # fmt: skip


def spoil(path: Path, rng: np.random.Generator) -> str:
    """Spoil a file in one way, and return which."""
    data = path.read_bytes()
    if not data:
        return "nothing"
    ways = SPOILS
    if path.suffix == ".json" and rng.random() < 0.7:
        ways = (_json,)
    elif path.suffix == ".npz" and rng.random() < 0.7:
        ways = (_npz,)
    number = int(rng.integers(0, len(ways)))
    path.write_bytes(ways[number](data, rng))
    return getattr(ways[number], "__name__", "spoilt")


@dataclass(frozen=True)
class Known:
    """A change whose right outcome is known.

    Attributes:
        line: the start of the command lines it is for.
        file: that is changed.
        change: of its bytes.
        refused: the command must refuse it; if not, its answer must be as without the change.
    """

    line: str
    file: str
    change: Callable[[bytes], bytes]
    refused: bool


def _crlf(data: bytes) -> bytes:
    return data.replace(b"\n", b"\r\n")


def _scaled(data: bytes) -> bytes:
    return re.sub(rb"-?\d+\.\d+", lambda m: b"%.3f" % (1e3 * float(m[0])), data)


KNOWN = (
    *(Known(f"skeletonize plant.{s}", f"plant.{s}", _crlf, False) for s in ("xyz", "csv")),
    Known("skeletonize plant.xyz", "plant.xyz", lambda d: d + b"\n\n", False),
    *(Known(f"skeletonize plant.{s}", f"plant.{s}", _scaled, True) for s in ("xyz", "csv", "pcd")),
    *(Known(f"skeletonize plant.{s}", f"plant.{s}", lambda d: d[: len(d) // 2], True) for s in ("ply", "pcd", "npz")),
    *(Known(f"plan tree.{s} --simulate", f"tree.{s}", _crlf, False) for s in ("swc", "txt", "mtg")),
    Known("plan tree.swc --simulate", "tree.swc", lambda d: b"# a comment\n" + d, False),
    Known("plan tree.swc --simulate", "tree.swc", lambda d: re.sub(rb" 4\n", b" 99\n", d), True),
    *(Known(f"view tree.{s}", f"tree.{s}", lambda d: d[: 2 * len(d) // 3], True) for s in ("npz", "graphml", "ply")),
    Known("reconstruct", "capture/transforms.json", lambda d: d.replace(b"0.0001", b"0.1"), True),
    Known("import turntable", "turntable/poses.json", lambda d: d.replace(b'"fx"', b'"f"'), True),
    Known("calibrate", "board/poses.csv", lambda d: d.replace(b"qw", b"w", 1), True),
    Known("identify --samples", "stem/profile.csv", _crlf, False),
    Known("identify --samples", "stem/profile.csv", lambda d: d.replace(b"_mm", b""), True),
    Known("identify --samples", "stem/leaves.csv", lambda d: d.replace(b"mass_g", b"mass_lb"), True),
)  # fmt: skip


def plain_answer(said: str) -> Any:
    """Return a command's JSON without what differs from run to run."""
    try:
        answer = json.loads(said)
    except ValueError:
        return said
    return {k: v for k, v in answer.items() if k not in {"seconds", "out"}} if isinstance(answer, dict) else answer


def is_finite(said: str) -> bool:
    """Return whether a command's JSON has no NaN and no infinity."""
    found: list[str] = []
    with suppress(ValueError):  # with a note before it, it is no JSON
        json.loads(said, parse_constant=found.append)
    return not found


def options_of(folder: Path, command: str) -> list[str]:
    """Return the options of a command."""
    return read_json(folder / "options.json")[command]
