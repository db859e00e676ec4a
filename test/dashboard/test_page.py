"""Page of the dashboard in a browser: tables, graph and forms, compared with the state of the engine."""

import re
import threading
from itertools import combinations
from typing import Any, Iterator

import pytest

pytest.importorskip("tornado", reason="tornado is not installed")

from dashboard_client import TIMEOUT_SECONDS, engine, serving  # noqa: E402

from retalis import foreign  # noqa: E402
from retalis.dashboard.view_model import TopicRow  # noqa: E402
from retalis.engine.engine_status import DEFAULT_LISTING_LIMIT  # noqa: E402
from retalis.visualization.program_graph import NODE_STYLES, GraphTopic, program_graph  # noqa: E402

pytestmark = pytest.mark.slow

HOSTILE = "<img src=x onerror=alert(1)><b>bold</b>"
LONG = "a" * 150
TOPICS = (
    TopicRow("/smoke", "house/Smoke", 7000, 1, 3, 0.5, 0.01),
    TopicRow("/heat", "house/Heat", publishers=0, event="heat"),
    TopicRow(f"/{LONG}", "house/Other"),
)
GRAPH_TOPICS = [GraphTopic(topic.name, topic.event_name) for topic in TOPICS]

IS_OPEN = "Number(document.body?.dataset.looks) >= 2"
ROWS = """
    Object.fromEntries([...document.querySelectorAll("#{table} tbody tr")].map((row) =>
      [row.cells[0].firstChild.textContent, [...row.cells].slice(1).map((cell) => cell.innerText.trim())]))
"""
"""Expression for the rows of a table: the texts of the further cells by the text of the first one."""

RULE_ROWS = """
    [...document.querySelectorAll("#rules tbody tr")].map((row) => Object.fromEntries(
      [...document.querySelectorAll("#rules th")].map((heading, column) =>
        [heading.innerText, row.cells[column].innerText])))
"""
"""Expression for the rows of the table of rules: the texts of the cells by the heading of their column."""

TILES = """
    Object.fromEntries([...document.querySelectorAll("#tiles .tile")].map((tile) =>
      [tile.children[1].textContent, tile.children[0].textContent]))
"""
NODES = """
    [...document.querySelectorAll("#graph g")].map((group) =>
      [group.querySelector("rect").className.baseVal.replace("k-", ""), group.querySelector("title").textContent])
"""
"""Expression for the kind and the title of each node of the graph."""

EDGES = """[...document.querySelectorAll("#graph path.edge")].map((edge) => edge.classList[1])"""
KIND_COLOURS = """
    Object.fromEntries([...document.querySelectorAll("#legend i")].map((sample) =>
      [sample.className.replace("k-", ""), getComputedStyle(sample).backgroundColor]))
"""


@pytest.fixture
def program() -> Any:
    return engine()


@pytest.fixture
def page(browser: Any, program: Any) -> Iterator[Any]:
    """Open the page of the program, and wait until it shows numbers; return the browser."""
    with serving(program, topics=lambda: TOPICS, allows_queries=True) as dashboard:
        browser.open(dashboard.url)
        browser.wait_for(IS_OPEN)
        yield browser


def text_of(browser: Any, selector: str) -> Any:
    return browser.ask(f"document.querySelector('{selector}').innerText")


def wait_for_text(browser: Any, selector: str, text: str) -> None:
    """Wait until an element has a text."""
    browser.wait_for(f"document.querySelector('{selector}').innerText.includes({text!r})")


def wait_for_update(browser: Any, count: int = 2) -> None:
    """Wait for further snapshots."""
    snapshots = browser.ask("Number(document.body.dataset.looks)")
    browser.wait_for(f"Number(document.body.dataset.looks) >= {snapshots + count}")


def rows_of(browser: Any, table: str) -> Any:
    return browser.ask(ROWS.format(table=table))


def test_tiles_show_counters_of_engine(page: Any, program: Any) -> None:
    program.event("smoke(hall)", 1)
    program.event("heat(hall)", 2)
    program.event("marker(7)", 3)
    program.load(rules="broken(X) <- number(X) where X > a.")
    program.event("number(1)", 4)
    wait_for_update(page)
    status, tiles = program.status(), page.ask(TILES)
    assert text_of(page, "#title") == "/retalis"
    assert text_of(page, "#state") == "live"
    assert status.errors == 1
    assert {name: tiles[name] for name in ("in the queue", "dropped", "errors", "partial matches")} == {
        "in the queue": str(status.queued),
        "dropped": str(status.dropped),
        "errors": str(status.errors),
        "partial matches": str(status.matches),
    }
    assert tiles["waiting queries"] == str(len(status.waiting)) == "1"
    assert int(tiles["MB of memory"].replace(",", "")) > 0


