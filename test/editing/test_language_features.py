"""Language features: problems, hover, completion and renaming, without a protocol."""

import os
from pathlib import Path
from typing import Any, Dict, List

import pytest

from retalis import Definitions, ProgramErrors, UsageError
from retalis.editing.language_features import (
    PredicateHelp,
    check_renamable,
    complete,
    find_problems,
    format_file,
    hover,
    rename,
)
from retalis.editing.program_index import ProgramIndex, ProgramIndexes
from retalis.engine.engine_settings import Settings

GOALS = "compile_event_file('eventRules.txt')\nmemorize(seen(X, _), [], seen(X), last_seen, 3)\n"
RULES = """\
seen(X, 1) <- std_msgs__0__String(X).
near(X) <- (seen(X, _) seq bump{data: true}) within 3.
where_is(X) :- prev(last_seen, seen(X), _, _, 3).
print_trigger(near/1).
"""
TOPICS = """\
<publish_subscribe>
  <subscribe_to name="texts" msg_type="std_msgs/String"/>
  <subscribe_to name="bumper" msg_type="std_msgs/Bool" event="bump"/>
</publish_subscribe>
"""
PREDICATES = {
    "prev": [PredicateHelp("prev(+Id, ?Record, -T1, -T2, +T)", "The last record.", "docs/memories.md")]
}
DEFINITIONS = Definitions()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in {"goalPredicates.txt": GOALS, "eventRules.txt": RULES, "pub_sub.xml": TOPICS}.items():
        (tmp_path / name).write_text(text)
    return Path(os.path.realpath(tmp_path))


def index_of(folder: Path, name: str = "eventRules.txt") -> ProgramIndex:
    return ProgramIndexes().find(str(folder / name), {})


def problems_of(folder: Path, texts: Dict[str, str], folder_or_file: str = "") -> Any:
    unsaved_texts = {str(folder / name): text for name, text in texts.items()}
    problems = find_problems(str(folder / folder_or_file), unsaved_texts, DEFINITIONS, Settings())
    return {os.path.relpath(path, folder): file_problems for path, file_problems in problems.items()}


def test_program_without_mistakes_has_no_problems(folder: Path) -> None:
    assert problems_of(folder, {}) == {}


def test_problems_of_unsaved_texts_are_in_their_files(folder: Path) -> None:
    texts = {
        "eventRules.txt": RULES.replace("(seen(X, _)", "(sen(X, _)"),
        "pub_sub.xml": TOPICS.replace('"std_msgs/Bool"', '"std_msgs"'),
        "goalPredicates.txt": f"{GOALS}fail\n",
    }
    assert sorted(problems_of(folder, texts)) == ["goalPredicates.txt", "pub_sub.xml"]
    (problem,) = problems_of(folder, {"eventRules.txt": texts["eventRules.txt"]})["eventRules.txt"]
    assert (problem.line, problem.column, problem.end_column) == (1, 12, 15)
    assert (problem.severity, problem.code) == ("warning", "RT1201")
    assert "did you mean seen/2?" in problem.message


def test_syntax_error_is_problem(folder: Path) -> None:
    (problem,) = problems_of(folder, {"eventRules.txt": "a(1).\nb <- c(.\n"})["eventRules.txt"]
    assert (problem.line, problem.column, problem.code, problem.severity) == (1, 7, "RT1001", "error")


def test_problem_without_place_is_that_of_folder(folder: Path) -> None:
    (folder / "goalPredicates.txt").unlink()
    assert list(problems_of(folder, {})) == ["."]


def test_single_file_is_checked(folder: Path) -> None:
    (folder / "alone.txt").write_text("x <- y(Z).\nprint_trigger(x).\n")
    assert [problem.code for problem in problems_of(folder, {}, "alone.txt")["alone.txt"]] == ["RT1406"]


def text_at(folder: Path, name: str, text: str, offset: int = 0) -> str:
    index = index_of(folder, name)
    position = index.files[str(folder / name)].text.index(text) + offset
    hovered = hover(str(folder / name), position, index, DEFINITIONS, PREDICATES)
    return "" if hovered is None else hovered.text


