"""Every command and snippet of README.md and docs/*.md runs as it stands there, on the samples of `anther samples`.

A page's blocks run in order, in an empty folder with `samples/`. What cannot run says why in a comment before it:

    <!-- run by the slow tests: REASON -->      <!-- not run by the tests: REASON -->

`anther` commands run in this process. Of `make`, `pip` and `python SCRIPT` it is checked that what they name exists.
"""

from __future__ import annotations

import ast
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from conftest import DATA
from test_history import full

from anther.cli import compile_all
from anther.cli.main import ACTIONS, COMMANDS, main
from anther.cli.sample_data import write_samples
from anther.core.files import read_json
from anther.core.geometry import Intrinsics, inverse, transform_points
from anther.history import record_trial
from anther.perception import skeleton, stem
from anther.perception.capture import Capture
from anther.perception.formats.clouds import read_cloud
from anther.perception.formats.skeletons import read_skeleton
from anther.robot.calibration import read_poses
from anther.robot.devices import GripperState
from anther.show.log import Log
from evaluation.numbers import NUMBER, filled, pages

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs/reports").glob("*.md"))]
BLOCK = re.compile(
    r"^(?:<!-- (?P<when>run by the slow tests|not run by the tests): (?P<why>[^\n]+) -->\n)?"
    r"```(?P<language>\w*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
SPAN = re.compile(r"`(anther [^`]+)`")
PLACEHOLDER = re.compile(r"(^|[/=:])[A-Z][A-Z_]+($|\W)|[|\[{…]|\.\.\.$")
"""A word in capitals, such as CAPTURE, stands for what the reader has: a command with one is a pattern."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, or the commands in its tables."""

    page: Path
    line: int
    language: str
    text: str
    when: str = ""

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks(page: Path) -> list[Block]:
    text = page.read_text()
    found = [
        Block(page, text[: m.start("text")].count("\n"), m["language"], m["text"], m["when"] or "")
        for m in BLOCK.finditer(text)
    ]
    return [b for b in found if b.language in ("bash", "sh", "python")]


def table(page: Path) -> list[Block]:
    """The commands in a page's tables, each a block of its own; a table's head and a report only speak of some."""
    lines = [] if page.parent.name == "reports" else [*page.read_text().splitlines(), ""]
    rows = [(n, a) for n, (a, b) in enumerate(pairwise(lines), 1) if a.startswith("| ") and not b.startswith("|--")]
    found = [Block(page, n, "bash", command) for n, row in rows for command in SPAN.findall(row)]
    return [replace(b, when="run by the slow tests") if " trial" in b.text else b for b in found]


def commands(text: str) -> Iterator[list[str]]:
    """The words of each command of a shell block."""
    for line in text.replace("\\\n", " ").splitlines():
        if words := shlex.split(line, comments=True):
            yield words


def is_pattern(words: list[str]) -> bool:
    return any(PLACEHOLDER.search(word) for word in words)


@cache
def options(command: str) -> frozenset[str]:
    """The options that a command knows."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said):
        patch.setenv("COLUMNS", "400")  # no name is broken over two lines
        with pytest.raises(SystemExit):
            main([*command.split(), "--help-all"])
    return frozenset(re.findall(r"--[a-z][\w.-]*", said.getvalue()))


def check_anther(words: list[str]) -> None:
    """The command exists and knows these options, whatever their values."""
    assert words[1] in COMMANDS or words[1].startswith("--"), words
    if words[1] in COMMANDS:
        command = " ".join(words[1:3]) if words[2:3] and words[2] in ACTIONS.get(words[1], ()) else words[1]
        given = {word.split("=")[0] for word in words[2:] if re.match(r"--[a-z]", word)}
        assert given <= options(command), f"{command} has no {given - options(command)}"


def check_make(words: list[str]) -> None:
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert all(word in targets for word in words[1:] if "=" not in word), words


def check_pip(words: list[str]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for word in words[2:]:
        name = re.fullmatch(r"anther(\[(\w+)\])?", word)
        assert name, words
        assert name[2] is None or name[2] in extras


def check_script(words: list[str]) -> None:
    """The scripts are there, and they know the options."""
    if words[1] == "-m":
        module = words[2].replace(".", "/")
        package = (ROOT / module).is_dir()
        words = [words[0], f"{module}/__main__.py" if package else f"{module}.py", *words[3:]]
    scripts = [n for n, word in enumerate(words) if word.endswith(".py")]
    assert scripts, words
    script = ROOT / words[scripts[-1]]
    text = script.read_text()
    beside = re.findall(r"^from (evaluation[\w.]*) import", text, re.MULTILINE)  # two scripts may share their options
    text += "".join(path.read_text() for name in beside if (path := ROOT / f"{name.replace('.', '/')}.py").is_file())
    for word in words[scripts[-1] + 1 :]:
        assert not word.startswith("--") or word in text or "tyro" in text, f"{words}: no {word}"
    assert all((ROOT / words[n]).is_file() for n in scripts)


ENDLESS = ["history", "serve"]
"""The command that goes on until it is stopped; its own tests run it."""
CHECKS: dict[str, Callable[[list[str]], None]] = {"make": check_make, "pip": check_pip, "python": check_script}


def run_shell(text: str, elsewhere: list[list[str]]) -> None:
    """Run commands; of those that another test runs as they stand it is checked that they exist."""
    for words in commands(text):
        if words[0] == "cd":
            os.chdir(words[1])
        elif words[0] == "anther" and words[1:3] != ENDLESS and not is_pattern(words) and words not in elsewhere:
            allowed = {0, 1} if words[1] == "trial" else {0}  # 1: a part of the trial's verdict failed
            assert main(words[1:]) in allowed, words
        elif words[0] == "anther":
            check_anther(words)
        else:
            assert words[0] in CHECKS, f"{words}: say why it is not run, in a comment before the block"
            CHECKS[words[0]](words)


def run_python(block: Block, names: dict[str, Any]) -> None:
    exec(compile(block.text, str(block), "exec"), names)


def is_here(node: ast.Import | ast.ImportFrom) -> bool:
    """Whether the package is Anther, or one that is installed: a cluster's own is not."""
    root = ((node.module or "") if isinstance(node, ast.ImportFrom) else node.names[0].name).split(".")[0]
    return root == "anther" or find_spec(root) is not None


def only_checked(block: Block, names: dict[str, Any]) -> None:
    """Of a block that is not run, what can be known: the commands' options, the imports, the syntax."""
    if block.language == "python":
        tree = ast.parse(block.text)
        imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom) and is_here(node)]
        exec(compile(ast.Module(imports, []), str(block), "exec"), names)
        return
    for words in commands(block.text):
        if words[0] == "anther":
            check_anther(words)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A new user's folder: the samples, and a history of a few visits."""
    monkeypatch.chdir(tmp_path)
    write_samples("samples")
    return tmp_path


