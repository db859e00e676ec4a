"""Page on SWI-Prolog: its program has the events and answers on the page."""

import re
from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import search

from retalis import Engine, Settings, UsageError
from retalis.prolog.swi.libswipl import find_library

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "how-to" / "swi-prolog.md"
FILES = dict(re.findall(r"<!-- (\S+) -->\n```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))


@pytest.fixture(params=["rules", "goals"])
def engine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Engine:
    try:
        find_library()
    except UsageError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.getbasetemp() / "swi-page"
    folder.mkdir(exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    engine = Engine(settings=Settings(allow_swi=True))
    directive = ":- use_swi('paths.pl').\n"
    if request.param == "rules":
        engine.load_rules(FILES["rules.txt"], "rules.txt", folder)
    else:
        engine.load(
            rules=FILES["rules.txt"].replace(directive, ""), goals="use_swi('paths.pl')", folder=folder
        )
    return engine


def test_example_emits_events_of_page(engine: Engine) -> None:
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("wanted(nao, hall, cellar)", 1)
    engine.event("late(nao, 7)", 2)
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    for event in events:
        assert f"`{event}`" in text or f"`{event.replace(',', ', ')}`" in text
    assert len(events) == 4


def test_caught_error_has_no_solution(engine: Engine) -> None:
    goal = search(r"`(catch\(reach.*?true\))`", PAGE.read_text(encoding="utf-8")).group(1)
    assert engine.query(goal) == []