def test_rates_follow_events(page: Any, program: Any) -> None:
    for second in range(1, 60):
        program.event("smoke(hall)", second)
    page.wait_for(f"parseFloat(({TILES})['events in /s']) > 0")
    page.wait_for(f"parseFloat(({ROWS.format(table='memories')}).fires[3]) > 0")
    page.wait_for("document.querySelectorAll('#graph path.edge.on').length > 0")


def test_topics_show_counters_ages_and_lags(page: Any, program: Any) -> None:
    program.event("heat(hall)", 2)
    wait_for_update(page)
    rows = rows_of(page, "topics")
    assert list(rows) == [topic.name for topic in TOPICS]
    assert rows["/smoke"][1:] == ["500 ms", "10 ms", "3"]
    assert rows["/heat"][1:] == ["0 s", "–", "–"]
    assert "house/Heat, no publisher" in text_of(page, "#topics")


def test_memories_show_their_records(page: Any, program: Any) -> None:
    for second in (1, 2, 4):
        program.event("smoke(hall)", second)
    wait_for_update(page)
    (memory,) = program.status().memories
    records, span, newest, _ = rows_of(page, "memories")["fires"]
    assert records == f"{memory.records} / {memory.size}" == "3 / 10"
    assert (span, newest) == ("3.00 s", "0 s ago")
    assert memory.event in text_of(page, "#memories")
    bar = "document.querySelector('#memories .bar i').style.width"
    assert page.ask(bar) == "30%"


def test_subscriptions_show_sent_outputs(page: Any, program: Any) -> None:
    program.event("smoke(hall)", 1)
    program.event("heat(hall)", 2)
    wait_for_update(page)
    (subscription,) = program.status().subscriptions
    assert rows_of(page, "subscriptions") == {
        "alarms": [subscription.id, subscription.event, str(subscription.sent)]
    }
    assert subscription.sent == 1


def test_waiting_queries_show_their_memories(page: Any, program: Any) -> None:
    program.event("marker(7)", 3)
    wait_for_text(page, "#waiting", "fires: empty so far")
    program.event("smoke(hall)", 4)
    wait_for_text(page, "#waiting", "fires: 96 s behind")
    assert "seen(7)" in text_of(page, "#waiting")


def test_rules_show_their_counters(page: Any, program: Any) -> None:
    program.load(rules="hot : warm(X) <- heat(X) where X > 1.", source="rules.txt")
    program.event("smoke(hall)", 1)
    program.event("heat(2)", 2)
    program.event("heat(hall)", 3)
    wait_for_update(page)
    rules = program.status().rules
    rows = page.ask(RULE_ROWS)
    assert [row["fired"] for row in rows] == [str(rule.fired) for rule in rules] == ["1", "0", "1"]
    assert [row["errors"] for row in rows] == [str(rule.errors) for rule in rules] == ["0", "0", "1"]
    assert [row["items"] for row in rows] == [str(rule.waiting) for rule in rules]
    assert [row["keys"] for row in rows] == [str(rule.keys) for rule in rules]
    titles = ["alarm(X) (text:1)", "seen(X) (text:1)", "hot (rules.txt:1)"]
    assert all(row["rule"].startswith(title) for row, title in zip(rows, titles))
    assert rows[2]["last"] == "1.00 s ago"
    for rule in rules:
        assert rule.text in text_of(page, "#rules")


def test_graph_names_rules_by_name_and_line(page: Any, program: Any) -> None:
    program.load(
        rules="\nfire(Room) <- smoke(Room).\na_rule_with_a_long_name(X) <- heat(X).", source="/p/rules.txt"
    )
    page.wait_for("document.querySelectorAll('#graph rect.k-rule').length === 4")
    nodes = "[...document.querySelectorAll('#graph rect.k-rule')].map(rect => rect.parentElement.textContent)"
    texts = sorted(page.ask(nodes))
    assert texts[0] == (
        "a_rule_with_a_long_name(X) (rules.txt:3)\na_rule_with_a_long_name(X) <- heat(X)a_rule_with_a… :3"
    )
    assert texts[2] == "fire(Room) (rules.txt:2)\nfire(Room) <- smoke(Room)fire(Room) :2"


