"""Every snippet in README and docs is run: what it shows is what happens."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from python_path import python_path

from retalis import Engine, Operators
from retalis.events.checks.check_runner import run_checks
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics
from retalis.prolog.syntax.term_reader import read_program
from retalis.prolog.terms import timestamps

pytestmark = pytest.mark.docs

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted(page for page in DOCS.rglob("*.md") if DOCS / "_build" not in page.parents),
]
SNIPPET = re.compile(r"(?:<!-- (?P<name>[\w.]+) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)```", re.DOTALL)
EVENT = re.compile(r"(\S.*?) \[([\d.]+),([\d.]+|datime\([^)]*\))\](?:, |$)")
UNTOLD = ("memory_created(", "null_event", "memory_updated(", "synchronized(")
"""Events of which a line below a rule does not tell: they are there with every memory and query."""

LINK = re.compile(r"\]\((?!https?:)([^)#]+)")
LINK_TO_HEADING = re.compile(r"\]\((?!https?:)([^)#]*)#([^)]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def snippets(page):
    return list(SNIPPET.finditer(page.read_text(encoding="utf-8")))


def test_the_readme_names_its_files_where_a_reader_sees_them():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = [found["name"] for found in snippets(ROOT / "README.md") if found["name"]]
    assert "fever.py" in named
    assert [name for name in named if name.endswith((".txt", ".py")) and f"`{name}`" not in text] == []


def test_the_example_of_the_readme_prints_what_it_says(tmp_path):
    files = {}
    for found in snippets(ROOT / "README.md"):
        if found["name"]:
            files[found["name"]] = found["text"]
            (tmp_path / found["name"]).write_text(found["text"], encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "fever.py"],
        cwd=tmp_path,
        env={"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.stderr == ""
    assert result.stdout == files["fever.out"]


MISTAKES = DOCS / "reference" / "errors.md"
"""The page whose rules have mistakes, see ``test_errors_page.py``."""


def prolog():
    for page in PAGES:
        if page == MISTAKES:
            continue
        for number, found in enumerate(snippets(page)):
            if found["kind"] == "prolog":
                yield pytest.param(found["text"], id=f"{page.relative_to(ROOT)}-{number}")


PARTS = (
    "unread-rules",
    "unpublished",
    "never-made",
    "never-taken",
    "memories",
    "undefined",
    "retracted",
    "unbounded-keys",
)
"""What is found in a part of a program because the rest of it is not there; the number of keys also depends on it."""


@pytest.mark.parametrize("text", list(prolog()))
def test_rules_and_goals_in_the_pages_load_and_check_has_nothing_to_say_of_them(text, definitions):
    engine = Engine()
    if text.startswith(("memorize(", "subscribe(")):
        engine.call_goals(text, "snippet")
    else:
        assert list(read_program(text, Operators.prolog(), "snippet"))
        engine.load(rules=text)
    found = run_checks(ProgramModel(engine.rules, engine.knowledge, definitions, Topics()))
    meant = (*PARTS, "waits-for-ever") if "unrestricted" in text else PARTS  # which is what it shows
    assert [str(one.problem) for one in found if one.check not in meant] == []


def claims():
    """Yield a snippet and a line of it that says which events it makes of others."""
    for page in PAGES:
        for found in snippets(page):
            for line in found["text"].splitlines():
                if found["kind"] == "prolog" and line.startswith("% ") and "=>" in line:
                    yield pytest.param(found["text"], line, id=re.sub(r"\W+", "_", line[:60]))


@pytest.mark.slow
@pytest.mark.parametrize("text, line", list(claims()))
def test_rules_make_the_events_that_the_pages_say(text, line):
    before, after = (part.strip() for part in line[2:].split("=>"))
    given, wanted = EVENT.findall(before), EVENT.findall(after)
    assert given and (wanted or after == "nothing")
    engine = Engine()
    seen = []
    engine.load(rules=text)
    by_clock = any(word in text for word in ("timer(", "state(", "aggregate(", "absent(", " with "))
    as_said = in_seconds if by_clock else shown  # so that people see the distances
    engine.on_event(lambda term, *interval: seen.append((engine.show(term), *map(as_said, interval))))
    for term, start, end in given:
        engine.clock.move_to(timestamps.from_seconds(float(end)))
        engine.event(term, *(float(stamp) if "." in stamp else int(stamp) for stamp in (start, end)))
    told = [event for event in seen if event not in given and not event[0].startswith(UNTOLD)]
    assert told == wanted


def shown(instant):
    return Engine().show(timestamps.to_term(instant))


def in_seconds(instant):
    return f"{instant / 10**9:g}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def heading_ids(page):
    """Return the anchors of a page's headings, as the site and repositories in browsers make them."""
    headings = HEADING.findall(page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_headings_lead_to_one(page):
    for target, heading in LINK_TO_HEADING.findall(page.read_text(encoding="utf-8")):
        assert heading in heading_ids(page.parent / target if target else page), f"{target}#{heading}"


@pytest.mark.slow
def test_commands_of_the_readme_are_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = [shlex.split(line, comments=True) for line in re.findall(r"^    (\S.*)$", text, re.MULTILINE)]
    known = {"./install.py", "source", "roslaunch", "rosservice", "rosrun", "python3", "pip", "retalis"}
    assert {command[0] for command in commands} <= known
    for command in commands:
        if command[0] == "./install.py":
            shown = subprocess.run(
                [sys.executable, str(ROOT / "install.py"), "--help"], capture_output=True, text=True
            )
            assert command[1] in shown.stdout
        elif command[0] in ("retalis", "rosrun"):
            words = command[1:] if command[0] == "retalis" else command[3:]
            module = subprocess.run(
                [sys.executable, "-m", "retalis", *words, "--help"],
                cwd=ROOT,
                env={"PYTHONPATH": python_path()},
                capture_output=True,
                timeout=60,
            )
            assert module.returncode == 0


def test_launch_arguments_that_the_readme_names_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    launch = ElementTree.parse(ROOT / "launch" / "retalis.launch")
    arguments = {arg.get("name") for arg in launch.iter("arg")}
    named = set(re.findall(r"`(\w+):=", text))
    assert named
    assert named <= arguments


NAMED_TEST = re.compile(r"`(?:test/)?([\w/]+\.(?:py|test))[ `]")


def test_the_tests_that_the_page_on_reliability_names_are_there():
    page = ROOT / "docs" / "explanation" / "reliability.md"
    named = set(NAMED_TEST.findall(page.read_text(encoding="utf-8")))
    there = {path.relative_to(ROOT / "test").as_posix() for path in (ROOT / "test").rglob("*.*")}
    missing = {name for name in named if not any(f"/{path}".endswith(f"/{name}") for path in there)}
    assert len(named) > 15
    assert not missing
