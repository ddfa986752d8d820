"""The house's page: what the robots did today, what failed and why, plant by plant, from the history.

It reads the history and never writes but a note, with a token; it knows no arm and sends nothing to one. Pages are
rendered here from templates that escape what they are given; HTMX, shipped beside them, renews parts. A page is one
short reading transaction, which the database keeps from writing, in a thread of its own: however slow a page is, a
robot that writes does not wait for it (SQLite's write-ahead log, PostgreSQL's snapshots).
"""

from __future__ import annotations

import secrets
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path
from threading import BoundedSemaphore
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from fastapi import FastAPI, Form, Query, Request, Response
from fastapi import Path as Path_
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, HTMLResponse, RedirectResponse
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from sqlalchemy.orm import Session
from starlette.background import BackgroundTask
from starlette.exceptions import HTTPException

from anther.core.errors import AntherError, InputError, MissingExtra
from anther.core.runs import FILES
from anther.history import (
    each_trial,
    export,
    find_visit,
    hide_password,
    open_reader,
    overview,
    read_outcomes,
    record_note,
)
from anther.history import starting_material as believed
from anther.history.overview import Tally
from anther.plant.visit import Result, Visit, result_of, result_words
from anther.show.style import STYLE, quantity

__all__ = ["make_app"]


class Bar(NamedTuple):
    """One day: its box in the view box, and what it says."""

    x: float
    y: float
    width: float
    height: float
    says: str


class Chart(NamedTuple):
    """A chart over days: what its top stands for, the last known value, and a bar for every day that has one.

    Its kind is the result that it counts, which gives it its colour; "" for what is no result.
    """

    kind: Result | Literal[""]
    title: str
    top: str
    last: str
    first_day: date
    last_day: date
    bars: tuple[Bar, ...]


RESULTS: dict[Result, str] = {
    "pollinated": "Pollinated",
    "held": "Held, flowers hardly moved or not measured",
    "failed": "Failed",
}
"""The three results of a visit, in words."""


def counted(tally: Tally) -> dict[Result, int]:
    """Return how many visits had each of the three results."""
    return {
        "pollinated": tally.pollinated,
        "held": tally.held - tally.pollinated,
        "failed": tally.visits - tally.held,
    }


def charts(days: Sequence[Tally], since: date, until: date, only: Result | None = None) -> list[Chart]:
    """Return visits a day, the share of each result (or of one only), and the flowers' mean acceleration."""
    by_day = {day.name: day for day in days}
    visits = {day: float(t.visits) for day, t in by_day.items()}
    felt = {day: t.acceleration for day, t in by_day.items() if t.acceleration is not None}
    shares = [
        _chart(
            words,
            {day: 100 * counted(t)[kind] / t.visits for day, t in by_day.items()},
            "{:.1f} %",
            (since, until),
            kind,
            top=100.0,
        )
        for kind, words in RESULTS.items()
        if only in (None, kind)
    ]
    return [
        _chart("Visits a day", visits, "{:.0f}", (since, until)),
        *shares,
        _chart("Flowers' acceleration, daily mean", felt, "{:.1f} m/s²", (since, until)),
    ]


def _chart(
    title: str,
    values: dict[date, float],
    form: str,
    span: tuple[date, date],
    kind: Result | Literal[""] = "",
    *,
    top: float = 0.0,
) -> Chart:
    since, until = span
    count = (until - since).days + 1
    top = top or max(values.values(), default=0.0) or 1.0
    width, height = 600.0, 100.0  # of the SVG's view box; the page stretches it
    step = width / count
    bars = [
        Bar(step * k, height * (1 - values[day] / top), 0.8 * step, height * values[day] / top, f"{day}: {said}")
        for k in range(count)
        if (day := since + timedelta(days=k)) in values and (said := form.format(values[day]))
    ]
    last = form.format(values[max(values)]) if values else "nothing yet"
    return Chart(kind, title, form.format(top), last, since, until, tuple(bars))


