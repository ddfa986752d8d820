"""The command line: exit codes, and one clear message for bad input."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from unicodedata import category

import numpy as np
import pytest
from made_plants import simple_plant

from anther import __version__
from anther.cli import main as cli
from anther.cli.main import ACTIONS, COMMANDS, main
from anther.cli.run_folder import WRITTEN, open_run
from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Intrinsics, look_at
from anther.history import record_trial
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.formats.skeletons import read_skeleton
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.plant import Visit
from anther.pollination.execution import Trial


def refused(capfd, *words: object) -> str:
    """Run a command that must fail with exit code 2 and without a traceback; return what it said."""
    try:
        code = main([str(word) for word in words])
    except SystemExit as stop:  # the argument parser's own way out
        code = stop.code
    said = capfd.readouterr()
    assert code == 2
    assert "Traceback" not in said.out + said.err
    return re.sub(r"[\s│]+", " ", said.err + said.out)


def test_help_names_every_command(capsys) -> None:
    assert main([]) == 2
    capsys.readouterr()
    assert main(["--help"]) == 0
    assert set(re.findall(r"^  ([a-z-]+) ", capsys.readouterr().out, flags=re.MULTILINE)) == set(COMMANDS)


def test_version(capsys) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"anther {__version__}"


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_no_label_commands_a_terminal_and_no_sign_is_too_strange(encoding, tmp_path) -> None:
    """A label can clear the screen, name the window, or fill the clipboard; a locale can lack its letters."""
    label = "row \x1b]52;c;ZXZpbA==\x07\x1b[2J\x9b2J\ründer µ"
    history = str(tmp_path / "h.sqlite")
    record_trial(Visit("tomato", label, held_unharmed=True, failure=None), history)
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "COLUMNS": "300", "FORCE_COLOR": "1"}
    said = b""
    for words in (["history", history, "--plant", label], ["skeletonize", label, "--out", "x"]):
        command = [sys.executable, "-m", "anther.cli", *words]
        done = subprocess.run(command, env=environment, capture_output=True, check=False)
        assert b"Traceback" not in done.stderr
        said += done.stdout + done.stderr
    assert said.count(rb"\x1b]52;c;ZXZpbA==") == 3  # in the table, below it, and in the error
    assert b"\x1b[1m" in said, "colours stay"
    assert not [
        sign for sign in re.sub(r"\x1b\[[0-9;]*m", "", said.decode()) if category(sign) == "Cc" and sign != "\n"
    ]
    assert "ünder µ".encode(encoding, "backslashreplace") in said


ALL = [*COMMANDS, *(f"{name} {action}" for name, actions in ACTIONS.items() for action in actions)]


def test_there_are_few_commands() -> None:
    assert len(COMMANDS) <= 14


@pytest.mark.parametrize("name", ALL)
def test_help_fits_two_screens_and_names_what_it_leaves_out(name, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = {}
    for way in ("--help", "--help-all"):
        with pytest.raises(SystemExit) as stop:
            main([*name.split(), way])
        assert stop.value.code == 0
        said[way] = capsys.readouterr().out
    short = said["--help"]
    assert f"anther {name}" in short
    assert all(f"`anther {name} {action}`" in short for action in ACTIONS.get(name, ()))
    assert len(short.splitlines()) <= 100
    options = {way: set(re.findall(r"^(?:│| ) (--[a-z][\w.-]*)", text, re.MULTILINE)) for way, text in said.items()}
    assert options["--help"] <= options["--help-all"]
    hidden = {option[2:].partition(".")[0] for option in options["--help-all"] - options["--help"] if "." in option}
    assert all(group in short for group in hidden), hidden
    assert (f"anther {name} --help-all" in short) == (options["--help"] != options["--help-all"])


def test_unknown_command(capfd) -> None:
    assert "no command 'tral'; allowed: trial, row, sweep, cell" in refused(capfd, "tral")


@pytest.mark.parametrize("name", ALL)
def test_unknown_option(capfd, name) -> None:
    required = {
        "trial": [],
        "row": [],
        "cell": ["check", "a"],
        "import": ["a", "b"],
        "import share": ["a", "b"],
        "calibrate": [],
        "identify": [],
        "doctor": [],
    }
    assert "--frobnicate" in refused(capfd, *name.split(), *required.get(name, ["a"]), "--frobnicate", 3)


HEAVY = ("numba", "scipy", "sqlalchemy", "rich", "matplotlib", "cv2", "mujoco", "small_gicp", "skimage")


MISTAKEN = [
    "tral",
    "trial --sede 3",
    "plan nowhere.swc",
    "plan nowhere.swc --simulate --youngs 2e8",
    "skeletonize nowhere.ply",
    "traits nowhere --out o",
    "reconstruct nowhere",
    "view nowhere",
    "import nowhere o",
    "import share nowhere o",
    "sweep nowhere.csv",
    "row --file nowhere.toml",
    "cell check nowhere.toml",
    "identify --trace nowhere.csv",
]


def test_what_is_misspelled_or_missing_is_told_before_anything_heavy_is_imported(tmp_path) -> None:
    """One after the other in one process, which imports nothing heavy to the end."""
    asked = [*(f"{name} --help" for name in ALL), *MISTAKEN]
    code = f"""
