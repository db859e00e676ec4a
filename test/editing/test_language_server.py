"""Language server: a client on its standard streams opens, edits and asks."""

import os
from pathlib import Path
from typing import Any, Iterator, List, Tuple

import pytest
from editing.editor_client import EditorClient

pytest.importorskip("pygls")
pytestmark = pytest.mark.slow

GOALS = "compile_event_file('eventRules.txt')\nmemorize(seen(X), [], seen(X), last_seen, 3)\n"
RULES = """\
seen(X) <- std_msgs__0__String(X).
near(X) <- (seen('"\U0001f916"') seq seen(X)) within 3.
print_trigger(near/1).
"""
TOPICS = '<publish_subscribe>\n  <subscribe_to name="t" msg_type="std_msgs/String"/>\n</publish_subscribe>\n'


@pytest.fixture(scope="module")
def editor() -> Iterator[EditorClient]:
    client = EditorClient()
    yield client
    assert client.stop() == 0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_program(tmp_path / "program")


def write_program(folder: Path) -> Path:
    folder.mkdir()
    for name, text in {"goalPredicates.txt": GOALS, "eventRules.txt": RULES, "pub_sub.xml": TOPICS}.items():
        (folder / name).write_text(text, encoding="utf-8")
    return Path(os.path.realpath(folder))


def places(locations: Any) -> List[Tuple[str, int, int, int]]:
    """Return name, line, first and last column of locations."""
    return [
        (
            location["uri"].rpartition("/")[2],
            location["range"]["start"]["line"],
            location["range"]["start"]["character"],
            location["range"]["end"]["character"],
        )
        for location in locations
    ]


def test_problems_follow_edits(editor: EditorClient, folder: Path) -> None:
    rules = folder / "eventRules.txt"
    editor.open(rules)
    editor.change(rules, RULES.replace("seq seen(X)", "seq sen(X)"))
    (problem,) = editor.problems(rules)
    # The robot before it takes two units of UTF-16.
    assert problem["range"] == {"start": {"line": 1, "character": 29}, "end": {"line": 1, "character": 32}}
    assert (problem["severity"], problem["code"], problem["source"]) == (2, "RT1201", "retalis")
    assert "did you mean seen/1?" in problem["message"]
    assert problem["codeDescription"]["href"].endswith("errors.md#rt1201-event-without-a-source")
    editor.change(rules, RULES)
    assert editor.problems(rules) == []
    editor.close(rules)


@pytest.mark.parametrize("separator", ["\f", "\v", "\x1c", "\x85", "\u2028"])
def test_separators_of_no_editor_end_no_line(editor: EditorClient, folder: Path, separator: str) -> None:
    """Only the ends of lines that editors know count, as in a file of Emacs with form feeds between its sections."""
    rules = folder / "eventRules.txt"
    text = f"% section{separator}of a file\n{RULES}"
    editor.open(rules, text)
    editor.change(rules, text.replace("seq seen(X)", "seq sen(X)"))
    (problem,) = editor.problems(rules)
    assert problem["range"]["start"] == {"line": 2, "character": 29}
    editor.change(rules, text)
    assert editor.problems(rules) == []
    uses = editor.at("textDocument/references", rules, 2, 29, context={"includeDeclaration": True})
    assert places(uses) == [
        ("goalPredicates.txt", 1, 9, 13),
        ("goalPredicates.txt", 1, 22, 26),
        ("eventRules.txt", 1, 0, 4),
        ("eventRules.txt", 2, 12, 16),
        ("eventRules.txt", 2, 29, 33),
    ]
    editor.close(rules)


@pytest.mark.parametrize(("encoding", "column"), [("utf-8", 31), ("utf-16", 29), ("utf-32", 28)])
def test_columns_are_units_of_encoding(folder: Path, encoding: str, column: int) -> None:
    editor = EditorClient(encoding=encoding)
    rules = folder / "eventRules.txt"
    # Characters of several units precede the position in its line and in the line before it.
    editor.open(rules, f"% \U0001f916 \xfc\n{RULES}")
    uses = editor.at("textDocument/references", rules, 2, column, context={"includeDeclaration": False})
    assert ("eventRules.txt", 2, column, column + 4) in places(uses)
    hovered = editor.at("textDocument/hover", rules, 1, 1)
    assert hovered["range"]["end"] == {"line": 1, "character": 4}
    assert editor.stop() == 0


def test_broken_file_keeps_server_working(editor: EditorClient, folder: Path) -> None:
    rules = folder / "eventRules.txt"
    editor.open(rules, f"{RULES}broken(X <- 'a\n")
    (problem,) = editor.problems(rules)
    assert (problem["severity"], problem["code"]) == (1, "RT1001")
    assert places(editor.at("textDocument/definition", rules, 1, 13)) == [("eventRules.txt", 0, 0, 4)]
    response = editor.response(
        "textDocument/formatting",
        textDocument={"uri": rules.as_uri()},
        options={"tabSize": 4, "insertSpaces": True},
    )
    assert "line 4" in response["error"]["message"]
    editor.change(rules, RULES)
    assert editor.problems(rules) == []
    editor.close(rules)


def test_problem_of_other_file_is_reported_there(editor: EditorClient, folder: Path) -> None:
    goals = folder / "goalPredicates.txt"
    editor.open(goals, f"{GOALS}fail\n")
    (problem,) = editor.problems(goals)
    assert problem["range"]["start"]["line"] == 2
    (folder / "eventRules.txt").write_text("a(\n", encoding="utf-8")
    editor.change(goals, GOALS)
    assert editor.problems(folder / "eventRules.txt")[0]["code"] == "RT1001"
    editor.close(goals)


