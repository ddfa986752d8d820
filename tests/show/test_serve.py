"""The house's pages: what they show, that they only read, that names do nothing, and that no robot waits for them."""

from __future__ import annotations

import csv
import html
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest

pytest.importorskip("fastapi", reason="FastAPI is not installed: pip install 'anther[serve]'")
from fastapi.testclient import TestClient

from anther.cli.main import main
from anther.history import (
    House,
    Outcome,
    Robot,
    Row,
    Shift,
    Side,
    begin_shift,
    overview,
    read_stems,
    record_house,
    record_outcome,
    record_trial,
)
from anther.history._jobs import Job, State, add_jobs, note_jobs
from anther.plant import GraspRecord, ShakeRecord, Visit
from anther.plant.model import TOMATO
from anther.show.serve import charts, make_app

NOW = datetime.now(UTC).replace(microsecond=0)
# the day of the served visits, all about its noon: no midnight can part them from each other or from the tests
NOON = NOW.replace(hour=12, minute=0, second=0) - timedelta(days=1)
DAY = NOON.date()
TOKEN = "a token of the house"
EVIL = "<script>alert('row')</script>"


def visit(plant: str, hours: float = 0, robot: str = "arm 1", failure: str | None = None, **more: object) -> Visit:
    """A visit some hours ago."""
    shake = None if failure else ShakeRecord(8.0, 1.25e-3, 3.0, "sine", (0, 1, 0))
    return Visit(
        "tomato", plant, failure is None, failure, GraspRecord(0.31, organ="main_stem"), shake,
        predicted_amplitude=(1e-3, 2e-3), measured_amplitude=(1.5e-3, float("nan")), measured_acceleration=(4.0, 6.0),
        believed=TOMATO, material=TOMATO.changed(scanned_youngs=1.6e8, youngs_spread=0.3), robot=robot,
        time=NOW - timedelta(hours=hours), **more,
    )  # fmt: skip


@pytest.fixture
def history(where: str, tmp_path: Path) -> str:
    """Seven visits of two robots to two plants in three days, in SQLite and in PostgreSQL."""
    for k in range(4):
        record_trial(visit("row 1", 24 * k), where)
    record_trial(visit(EVIL, 24, robot=EVIL, run="runs/7"), where)
    record_trial(visit("row 1", 25, robot="arm 2", failure="slipped"), where)
    record_trial(visit("row 1", -2, robot="arm 2"), where)
    record_outcome(Outcome("tomato", "row 1", 12, 9, date(2026, 6, 1), note=EVIL), where)
    return where


def client(history: str, runs: Path, token: str | None = None) -> TestClient:
    return TestClient(make_app(history, runs, token), base_url="http://localhost")


def text_of(page: str) -> str:
    return html.unescape(" ".join(re.sub(r"<[^>]+>", " ", page).split()))