def test_items_beyond_limit_are_counted(page: Any, program: Any) -> None:
    rules = "".join(f"a{number} <- b{number}. " for number in range(DEFAULT_LISTING_LIMIT))
    goals = "".join(
        f"memorize(c{number}, [], _, m{number}, 5)\n" for number in range(DEFAULT_LISTING_LIMIT + 1)
    )
    program.load(rules=rules, goals=goals)
    wait_for_text(page, "#rules", "and 2 more")
    wait_for_text(page, "#memories", "and 2 more")


def test_running_goal_is_shown(page: Any, program: Any) -> None:
    released = threading.Event()

    @foreign
    def spin() -> bool:
        return released.wait(TIMEOUT_SECONDS)

    program.add_foreign(spin)
    program.load(rules="null_event do spin <- start.")
    thread = threading.Thread(target=program.event, args=("start", 1))
    thread.start()
    try:
        page.wait_for("!document.getElementById('busy').hidden")
        text = text_of(page, "#busy")
    finally:
        released.set()
        thread.join()
    assert re.fullmatch(
        r"Busy for \d+\.\d+ s with start: rule do spin: goal spin, for event start, at text:1:1", text
    )
    page.wait_for("document.getElementById('busy').hidden")


def test_state_of_forwarding_is_shown(browser: Any, page: Any) -> None:
    assert page.ask("document.getElementById('forwarding').hidden")
    with serving(forwarding=lambda: "connected for 5 s") as dashboard:
        browser.open(dashboard.url)
        browser.wait_for(IS_OPEN)
        wait_for_text(browser, "#forwarding", "Forwarding: connected for 5 s")


def test_graph_shows_nodes_and_edges_of_program(page: Any, program: Any) -> None:
    program.load(rules="quiet(X) <- (smoke(X) seq heat(X)) cnot known(X) where owner(X). owner(hall).")
    graph = program_graph(program, GRAPH_TOPICS)
    page.wait_for(f"document.querySelectorAll('#graph g').length === {len(graph.nodes)}")
    expected = [
        [node.kind, f"{node.label}\n{node.text}" if node.kind == "rule" else node.text]
        for node in graph.nodes
    ]
    assert sorted(page.ask(NODES)) == sorted(expected)
    assert sorted(page.ask(EDGES)) == sorted(edge.kind for edge in graph.edges)
    assert {edge.kind for edge in graph.edges} == {"flow", "absent", "reads"}


@pytest.mark.parametrize("dark", [False, True])
def test_node_kinds_have_distinct_colours(page: Any, program: Any, dark: bool) -> None:
    program.load(rules="a <- b where c, tf_missing(d, e, 0, _). c.")
    page.set_dark(dark)
    page.wait_for(f"document.querySelectorAll('#legend span').length === {len(NODE_STYLES)}")
    colours = page.ask(KIND_COLOURS)
    assert list(colours) == list(NODE_STYLES)
    components = {kind: list(map(int, re.findall(r"\d+", colour))) for kind, colour in colours.items()}
    for first, second in combinations(components.values(), 2):
        assert sum(abs(a - b) for a, b in zip(first, second)) >= 20
    texts = page.ask("[...document.querySelectorAll('#legend span')].map((entry) => entry.textContent)")
    assert texts == [style.legend for style in NODE_STYLES.values()]


def test_wide_graph_has_hint_to_scroll(page: Any, program: Any) -> None:
    hint = "document.getElementById('graph-scroll').hidden"
    program.load(rules=" ".join(f"stage{number + 1} <- stage{number}." for number in range(9)))
    page.wait_for(f"!{hint}")
    graph = "document.getElementById('graph')"
    assert page.ask(f"{graph}.className") == "scroll after"
    page.ask(f"{graph}.scrollLeft = 100")
    page.wait_for(f"{graph}.className === 'scroll after before'")
    page.ask(f"{graph}.scrollLeft = {graph}.scrollWidth")
    page.wait_for(f"{graph}.className === 'scroll before'")


def test_small_graph_has_no_hint_to_scroll(page: Any) -> None:
    page.resize(1600, 900)
    page.wait_for("document.getElementById('graph-scroll').hidden")
    assert page.ask("document.getElementById('graph').className") == "scroll"