import sys
from anther.cli.main import main
for words in {asked!r}:
    try:
        code = main(words.split())
    except SystemExit as stop:
        code = stop.code
    print("CODE", code, words, sorted({set(HEAVY)!r} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    told = [line for line in done.stdout.splitlines() if line.startswith("CODE ")]
    assert told == [f"CODE {0 if words.endswith('--help') else 2} {words} []" for words in asked]
    assert not list(tmp_path.iterdir())


def test_the_parameters_of_a_stage_are_taken_where_one_is_given(capfd, tmp_path) -> None:
    np.savetxt(tmp_path / "a.xyz", np.zeros((3, 3)))
    words = ["skeletonize", tmp_path / "a.xyz", "--units", "m"]
    assert "spacing" in refused(capfd, *words, "--params.spacing", -1)
    assert "--params.spaceing" in refused(capfd, *words, "--params.spaceing", 1)
    assert "3 points" in refused(capfd, *words, "--params.spacing", 0.01)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--plant", "potato"], "potato"),
        (["--seed", -1], "0 <= seed"),
        (["--seed", "one"], "one"),
        (["--views", 1], "3 <= views"),
        (["--distance", 600], "distance <= 3 m"),
        (["--viewpoint", "nan"], "viewpoint: got nan"),
        (["--root", "here"], "x,y,z in metres"),
        (["--restart-from", "skelton"], "'skelton'; allowed: capture"),
        (["--restart-from", "response"], "restart from execution"),
    ],
)
def test_trial_refuses_bad_options(capfd, tmp_path, words, message) -> None:
    assert message in refused(capfd, "trial", "--out", tmp_path / "run", *words)
    assert not (tmp_path / "run" / "trial.json").exists()


def test_trial_does_not_overwrite(capfd, tmp_path) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    assert "holds other files" in refused(capfd, "trial", "--out", tmp_path, "--overwrite")
    assert (tmp_path / "precious.txt").read_text() == "mine"
    (tmp_path / "00_params.json").write_text("{}")
    assert "add --overwrite" in refused(capfd, "trial", "--out", tmp_path)
    assert "besides it precious.txt" in refused(capfd, "trial", "--out", tmp_path, "--overwrite")
    assert (tmp_path / "precious.txt").read_text() == "mine"
    assert (tmp_path / "00_params.json").exists()


@dataclass(frozen=True)
class Asked:
    """Arguments of a command that fills a run folder."""

    plant: str = "tomato"
    seed: int = 3
    where: Path = Path("a")
    restart_from: str | None = None
    overwrite: bool = False


def opened(folder, args=Asked(), restart_from=None, overwrite=False):
    asked = replace(args, restart_from=restart_from, overwrite=overwrite)
    return open_run(folder, asked, ("plant", "seed", "where"))


def test_overwrite_removes_what_a_run_wrote_and_only_that(tmp_path) -> None:
    with opened(tmp_path) as run:
        (run.folder / "01_capture").mkdir()
        (run.folder / "trial.json").write_text("{}")
        (run.folder / "04_skeleton.npz").write_text("old")
    with opened(tmp_path, overwrite=True):
        pass
    assert {path.name for path in tmp_path.iterdir()} == {"00_params.json", "progress.json", "timing.json"}


def test_a_run_is_not_gone_on_with_as_another_plants(tmp_path) -> None:
    with opened(tmp_path):
        pass
    kept = (tmp_path / "00_params.json").read_text()
    for other, said in (
        (Asked(plant="pepper"), "plant tomato instead of pepper"),
        (Asked(seed=4), "seed 3 instead of 4"),
    ):
        with pytest.raises(InputError, match=said), opened(tmp_path, other, restart_from="grasp"):
            pass
    assert (tmp_path / "00_params.json").read_text() == kept
    with opened(tmp_path, restart_from="grasp"):
        pass


