"""`anther row`: every stem is visited or left with its reason, after a kill too; a wrong row changes nothing."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("ortools", reason="OR-Tools is not installed: pip install 'anther[row]'")
from anther.cli import row as command
from anther.cli import row_visit, simulated_house
from anther.cli.main import main
from anther.core.errors import InputError, StageFailure
from anther.core.runs import FILES
from anther.history import Order, Report, count_trials, read_shift, read_stems
from anther.history._jobs import Job
from anther.plant import Visit
from anther.pollination import row as pollination_row
from evaluation.house.shift import Worked, drawn_work

HOUSE = ("row", "--simulate", "tomato", "--plants", "4", "--seed", "3")
FILE = """[[row]]
name = "12"
[row.left]
hooks = [0.4, 0.8, 1.2]
[row.right]
hooks = []
"""


class Killed(BaseException):
    """What a kill leaves: no report."""


class Drawn:
    """Visits whose outcomes are drawn; it dies at some of its orders."""

    def __init__(self, dies: tuple[int, ...] = ()) -> None:
        self.orders: list[Order] = []
        self.asked: list[int] = []
        self.hooks: list[Any] = []
        self.dies = dies

    def __call__(self, row: Any, order: Order, history: str, folder: Path, *, quiet: bool) -> Report:
        self.orders.append(order)
        self.asked.append(row.asked)
        self.hooks.append(row.worked.twines[0].hook)
        if len(self.orders) in self.dies:
            raise Killed
        return drawn_work([Worked(12.0, True, True, None), Worked(20.0, False, False, "slipped")], 0, 0.0)(order)


@pytest.fixture
def grown(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[Any, ...], Any]:
    """Rows that were grown, each once: growing takes seconds."""
    monkeypatch.setattr(simulated_house, "grow_row", _grown)
    return _ROWS


_ROWS: dict[tuple[Any, ...], Any] = {}
_GROW = simulated_house.grow_row


def _grown(*what: Any) -> Any:
    if what not in _ROWS:
        _ROWS[what] = _GROW(*what)
    return _ROWS[what]


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, grown: Any) -> Any:
    """Return what runs `anther` in a folder of its own, with drawn visits."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str, visits: Drawn | None = None) -> int:
        monkeypatch.setattr(command, "visit_stem", visits or Drawn())
        return main(list(words))

    return run


def test_every_stem_of_a_row_is_visited_and_told(call, capsys) -> None:
    visits = Drawn()
    assert call(*HOUSE, visits=visits) == 0
    said = capsys.readouterr().out
    assert len(re.findall(r"^ +\d of 4  row 1 (left|right), hook \d: .*, \d+\.\d s", said, re.MULTILINE)) == 4
    assert "4 stems: 4 visited" in said
    assert [(o.side, o.hook) for o in visits.orders] == [("left", 0), ("left", 1), ("right", 1), ("right", 0)]
    assert visits.asked == [o.hook for o in visits.orders], "the plant of that hook"
    stems = read_stems("simulated tomato 3, 1 x 4")
    assert [stem.plant for stem in stems] == [order.plant for order in (*visits.orders[:2], *visits.orders[:1:-1])]
    assert all(stem.open_flowers and stem.certainty > 0.95 for stem in stems)


def test_both_stems_of_a_pepper_are_visited(call, capsys) -> None:
    visits = Drawn()
    assert call("row", "--simulate", "pepper", "--plants", "2", "--seed", "3", visits=visits) == 0
    assert "4 stems: 4 visited" in capsys.readouterr().out
    asked = zip(visits.orders, visits.asked, visits.hooks, strict=True)
    strings = {(order.side, plant, tuple(hook)) for order, plant, hook in asked}
    assert len(strings) == 4
    assert {(side, plant) for side, plant, _ in strings} == {("left", 0), ("right", 0)}


def test_the_same_again_goes_on_after_a_kill_and_later_visits_only_what_is_due(call, capsys) -> None:
    with pytest.raises(Killed):
        call(*HOUSE, visits=Drawn(dies=(3,)))
    assert count_trials() == 2
    visits = Drawn()
    assert call(*HOUSE, visits=visits) == 0
    assert "shift 1 goes on" in capsys.readouterr().out
    assert len(visits.orders) == 2
    assert {stem.state for stem in read_shift(1)} == {"visited"}
    dosed = [stem.plant for stem in read_shift(1) if stem.reason == "pollinated"]
    assert dosed
    assert call(*HOUSE) == 0
    said = capsys.readouterr().out
    assert "shift 2 begins" in said
    assert said.count("dosed on") == len(dosed) == sum(stem.state == "left" for stem in read_shift(2))


def test_a_file_names_rows_and_hooks(call, tmp_path, capsys) -> None:
    Path("north.toml").write_text(FILE)
    assert call(*HOUSE, "--file", "north.toml", "--house", "north") == 0
    stems = read_stems("north")
    assert [(stem.row, stem.side) for stem in stems] == [("12", "left")] * 3
    places = [stem.position for stem in stems]
    assert places == pytest.approx([0.4, 0.8, 1.2], abs=0.1), "a quarter of a gap: odometry drifts by 5 cm on this way"
    assert "row 12 left, hook 3" in capsys.readouterr().out


WRONG_FILES = {
    "without its right side": FILE.partition("[row.right]")[0],
    "hooks in order": FILE.replace("0.8, 1.2", "1.2, 0.8"),
    "two rows called '12'": FILE + FILE,
    "a row without hooks": FILE.replace("0.4, 0.8, 1.2", ""),
    "up to 8": FILE.replace("0.4, 0.8, 1.2", ", ".join(f"{0.4 * k}" for k in range(1, 10))),
}


