"""The pages in a real browser: Debian's Chromium, on a desk and on a phone."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from typing import Any

import pytest
from test_serve import DAY, EVIL, TOKEN, serving

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt install chromium")
VISITS = f"/?day={DAY}"
PAGES = (
    "/",
    VISITS,
    "/house",
    f"{VISITS}&result=failed",
    "/trends",
    "/robots",
    "/plants",
    "/plants/2",
    "/visits/3",
    "/sweeps",
    "/exports",
    "/none",
)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with serving(tmp_path_factory.mktemp("house")) as address:
        yield address


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture(params=[1200, 390], ids=["desk", "phone"])
def page(request: pytest.FixtureRequest, chromium: Any, running: str) -> Iterator[Any]:
    """A page that notes what it asks for, what it was forbidden, and any dialogue."""
    opened = chromium.new_page(viewport={"width": request.param, "height": 800}, base_url=running)
    opened.set_default_timeout(60_000)
    opened.asked, opened.complaints = [], []
    opened.on("request", lambda asked: opened.asked.append(asked.url))
    opened.on("console", lambda said: opened.complaints.append(said.text) if said.type == "error" else None)
    opened.on("pageerror", lambda error: opened.complaints.append(str(error)))
    opened.on("dialog", lambda dialogue: (opened.complaints.append(dialogue.message), dialogue.dismiss()))
    yield opened
    opened.close()


def test_every_page_fits_and_asks_nobody_else(page: Any, running: str) -> None:
    for address in PAGES:
        page.goto(address)
        width = page.viewport_size["width"]
        assert page.evaluate("document.documentElement.scrollWidth") <= width, address
        assert page.locator("h1").is_visible()
        small = page.evaluate(
            "[...document.querySelectorAll('main a, main button, main td, main p')]"
            ".filter(e => e.innerText && parseFloat(getComputedStyle(e).fontSize) < 12).length"
        )
        assert small == 0, address
    assert {url for url in page.asked if not url.startswith(running)} == set()
    # one page is not there, and its status is an error to the browser
    assert [said for said in page.complaints if "404" not in said] == []


def test_what_is_in_sight_on_a_phone_is_whole(page: Any) -> None:
    """No cell reaches over its table's edge, and no two cells of a row lie on each other."""
    page.goto(VISITS)
    overlaps = page.evaluate(
        """() => [...document.querySelectorAll('table.visits tbody tr')].filter(row => {
             const boxes = [...row.children].map(cell => cell.getBoundingClientRect());
             const edge = row.closest('section').getBoundingClientRect().right;
             return boxes.some((a, i) => a.right > edge || boxes.slice(i + 1).some(b =>
               a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1));
           }).length"""
    )
    assert overlaps == 0


def test_no_word_of_a_visit_is_torn(page: Any) -> None:
    """The longest result beside a plant's label: each in four lines at most, the time in one."""
    page.goto(VISITS)
    row = page.locator("table.visits tbody tr", has_text="held, flowers hardly moved").first
    cells = row.locator("td").all()
    assert max(cell.bounding_box()["height"] for cell in cells) < 5 * 24, "pixels of a line"
    assert cells[0].locator("a").evaluate("a => a.getClientRects().length") == 1


def test_earlier_visits_are_added_without_a_new_page(page: Any) -> None:
    page.goto(VISITS)
    rows = page.locator("table.visits tbody tr:not(#more)")
    playwright.expect(rows).to_have_count(50)
    page.get_by_text("Earlier visits").click()
    playwright.expect(rows).not_to_have_count(50)
    assert rows.count() > 50
    assert "before" not in page.url


def test_plants_are_found_while_typing(page: Any) -> None:
    page.goto("/plants")
    page.get_by_label("Part of a label").press_sequentially("row 59")
    playwright.expect(page.locator("#found li")).to_have_count(1)
    page.locator("#found a").click()
    assert page.locator("h1").inner_text() == f"row 59, {EVIL}"
    assert page.complaints == []


def test_a_note_is_written_with_the_token(page: Any) -> None:
    page.goto("/visits/1")
    for token, said in (("a wrong one, and long", "That is not the token"), (TOKEN, "Leaf cut")):
        page.goto("/visits/1")
        page.get_by_label("A note").fill("Leaf cut\nbefore the visit")
        page.get_by_label("Token").fill(token)
        page.get_by_role("button", name="Write").click()
        playwright.expect(page.locator("main")).to_contain_text(re.compile(said))
