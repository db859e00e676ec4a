"""The page on the two Prologs: its program does what the page says."""

import re
from pathlib import Path

import pytest

from retalis import Engine, Settings, UsageError
from retalis.prolog.swi.libswipl import find_library

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "how-to" / "swi-prolog.md"
FILES = dict(re.findall(r"<!-- (\S+) -->\n```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))


@pytest.fixture(params=["rules", "goals"])
def engine(request, tmp_path_factory):
    try:
        find_library()
    except UsageError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.getbasetemp() / "swi-page"
    folder.mkdir(exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    made = Engine(settings=Settings(allow_swi=True))
    asks = ":- use_swi('paths.pl').\n"
    if request.param == "rules":
        made.load_rules(FILES["rules.txt"], "rules.txt", folder)
    else:
        made.load(rules=FILES["rules.txt"].replace(asks, ""), goals="use_swi('paths.pl')", folder=folder)
    return made


def test_the_example(engine):
    said = []
    engine.on_event(lambda term, start, end: said.append(engine.show(term)))
    engine.event("wanted(nao, hall, cellar)", 1)
    engine.event("late(nao, 7)", 2)
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    for one in said:
        assert f"`{one}`" in text or f"`{one.replace(',', ', ')}`" in text
    assert len(said) == 4


def test_the_error_that_is_caught(engine):
    goal = re.search(r"`(catch\(reach.*?true\))`", PAGE.read_text(encoding="utf-8")).group(1)
    assert engine.query(goal) == []
