"""The page in a browser: live numbers, nothing on its console, no scrolling to the side on a phone."""

import pytest

pytest.importorskip("tornado", reason="tornado is not installed")

from dashboard_client import engine, serving  # noqa: E402

from retalis.dashboard.view_model import TopicRow  # noqa: E402

pytestmark = pytest.mark.slow

HOSTILE = "<img src=x onerror=alert(1)><b>bold</b>"
LONG = "a" * 150
TOPICS = (TopicRow("/smoke", "house/Smoke", 7, 1, 0, 0.5, 0.01), TopicRow(f"/{LONG}", "house/Other"))


@pytest.fixture(scope="module")
def program():
    return engine()


@pytest.fixture(scope="module")
def page(program):
    with serving(program, topics=lambda: TOPICS, allows_queries=True) as served:
        yield served


@pytest.fixture
def opened(browser, page):
    """The page, when it has begun to show numbers."""
    browser.open(page.url)
    browser.wait_for("Number(document.body?.dataset.looks) >= 2")
    return browser


def text_of(browser, part):
    return browser.ask(f"document.querySelector('{part}').innerText")


def shows(browser, part, text):
    """Wait until a part of the page has a text."""
    browser.wait_for(f"document.querySelector('{part}').innerText.includes({text!r})")


def test_numbers_are_live_and_nothing_is_on_the_console(opened, program):
    assert text_of(opened, "#title") == "/retalis"
    assert text_of(opened, "#state") == "live"
    program.event("smoke(hall)", 1)
    program.event("heat(hall)", 2)
    program.event("marker(7)", 3)
    shows(opened, "#events", "alarm(hall)")
    shows(opened, "#memories", "1 / 10")
    shows(opened, "#waiting", "fires: 99 s behind")
    shows(opened, "#subscriptions", "alarms")
    shows(opened, "#rules", "alarm(X)")
    opened.wait_for("document.querySelectorAll('#graph rect').length >= 8")
    program.event("smoke(hall)", 4)
    shows(opened, "#memories", "2 / 10")


def test_texts_from_outside_stay_texts(opened, program):
    program.event(f"said('{HOSTILE}')", 5)
    program.load(rules=f"'{HOSTILE}' <- '{HOSTILE}'(_).", goals=f"memorize(x, [], _, '{HOSTILE}', 5)")
    shows(opened, "#events", HOSTILE)
    shows(opened, "#rules", HOSTILE)
    shows(opened, "#memories", HOSTILE)
    opened.wait_for("document.querySelector('#graph').textContent.includes('<img')")
    assert opened.ask("document.querySelectorAll('main img, main table b').length") == 0


def test_why_an_event_happened_is_shown_on_demand(opened, program):
    program.event("smoke(attic)", 6)
    program.event("heat(attic)", 7)
    shows(opened, "#events", "alarm(attic)")
    row = "[...document.querySelectorAll('#events tr')].find(one => one.innerText.includes('alarm(attic)'))"
    opened.ask(f"{row}.querySelector('button').click()")
    shows(opened, "#why", "by rule")
    assert "smoke(attic)" in text_of(opened, "#why")
    opened.ask("document.getElementById('why-close').click()")
    assert opened.ask("document.getElementById('why').hidden")


def test_a_query_is_answered(opened, program):
    program.call("assertz(room(hall))")
    ask = "document.getElementById('goal').value = {!r}; document.querySelector('#query button').click()"
    opened.ask(ask.format("room(X)"))
    shows(opened, "#answer", "X = hall")
    opened.ask(ask.format("room("))
    shows(opened, "#answer", "column")


def test_events_are_followed_only_while_that_is_wanted(opened, program):
    opened.ask("document.getElementById('follow').click()")
    opened.wait_for("!document.getElementById('follow').checked")
    seen = opened.ask("Number(document.body.dataset.looks)")
    opened.wait_for(f"Number(document.body.dataset.looks) > {seen} + 2")
    program.event("unseen(1)", 8)
    seen = opened.ask("Number(document.body.dataset.looks)")
    opened.wait_for(f"Number(document.body.dataset.looks) > {seen} + 2")
    assert "unseen" not in text_of(opened, "#events")


@pytest.mark.parametrize("width", [390, 320, 700, 1280])
def test_nothing_has_to_be_scrolled_to_the_side(opened, program, width):
    opened.resize(width, 800)
    program.event(f"long('{LONG}', [{LONG}])", 9)
    program.event(f"marker({LONG})", 9)
    program.load(rules=f"{LONG} <- {LONG}(_), {LONG}(2).") if width == 390 else None
    shows(opened, "#events", "long(")
    seen = opened.ask("Number(document.body.dataset.looks)")
    opened.wait_for(f"Number(document.body.dataset.looks) > {seen} + 1")
    assert opened.ask("document.documentElement.scrollWidth") <= width
    columns = opened.ask("getComputedStyle(document.querySelector('main')).gridTemplateColumns").split()
    assert len(columns) == (1 if width <= 600 else 2)


def test_page_shows_a_lost_node_and_reconnects(browser, program):
    with serving(program) as page:
        browser.open(page.url)
        browser.wait_for("Number(document.body?.dataset.looks) >= 1")
    state = "document.getElementById('state').innerText"
    browser.wait_for(f"{state} === 'the node does not answer'", allow_problems=True)
    with serving(program, port=page.port):
        browser.wait_for(f"{state} === 'live'", allow_problems=True)
    # The browser reports each failed attempt to connect.
    assert all(page.url in problem for problem in browser.take_problems())