@pytest.mark.parametrize("message", WRONG_FILES)
def test_a_wrong_file_is_one_message_and_nothing_is_written(call, capsys, message) -> None:
    Path("north.toml").write_text(WRONG_FILES[message])
    assert call(*HOUSE, "--file", "north.toml") == 2
    said = capsys.readouterr().err.strip()
    assert message in said
    assert said.count("\n") == 0
    assert [path.name for path in Path().iterdir()] == ["north.toml"]


OTHER_HOUSES = {
    "its stems": (("--seed", "4"), "no post that row '1', left, had"),
    "its crop": (("--simulate", "pepper"), "as its map has"),
    "its rows": (("--file", "north.toml"), "all sides that its map has"),
}


@pytest.mark.parametrize("what", OTHER_HOUSES)
def test_the_map_of_another_house_is_refused_and_nothing_changes(call, capsys, what) -> None:
    words, message = OTHER_HOUSES[what]
    Path("north.toml").write_text(FILE)
    assert call(*HOUSE, "--house", "north") == 0
    before = read_stems("north"), read_shift(1), count_trials()
    capsys.readouterr()
    assert call(*HOUSE, "--house", "north", *words) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert said.err.strip().count("\n") == 0
    assert (read_stems("north"), read_shift(1), count_trials()) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("row",), "--simulate tomato"),
        ((*HOUSE[:3], "--plants", "17"), "plants <= 16"),
        ((*HOUSE, "--rows", "0"), "1 <= rows"),
        ((*HOUSE, "--robots", "0"), "1 <= robots"),
        ((*HOUSE, "--file", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_bad_options_are_refused(call, capsys, words, message) -> None:
    assert call(*words) == 2
    assert message in capsys.readouterr().err
    assert not list(Path().iterdir())


@pytest.mark.parametrize("enters", [True, False])
def test_a_stem_that_cannot_be_reached_is_a_visit_with_its_reason(tmp_path, monkeypatch, enters) -> None:
    def far(*_: Any, **__: Any) -> Any:
        raise StageFailure("unreachable", "the arm reaches two views")

    monkeypatch.setattr(row_visit, "build_row", far)
    begin = datetime(2026, 6, 1, 10, tzinfo=UTC)
    order = Order(1, "simulated 1", "tomato", "north 1 left 1", "north", "1", "left", 0, 0.4, begin, enters)
    row: Any = SimpleNamespace(seed=3)
    report = row_visit.visit_stem(row, order, str(tmp_path / "h.sqlite"), tmp_path / "run")
    visit = report.visit
    assert (visit.failure, visit.plant, visit.robot, visit.time) == ("unreachable", order.plant, order.robot, begin)
    assert report.stopped is None
    assert (report.ended - begin).total_seconds() == pytest.approx(120.0 if enters else 2.0, abs=0.5)
    assert Visit.load(tmp_path / "run" / "trial.json").failure == "unreachable"
    page = (tmp_path / "run" / FILES["report"]).read_text()
    assert "row 1 left, hook 1" in page
    assert "the arm reaches two views" in page


def test_a_visit_that_fails_is_a_reason_and_no_end_of_the_shift(tmp_path, monkeypatch) -> None:
    def unlike(*_: Any, **__: Any) -> Any:
        raise StageFailure("no_plant_found", "plant size: got 0.01 m; allowed: 0.02 to 20. Look at the map.")

    monkeypatch.setattr(row_visit, "build_row", unlike)
    begin = datetime(2026, 6, 1, 10, tzinfo=UTC)
    order = Order(1, "simulated 1", "tomato", "north 1 left 1", "north", "1", "left", 0, 0.4, begin, False)
    row: Any = SimpleNamespace(seed=3)
    visit = row_visit.visit_stem(row, order, str(tmp_path / "h.sqlite"), tmp_path / "run").visit
    assert visit.failure == "no_plant_found"
    assert "plant size" in (tmp_path / "run" / FILES["report"]).read_text()


def test_views_that_cannot_be_worked_with_are_a_failure_and_wrong_arguments_are_not(monkeypatch) -> None:
    def unlike(*_: Any) -> Any:
        raise InputError("plant size: got 0.01 m; allowed: 0.02 to 20. Look at the map.")

    monkeypatch.setattr(pollination_row, "pollinate", unlike)
    nothing: Any = None
    with pytest.raises(StageFailure, match="plant size") as failure:
        pollination_row.visit_row_stem(nothing, "tomato", (0, 0, 2), nothing)
    assert failure.value.kind == "no_plant_found"
    with pytest.raises(InputError, match="a foot below its hook"):
        pollination_row.visit_row_stem(nothing, "tomato", (0, 0, 2), nothing, foot=(0, 0, 3))
    with pytest.raises(InputError, match="a foot below its hook"):
        pollination_row.visit_row_stem(nothing, "tomato", (0, 0, 2), nothing, others=[((0, 1, 2), (0, 1, 2))])


def test_many_houses_run_on_dask_each_with_its_history(call, capsys, monkeypatch) -> None:
    from anther.history import sweep  # noqa: PLC0415

    def here(function, rows, folder, *, name):
        done = [function(row, _made(Path(folder) / str(k))) for k, row in enumerate(rows)]
        return [Job(str(k), row, "done", result=done[k]) for k, row in enumerate(rows)]

    monkeypatch.setattr(sweep, "run", here)
    monkeypatch.setattr(sweep, "export", lambda folder, jobs: Path(folder) / "results.parquet")
    assert call(*HOUSE, "--many", "2", "--out", "many") == 0
    said = capsys.readouterr().out
    assert "2 of 2 houses: 8 stems, 8 visited, 0 left" in said
    assert [count_trials(Path("many") / k / "history.sqlite") for k in "01"] == [4, 4]
    assert "4 stems" in (Path("many") / "0" / "log.txt").read_text()


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder
