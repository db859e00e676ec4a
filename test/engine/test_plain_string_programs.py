"""Programs with plain strings: messages, outputs, checks, snapshots and reloads."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import fail

from retalis import (
    BagReader,
    BagWriter,
    Definitions,
    Engine,
    Playback,
    ProgramErrors,
    Settings,
    UsageError,
)
from retalis.engine.program_check import check_program
from retalis.events.program.topic_configuration import read_topics
from retalis.messages.message_dictionaries import make_message_term
from retalis.prolog.syntax.event_text import to_text

TOPICS = """
<publish_subscribe strings="{strings}">
  <subscribe_to name="names" msg_type="std_msgs/String"/>
  <publish_to name="greetings" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """
compile_event_file('eventRules.txt')
memorize(greeting(_), [], _, greetings, 5)
subscribe(greeting(Name), [], std_msgs__0__String(Name), greetings, g)
"""
PLAIN_RULES = "greeting(hello) <- std_msgs__0__String(anna).\n"
QUOTED_RULES = "greeting('\"hello\"') <- std_msgs__0__String('\"anna\"').\n"


def write_program(folder: Path, rules: str, strings: str) -> Path:
    (folder / "pub_sub.xml").write_text(TOPICS.format(strings=strings))
    (folder / "goalPredicates.txt").write_text(GOALS)
    (folder / "eventRules.txt").write_text(rules)
    return folder


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    definitions = Definitions()
    definition = definitions.find("std_msgs/String")
    message = make_message_term(definition, {"data": "anna"})
    path = tmp_path / "names.bag"
    with BagWriter(path) as writer:
        connection = writer.add("/names", definition)
        writer.write(connection, 10**9, definitions.encoder(definition).encode(message))
    return path


def outputs_of(playback: Playback, bag: Path) -> List[Any]:
    with BagReader(bag) as reader:
        return [to_text(output.term) for output in playback.run(reader)]


@pytest.mark.parametrize(
    ("strings", "rules", "expected"),
    [
        ("plain", PLAIN_RULES, "std_msgs__0__String(hello)"),
        ("quoted", QUOTED_RULES, "std_msgs__0__String('\"hello\"')"),
        ("plain", QUOTED_RULES, None),
        ("quoted", PLAIN_RULES, None),
    ],
)
def test_messages_have_form_of_program(
    tmp_path: Path, bag: Path, strings: str, rules: str, expected: Any
) -> None:
    playback = Playback(write_program(tmp_path, rules, strings), fail)
    assert outputs_of(playback, bag) == ([] if expected is None else [expected])


def test_published_bytes_have_no_quotes(tmp_path: Path, bag: Path) -> None:
    playback = Playback(write_program(tmp_path, PLAIN_RULES, "plain"), fail)
    with BagReader(bag) as reader:
        assert [output.data for output in playback.run(reader)] == [b"\5\0\0\0hello"]


@pytest.mark.parametrize(
    ("strings", "rules", "warnings"),
    [
        ("plain", PLAIN_RULES, []),
        ("quoted", QUOTED_RULES, []),
        (
            "plain",
            QUOTED_RULES,
            [
                "data of std_msgs/String is a text without quotes inside: write anna",
                "Name is a text ('\"hello\"' in line 1 of eventRules.txt) and goes into a plain text (data of "
                "std_msgs/String): write hello",
            ],
        ),
        (
            "quoted",
            PLAIN_RULES,
            ["data of std_msgs/String is a string, which keeps its quotes in events: write '\"anna\"'"],
        ),
        (
            "plain",
            "greeting(N) <- std_msgs__0__String(N) where N == '\"anna\"'.\n",
            ["N is a plain text (data of std_msgs/String): it has no quotes inside, write anna"],
        ),
        (
            "plain",
            'greeting(N) <- std_msgs__0__String(N) where N == "anna".\n',
            ["N is a plain text (data of std_msgs/String): it is an atom in events, write anna"],
        ),
        (
            "plain",
            "known('\"anna\"').\ngreeting(N) <- std_msgs__0__String(N) where known(N).\n",
            [
                "N is a plain text (data of std_msgs/String), and argument 1 of known/1 is a text ('\"anna\"' in "
                "line 1): these are never equal; write anna"
            ],
        ),
        (
            "plain",
            "known(anna).\nknown('\"ben\"').\ngreeting(N) <- std_msgs__0__String(N) where known(N).\n",
            ["N is a plain text (data of std_msgs/String), never '\"ben\"': write ben"],
        ),
        (
            "plain",
            "greeting(T) <- std_msgs__0__String(N) where format(atom(T), '\"~w!\"', [N]).\n",
            [
                "Name is a text ('\"~w!\"' in line 1 of eventRules.txt) and goes into a plain text (data of "
                "std_msgs/String): write '~w!'"
            ],
        ),
        (
            "plain",
            "greeting(hello) <- std_msgs__0__String(anna).\n"
            "greeting(T) <- std_msgs__0__String(N) where format(atom(T), '\"~w!\"', [N]).\n",
            ["Name is a plain text (data of std_msgs/String), never '\"~w!\"': write '~w!'"],
        ),
        (
            "quoted",
            "greeting(T) <- std_msgs__0__String(N) where format(atom(T), '\"~w!\"', [N]).\n",
            [],
        ),
    ],
)
def test_check_warns_of_other_form(tmp_path: Path, strings: str, rules: str, warnings: List[str]) -> None:
    findings = check_program(write_program(tmp_path, rules, strings), Definitions())
    assert [finding.problem.message for finding in findings] == warnings