def visited(count: int = 20) -> None:

    for k in range(count):
        record_trial(full("row 3, 14" if k == 2 else f"row 4, {k}", minutes=k), "runs/history.sqlite")


def looked_at() -> dict[str, Any]:
    """What docs/views.md has at that point: views, a skeleton with its stem, and further places for a camera."""

    capture = Capture.load("samples/capture")
    tree: skeleton.Skeleton = read_skeleton("samples/skeleton.swc").skeleton(None)
    names = {"capture_so_far": capture, "skeleton": tree, "stem": stem.find_stem(tree)}
    return names | {"T_world_cam_of_candidates": capture.T_world_cam}


def calibrated() -> dict[str, Any]:
    """What docs/calibration.md has at that point: images in memory, the flange's poses, the camera."""

    poses = np.stack(list(read_poses(Path("samples/board/poses.csv")).values()))
    files = sorted(Path("samples/board").glob("*.png"))
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
    camera = Intrinsics(**read_json("samples/board/camera.json"))
    return {"images": images, "T_base_flange": poses, "intrinsics": camera}


def logged() -> None:
    Path("runs/demo").mkdir(parents=True)
    book = Log(Path("runs/demo/log.mcap"))
    book.say("gripper", (0.04, GripperState(0.04, 0.0, False)))
    book.close()


GIVEN: dict[str, Callable[[], Any]] = {
    "log.md": logged,
    "history.md": visited,
    "views.md": looked_at,
    "calibration.md": calibrated,
}
"""What the reader of a page has when its blocks begin: files, or the names that a text around a snippet explains."""


def run_page(page: Path, chosen: list[Block], monkeypatch: pytest.MonkeyPatch, *, slow: bool) -> None:
    home = Path.cwd()
    elsewhere = [words for b in table(COMMANDS_PAGE) if b not in chosen for words in commands(b.text)]
    elsewhere = [words for words in elsewhere if words[1] == "plan"]  # of the others pages take the results
    names: dict[str, Any] = GIVEN.get(page.name, dict)() or {}
    for block in chosen:
        monkeypatch.chdir(home)
        runs = block.when == "run by the slow tests" if slow else not block.when
        if not runs:
            only_checked(block, dict(names))
        elif block.language == "python":
            run_python(block, names)
        else:
            run_shell(block.text, elsewhere)