def test_a_day(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    day = (NOW - timedelta(days=1)).date()
    said = text_of(pages.get(f"/?day={day}").text)
    # by the hour of the day, the visit of 25 hours ago may be of the day before
    slipped = (NOW - timedelta(hours=25)).date() == day
    for part in (
        "held, flowers not measured",
        "1.25 mm at 8.00 Hz, 3.00 s",
        "5.00 m/s²",
        "row 1",
        "What failed, and why",
    ):
        assert part in said, part
    assert ("slipped 1" in said) == slipped
    failed = text_of(pages.get(f"/?day={(NOW - timedelta(hours=25)).date()}&result=failed").text)
    assert "slipped" in failed
    assert "not shaken" in failed
    assert "No visit on this day" in text_of(pages.get("/?day=2020-01-01").text)


def test_trends_and_robots(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    page = pages.get("/trends?days=7").text
    assert page.count("<svg") == 5
    assert f"{(NOW - timedelta(days=3)).date()}: 1<" in page
    said = text_of(pages.get("/robots").text)
    assert "arm 1" in said
    assert "its clock is fast" in said  # arm 2 came in two hours
    assert said.count("its clock is fast") == 1


def test_each_of_the_three_results_is_counted_filtered_and_said(where: str, tmp_path: Path) -> None:
    for k, (failure, moved) in enumerate([(None, True), (None, True), (None, False), (None, None), ("slipped", True)]):
        record_trial(visit(f"plant {k}", failure=failure, flowers_moved=moved), where)
    pages, day = client(where, tmp_path), NOW.date()
    said = {name: text_of(pages.get(f"/?day={day}&result={name}").text) for name in ("pollinated", "held", "failed")}
    shown = {name: [k for k in range(5) if f"plant {k}" in text] for name, text in said.items()}
    assert shown == {"pollinated": [0, 1], "held": [2, 3], "failed": [4]}, "the slipped one's flowers do not count"
    assert "40.0 % pollinated 2 held, flowers hardly moved or not measured 1 failed" in said["held"]
    assert "held, flowers hardly moved" in said["held"]
    assert "held, flowers not measured" in said["held"]
    assert "40.0 % 40.0 % 20.0 %" in text_of(pages.get("/robots").text)
    trends = text_of(pages.get("/trends?days=7").text)
    for share in ("40.0 % pollinated: 2 of 5 visits", "40.0 % held, flowers hardly", "20.0 % failed: 1 of 5 visits"):
        assert share in trends
    listed = {name: text_of(pages.get(f"/trends?days=7&result={name}").text) for name in said}
    assert {name: [k for k in range(5) if f"plant {k}" in text] for name, text in listed.items()} == shown
    assert pages.get("/trends?days=7&result=held").text.count("<svg") == 3, "one result of the three"
    page = pages.get("/visits/3").text
    assert 'class="verdict held"' in page
    assert "Held, flowers hardly moved" in page


def test_a_plant_and_its_visits(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    assert text_of(pages.get("/plants?q=OW 1").text).count("tomato") == 1
    assert "No plant whose label contains “%”" in text_of(pages.get("/plants?q=%25").text)
    said = text_of(pages.get("/plants/1").text)
    for part in ("row 1", "160 MPa", "row 1's own, learned in 5 trials", "75 %", "slipped", "No visit left a run",
                 "1.50 measured over predicted flower motion at the last visit (median of 1)"):  # fmt: skip
        assert part in said, part
    said = text_of(pages.get("/visits/1").text)
    for part in ("1.25 mm", "31 cm", "main stem", "1.50 mm", "not measured", "6.00 m/s²", "arm 1"):
        assert part in said, part


def house_of(where: str, rows: int = 2, hooks: int = 4) -> list[str]:
    """A house some of whose stems a shift of today visited; return its plants."""
    side = Side({}, tuple(0.4 * (k + 1) for k in range(hooks)))
    record_house(House(f"north {EVIL}", "tomato", tuple(Row(f"{k + 1}", side, side) for k in range(rows))), where)
    plants = [stem.plant for stem in read_stems(f"north {EVIL}", where)]
    for k, (failure, moved) in enumerate([(None, True), (None, False), ("slipped", None)]):
        record_trial(visit(plants[k], failure=failure, flowers_moved=moved), where)
    record_trial(visit(plants[3], 24, flowers_moved=True), where)
    begin = NOW.replace(hour=0, minute=0, second=0)
    begin_shift(Shift(f"north {EVIL}", begin, begin + timedelta(hours=23), (Robot("a"),)), where)
    return plants


def test_the_house_by_rows_and_hooks(where: str, tmp_path: Path) -> None:
    pages = client(where, tmp_path)
    assert "No house has a map" in text_of(pages.get("/house").text)
    plants = house_of(where)
    page = pages.get(f"/house?day={NOW.date()}").text
    assert EVIL not in page, "names are text"
    cells = re.findall(r'<a href="/plants/(\d+)" class="(\w+)" title', page)
    assert [state for _, state in cells] == ["pollinated", "held", "failed", "left", *["waiting"] * 4]
    assert len({number for number, _ in cells}) == 8, "the stems of the first row"
    said = text_of(page)
    for part in ("1 pollinated", "1 of 8, 1 ✗", "0 of 8", "failed: slipped", "held, flowers hardly moved",
                 f"dosed on {(NOW - timedelta(hours=24)).date()}", "12 waiting"):  # fmt: skip
        assert part in said, part
    other = pages.get(f"/house?row=2&day={NOW.date()}").text
    assert re.findall(r'class="(\w+)" title', other) == ["waiting"] * 8
    yesterday = pages.get(f"/house?day={(NOW - timedelta(hours=24)).date()}").text
    assert re.findall(r'class="(\w+)" title', yesterday) == ["none"] * 3 + ["pollinated"] + ["none"] * 4
    assert pages.get("/house?row=7").status_code == 404
    assert plants[2] in page.replace("&lt;", "<").replace("&gt;", ">").replace("&#39;", "'")


def test_older_visits_come_page_by_page(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anther.history.overview.PAGE", 3)
    for k in range(8):
        record_trial(visit("a", k / 60), where)
    pages, address, seen = client(where, tmp_path), "/plants/1", []
    while address:
        page = pages.get(address).text
        seen += re.findall(r'href="/visits/(\d+)">', page)
        more = re.search(r'hx-get="([^"]+)"', page)
        address = more[1] if more else ""
    assert seen == [str(k) for k in range(1, 9)]


def test_names_are_text(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    day = (NOW - timedelta(days=1)).date()
    for address in (f"/?day={day}", "/robots", "/plants", f"/plants?q={EVIL}", "/plants/1", "/plants/2", "/visits/5"):
        page = pages.get(address).text
        assert EVIL not in page, address
        assert "&lt;script&gt;" in page, address


def test_every_answer_forbids_what_is_not_ours(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    for address in ("/", "/trends", "/nothing", "/plants/99", "/?day=x", "/static/htmx.min.js", "/style.css"):
        answer = pages.get(address)
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'"), address
        assert "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        if "html" in answer.headers["content-type"]:
            assert not re.search(r"(src|href|action)=\"(https?:)?//", answer.text), address
            assert not re.search(r"<script>|\son\w+=|\sstyle=", answer.text), address


def test_what_is_not_there_is_said(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    for address, status in (
        ("/plants/99", 404), ("/visits/99", 404), ("/visits/1/report", 404), ("/nothing", 404), ("/plants/x", 400),
        ("/?day=1066-10-14", 400), ("/?day=9999-12-31", 400),
        ("/export?table=visits&form=csv&since=9999-12-30&until=9999-12-31", 400),
        ("/export?table=visits&form=csv&since=0001-01-01&until=0001-01-02", 400),
        ("/trends?days=9999", 400), ("/visits/99999999999999999999999", 400),
    ):  # fmt: skip
        answer = pages.get(address)
        assert answer.status_code == status, address
        assert "This cannot be shown" in answer.text


def test_a_history_that_is_not_there_yet_is_empty(tmp_path: Path) -> None:
    pages = client(str(tmp_path / "none.sqlite"), tmp_path)
    for address in ("/", "/trends", "/robots", "/plants", "/sweeps", "/exports"):
        assert pages.get(address).status_code == 200, address
    assert not (tmp_path / "none.sqlite").exists()
    (tmp_path / "bad.sqlite").write_text("not a database " * 100)
    answer = client(str(tmp_path / "bad.sqlite"), tmp_path).get("/")
    assert (answer.status_code, "not a database" in answer.text) == (503, True)


def test_only_reports_of_runs_are_shown(where: str, tmp_path: Path) -> None:
    runs, out = tmp_path / "runs", tmp_path / "elsewhere"
    for folder in (runs / "7", out):
        folder.mkdir(parents=True)
        (folder / "10_report.html").write_text("<h1>report</h1><script>1</script>")
    (runs / "linked").symlink_to(out)
    (runs / "loop").symlink_to("loop")
    places = [
        "7",
        str(runs / "7"),
        "../elsewhere",
        str(out),
        "linked",
        "8",
        "loop",
        "x" * 5000,
        "/".join(["x" * 200] * 40),
    ]
    places += ["a\0b"] if "postgresql" not in where else []  # which keeps no such text
    numbers = [record_trial(visit("a", k, run=run), where) for k, run in enumerate(places)]
    pages = client(where, runs)
    shown = [pages.get(f"/visits/{n}/report").status_code for n in numbers]
    assert shown == [200, 200] + [404] * (len(places) - 2)
    assert {pages.get(f"/visits/{n}").status_code for n in numbers} == {pages.get("/plants/1").status_code} == {200}
    policy = pages.get(f"/visits/{numbers[0]}/report").headers["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "sandbox;" in policy
    assert "script" not in policy
    assert f'src="/visits/{numbers[0]}/report"' in pages.get(f"/visits/{numbers[0]}").text
    assert "not on this computer" in pages.get(f"/visits/{numbers[5]}").text


def test_notes_need_the_token(history: str, tmp_path: Path) -> None:
    note = {"text": f"leaf cut {EVIL}", "token": TOKEN}
    reads = client(history, tmp_path)
    assert reads.post("/visits/1/notes", data=note).status_code == 403
    writes = client(history, tmp_path, TOKEN)
    assert writes.post("/visits/1/notes", data=note | {"token": "guess"}).status_code == 403
    assert writes.post("/visits/1/notes", data={"text": "x"}).status_code == 400
    assert writes.post("/visits/99/notes", data=note).status_code == 400
    assert writes.post("/visits/1/notes", data=note | {"text": " "}).status_code == 400
    assert "leaf cut" not in reads.get("/visits/1").text
    assert "<textarea" not in reads.get("/visits/1").text
    page = writes.post("/visits/1/notes", data=note).text
    assert "leaf cut &lt;script&gt;" in page
    assert "<textarea" in page


def test_a_form_is_not_read_before_its_size_is_known(history: str, tmp_path: Path) -> None:
    """The token is in the form: until it is read, anybody may have sent it."""
    read = list[int]()

    def sent() -> Iterator[bytes]:
        for _ in range(100):
            read.append(2**20)
            yield b"a" * 2**20

    writes = client(history, tmp_path, TOKEN)
    kind = {"content-type": "application/x-www-form-urlencoded"}
    for size in ({}, {"content-length": str(100 * 2**20)}, {"content-length": "-1"}, {"content-length": "9" * 5000}):
        assert writes.post("/visits/1/notes", content=sent(), headers=kind | size).status_code == 413
    long = {"text": "ü" * 2000, "token": TOKEN}
    assert writes.post("/visits/1/notes", data=long).status_code == 200, "the longest note is not too long"


def test_nothing_else_is_written_and_no_arm_is_known(history: str, tmp_path: Path) -> None:
    """Only notes are posted; and the room imports nothing that could reach a device."""
    app = make_app(history, tmp_path, TOKEN)
    methods = {(path.path, m) for path in app.routes for m in getattr(path, "methods", None) or ()}
    assert {m for m in methods if m[1] not in ("GET", "HEAD")} == {("/visits/{number}/notes", "POST")}
    code = "import sys, anther.show.serve; print([m for m in sys.modules if m.startswith('anther.')])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for room in ("robot", "pollination", "sim"):
        assert f"'anther.{room}" not in loaded, room


def test_only_as_localhost_unless_told_otherwise(history: str, tmp_path: Path) -> None:
    for name in ("evil.example", "testserver"):
        assert client(history, tmp_path).get("/", headers={"host": name}).status_code == 400
    for name in ("localhost:8000", "127.0.0.1:8000", "[::1]:8000"):
        assert client(history, tmp_path).get("/exports", headers={"host": name}).status_code == 200
    shared = TestClient(make_app(history, tmp_path, local=False), base_url="http://greenhouse")
    assert shared.get("/exports").status_code == 200


def test_exports(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    span = f"since={(NOW - timedelta(days=9)).date()}&until={(NOW + timedelta(days=1)).date()}"
    rows = list(csv.DictReader(pages.get(f"/export?table=visits&form=csv&{span}").text.splitlines()))
    assert len(rows) == 7
    assert {row["robot"] for row in rows} == {"arm 1", "arm 2", EVIL}
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'anther[parquet]'")
    answer = pages.get(f"/export?table=flowers&form=parquet&{span}")
    assert answer.content[:4] == answer.content[-4:] == b"PAR1"
    assert "attachment" in answer.headers["content-disposition"]
    assert pages.get("/export?table=visits&form=csv&since=2020-01-01&until=2026-01-01").status_code == 400
    assert pages.get("/export?table=plants&form=csv&since=2026-01-01&until=2026-01-01").status_code == 400


def test_sweeps_where_there_are_any(history: str, tmp_path: Path) -> None:
    pages = client(history, tmp_path)
    assert "keeps no sweep" in pages.get("/sweeps").text
    jobs = [Job(name, {"seed": n}) for n, name in enumerate("abcd")]
    add_jobs(jobs, history, uid="u", folder="runs/night", function="trial")
    ended: list[State] = ["done", "done", "waiting", "poison"]
    note_jobs([replace(job, state=state) for job, state in zip(jobs, ended, strict=True)], history, uid="u")
    said = text_of(pages.get("/sweeps").text)
    assert re.search(r"runs/night trial \S+ \S+ 2 of 4 1 1", said)


def test_a_slow_page_holds_up_no_robot(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that has begun to read and does not end: a visit is recorded meanwhile, and the page ends as it began."""
    record_trial(visit("a"), where)
    begun, go_on, days = threading.Event(), threading.Event(), overview.days

    def slowly(*which: object) -> object:
        found = days(*which)  # type: ignore[arg-type]
        begun.set()
        go_on.wait(60)
        return found

    monkeypatch.setattr("anther.show.serve.overview.days", slowly)
    pages, answers = client(where, tmp_path), []
    page = threading.Thread(target=lambda: answers.append(pages.get(f"/?day={NOW.date()}")))
    page.start()
    try:
        assert begun.wait(60)
        begin = time.monotonic()
        record_trial(visit("a", 0.001), where)
        assert time.monotonic() - begin < 20  # whoever waits for a lock waits for 30 s
        assert not answers
    finally:
        go_on.set()
        page.join()
    assert answers[0].status_code == 200


def test_charts_stay_within_their_box() -> None:
    day = date(2026, 5, 1)
    days = [
        overview.Tally(day + timedelta(days=k), 10 * k + 1, k, k, None if k == 2 else 3.0 * k, NOW) for k in range(5)
    ]
    drawn = charts(days, day, day + timedelta(days=6))
    assert [len(chart.bars) for chart in drawn] == [5, 5, 5, 5, 4]
    assert [chart.last for chart in drawn] == ["41", "9.8 %", "0.0 %", "90.2 %", "12.0 m/s²"]
    for bar in (bar for chart in drawn for bar in chart.bars):
        assert 0 <= bar.x <= bar.x + bar.width <= 600
        assert bar.y + bar.height == pytest.approx(100)
        assert bar.y >= 0
    assert drawn[0].bars[-1].height == 100
    assert [chart.last for chart in charts([], day, day)] == ["nothing yet"] * 5


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Yield the address of `anther history serve` in a process of its own, with 61 visits of `DAY`."""
    noon = (NOW - NOON) / timedelta(hours=1)
    record_trial(visit("row 1", noon), folder / "h.sqlite")
    for k in range(60):
        record_trial(visit(f"row {k}, {EVIL}", noon + k / 3600, flowers_moved=k % 3 > 0), folder / "h.sqlite")
    (folder / "token").write_text(TOKEN)
    words = [
        "history",
        "serve",
        str(folder / "h.sqlite"),
        "--port",
        "0",
        "--token",
        str(folder / "token"),
        "--runs",
        str(folder),
    ]
    command = [sys.executable, "-m", "anther.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first, second = process.stdout.readline(), process.stdout.readline()
        assert "61 visits at http://127.0.0.1:" in first
        assert "only this computer can read it; notes: with the token" in second
        yield first.split(" at ")[1].split("/ ")[0]
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def test_the_command_serves_until_it_is_interrupted(tmp_path: Path) -> None:
    with serving(tmp_path) as address:
        with urllib.request.urlopen(f"{address}/robots", timeout=60) as reply:
            assert "arm 1" in reply.read().decode()
        with pytest.raises(urllib.error.HTTPError, match="400"):
            urllib.request.urlopen(urllib.request.Request(f"{address}/robots", headers={"Host": "evil.example"}))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "99999"], "port"),
        (["--host", "203.0.113.7"], "Choose another --host or --port"),
        (["--token", "short"], "16 or more"),
        (["--token", "missing"], "missing"),
        (["--runs", "missing"], "missing"),
    ],
)
def test_what_cannot_be_served_is_refused(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short").write_text("guess")
    assert main(["history", "serve", "h.sqlite", *words]) == 2
    assert said in capsys.readouterr().err


def test_without_fastapi_the_message_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert main(["history", "serve"]) == 2
    assert "pip install 'anther[serve]'" in capsys.readouterr().err