def test_completion_and_hover(editor: EditorClient, folder: Path) -> None:
    rules = folder / "eventRules.txt"
    editor.open(rules)
    items = {item["label"]: item for item in editor.at("textDocument/completion", rules, 2, 0)}
    assert {"seen", "within", "std_msgs__0__String", "atom_length"} <= set(items)
    assert items["within"]["documentation"] == "`P within N`: P happened and took less than N seconds"
    hover = editor.at("textDocument/hover", rules, 1, 9)
    assert hover["contents"]["value"].startswith("`near(X)` is emitted when\n- ")
    assert editor.at("textDocument/hover", rules, 0, 5) is None
    editor.close(rules)


def test_definition_and_references(editor: EditorClient, folder: Path) -> None:
    rules = folder / "eventRules.txt"
    editor.open(rules)
    assert places(editor.at("textDocument/definition", rules, 1, 30)) == [("eventRules.txt", 0, 0, 4)]
    assert places(editor.at("textDocument/definition", rules, 0, 13)) == [("pub_sub.xml", 1, 35, 50)]
    context = {"includeDeclaration": False}
    assert places(editor.at("textDocument/references", rules, 0, 1, context=context)) == [
        ("goalPredicates.txt", 1, 9, 13),
        ("goalPredicates.txt", 1, 22, 26),
        ("eventRules.txt", 1, 12, 16),
        ("eventRules.txt", 1, 29, 33),
    ]
    assert editor.at("textDocument/definition", rules, 0, 5) == []
    editor.close(rules)


def test_rename(editor: EditorClient, folder: Path) -> None:
    rules = folder / "eventRules.txt"
    editor.open(rules)
    assert editor.at("textDocument/prepareRename", rules, 0, 1)["end"] == {"line": 0, "character": 4}
    changes = editor.at("textDocument/rename", rules, 0, 1, newName="spotted")["changes"]
    edits = {
        uri.rpartition("/")[2]: [edit["newText"] for edit in text_edits]
        for uri, text_edits in changes.items()
    }
    assert edits == {"eventRules.txt": ["spotted"] * 3, "goalPredicates.txt": ["spotted"] * 2}
    position = {"line": 0, "character": 13}
    response = editor.response(
        "textDocument/rename", textDocument={"uri": rules.as_uri()}, position=position, newName="x"
    )
    assert response["error"]["message"] == "cannot rename std_msgs__0__String/1: it is a message type"
    editor.close(rules)


def test_quote_completes_values_of_topics_only(editor: EditorClient, folder: Path) -> None:
    rules, topics = folder / "eventRules.txt", folder / "pub_sub.xml"
    text = '<publish_subscribe>\n<publish_to latch="'
    context = {"triggerKind": 2, "triggerCharacter": '"'}
    editor.open(topics, text)
    editor.open(rules)
    items = editor.at("textDocument/completion", topics, 1, 19, context=context)
    assert [(item["label"], item["detail"]) for item in items] == [("true", "latch"), ("false", "latch")]
    assert editor.at("textDocument/completion", rules, 2, 0, context=context) == []
    editor.close(topics)
    editor.close(rules)


def test_formatting(editor: EditorClient, folder: Path) -> None:
    rules = folder / "eventRules.txt"
    options = {"tabSize": 4, "insertSpaces": True}
    editor.open(rules, "a<-b.\n\n\n")
    document = {"uri": rules.as_uri()}
    (edit,) = editor.request("textDocument/formatting", textDocument=document, options=options)
    assert edit["newText"] == "a <- b.\n"
    assert edit["range"] == {"start": {"line": 0, "character": 0}, "end": {"line": 3, "character": 0}}
    editor.change(rules, "a <- b.\n")
    assert editor.request("textDocument/formatting", textDocument=document, options=options) == []
    editor.close(rules)


def test_only_program_of_file_is_checked(editor: EditorClient, tmp_path: Path) -> None:
    for number in range(50):
        other = write_program(tmp_path / f"program{number}")
        (other / "eventRules.txt").write_text("broken(\n", encoding="utf-8")
    rules = write_program(tmp_path / "good") / "eventRules.txt"
    editor.open(rules, f"{RULES}broken(\n")
    assert [problem["code"] for problem in editor.problems(rules)] == ["RT1001"]
    # The answer to a request follows all notifications that were sent before.
    editor.at("textDocument/hover", rules, 0, 0)
    checked = {
        Path(message["params"]["uri"]).parent.name
        for message in editor.notifications
        if message.get("method") == "textDocument/publishDiagnostics"
    }
    # The server also has a program of the module.
    assert not checked.intersection(f"program{number}" for number in range(50))
    editor.close(rules)


def test_output_of_goals_does_not_reach_client(editor: EditorClient, folder: Path) -> None:
    goals = folder / "goalPredicates.txt"
    editor.open(goals, f"write(hello), nl\n{GOALS}fail\n")
    assert [problem["range"]["start"]["line"] for problem in editor.problems(goals)] == [3]
    editor.close(goals)


def test_goal_that_does_not_end_is_stopped(tmp_path: Path) -> None:
    goals = write_program(tmp_path / "program") / "goalPredicates.txt"
    editor = EditorClient("--max-seconds", "0.2")
    editor.open(goals, f"{GOALS}repeat, fail\n")
    (problem,) = editor.problems(goals)
    assert problem["range"]["start"]["line"] == 2
    assert editor.stop() == 0