def test_hover_shows_rules_of_event(folder: Path) -> None:
    text = text_at(folder, "goalPredicates.txt", "seen(X, _)")
    assert "eventRules.txt, line 1\n```prolog\nseen(X, 1) <- std_msgs__0__String(X).\n```" in text
    assert "`seen(X, 1)` is emitted when\n- `std_msgs__0__String(X)` happened" in text


def test_hover_shows_definition_of_message_type(folder: Path) -> None:
    assert "```prolog\nstd_msgs__0__String{" in text_at(folder, "eventRules.txt", "std_msgs__0__String")
    for name, text in (("eventRules.txt", "bump{"), ("pub_sub.xml", 'bump"')):
        assert "```prolog\nstd_msgs__0__Bool{" in text_at(folder, name, text)


def test_hover_shows_memory_operator_and_reading(folder: Path) -> None:
    assert "memorize(seen(X, _)" in text_at(folder, "eventRules.txt", "last_seen")
    assert (
        text_at(folder, "eventRules.txt", "within", 3)
        == "`P within N`: P happened and took less than N seconds"
    )
    assert text_at(folder, "eventRules.txt", "<- (seen").startswith("`near(X)` is emitted when\n- ")


def test_hover_shows_built_in_predicate(folder: Path) -> None:
    (entry,) = PREDICATES["prev"]
    expected = f"`{entry.call}`\n\n{entry.meaning}\n\n{entry.page}"
    assert text_at(folder, "eventRules.txt", "prev") == expected


def test_no_hover_at_variable(folder: Path) -> None:
    assert text_at(folder, "eventRules.txt", "X, 1)") == ""
    assert hover(str(folder / "none.txt"), 0, index_of(folder), DEFINITIONS, PREDICATES) is None


def completions(folder: Path, addition: str, name: str = "eventRules.txt") -> Dict[str, str]:
    text = (folder / name).read_text() + addition
    path = str(folder / name)
    names = complete(path, text, len(text), index_of(folder, name), DEFINITIONS, PREDICATES)
    return {completion.name: completion.kind for completion in names}


def test_names_of_all_kinds_are_completed(folder: Path) -> None:
    kinds = completions(folder, "new(Thing) <- s")
    assert kinds["Thing"] == "variable"
    assert kinds["seen"] == "event"
    assert kinds["std_msgs__0__Bool"] == "message"
    assert kinds["within"] == "operator"
    assert kinds["prev"] == "predicate"
    assert "not" not in kinds


def test_slots_of_nested_messages_are_completed(folder: Path) -> None:
    assert completions(folder, "x <- bump{") == {"data": "slot"}
    assert list(completions(folder, "x <- geometry_msgs__0__PoseStamped{header: {seq: 1, ")) == [
        "stamp",
        "frame_id",
    ]
    assert completions(folder, "x <- unknown{") == {}


def test_constants_of_messages_are_completed(folder: Path) -> None:
    message = "diagnostic_msgs__0__DiagnosticStatus{"
    levels = dict.fromkeys(["OK", "WARN", "ERROR", "STALE"], "constant")
    slots = dict.fromkeys(["level", "name", "message", "hardware_id", "values"], "slot")
    assert completions(folder, f"x(Y) <- {message}") == {**slots, **levels}
    assert completions(folder, f"x(Y) <- {message}level: {{") == levels
    assert completions(folder, "x <- diagnostic_msgs__0__DiagnosticArray{status: [{level: {") == levels
    assert "level" not in completions(folder, f"x <- {message}level: 1, ")


def test_hover_shows_value_of_constant(folder: Path) -> None:
    message = "diagnostic_msgs__0__DiagnosticStatus"
    rules = f"x <- {message}{{level: {{ERROR}}}}.\ny({message}{{WARN}}).\n"
    (folder / "eventRules.txt").write_text(rules)
    assert text_at(folder, "eventRules.txt", "ERROR") == "`byte ERROR=2`"
    assert text_at(folder, "eventRules.txt", "WARN") == "`byte WARN=1`"