def test_what_became_of_a_run_is_said(tmp_path) -> None:
    with opened(tmp_path):  # it ends before its first stage, as when the cell is being built
        pass
    with pytest.raises(InputError, match="ended in the stage capture"), opened(tmp_path):
        pass
    with opened(tmp_path, restart_from="where-it-stopped") as run:
        assert run.stage("capture", lambda _: "read", lambda _: "new", lambda result, path: None) == "new"

    def fail(_):
        raise StageFailure("no_plant_found", "nothing green")

    with opened(tmp_path, restart_from="masks") as run, pytest.raises(StageFailure):
        run.stage("masks", lambda _: None, fail)
    with pytest.raises(InputError, match="ended in the stage masks: nothing green"), opened(tmp_path):
        pass


def test_a_service_that_is_stopped_ends_as_with_ctrl_c(monkeypatch, capfd) -> None:
    def command(_):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr("anther.cli.history.run", command)
    assert main(["history"]) == 130
    assert "interrupted" in capfd.readouterr().err
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_missing_system_library_names_its_package(monkeypatch, capfd) -> None:
    def run(_: object) -> int:
        raise ImportError("libgomp.so.1: cannot open shared object file: No such file or directory")

    @dataclass
    class Args:
        pass

    monkeypatch.setattr(cli, "_module", lambda *_: SimpleNamespace(Args=Args, run=run, __doc__=""))
    assert main(["trial"]) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    assert "apt-get install libgomp1" in said
    monkeypatch.setattr(cli, "_module", lambda *_: SimpleNamespace(Args=Args, run=lambda _: int("x", 99), __doc__=""))
    with pytest.raises(ValueError, match="base"):
        main(["trial"])