def test_texts_of_program_are_not_markup(page: Any, program: Any) -> None:
    program.event(f"speech('{HOSTILE}')", 5)
    program.load(rules=f"'{HOSTILE}' <- '{HOSTILE}'(_).", goals=f"memorize(x, [], _, '{HOSTILE}', 5)")
    for part in ("#events", "#rules", "#memories"):
        wait_for_text(page, part, HOSTILE)
    page.wait_for("document.querySelector('#graph').textContent.includes('<img')")
    assert page.ask("document.querySelectorAll('main img, main table b').length") == 0


def test_events_are_listed_and_filtered(page: Any, program: Any) -> None:
    program.event("smoke(hall, 1.23456789)", 1)
    program.event("heat(attic)", 2)
    wait_for_text(page, "#events", "smoke(hall,1.234)")
    page.ask("document.querySelectorAll('#events td.clamp')[1].click()")
    wait_for_text(page, "#events", "smoke(hall,1.23456789)")
    page.ask("document.querySelectorAll('#events td.clamp')[1].click()")
    wait_for_text(page, "#events", "smoke(hall,1.234)")
    page.ask("document.getElementById('filter').value = 'attic'")
    page.ask("document.getElementById('filter').dispatchEvent(new Event('input'))")
    assert page.ask("document.querySelectorAll('#events tbody tr').length") == 1


def test_event_is_explained_on_request(page: Any, program: Any) -> None:
    program.event("smoke(attic)", 6)
    program.event("heat(attic)", 7)
    wait_for_text(page, "#events", "alarm(attic)")
    row = "[...document.querySelectorAll('#events tr')].find((row) => row.innerText.includes('alarm(attic)'))"
    page.ask(f"{row}.querySelector('button').click()")
    wait_for_text(page, "#why", "by rule")
    assert "smoke(attic)" in text_of(page, "#why")
    page.ask("document.getElementById('why-close').click()")
    assert page.ask("document.getElementById('why').hidden")


@pytest.mark.parametrize(
    ("goal", "answer"),
    [
        ("room(X)", "X = hall\n\nX = attic"),
        ("room(hall)", "true"),
        ("room(cellar)", "false"),
        ("room(", "column"),
        ("repeat", "... there may be more"),
    ],
)
def test_query_is_answered(page: Any, program: Any, goal: str, answer: str) -> None:
    program.call("assertz(room(hall)), assertz(room(attic))")
    page.ask(f"document.getElementById('goal').value = {goal!r}")
    page.ask("document.querySelector('#query button').click()")
    wait_for_text(page, "#answer", answer)


def test_query_form_is_hidden_if_not_allowed(browser: Any, program: Any) -> None:
    with serving(program) as dashboard:
        browser.open(dashboard.url)
        browser.wait_for(IS_OPEN)
        assert browser.ask("document.getElementById('asking').hidden")


def test_events_are_observed_only_on_request(page: Any, program: Any) -> None:
    program.event("seen_before(1)", 7)
    page.wait_for("document.getElementById('events').textContent.includes('seen_before')")
    page.ask("document.getElementById('follow').click()")
    page.wait_for("!document.getElementById('follow').checked")
    wait_for_update(page, 3)
    program.event("unseen(1)", 8)
    wait_for_update(page, 3)
    assert "unseen" not in text_of(page, "#events")


@pytest.mark.parametrize("width", [320, 390, 700, 1280])
def test_page_is_not_wider_than_screen(page: Any, program: Any, width: int) -> None:
    page.resize(width, 800)
    program.event(f"long('{LONG}', [{LONG}])", 9)
    program.event(f"marker({LONG})", 9)
    program.load(rules=f"{LONG} <- {LONG}(_), {LONG}(2).")
    wait_for_text(page, "#events", "long(")
    wait_for_update(page)
    assert page.ask("document.documentElement.scrollWidth") <= width
    columns = page.ask("getComputedStyle(document.querySelector('main')).gridTemplateColumns").split()
    assert len(columns) == (1 if width <= 600 else 2)


def test_page_shows_lost_node_and_reconnects(browser: Any, program: Any) -> None:
    with serving(program) as dashboard:
        browser.open(dashboard.url)
        browser.wait_for(IS_OPEN)
    state = "document.getElementById('state').innerText"
    browser.wait_for(f"{state} === 'the node does not answer'", allow_problems=True)
    with serving(program, port=dashboard.port):
        browser.wait_for(f"{state} === 'live'", allow_problems=True)
    # The browser may report failed attempts to connect, but nothing else.
    assert all(dashboard.url in problem for problem in browser.take_problems())