@pytest.mark.parametrize(
    ("window", "names"),
    [
        ("", ["last", "every", "running", "session", "held", "steps", "timed_out"]),
        ("se", ["last", "every", "running", "session", "held", "steps", "timed_out"]),
        ("last(5, ", ["events", "every"]),
        ("every(5, ", ["first", "events"]),
        ("running(", ["every"]),
        ("session(5, ", ["max"]),
        ("held(", ["last", "every"]),
        ("held(last(5, ", ["every"]),
        ("running(every(5, ", ["first", "events"]),
        ("held(every(5), ", ["max"]),
        ("timed_out(", ["steps"]),
    ],
)
def test_windows_are_completed(folder: Path, window: str, names: List[str]) -> None:
    kinds = completions(folder, f"x(N) <- aggregate([count, avg(Y)], seen(Y), N, {window}")
    assert kinds == dict.fromkeys(names, "operator")


@pytest.mark.parametrize(
    "text",
    [
        "x(N) <- aggregate(",
        "x(N) <- aggregate(count, ",
        "x(N) <- aggregate(count, seen(",
        "x(N) <- aggregate(count, seen(Y), N, last(",
        "x(N) <- aggregate(count, seen(Y), N, steps([low where last(low, ",
        "x(N) <- aggregate(count, seen(Y), N, last(5)) where ",
        "x :- last(5, ",
    ],
)
def test_no_windows_are_completed_elsewhere(folder: Path, text: str) -> None:
    kinds = completions(folder, text)
    assert kinds["within"] == "operator"
    assert not {"last", "session", "events"} & set(kinds)


def test_memories_are_completed(folder: Path) -> None:
    assert completions(folder, "x :- prev(") == {"last_seen": "memory"}


def test_goals_are_completed_without_operators(folder: Path) -> None:
    kinds = completions(folder, "subscribe(se", "goalPredicates.txt")
    assert kinds["seen"] == "event"
    assert "within" not in kinds


def test_no_completion_in_comments_and_topics(folder: Path) -> None:
    assert completions(folder, "% se") == {}
    assert completions(folder, "<!-- <", "pub_sub.xml") == {}


@pytest.mark.parametrize(
    ("addition", "expected"),
    [
        ("<", ["subscribe_to", "publish_to", "observe_action", "observe_service"]),
        ("<obs", ["subscribe_to", "publish_to", "observe_action", "observe_service"]),
        ("<observe_service ", ["name", "srv_type", "event"]),
        ("<publish_to name='a' m", ["msg_type", "latch", "reliability", "durability", "depth"]),
        ('<publish_to latch = "', ["true", "false"]),
        ("<subscribe_to name='a>b'\n reliability='be", ["reliable", "best_effort", "auto"]),
        ('<observe_action reliability="', []),
        ('<subscribe_to name="', []),
        ('<subscribe_to name="a"', []),
        ('<subscribe_to name="a"/> ', []),
        ("</", []),
        ("<group ", []),
        ("", []),
    ],
)
def test_elements_and_attributes_of_topics_are_completed(
    folder: Path, addition: str, expected: List[str]
) -> None:
    assert list(completions(folder, addition, "pub_sub.xml")) == expected


def test_root_of_topics_is_completed_first(folder: Path) -> None:
    (folder / "pub_sub.xml").write_text("<?xml version='1.0'?>\n<!-- topics -->\n")
    assert completions(folder, "<", "pub_sub.xml") == {"publish_subscribe": "element"}


def renamed(folder: Path, text: str, new_name: str, rules: str = RULES) -> Dict[str, str]:
    """Return the texts of all files after the symbol at a text of the rule file was renamed."""
    index = index_of(folder)
    use = index.use_at(str(folder / "eventRules.txt"), rules.index(text))
    assert use is not None
    changed = {}
    for path, edits in rename(use.symbol, new_name, index, PREDICATES).items():
        content = index.files[path].text
        for edit in sorted(edits, reverse=True):
            content = content[: edit.start] + edit.text + content[edit.end :]
        changed[os.path.basename(path)] = content
    return changed