HERE = Path(__file__).parent
OURS = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""What a page may load: what it was sent with."""
REPORTS = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox; frame-ancestors 'self'"
"""What a report may load: nothing; it holds its pictures. It runs no script and belongs to no site."""
LOCAL = ("localhost", "127.0.0.1", "[::1]")

DAYS: Any = {"ge": date(1970, 1, 2), "le": date(9000, 1, 1)}
Bounded = Query(**DAYS)
Day = Annotated[date | None, Bounded]
Name = Annotated[str | None, Query(max_length=200)]
Number = Annotated[int, Path_(ge=1, le=2**31 - 1)]
Before = Annotated[int | None, Query(ge=1, le=2**31 - 1)]
"""Of the last visit of the page before."""


class Site(NamedTuple):
    """What the pages are about; see `make_app`."""

    history: str
    runs: Path
    token: str | None = None


def make_app(history: str, runs: Path, token: str | None = None, *, local: bool = True) -> FastAPI:
    """Return the pages as an ASGI application.

    Args:
        history: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE.
        runs: only reports under this folder are shown; a run's folder in the history is taken relative to it.
        token: that whoever writes a note must know; None: nothing can be written.
        local: answer only requests that name this computer as localhost.
    """
    app = FastAPI(title="Anther", docs_url=None, redoc_url=None, openapi_url=None)
    site = Site(history, runs.resolve(), token)
    templates = Jinja2Templates(HERE / "templates")
    templates.env.globals.update(
        result_of=result_of, result_words=result_words, quantity=quantity, results=RESULTS, states=STATES
    )
    templates.env.globals.update(
        {"today": lambda: datetime.now(UTC).date(), "place": hide_password(history), "writes": token is not None}
    )

    def page(request: Request, name: str, status: int = 200, **values: Any) -> HTMLResponse:
        return templates.TemplateResponse(
            request, name, {"at": request.url.path, "most": overview.PAGE, **values}, status_code=status
        )

    def refused(request: Request, status: int, said: str) -> HTMLResponse:
        return page(request, "refused.html", status, said=said)

    # most bytes of a form that is read [-]: the token is in it, so that it is read before anybody is trusted. A guess
    largest = 65_536

    @app.middleware("http")
    async def guard(request: Request, answer: Callable[[Request], Any]) -> Response:
        name = request.headers.get("host", "").rsplit(":", 1)[0] if local else LOCAL[0]
        if name not in LOCAL:  # another site whose name was bent to this computer
            return Response("Only as localhost.", 400)
        size = request.headers.get("content-length", "0" if request.method in ("GET", "HEAD") else "")
        if "transfer-encoding" in request.headers or not size.isdecimal() or int(size[:18]) > largest:
            return Response(f"A form of at most {largest} bytes, with its Content-Length.", 413)
        response: Response = await answer(request)
        response.headers.setdefault("Content-Security-Policy", OURS)
        response.headers.setdefault("Cache-Control", "no-store")
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    @app.exception_handler(AntherError)
    def not_read(request: Request, error: AntherError) -> HTMLResponse:
        return refused(request, 503 if not isinstance(error, MissingExtra) else 501, str(error))

    @app.exception_handler(RequestValidationError)
    def not_understood(request: Request, error: RequestValidationError) -> HTMLResponse:
        wrong = "; ".join(f"{what['loc'][-1]}: {what['msg']}" for what in error.errors())
        return refused(request, 400, f"The address holds what this page does not understand: {wrong}.")

    @app.exception_handler(HTTPException)
    def not_there(request: Request, error: HTTPException) -> HTMLResponse:
        return refused(request, error.status_code, str(error.detail))

    @app.get("/style.css")
    def style() -> Response:
        text = STYLE + (HERE / "static" / "serve.css").read_text(encoding="utf-8")
        return Response(text, media_type="text/css", headers={"Cache-Control": "max-age=300"})

    app.mount("/static", StaticFiles(directory=HERE / "static"))
    _overviews(app, site, page)
    _details(app, site, page)
    _exports(app, site, page)
    return app


def _overviews(app: FastAPI, site: Site, page: Callable[..., HTMLResponse]) -> None:
    """Add the pages about many visits."""

    @app.get("/")
    def a_day(
        request: Request,
        day: Day = None,
        result: Result | None = None,
        before: Before = None,
    ) -> HTMLResponse:
        shown_day = day or datetime.now(UTC).date()
        ask = partial(_whole_day, day=shown_day, result=result, before=before)
        values = _read(site, ask, {"failures": [], "visits": [], "tally": None, "charts": [], "last_day": None})
        return page(request, "day.html", day=shown_day, result=result, step=timedelta(days=1), **values)

    @app.get("/house")
    def a_house(request: Request, house: Name = None, row: Name = None, day: Day = None) -> HTMLResponse:
        shown_day = day or datetime.now(UTC).date()
        ask = partial(_house_day, house=house, row=row, day=shown_day)
        found = _read(site, ask, {"houses": [], "house": None, "rows": {}, "row": None, "stems": []})
        if (house or row) and not found["stems"]:
            raise HTTPException(404, f"There is no row '{row or ''}' of a house '{house or ''}' in this history.")
        return page(request, "house.html", day=shown_day, step=timedelta(days=1), **found)

    @app.get("/trends")
    def trends(
        request: Request,
        days: Annotated[int, Query(ge=2, le=90)] = 30,
        result: Result | None = None,
        before: Before = None,
    ) -> HTMLResponse:
        until = datetime.now(UTC).date()
        since = until - timedelta(days=days - 1)

        ask = partial(_trends, span=(since, until), result=result, before=before)
        found = _read(site, ask, {"charts": [], "counts": {}, "failures": [], "visits": []})
        return page(request, "trends.html", days=days, result=result, **found)

    @app.get("/robots")
    def robots(request: Request) -> HTMLResponse:
        now = datetime.now(UTC)
        # a clock that is fast writes visits of tomorrow
        span = now.date() - timedelta(days=29), now.date() + timedelta(days=2)
        found = _read(site, lambda session: {"robots": overview.robots(session, *span)}, {"robots": []})
        return page(request, "robots.html", now=now + timedelta(minutes=1), **found)

    @app.get("/plants")
    def plants(request: Request, q: Annotated[str, Query(max_length=200)] = "") -> HTMLResponse:
        found = _read(site, lambda session: {"plants": overview.plants(session, q)}, {"plants": []})
        return page(request, "plants.html", q=q, **found)

    @app.get("/sweeps")
    def sweeps(request: Request) -> HTMLResponse:
        found = _read(site, lambda session: {"sweeps": overview.sweeps(session)}, {"sweeps": []})
        return page(request, "sweeps.html", **found)


def _whole_day(session: Session, day: date, result: Result | None, before: int | None) -> dict[str, Any]:
    """Return what the page of a day shows, two weeks of charts among it."""
    begin = day - timedelta(days=13)
    weeks = overview.days(session, begin, day)
    return {
        "failures": overview.failures(session, day, day),
        "visits": overview.visits(session, day=day, result=result, before=before),
        "tally": next((t for t in weeks if t.name == day), None),
        "charts": charts(weeks, begin, day),
        "last_day": overview.last_day(session, day),
    }


STATES = {
    "pollinated": ("✓", "pollinated"),
    "held": ("~", "held, flowers hardly moved or not measured"),
    "failed": ("✗", "failed"),
    "left": ("–", "left"),
    "working": ("…", "under way"),
    "waiting": ("·", "waiting"),
    "none": ("", "not in a shift"),
}
"""State of a stem -> its sign and what it means."""


def _house_day(session: Session, house: str | None, row: str | None, day: date) -> dict[str, Any]:
    """Return what the page of a house shows: how many stems of each row came to what, and the stems of one row."""
    names = overview.houses(session)
    house = house or next(iter(names), None)
    stems = [] if house is None else overview.house_day(session, house, day)
    rows: dict[str, Counter[str]] = {}
    for stem in stems:
        rows.setdefault(stem.row, Counter())[stem.state] += 1
    row = row or next(iter(rows), None)
    of_row = [stem for stem in stems if stem.row == row]
    return {"houses": names, "house": house, "rows": rows, "row": row, "stems": of_row}


def _trends(session: Session, span: tuple[date, date], result: Result | None, before: int | None) -> dict[str, Any]:
    """Return what the page of trends shows of some days; with a result also the last visits that had it."""
    tallies = overview.days(session, *span)
    return {
        "charts": charts(tallies, *span, result),
        "counts": {kind: sum(counted(t)[kind] for t in tallies) for kind in RESULTS},
        "failures": overview.failures(session, *span),
        "visits": overview.visits(session, result=result, before=before) if result else [],
    }


def _details(app: FastAPI, site: Site, page: Callable[..., HTMLResponse]) -> None:
    """Add the pages about one plant and one visit."""

    @app.get("/plants/{number}")
    def a_plant(request: Request, number: Number, before: Before = None) -> HTMLResponse:
        def ask(session: Session) -> dict[str, Any]:
            return {
                "plant": overview.plant(session, number),
                "visits": overview.visits(session, plant=number, before=before),
                "counts": overview.counts(session, number),
                "last": overview.last_run(session, number),
            }

        found = _read(site, ask, {"plant": None})
        if found["plant"] is None:
            raise HTTPException(404, f"There is no plant {number} in this history.")
        belief = believed(found["plant"].species, found["plant"].label, site.history)
        newest = find_visit(found["visits"][0].id, site.history) if found["visits"] else None
        last = found["last"]
        report = None if last is None or _report(site, last.run) is None else last.id
        return page(request, "plant.html", belief=belief, report=report, over=_over_predicted(newest), **found)

    @app.get("/visits/{number}")
    def a_visit(request: Request, number: Number) -> HTMLResponse:
        record = find_visit(number, site.history)
        if record is None:
            raise HTTPException(404, f"There is no visit {number} in this history.")

        def ask(session: Session) -> dict[str, Any]:
            visit = overview.visit(session, number)
            return {"plant_id": visit.plant_id, "notes": overview.notes(session, number)}

        report = None if record.run is None else _report(site, record.run)
        found = _read(site, ask, {})
        return page(request, "visit.html", visit=record, number=number, report=report, **found)

    @app.get("/visits/{number}/report")
    def report(number: Number) -> FileResponse:
        record = find_visit(number, site.history)
        path = None if record is None or record.run is None else _report(site, record.run)
        if path is None:
            raise HTTPException(404, f"There is no report of visit {number} under {site.runs}.")
        return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORTS})

    @app.post("/visits/{number}/notes")
    def note(number: Number, text: Annotated[str, Form()], token: Annotated[str, Form()]) -> RedirectResponse:
        if site.token is None:
            raise HTTPException(403, "This page only reads. Start it with --token FILE to let people write notes.")
        if not secrets.compare_digest(token.encode(), site.token.encode()):
            raise HTTPException(403, "That is not the token. Nothing was written.")
        try:
            record_note(number, text, site.history)
        except InputError as error:
            raise HTTPException(400, str(error)) from error
        return RedirectResponse(f"/visits/{number}", 303)


def _exports(app: FastAPI, site: Site, page: Callable[..., HTMLResponse]) -> None:
    """Add the tables for other programs."""
    one_at_a_time = BoundedSemaphore(1)

    longest = 366  # days of an export

    @app.get("/exports")
    def exports(request: Request) -> HTMLResponse:
        return page(request, "exports.html", month=datetime.now(UTC).date() - timedelta(days=29), longest=longest)

    @app.get("/export")
    def table(
        table: Literal["visits", "flowers", "outcomes"],
        form: Literal["csv", "parquet"],
        since: Annotated[date, Bounded],
        until: Annotated[date, Bounded],
    ) -> FileResponse:
        if not 0 <= (until - since).days < longest:
            raise HTTPException(400, f"Choose 1 to {longest} days; `anther history --export` has no such limit.")
        if not one_at_a_time.acquire(blocking=False):
            raise HTTPException(503, "Another export is being written: try again when it is done.")
        try:
            folder = tempfile.TemporaryDirectory(prefix="anther-export-")
            path = Path(folder.name) / f"{table} {since} to {until}.{form}"
            outcomes = (o for o in read_outcomes(site.history) if since <= o.date <= until)
            export(path, table, each_trial(site.history, since=since, until=until), outcomes)
        finally:
            one_at_a_time.release()
        return FileResponse(path, filename=path.name, background=BackgroundTask(folder.cleanup))


def _read(site: Site, ask: Callable[[Session], dict[str, Any]], nothing: dict[str, Any]) -> dict[str, Any]:
    """Return what is read in one transaction; `nothing` where there is no history yet."""
    with open_reader(site.history) as session:
        return nothing if session is None else ask(session)


def _report(site: Site, run: str) -> Path | None:
    """Return the report of a run, its only file that is shown, if it is there and under the folder of runs."""
    try:
        path = (site.runs / run / FILES["report"]).resolve()
        return path if path.is_relative_to(site.runs) and path.is_file() else None
    except (OSError, ValueError, RuntimeError):  # a name too long, a null character, a link to itself: no path
        return None


def _over_predicted(visit: Visit | None) -> tuple[float, int] | None:
    """Return the median of measured over predicted flower motion of a visit, and of how many; None: nothing was."""
    motions = None if visit is None or not visit.flowers else visit.motions()
    if motions is None:
        return None
    ratio = np.array(motions["measured_amplitude"]) / np.array(motions["predicted_amplitude"])
    seen = ratio[np.isfinite(ratio)]
    return (float(np.median(seen)), len(seen)) if len(seen) else None