@pytest.mark.parametrize(
    ("strings", "advice"),
    [
        ("plain", "data of std_msgs/String is a text without quotes inside: write anna"),
        ("quoted", "data of std_msgs/String is a string, which keeps its quotes in events: write '\"anna\"'"),
    ],
)
def test_file_alone_has_form_of_its_program(tmp_path: Path, strings: str, advice: str) -> None:
    folder = write_program(tmp_path, QUOTED_RULES, strings)
    (folder / "rules").mkdir()
    rules = folder / "rules" / "greeting.txt"
    text = "anna" if strings == "quoted" else "'\"anna\"'"
    rules.write_text(f"seen <- std_msgs__0__String({text}).\n")
    findings = check_program(rules, Definitions())
    assert [finding.problem.message for finding in findings if finding.problem.code == "RT1105"] == [advice]


def test_unknown_form_is_refused(tmp_path: Path) -> None:
    folder = write_program(tmp_path, PLAIN_RULES, "bare")
    with pytest.raises(ProgramErrors, match='strings is "quoted" or "plain", found "bare"'):
        read_topics(folder / "pub_sub.xml")


def test_misspelt_attribute_of_root_is_reported(tmp_path: Path) -> None:
    folder = write_program(tmp_path, QUOTED_RULES, "quoted")
    topics = folder / "pub_sub.xml"
    topics.write_text(topics.read_text().replace("strings=", "string="))
    (finding,) = check_program(folder, Definitions())
    assert finding.problem.message == "<publish_subscribe> has no attribute string; did you mean strings?"


def test_reload_with_other_form_is_refused(tmp_path: Path) -> None:
    engine = Engine()
    engine.load_program(write_program(tmp_path, PLAIN_RULES, "plain"))
    write_program(tmp_path, QUOTED_RULES, "quoted")
    with pytest.raises(
        UsageError, match='are "quoted" in pub_sub.xml, .* loaded with "plain": start it again'
    ):
        engine.reload(tmp_path)
    assert engine.strings == "plain"
    assert engine.rules.rules[0].definition.term is not None
    write_program(tmp_path, PLAIN_RULES.replace("hello", "hi"), "plain")
    assert engine.reload(tmp_path)[0].startswith("rules: 1 new")


def test_snapshot_keeps_form(tmp_path: Path) -> None:
    engine = Engine()
    engine.load_program(write_program(tmp_path, PLAIN_RULES, "plain"))
    restored = Engine.restore(engine.snapshot())
    assert restored.strings == "plain"
    write_program(tmp_path, QUOTED_RULES, "quoted")
    with pytest.raises(UsageError, match='loaded with "plain"'):
        restored.reload(tmp_path)


def test_state_of_other_form_is_refused(tmp_path: Path) -> None:
    state = Playback(write_program(tmp_path, QUOTED_RULES, "quoted"), fail).engine.snapshot()
    folder = write_program(tmp_path, PLAIN_RULES, "plain")
    with pytest.raises(UsageError, match='are "plain" in .*, but the state is of a program with "quoted"'):
        Playback(folder, fail, state=state)


def test_setting_applies_without_topics(tmp_path: Path) -> None:
    engine = Engine(settings=Settings(strings="plain"))
    engine.load(rules="greeting(M) <- hello where M = std_msgs__0__String{}.")
    assert engine.strings == "plain"