@pytest.mark.parametrize("name", ["reconstruct", "skeletonize", "plan", "view"])
def test_missing_files(capfd, tmp_path, name) -> None:
    extra = ["--units", "m", "--up", "z"] if name == "skeletonize" else []
    extra += ["--simulate", "--grip", 3, "--flower", 5] if name == "plan" else []
    extra += ["--out", tmp_path / "out"] if name not in ("view",) else []
    assert "nowhere" in refused(capfd, name, tmp_path / "nowhere", *extra)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("points", "units", "message"),
    [
        (np.random.default_rng(0).random((2, 3)), "m", "2 points"),
        (np.random.default_rng(0).random((500, 3)) * 600, "m", "unit"),
        (np.full((500, 3), np.nan), "m", "NaN"),
        (np.random.default_rng(0).random((500, 2)), "m", "column"),
        (np.zeros((0, 3)), "m", "no row of numbers"),
    ],
    ids=["two points", "600 m", "NaN", "two columns", "empty"],
)
def test_skeletonize_refuses_bad_clouds(capfd, tmp_path, points, units, message) -> None:
    path = tmp_path / "cloud.xyz"
    np.savetxt(path, points)
    assert message in refused(capfd, "skeletonize", path, "--units", units, "--up", "z", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def empty_room() -> Capture:
    """Three views of nothing."""
    poses = np.stack([look_at([np.cos(a), np.sin(a), 0.3], [0, 0, 0]) for a in (0.0, 1.0, 2.0)])
    camera = Intrinsics(width=64, height=48, fx=50, fy=50, cx=31.5, cy=23.5)
    return Capture(np.zeros((3, 48, 64)), camera, poses, np.full((3, 48, 64, 3), 128))


def test_reconstruct_says_when_there_is_no_plant(capfd, tmp_path) -> None:
    empty_room().save(tmp_path / "capture")
    assert "Is the plant within" in refused(capfd, "reconstruct", tmp_path / "capture", "--out", tmp_path / "run")
    assert not (tmp_path / "run" / "10_report.html").exists()


def test_reconstruct_refuses_a_truncated_image(capfd, tmp_path) -> None:
    empty_room().save(tmp_path / "capture")
    image = sorted((tmp_path / "capture").rglob("*.png"))[0]
    image.write_bytes(image.read_bytes()[:60])
    assert image.name in refused(capfd, "reconstruct", tmp_path / "capture", "--out", tmp_path / "run")


def test_view_refuses_a_folder_that_is_no_run(capfd, tmp_path) -> None:
    assert "00_params.json" in refused(capfd, "view", tmp_path)


def test_module_runs_as_a_program() -> None:
    done = subprocess.run([sys.executable, "-m", "anther.cli", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("anther ")


def test_a_command_that_plans_motions_says_nothing_at_its_end() -> None:
    code = "import roboplan.core, roboplan.rrt, sys; from anther.cli.main import main; sys.exit(main())"
    asked = [sys.executable, "-c", code, "--version"]
    assert not subprocess.run(asked, capture_output=True, text=True, check=True).stderr


def test_a_skeleton_comes_with_its_stem_and_replaces_nothing_unasked(tmp_path, capfd) -> None:
    Cloud(simple_plant()).save(tmp_path / "plant.ply")
    out = tmp_path / "o"
    words = ["skeletonize", str(tmp_path / "plant.ply"), "--units", "m", "--up", "z", "--out", str(out)]
    assert main(words) == 0
    capfd.readouterr()
    stem, skeleton = Stem.load(out / "stem.npz"), Skeleton.load(out / "skeleton.npz")
    assert len(stem.organ) == len(skeleton.nodes)
    assert sorted(read_skeleton(out / "skeleton.swc").labels or ()) == sorted(stem.organ_names())
    (out / "grasp.json").write_text("mine")
    assert "--overwrite" in refused(capfd, *words)
    assert (out / "grasp.json").read_text() == "mine"
    assert main([*words, "--overwrite"]) == 0
    assert (out / "grasp.json").read_text() != "mine"


UNNEEDED = {"coal", "matplotlib", "mujoco", "pinocchio", "rich", "sqlalchemy", "torch", "trimesh", "viser"}
"""What takes a command long to import, and neither help nor a skeleton needs."""


@pytest.mark.parametrize(
    ("words", "unneeded"),
    [
        (["--help"], UNNEEDED | {"numba", "numpy", "scipy", "tyro"}),
        (["skeletonize", "--units", "m", "--up", "z"], UNNEEDED),
    ],
)
def test_a_command_starts_without_what_it_does_not_need(tmp_path, words, unneeded) -> None:
    plant = tmp_path / "plant.ply"
    Cloud(simple_plant()).save(plant)
    asked = [*words, str(plant)]
    code = f"import sys; from anther.cli.main import main; assert main({asked}) == 0; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not unneeded & set(done.stdout.splitlines()[-1].split())


def test_a_plant_out_of_reach_is_said_so_and_kept(tmp_path, capfd) -> None:
    out = tmp_path / "run"
    words = ["trial", "--distance", 2.5, "--views", 4, "--out", out, "--history", tmp_path / "h.sqlite"]
    assert "can be reached. Move the plant or arm." in refused(capfd, *words)
    summary = json.loads((out / "trial.json").read_text())
    assert (summary["success"], summary["held"], summary["failure"]) == (False, False, "unreachable")
    assert summary["unharmed"] is summary["flowers_moved"] is None, "nobody has touched it"
    assert (out / "10_report.html").exists()


@pytest.mark.slow
def test_a_trial_end_to_end(tmp_path, capsys) -> None:
    """The main job, with fewer views than usual; what it leaves behind is complete and can be read."""
    out = tmp_path / "run"
    code = main(
        [
            "trial",
            "--plant",
            "pepper",
            "--seed",
            "0",
            "--views",
            "12",
            "--out",
            str(out),
            "--history",
            str(tmp_path / "h.sqlite"),
        ]
    )
    summary = json.loads((out / "trial.json").read_text())
    assert code == int(not (summary["held"] and summary["unharmed"]))
    assert summary["success"] == (summary["held"] and summary["unharmed"] and summary["flowers_moved"])
    assert (summary["failure"] is None) == (summary["held"] and summary["unharmed"])
    assert Trial.load(out / "09_trial.npz").stop_reason == "finished"
    assert 0 <= summary["harm_probability"] <= 1
    assert summary["true_flower_acceleration_least_ms2"] <= summary["true_flower_acceleration_median_ms2"]
    assert summary["pollen_freed_low"] < summary["pollen_freed_median"] < summary["pollen_freed_high"]
    assert {"01_capture", "03_cloud.ply", "04_skeleton.npz", "10_report.html"} <= {p.name for p in out.iterdir()}
    assert {p.name for p in out.iterdir()} <= WRITTEN, "--overwrite would not know it"
    assert not list(Path(out).rglob(".*")), "no temporary files are left"
    assert len(summary["grasp_pose7"]) == 7
    assert np.isclose(np.linalg.norm(summary["shake_direction"]), 1)
    assert {"capture", "skeleton", "shake plan", "execution"} <= set(summary["seconds"])
    timing = json.loads((out / "timing.json").read_text())
    assert timing["seconds"].keys() == timing["cpu_seconds"].keys() == timing["peak_mb"].keys()
    assert min(timing["peak_mb"].values()) > 100, "more than NumPy alone"
    assert "Most memory" in (out / "10_report.html").read_text()
    assert summary["parameters"]["seed"] == 0
    assert {"mujoco", "numpy"} <= set(summary["parameters"]["libraries"])
    assert "report" in capsys.readouterr().out
    assert main(["view", str(out), "--to", str(tmp_path / "scene.html")]) == 0
    assert (tmp_path / "scene.html").stat().st_size > 100_000
