"""Sweeps: every row once, whatever is killed, raised or missing; what was set aside and why; disk, store, Parquet."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from anther.cli import sweep as sweep_command
from anther.cli.main import main
from anther.core.errors import InputError
from anther.history import open_reader, overview, sweep
from anther.history._jobs import Job
from anther.history.sweep import _running, _working
from anther.history.sweep._working import Disk, Store, place

distributed = pytest.importorskip("distributed", reason="dask is not installed: pip install 'anther[sweep]'")


def squared(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A task that notes every time it is run, and does what its row says."""
    with Path(row["log"]).open("a") as log:
        log.write(f"{row['n']}\n")
    (folder / "n.txt").write_text(str(row["n"]))
    what = row.get("what")
    if what == "raise" and not Path(row["log"]).with_suffix(".mended").exists():
        raise ValueError("no plant has\nminus one leaf")
    if what == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "full":
        try:
            raise OSError(errno.ENOSPC, "No space left on device")
        except OSError as error:
            raise InputError("cloud.ply cannot be written") from error
    return {"square": row["n"] ** 2, "where": folder, "nothing": float("nan")}


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A cluster of one worker that all tests share; its nanny starts a killed worker anew."""
    options: dict[str, Any] = {"processes": True, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(n_workers=1, silence_logs=50, **options) as made:
        yield made.scheduler_address


@pytest.fixture
def rows(tmp_path: Path) -> list[dict[str, Any]]:
    return [{"n": n, "log": str(tmp_path / "log")} for n in range(4)]


def runs(tmp_path: Path) -> list[int]:
    return sorted(int(n) for n in (tmp_path / "log").read_text().split())


def test_every_row_is_run_once_and_the_folder_goes_on(rows, scheduler: str, tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    jobs = sweep.run(squared, rows[:3], folder, scheduler=scheduler, quiet=True)
    assert [job.result and job.result["square"] for job in jobs] == [0, 1, 4]
    assert {(job.state, job.tries) for job in jobs} == {("done", 1)}
    assert [(folder / "tasks" / job.key / "n.txt").read_text() for job in jobs] == ["0", "1", "2"]
    again = sweep.run(squared, reversed(rows), folder, scheduler=scheduler, quiet=True)
    assert [job.row["n"] for job in again] == [3, 2, 1, 0]
    assert again[1] == jobs[2]
    (folder / "history.sqlite").unlink()  # what was finished is in the folders too
    assert sweep.run(squared, rows, folder, scheduler=scheduler, quiet=True)[:3] == jobs
    assert runs(tmp_path) == [0, 1, 2, 3]
    assert list((folder / "under_way").iterdir()) == []
    with open_reader(folder / "history.sqlite") as session:
        assert session is not None
        (noted,) = overview.sweeps(session)
    assert (noted.jobs, noted.function.endswith("squared"), noted.folder) == ({"done": 4}, True, str(folder))
    assert sorted(job.row["n"] for job in sweep.read(folder)) == [0, 1, 2, 3]
    with pytest.raises(InputError, match="holds a sweep of"):
        sweep.run(squared, rows, folder, name="trial", scheduler=scheduler, quiet=True)


def test_what_raises_or_kills_is_set_aside_with_its_reason(rows, scheduler: str, tmp_path: Path) -> None:
    rows[1]["what"], rows[2]["what"] = "raise", "die"
    folder = tmp_path / "sweep"
    options: dict[str, Any] = {"scheduler": scheduler, "quiet": True, "tries": 2, "deaths": 2}
    jobs = sweep.run(squared, rows, folder, **options)
    assert [job.state for job in jobs] == ["done", "poison", "poison", "done"]
    assert [job.tries for job in jobs] == [1, 2, 2, 1]
    assert jobs[1].reason is not None
    assert jobs[1].reason.startswith("ValueError: no plant has minus one leaf (test_sweep.py:")
    assert jobs[2].reason == "its worker died 2 times while it ran"
    assert runs(tmp_path) == [0, 1, 1, 2, 2, 3]
    assert sweep.run(squared, rows, folder, **options) == jobs  # nothing is tried again
    assert (folder / "under_way" / jobs[1].key / "n.txt").read_text() == "1"  # to be looked at
    (tmp_path / "log.mended").touch()
    mended = sweep.run(squared, rows[:2], folder, again=True, **options)
    assert [(job.state, job.tries) for job in mended] == [("done", 1), ("done", 1)]
    assert runs(tmp_path) == [0, 1, 1, 1, 2, 2, 3]


def order(folder: Path | str, **other: Any) -> _working.Order:
    """Register a sweep without rows and return what its tasks have in common."""
    sweep.run(squared, [], folder, quiet=True, history=other.pop("history", None))
    uid = json.loads(place(folder).read("sweep.json") or b"")["uid"]
    return replace(_working.Order(squared, str(folder), uid, 3, 3, _working.versions()), **other)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks are performed in this process."""
    monkeypatch.setattr(_working, "_keep_to_one_thread", lambda _: None)


