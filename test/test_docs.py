"""Snippets in the README and in ``docs``: each is run and compared with the shown output."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List, Set, Tuple
from xml.etree import ElementTree

import pytest
from asserting_accessors import stream_clock
from page_snippet_runner import run_commands
from subprocess_python_path import python_path

from retalis import Definitions, Engine, Operators
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
OMITTED_EVENTS = ("memory_created(", "null_event", "memory_updated(", "synchronized(")
"""Events that lines below a rule omit, because each memory and query emits them."""

LINK = re.compile(r"\]\((?!https?:)([^)#]+)")
LINK_TO_HEADING = re.compile(r"\]\((?!https?:)([^)#]*)#([^)]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def snippets(page: Path) -> List[Any]:
    return list(SNIPPET.finditer(page.read_text(encoding="utf-8")))


def test_readme_shows_names_of_its_files() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    names = [snippet["name"] for snippet in snippets(ROOT / "README.md") if snippet["name"]]
    assert "fever.py" in names
    assert [name for name in names if name.endswith((".txt", ".py")) and f"`{name}`" not in text] == []


def test_example_of_readme_has_shown_output(tmp_path: Path) -> None:
    files: Dict[Any, Any] = {}
    for snippet in snippets(ROOT / "README.md"):
        if snippet["name"]:
            files[snippet["name"]] = snippet["text"]
            (tmp_path / snippet["name"]).write_text(snippet["text"], encoding="utf-8")
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


def test_commands_of_readme_have_shown_output(tmp_path: Path) -> None:
    blocks = [snippet["text"] for snippet in snippets(ROOT / "README.md") if snippet["kind"] == "console"]
    assert blocks
    for block in blocks:
        assert run_commands(block, tmp_path) == block


MISTAKES = DOCS / "reference" / "errors.md"
"""The page whose rules have mistakes, see ``test_errors_page.py``."""


def prolog() -> Iterator[Any]:
    for page in PAGES:
        if page == MISTAKES:
            continue
        # The form of strings is that of the program on the page.
        strings = "plain" if 'strings="plain">' in page.read_text(encoding="utf-8") else "quoted"
        for number, snippet in enumerate(snippets(page)):
            if snippet["kind"] == "prolog":
                yield pytest.param(snippet["text"], strings, id=f"{page.relative_to(ROOT)}-{number}")


CHECKS_OF_WHOLE_PROGRAMS = (
    "unread-rules",
    "unpublished",
    "never-made",
    "never-taken",
    "memories",
    "undefined",
    "retracted",
    "unbounded-keys",
    "called-services",
)
"""Checks with findings in a part of a program without its other parts."""


@pytest.mark.parametrize(("text", "strings"), list(prolog()))
def test_rules_and_goals_load_without_findings(text: str, strings: str, definitions: Definitions) -> None:
    engine = Engine()
    if text.startswith(("memorize(", "subscribe(")):
        engine.call_goals(text, "snippet")
    else:
        assert list(read_program(text, Operators.prolog(), "snippet"))
        engine.load(rules=text)
    known_types = definitions.with_strings(strings)
    findings = run_checks(ProgramModel(engine.rules, engine.knowledge, known_types, Topics()))
    expected_checks: Tuple[str, ...] = CHECKS_OF_WHOLE_PROGRAMS
    if "unrestricted" in text:  # the page shows the finding
        expected_checks = (*expected_checks, "waits-for-ever")
    assert [str(finding.problem) for finding in findings if finding.check not in expected_checks] == []


def claims() -> Iterator[Any]:
    """Yield a snippet and a line of it with input events and emitted events."""
    for page in PAGES:
        for snippet in snippets(page):
            for line in snippet["text"].splitlines():
                if snippet["kind"] == "prolog" and line.startswith("% ") and "=>" in line:
                    yield pytest.param(snippet["text"], line, id=re.sub(r"\W+", "_", line[:60]))


@pytest.mark.slow
@pytest.mark.parametrize(("text", "line"), list(claims()))
def test_rules_emit_shown_events(text: Any, line: Any) -> None:
    before, after = (part.strip() for part in line[2:].split("=>"))
    inputs, expected = EVENT.findall(before), EVENT.findall(after)
    assert inputs
    assert expected or after == "nothing"
    engine = Engine()
    events: List[Any] = []
    engine.load(rules=text)
    by_clock = any(word in text for word in ("timer(", "state(", "aggregate(", "absent(", " with "))
    format_instant = format_seconds if by_clock else format_datime  # seconds show the distances
    engine.on_event(
        lambda term, *interval: events.append((engine.show(term), *map(format_instant, interval)))
    )
    for term, start, end in inputs:
        stream_clock(engine).move_to(timestamps.from_seconds(float(end)))
        engine.event(term, *(float(stamp) if "." in stamp else int(stamp) for stamp in (start, end)))
    emitted = [event for event in events if event not in inputs and not event[0].startswith(OMITTED_EVENTS)]
    assert emitted == expected


def format_datime(instant: Any) -> str:
    return Engine().show(timestamps.to_term(instant))


def format_seconds(instant: Any) -> str:
    return f"{instant / 10**9:g}"


def test_pages_have_links() -> None:
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    assert sum(len(LINK.findall(text)) for text in texts) > 300
    assert sum(len(LINK_TO_HEADING.findall(text)) for text in texts) > 30


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_targets_of_links_exist(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def heading_ids(page: Path) -> Set[Any]:
    """Return the anchors of the headings of a page, as the site and web pages of repositories define them."""
    headings = HEADING.findall(page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_headings_of_links_exist(page: Path) -> None:
    for target, heading in LINK_TO_HEADING.findall(page.read_text(encoding="utf-8")):
        assert heading in heading_ids(page.parent / target if target else page), f"{target}#{heading}"


@pytest.mark.slow
def test_commands_of_readme_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = [shlex.split(line, comments=True) for line in re.findall(r"^    (\S.*)$", text, re.MULTILINE)]
    programs = {
        "./install.py",
        "source",
        "roslaunch",
        "rosservice",
        "rosrun",
        "python3",
        "pip",
        "retalis",
        "colcon",
        "rosdep",
        "ros2",
    }
    assert {command[0] for command in commands} <= programs
    for command in commands:
        if command[0] == "./install.py":
            process = subprocess.run(
                [sys.executable, str(ROOT / "install.py"), "--help"], capture_output=True, text=True
            )
            assert command[1] in process.stdout
        elif command[0] in ("retalis", "rosrun"):
            words = command[1:] if command[0] == "retalis" else command[3:]
            help_process = subprocess.run(
                [sys.executable, "-m", "retalis", *words, "--help"],
                cwd=ROOT,
                env={"PYTHONPATH": python_path()},
                capture_output=True,
                timeout=60,
            )
            assert help_process.returncode == 0


def test_launch_arguments_of_readme_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    launch = ElementTree.parse(ROOT / "launch" / "retalis.launch")
    arguments = {arg.get("name") for arg in launch.iter("arg")}
    names = set(re.findall(r"`(\w+):=", text))
    assert names
    assert names <= arguments


NAMED_TEST = re.compile(r"`(?:test/)?([\w/]+\.(?:py|test))[ `]")


def test_tests_named_on_reliability_page_exist() -> None:
    page = ROOT / "docs" / "explanation" / "reliability.md"
    names = set(NAMED_TEST.findall(page.read_text(encoding="utf-8")))
    test_paths = {path.relative_to(ROOT / "test").as_posix() for path in (ROOT / "test").rglob("*.*")}
    missing = {name for name in names if not any(f"/{path}".endswith(f"/{name}") for path in test_paths)}
    assert len(names) > 15
    assert not missing