def test_event_is_renamed_in_all_files(folder: Path) -> None:
    changed = renamed(folder, "seen(X, _)", "spotted")
    assert changed == {
        "eventRules.txt": RULES.replace("seen(X, ", "spotted(X, "),
        "goalPredicates.txt": GOALS.replace("seen(X, _)", "spotted(X, _)"),
    }


def test_event_of_topic_and_memory_are_renamed(folder: Path) -> None:
    assert renamed(folder, "bump{", "hit")["pub_sub.xml"] == TOPICS.replace('"bump"', '"hit"')
    changed = renamed(folder, "last_seen", "Last One")
    assert changed["goalPredicates.txt"] == GOALS.replace("last_seen", "'Last One'")
    assert changed["eventRules.txt"] == RULES.replace("last_seen", "'Last One'")


OBSERVED = """\
<publish_subscribe>
  <observe_action name="go" action_type="lab/Go" event="drive"/>
  <observe_service name="dock" srv_type="std_srvs/SetBool" event="dock"/>
</publish_subscribe>
"""
OBSERVING_RULES = (
    "ended(G) <- drive__result(G, S, _).\nmoving(G) <- drive__feedback(G, _).\non <- dock(_, R, _).\n"
)


@pytest.fixture
def observing_folder(folder: Path) -> Path:
    (folder / "pub_sub.xml").write_text(OBSERVED)
    (folder / "eventRules.txt").write_text(OBSERVING_RULES)
    return folder


@pytest.mark.parametrize("event", ["drive__result", "drive__feedback"])
def test_events_of_action_are_renamed_together(observing_folder: Path, event: str) -> None:
    new_name = event.replace("drive", "travel")
    assert renamed(observing_folder, event, new_name, OBSERVING_RULES) == {
        "pub_sub.xml": OBSERVED.replace('"drive"', '"travel"'),
        "eventRules.txt": OBSERVING_RULES.replace("drive", "travel"),
    }
    with pytest.raises(
        UsageError, match=f"pub_sub.xml defines it: expected a name that ends with '{event[5:]}'"
    ):
        renamed(observing_folder, event, "travel", OBSERVING_RULES)


def test_event_of_service_is_renamed(observing_folder: Path) -> None:
    assert renamed(observing_folder, "dock(", "moor", OBSERVING_RULES) == {
        "pub_sub.xml": OBSERVED.replace('event="dock"', 'event="moor"'),
        "eventRules.txt": OBSERVING_RULES.replace("dock", "moor"),
    }


def test_topics_of_action_are_no_topics_of_outputs(observing_folder: Path) -> None:
    assert completions(observing_folder, "subscribe(on, [], _, ", "goalPredicates.txt") == {}


def test_indicator_is_renamed_with_event(folder: Path) -> None:
    assert "print_trigger(close/1)" in renamed(folder, "near(X)", "close")["eventRules.txt"]


@pytest.mark.parametrize(
    ("text", "new_name", "message"),
    [
        ("std_msgs__0__String", "x", "cannot rename std_msgs__0__String/1: it is a message type"),
        ("prev", "x", "cannot rename prev/5: it is built in"),
        ("near(X)", "where_is", "the program has where_is/1 already"),
        ("near(X)", " ", "expected a name"),
        ("bump{", "a b", "'a b' is not a name of ROS"),
    ],
)
def test_impossible_renaming_is_error(folder: Path, text: str, new_name: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        renamed(folder, text, new_name)


def test_memory_can_be_renamed(folder: Path) -> None:
    index = index_of(folder)
    use = index.use_at(str(folder / "eventRules.txt"), RULES.index("last_seen"))
    assert use is not None
    check_renamable(use.symbol, index, PREDICATES)


def test_files_are_formatted_by_their_names() -> None:
    assert format_file("/p/eventRules.txt", "a<-b.") == "a <- b.\n"
    assert format_file("/p/goalPredicates.txt", "a(1,2)\n") == "a(1, 2)\n"
    assert format_file("/p/pub_sub.xml", TOPICS) == TOPICS
    with pytest.raises(ProgramErrors):
        format_file("/p/goalPredicates.txt", "a(\n")
