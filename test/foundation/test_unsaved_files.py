"""Unsaved texts: preferred by the readers of files, by whatever name a file is read."""

from pathlib import Path

import pytest

from retalis import Engine, ProgramErrors
from retalis.events.program.topic_configuration import read_text, read_topics
from retalis.foundation.unsaved_files import unsaved_files, unsaved_text

TOPICS = '<publish_subscribe><subscribe_to name="t" msg_type="a/B"/></publish_subscribe>'


def test_text_replaces_file_until_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "rules.txt"
    path.write_text("saved")
    with unsaved_files({str(path): "unsaved"}):
        assert read_text(path) == "unsaved"
        with unsaved_files({}):
            assert read_text(path) == "saved"
        assert unsaved_text(path) == "unsaved"
    assert read_text(path) == "saved"
    assert unsaved_text(path) is None


def test_links_lead_to_text(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "rules.txt")
    with unsaved_files({str(tmp_path / "rules.txt"): "unsaved"}):
        assert unsaved_text(tmp_path / "link") == "unsaved"
        assert unsaved_text(tmp_path / "." / "rules.txt") == "unsaved"


def test_program_is_loaded_from_texts(tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (tmp_path / "eventRules.txt").write_text("a(1).\n")
    texts = {
        str(tmp_path / "eventRules.txt"): ":- include('more.txt').\na(2).\n",
        str(
            tmp_path / "pub_sub.xml"
        ): '<publish_subscribe><subscribe_to name="t" msg_type="a/B"/></publish_subscribe>',
    }
    (tmp_path / "more.txt").write_text("c(1).\n")
    with unsaved_files(texts):
        engine = Engine()
        engine.load_program(tmp_path)
        topics = read_topics(tmp_path / "pub_sub.xml")
    assert engine.query("c(X)")
    assert [engine.show(binding["X"]) for binding in engine.query("a(X)")] == ["2"]
    assert dict(topics.subscribed) == {"t": "a/B"}


def test_errors_have_places_in_text(tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("true\n")
    with unsaved_files({str(tmp_path / "goalPredicates.txt"): "true\nfail\n"}), pytest.raises(
        ProgramErrors
    ) as caught:
        Engine().load_program(tmp_path)
    assert [error.place.line for error in caught.value.errors if error.place] == [2]
