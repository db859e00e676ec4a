"""Strings of messages that are not ASCII: rules match them in each form of input."""

import json
import struct
from pathlib import Path
from typing import Any, List

import pytest

from retalis import BagReader, BagWriter, Definitions, Engine, StreamClock, Term
from retalis.cli.command_line import main
from retalis.dashboard.view_model import RecentEvents
from retalis.prolog.syntax.event_text import to_text

SECOND = 10**9
NOTE = "my_msgs/Note"
DEFINITIONS = Definitions()
DEFINITIONS.add(NOTE, "string text\nuint8[] raw\n")
RULES = """
met(Raw) <- my_msgs__0__Note('"Jürgen"', Raw).
hello(Text) <- my_msgs__0__Note(Text, '"bytes"').
"""
GOALS = """
memorize(met(Raw), [], met(Raw, '"Jürgen"'), memory, 10).
subscribe(met(_), [], my_msgs__0__Note('"Jürgen"', '"bytes"'), greeting, met).
subscribe(hello(Text), [], my_msgs__0__Note(Text, '"bytes"'), greeting, hello).
"""
LONG = "Grüße, 日本 🤖 'quoted' \"twice\" \\ \n" * 100


def message(text: str, raw: bytes = b"bytes") -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data + struct.pack("<I", len(raw)) + raw


def decode(data: bytes) -> Term:
    return DEFINITIONS.decoder(NOTE).decode(data)


def from_message(engine: Engine, data: Any) -> None:
    engine.post(decode(data))


def from_lazy_message(engine: Engine, data: Any) -> None:
    engine.post(DEFINITIONS.decoder(NOTE).lazy(data))


def from_text(engine: Any, data: Any) -> None:
    engine.post_text(f"event({to_text(decode(data))})")


def from_shown_text(engine: Engine, data: Any) -> None:
    engine.event(engine.show(decode(data)))


@pytest.mark.parametrize("feed", [from_message, from_lazy_message, from_text, from_shown_text])
@pytest.mark.parametrize("text", ["Jürgen", LONG], ids=["short", "long"])
def test_rule_matches_and_sends_unicode_text(feed: Any, text: str) -> None:
    engine = Engine(StreamClock(0))
    engine.load(rules=RULES, goals=GOALS)
    published: List[Any] = []
    encode = DEFINITIONS.encoder(NOTE).encode
    engine.on_output(lambda term, topic, name: published.append((engine.show(name), encode(term))))
    for _ in range(4):  # repeated texts are read and sent by faster paths
        feed(engine, message(text))
    expected = ["met", "hello"] if text == "Jürgen" else ["hello"]
    assert sorted(published) == sorted((name, message(text)) for name in expected * 4)


def test_strings_and_byte_arrays_differ() -> None:
    term = decode(message("Jürgen", "Jürgen".encode()))
    assert to_text(term) == "my_msgs__0__Note('\"Jürgen\"','\"FFFFFFFFFFSsO8cmdlbg==////\"')"
    assert DEFINITIONS.encoder(NOTE).encode(term) == message("Jürgen", "Jürgen".encode())


def test_snapshot_and_dashboard_have_unicode_text() -> None:
    engine = Engine(StreamClock(0))
    engine.load(rules=RULES, goals=GOALS)
    recent = RecentEvents(engine)
    recent.set_observing(True)
    engine.post(decode(message("Jürgen")), SECOND)
    assert "my_msgs__0__Note('\"Jürgen\"','\"bytes\"')" in [event.text for event in recent.take_latest()]
    restored = Engine.restore(engine.snapshot())
    assert restored.query("access_mem(memory, met(_, '\"Jürgen\"'), _)")
    restored.post(decode(message("Jürgen")), 2 * SECOND)
    assert len(restored.query("access_mem(memory, met(_, '\"Jürgen\"'), _)")) == 2


def test_bag_stores_unicode_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "eventRules.txt").write_text(RULES, encoding="utf-8")
    (program / "goalPredicates.txt").write_text(
        f"compile_event_file('eventRules.txt').\n{GOALS}", encoding="utf-8"
    )
    (program / "pub_sub.xml").write_text(
        f'<publish_subscribe><subscribe_to name="heard" msg_type="{NOTE}"/>'
        f'<publish_to name="greeting" msg_type="{NOTE}"/></publish_subscribe>'
    )
    with BagWriter(tmp_path / "in.bag") as bag:
        connection = bag.add("/heard", DEFINITIONS.find(NOTE))
        bag.write(connection, SECOND, message("Jürgen"))
        bag.write(connection, 2 * SECOND, message(LONG))
    out = str(tmp_path / "out.bag")
    options = ["--program", str(program), "--output", out, "--json", "--events"]
    assert main(["bag", str(tmp_path / "in.bag"), *options]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "met('\"bytes\"')" in [line.get("event") for line in lines]
    with BagReader(out) as bag:
        assert [record.data for record in bag.records()] == [
            message("Jürgen"),
            message("Jürgen"),
            message(LONG),
        ]