COMMANDS_PAGE = ROOT / "docs" / "commands.md"
FAST = [page for page in PAGES if blocks(page) and page.name != "README.md"]
SLOW = [page for page in PAGES if any("slow" in b.when for b in (*blocks(page), *table(page)))]


@pytest.mark.parametrize("page", FAST, ids=lambda page: page.name)
def test_what_a_page_says_runs(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_page(page, blocks(page), monkeypatch, slow=False)


def test_what_the_readme_says_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The table of commands first, from top to bottom and from nothing: it makes the samples itself."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compile_all, "_work", lambda _: [])  # it does on samples what is done here
    run_page(ROOT / "README.md", [*table(COMMANDS_PAGE), *blocks(ROOT / "README.md")], monkeypatch, slow=False)
    said = capsys.readouterr().out
    assert "buckles" not in said
    assert (tmp_path / "scene.html").stat().st_size < 8e6
    missing = [name for name in COMMANDS if f"`anther {name}" not in COMMANDS_PAGE.read_text()]
    assert not missing, f"the table of commands has no {missing}"
    assert len((ROOT / "README.md").read_text().split()) <= 500


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("page", SLOW, ids=lambda page: page.name)
def test_what_a_page_says_runs_slowly(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if DATA.is_dir():
        (folder / "data").symlink_to(DATA)
    if "runs/demo" in page.read_text():
        assert main(["trial", "--plant", "tomato", "--preset", "fast", "--out", "runs/demo"]) in {0, 1}
    run_page(page, [*table(page), *blocks(page)], monkeypatch, slow=True)


@pytest.mark.slow
def test_the_scripts_of_the_pages_know_their_options() -> None:
    for block in (b for page in PAGES for b in blocks(page) if b.language != "python"):
        for words in commands(block.text):
            script = next((n for n, word in enumerate(words) if word.startswith("evaluation.")), None)
            if words[0] == "python" and script is not None:
                done = subprocess.run(
                    [sys.executable, "-m", words[script], "--help"],
                    cwd=ROOT,
                    capture_output=True,
                    text=True,
                    check=False,
                )
                assert done.returncode == 0, done.stderr
                for word in words[script + 1 :]:
                    assert not word.startswith("--") or word in done.stdout, f"{block}: {words}: no {word}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_text_exist(page: Path) -> None:
    """In running text too: no command, and no option of it, that is not there."""
    for command in SPAN.findall(page.read_text().replace("\n", " ")):
        words = re.sub(r"[\[\]|]", " ", command).split()
        if re.match(r"[a-z]", words[1]):
            check_anther(words)


def test_a_block_of_commands_says_that_it_is_one() -> None:
    """No command hides from the tests in a block without a language; few blocks are left out, each with a reason."""
    hidden, left_out = [], []
    for page in PAGES:
        for m in BLOCK.finditer(page.read_text()):
            if not m["language"] and re.match(r"(anther|python3?|pip|make|hf) ", m["text"]):
                hidden.append((page.name, m["text"][:40]))
            left_out += [page.name] if m["when"] == "not run by the tests" else []
    assert not hidden
    assert len(left_out) <= 12, left_out  # clusters, cameras, a GPU, network weights, metal


def test_samples_are_small_and_not_overwritten(tmp_path: Path, capsys) -> None:
    assert main(["samples", str(tmp_path)]) == 0
    assert sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) < 3e6
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert main(["samples", str(tmp_path)]) == 2
    assert "capture" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


def test_the_samples_are_what_they_say(folder: Path) -> None:
    """Cloud and skeleton lie where the views see them, and the stem is of 90 MPa."""
    capture, cloud = Capture.load("samples/capture"), read_cloud(Path("samples/plant.ply"))
    tree = read_skeleton("samples/skeleton.swc").skeleton(None)
    for points, least in ((cloud.points, 0.9), (tree.nodes, 0.8)):
        near = np.zeros(len(points), bool)
        for depth, T_world_cam in zip(capture.depth, capture.T_world_cam, strict=True):
            seen = transform_points(inverse(T_world_cam), points)
            u, v = np.round(capture.intrinsics.project(seen)).astype(int).T
            inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
            near[inside] |= np.abs(depth[v[inside], u[inside]] - seen[inside, 2]) < 0.015
        assert near.mean() > least
    words = "--samples samples.csv --profile profile.csv --leaves leaves.csv --trace pluck1.csv --orientation upright"
    words = [word if word.startswith("--") or "." not in word else f"samples/stem/{word}" for word in words.split()]
    assert main(["identify", *words, "--out", "found"]) == 0
    youngs = read_json("found/identify.json")["youngs"]
    assert abs(youngs["value"] - 90e6) < 2 * youngs["standard_error"]


TEST = re.compile(r"`tests/([\w/]+\.py) -k (\w+)`")


def test_every_test_that_a_page_names_is_there() -> None:
    named = {(page.name, *found) for page in PAGES for found in TEST.findall(page.read_text())}
    assert any(page == "hazards.md" for page, _, _ in named)
    tests = ROOT / "tests"
    sources = {str(path.relative_to(tests)): path.read_text() for path in tests.rglob("test_*.py")}
    kit = (ROOT / "src/anther/robot/testing.py").read_text()  # the checks that `test_conformance.py` runs
    sources["robot/test_conformance.py"] += kit
    lost = [row for row in sorted(named) if not re.search(rf"^ *def {row[2]}\(", sources.get(row[1], ""), re.MULTILINE)]
    assert not lost


def test_every_hazard_has_its_evidence_or_says_that_it_has_none() -> None:
    text = (ROOT / "docs/hazards.md").read_text()
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    hazards = [row for row in rows if len(row) == 5 and row[0] != "hazard"]
    assert len(hazards) > 20
    for hazard, *_, evidence, remains in hazards:
        assert evidence == "none" or TEST.sub("", evidence).replace(";", "").strip() == "", hazard
        assert remains, hazard


MEASURED = re.compile(r"<!-- measured: ([^\n]+) -->\n(.*?)<!-- end -->", re.DOTALL)


def test_what_measures_a_report_is_there_and_named_once() -> None:
    """Its result file is named by the script."""
    found = [(page, *found) for page in PAGES for found in MEASURED.findall(page.read_text())]
    for _, command, said in found:
        check_script(shlex.split(command))
        assert not said or f"`{command}` at " in said
    scripts = [shlex.split(command)[2] for _, command, _ in found]
    assert len(set(scripts)) == len(scripts)


def test_numbers_of_pages_are_those_of_the_runs_that_measured_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert NUMBER.search((ROOT / "README.md").read_text())
    for page in pages():
        text = page.read_text()
        assert filled(text) == text, f"{page}: python -m evaluation.numbers"
        assert not re.search(r"^\s*<!--[\w/]+ [\w.-]+:", text, re.MULTILINE), (
            f"{page}: a mark that begins a line ends a paragraph"
        )
    wrong = "moved by <!--long/shaking plan_ms2:.1f-->99<!--/--> m/s2"
    measured = json.loads((ROOT / "docs/results/long/shaking.json").read_text())["metrics"]["plan_ms2"]
    assert filled(wrong) == wrong.replace("99", f"{measured:.1f}")


def test_numbers_of_a_quick_run_stand_beside_those_of_its_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    block = "<!-- compared: run, plants plants\nheld [%] = held:.0% (low:.0%)\nover = over:.1f\n-->\nold\n<!-- end -->"
    with pytest.raises(FileNotFoundError):
        filled(block)
    run = {"command": "python -m run", "commit": "abc", "date": "2026-01-02"}
    quick = run | {"metrics": {"plants": 6.0, "held": 0.5, "low": None}}
    long = run | {"commit": "def", "metrics": {"plants": 1000, "held": 0.9, "low": 0.8, "over": 3.94}}
    (tmp_path / "docs/results/long").mkdir(parents=True)
    (tmp_path / "docs/results/run.json").write_text(json.dumps(quick))
    with pytest.raises(KeyError, match="over"):
        filled(block)
    (tmp_path / "docs/results/long/run.json").write_text(json.dumps(long))
    found = filled(block)
    assert "old" not in found
    assert [line for line in found.splitlines() if line.startswith("|")] == [
        "|  | sample: 6 plants, abc, 2026-01-02 | campaign: 1,000 plants, def, 2026-01-02 |",
        "| --- | --- | --- |",
        "| held [%] | 50% (–) | 90% (80%) |",
        "| over | – | 3.9 |",
    ]
    assert "Campaign: `python -m run`" in found
    assert filled(found) == found