def test_a_full_disk_is_no_fault_of_the_task(rows, here: None, tmp_path: Path) -> None:
    asked = order(tmp_path / "sweep")
    with pytest.raises(InputError, match=r"cloud\.ply cannot be written\. What was finished is kept"):
        _working.perform(asked, Job("a", rows[0] | {"what": "full"}))
    done = _working.perform(asked, Job("a", rows[0]))
    assert (done.state, done.tries) == ("done", 1)


@pytest.mark.parametrize(
    ("change", "told"),
    [({"uid": "other"}, "another folder"), ({"versions": {"numpy": "0.1", "python": "9.9"}}, "instead of 0.1")],
)
def test_a_worker_that_does_not_fit_stops_the_sweep(change, told: str, rows, here: None, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=told):
        _working.perform(order(tmp_path / "sweep", **change), Job("a", rows[0]))
    assert not (tmp_path / "log").exists()


def test_other_versions_are_told_by_a_real_worker_and_nothing_is_lost(
    rows, scheduler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(sweep, "versions", lambda: _working.versions() | {"mujoco": "1.2.3"})
        with pytest.raises(InputError, match=r"mujoco .* instead of 1\.2\.3"):
            sweep.run(squared, rows, tmp_path / "sweep", scheduler=scheduler, quiet=True)
    assert len(sweep.run(squared, rows, tmp_path / "sweep", scheduler=scheduler, quiet=True)) == 4
    assert runs(tmp_path) == [0, 1, 2, 3]


def test_a_task_that_another_process_is_at_is_waited_for_not_begun_twice(rows, here: None, tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    asked, job, found = order(folder), Job("a", rows[3]), []
    with Disk(folder).attempt("a") as attempt:
        second = threading.Thread(target=lambda: found.append(_working.perform(asked, job)))
        second.start()
        time.sleep(0.3)
        assert second.is_alive()
        Disk(folder).publish("a", attempt, '{"state": "done", "tries": 1, "result": {"square": 9}}')
    second.join(20)
    assert found == [replace(job, state="done", tries=1, result={"square": 9})]
    assert not (tmp_path / "log").exists()


@pytest.mark.parametrize(("seconds", "room"), [(np.inf, 2), (35.0, 2), (0.1, 12), (1e-4, 202)])
def test_of_long_tasks_none_is_handed_over_before_a_worker_has_time(seconds: float, room: int) -> None:
    client: Any = SimpleNamespace(nthreads=lambda: {"tcp://a": 1, "tcp://b": 1})
    assert _running._room(client, seconds) == room


def test_a_store_keeps_the_files_and_tells_what_it_refuses(rows, here: None, tmp_path, monkeypatch) -> None:
    fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: pip install 'anther[sweep]'")
    where, history = f"memory://{tmp_path.name}", tmp_path / "h.sqlite"
    with pytest.raises(InputError, match="A store holds no database"):
        sweep.run(squared, rows, where, quiet=True)
    asked = order(where, history=history)
    first = _working.perform(asked, Job("a", rows[2]))
    assert _working.perform(asked, Job("a", rows[2])) == first
    assert (first.result or {})["square"] == 4
    kept = place(where)
    assert isinstance(kept, Store)
    assert kept.read("tasks/a/n.txt") == b"2"
    assert kept.read("under_way/a.json") is None
    assert runs(tmp_path) == [2]

    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError("Access Denied")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "pipe_file", refuse)
    with pytest.raises(InputError, match=r"cannot be read or written \(Access Denied\)"):
        _working.perform(asked, Job("b", rows[3]))


@pytest.mark.slow
def test_s3(rows, scheduler: str, tmp_path: Path) -> None:
    """A real S3 client in client and worker processes, and moto's server."""
    for name in ("s3fs", "boto3", "moto", "flask"):
        pytest.importorskip(name, reason="S3 is tested where s3fs, moto[s3], flask and flask-cors are installed")
    with moto_server() as endpoint:
        environment = {"AWS_ACCESS_KEY_ID": "x", "AWS_SECRET_ACCESS_KEY": "x", "AWS_ENDPOINT_URL": endpoint}
        environment |= {"AWS_DEFAULT_REGION": "us-east-1"}
        script = tmp_path / "on_s3.py"
        script.write_text(S3_SCRIPT)
        for _ in range(2):  # the second time nothing is run
            words = [sys.executable, str(script), str(Path(__file__).parent), str(tmp_path)]
            done = subprocess.run(words, env=os.environ | environment, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            assert done.stdout.splitlines()[-1] == "[0, 1, 4, 9] b'3'"
        assert runs(tmp_path) == [0, 1, 2, 3]
        missing = [sys.executable, "-m", "anther.cli", "sweep", "--out", "s3://none/x", "--history", f"{tmp_path}/h"]
        done = subprocess.run(missing, env=os.environ | environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr


S3_SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
from test_sweep import squared
from anther.history import sweep
from anther.history.sweep._working import place
import boto3

if __name__ == "__main__":
    boto3.client("s3").create_bucket(Bucket="plants")
    folder, log = "s3://plants/night", sys.argv[2]
    rows = [{"n": n, "log": log + "/log"} for n in range(4)]
    jobs = sweep.run(squared, rows, folder, history=log + "/h.sqlite", workers=1, quiet=True)
    print([job.result["square"] for job in jobs], place(folder).read(f"tasks/{jobs[3].key}/n.txt"))
    sweep.export(folder, jobs)
    assert place(folder).read("results.parquet")
"""


def moto_server() -> Any:
    from contextlib import contextmanager  # noqa: PLC0415

    from moto.server import ThreadedMotoServer  # noqa: PLC0415

    @contextmanager
    def running() -> Iterator[str]:
        server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
        server.start()
        host, port = server.get_host_and_port()
        yield f"http://{host}:{port}"
        server.stop()

    return running()


def test_parquet_is_read_by_duckdb_in_a_line(tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb", reason="duckdb is not installed")
    jobs = [
        Job("a", {"seed": 1, "state": "wet"}, "done", 1, None, {"success": True, "moved": 2, "odd": 1}, 3.5),
        Job("b", {"seed": 2}, "done", 2, "its worker died", {"success": False, "moved": 2.5, "odd": [1, "x"]}, 4.0),
        Job("c", {"seed": 3}, "poison", 3, "ValueError: x"),
    ]
    file = sweep.export(tmp_path, jobs)
    assert file == f"{tmp_path}/results.parquet"
    found = duckdb.sql(f"SELECT avg(moved), count(*) FILTER (success), max(seed) FROM '{file}'").fetchall()
    assert found == [(2.25, 1, 3)]
    told = duckdb.sql(f"SELECT key, state, row_state, odd, reason FROM '{file}' ORDER BY key").fetchall()
    assert told == [
        ("a", "done", "wet", "1", None),
        ("b", "done", None, '[1, "x"]', "its worker died"),
        ("c", "poison", None, None, "ValueError: x"),
    ]


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("plant,sead\ntomato,3\n", "column 'sead'"),
        ("plant,out\ntomato,x\n", "column 'out'"),
        ("plant,params.grasp\ntomato,3\n", "column 'params.grasp'"),
        ("plant,seed\ntomato,3\ntomato,many\n", "row 2, column 'seed'"),
        ("plant,seed\ncucumber,3\n", "allowed: tomato | pepper"),
        ("plant,seed\ntomato,3\npepper,3\ntomato,3\n", "row 3"),
        ("plant,plant\ntomato,3\n", "no two alike"),
        ("plant,seed\ntomato,3,4\n", "line 2"),
        ("plant,seed\n", "no rows"),
        ("", "without names"),
    ],
)
def test_a_wrong_table_is_told_in_a_line(table: str, told: str, tmp_path: Path, capsys) -> None:
    (tmp_path / "t.csv").write_text(table)
    assert main(["sweep", str(tmp_path / "t.csv"), "--out", str(tmp_path / "s")]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not (tmp_path / "s" / "tasks").exists()


def test_cells_become_what_the_options_take() -> None:
    rows = [{"plant": "pepper", "seed": "3", "viewpoint": "-90", "views": "None", "watch": "False", "models": "m"}]
    (row,) = sweep_command.typed("trial", rows)
    assert row == {"plant": "pepper", "seed": 3, "viewpoint": -90.0, "views": None, "watch": False} | {
        "models": str(Path("m").absolute())
    }
    (row,) = sweep_command.typed("reconstruct", [{"capture": "s3://b/c", "workspace": "0 0 0 1 1 2"}])
    assert row == {"capture": "s3://b/c", "workspace": (0, 0, 0, 1, 1, 2)}
    with pytest.raises(InputError, match="a row without capture"):
        sweep_command.typed("reconstruct", [{"masks": "colour"}])


def test_others_on_this_machine_cannot_run_code_by_its_own_scheduler() -> None:
    with _running.connected(1, None, 30.0) as client:
        address = client.scheduler_info()["address"]
        assert client.submit(int, 7).result(timeout=60) == 7
        for guess in (address, address.replace("tls://", "tcp://")):
            words = [sys.executable, "-c", f"import distributed; distributed.Client({guess!r}, timeout=3); print('in')"]
            stranger = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
            assert stranger.returncode, "who has no key is refused"
            assert "in" not in stranger.stdout.split()


@pytest.mark.parametrize("where", ["tcp://127.0.0.1:9", "nonsense"])
def test_a_scheduler_that_is_not_there(where: str, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_running, "PATIENCE", 1.0)
    (tmp_path / "t.csv").write_text("seed\n3\n")
    assert main(["sweep", str(tmp_path / "t.csv"), "--out", str(tmp_path / "s"), "--scheduler", where]) == 2
    said = capsys.readouterr().err
    assert "nobody answers" in said
    assert [job.state for job in sweep.read(tmp_path / "s")] == ["waiting"]


def test_places_that_cannot_be(tmp_path: Path, capsys) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "t.csv").write_text("seed\n3\n")
    for out in (str(tmp_path / "file" / "s"), "nostore://x"):
        assert main(["sweep", str(tmp_path / "t.csv"), "--out", out, "--history", str(tmp_path / "h.sqlite")]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert main(["sweep", "--out", str(tmp_path / "none")]) == 2
    assert "where no sweep is" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.long
def test_trials_from_a_table(tmp_path: Path, capsys) -> None:
    (tmp_path / "t.csv").write_text("plant,seed,preset,params.shake.duration\ntomato,0,fast,2\n")
    out = tmp_path / "s"
    assert main(["sweep", str(tmp_path / "t.csv"), "--out", str(out), "--workers", "1"]) == 0
    (job,) = sweep.read(out)
    assert (job.result or {})["exit_code"] in (0, 1)
    assert (out / "tasks" / job.key / "10_report.html").is_file()
    assert "duckdb" in capsys.readouterr().out
