"""What a program was probably not meant to say."""

import pytest

from retalis.engine import Engine, parts_of
from retalis.events.program import unknown_memories, unread_rules, wrong_messages
from retalis.foundation import ProgramErrors
from retalis.messages import Definitions

HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
WARM = f"Header header\nfloat64 warmth\n{'=' * 80}\nMSG: std_msgs/Header\n{HEADER}"


@pytest.fixture
def definitions():
    known = Definitions()
    known.add("my_msgs/Warm", WARM)
    known.add("my_msgs/Empty", "")
    return known


def warnings(definitions, rules="", goals=""):
    engine = Engine()
    engine.load(rules=rules, goals=goals)
    return [str(found) for found in messages(engine, definitions, ["my_msgs/Warm", "my_msgs/Empty"])]


def messages(engine, definitions, types):
    parts = parts_of(engine)
    return list(wrong_messages(parts.rules, parts.knowledge.patterns(), definitions, types))


def memories(engine):
    parts = parts_of(engine)
    return list(unknown_memories(parts.rules, [memory.id for memory in parts.knowledge.memories]))


def unread(engine, folder):
    return list(unread_rules(parts_of(engine).rules.files, folder))


@pytest.mark.parametrize(
    ("rules", "warning"),
    [
        (
            "a <- my_msgs__0__Warm(_).",
            "my_msgs__0__Warm/1 does not match its type: my_msgs/Warm has 2 slots: header, warmth",
        ),
        (
            "a <- b where X = my_msgs__0__Warm(std_msgs__0__Header(_, _), 1).",
            "std_msgs__0__Header/2 does not match its type: std_msgs/Header has 3 slots: seq, stamp, frame_id",
        ),
        (
            "a <- my_msgs__0__Empty(_).",
            "my_msgs__0__Empty/1 does not match its type: my_msgs/Empty has 0 slots",
        ),
        (
            "a <- my_msgs__0__Warn(_, _).",
            "there is no message type my_msgs/Warn here; did you mean my_msgs/Warm?",
        ),
    ],
)
def test_rules_with_wrong_messages_are_warned_of_with_their_places(definitions, rules, warning):
    (found,) = warnings(definitions, rules)
    assert found.startswith(f"text:1:1: {warning}\n")


def test_patterns_of_memories_and_subscriptions_are_looked_at(definitions):
    goals = "memorize(my_msgs__0__Warm(_), [], _, m, 5)\nsubscribe(my_msgs__0__Warm(_, _, _), [], _, out, s)"
    assert warnings(definitions, goals=goals) == [
        "memory m: my_msgs__0__Warm/1 does not match its type: my_msgs/Warm has 2 slots: header, warmth",
        "a subscription of topic out: my_msgs__0__Warm/3 does not match its type: "
        "my_msgs/Warm has 2 slots: header, warmth",
    ]


def test_right_and_foreign_terms_are_left_alone(definitions):
    rules = "a(X) <- my_msgs__0__Warm(std_msgs__0__Header(_, _, _), X)."
    assert warnings(definitions, f"{rules} b <- other__0__Thing(_) or my_msgs__0__Empty.") == []


@pytest.mark.parametrize("text", ["ann", '"ann"'])
def test_texts_without_their_quotes_are_warned_of(definitions, text):
    header = f"std_msgs__0__Header(_, _, {text})"
    wrong = """frame_id of std_msgs/Header is a string, which keeps its quotes in events: write '"ann"'"""
    rules = f"a <- b seq (my_msgs__0__Warm({header}, _) where true)."
    assert [found.split("\n")[0] for found in warnings(definitions, rules)] == [f"text:1:1: {wrong}"]
    goals = f"memorize(my_msgs__0__Warm({header}, _), [], _, m, 5)"
    assert warnings(definitions, goals=goals) == [f"memory m: {wrong}"]


def test_texts_with_their_quotes_and_in_heads_and_goals_are_left_alone(definitions):
    header = "std_msgs__0__Header(0, [0,0], {})".format
    right = header("""'"ann"'""")
    rules = f"my_msgs__0__Warm({header('ann')}, 1) <- my_msgs__0__Warm({right}, X) where X = {header('b')}."
    assert warnings(definitions, rules) == []


def test_types_that_are_learned_later_are_left_alone(definitions):
    engine = Engine()
    engine.load(rules="a(X) <- far_msgs__0__WarmFeedback(far_msgs__0__Warm(X), my_msgs__0__Warm(_, _)).")
    types = ["my_msgs/Warm", "far_msgs/WarmFeedback"]
    assert messages(engine, definitions, types) == []


@pytest.mark.parametrize(
    ("rules", "found"),
    [
        (
            "a <- b where prev(odom_bas, _, 1, 2, 3).",
            "there is no memory odom_bas yet; did you mean odom_base?",
        ),
        ("synchronized(a(T), true, [[odom_base, T], [heap, T]]) <- b(T).", "there is no memory heap yet"),
        ("a <- b where seen(_). seen(X) :- access_mem(haed, X, _).", "there is no memory haed yet"),
    ],
)
def test_memories_that_are_read_and_not_there_are_warned_of(rules, found):
    engine = Engine()
    engine.load(rules=rules, goals="memorize(t(X), [], _, odom_base, 5)")
    (warning,) = memories(engine)
    assert warning.message == found


@pytest.mark.parametrize(
    "rules",
    [
        "a(X) <- b(X) where prev(X, _, 1, 2, 3).",
        "a <- b where (memorize(t(X), [], _, here, 5), access_mem(here, _, _)).",
        "a <- b where access_mem(odom_base, _, _). c :- next_inf(odom_base, _, 1, 2, 3).",
        "a(N) <- b(N) do memorize(t(X), [], _, N, 5). c <- d where access_mem(there, _, _).",
    ],
)
def test_memories_that_are_there_or_may_come_are_left_alone(rules):
    engine = Engine()
    engine.load(rules=rules, goals="memorize(t(X), [], _, odom_base, 5)")
    assert memories(engine) == []


def test_rules_that_no_goal_reads_are_warned_of(tmp_path):
    engine = Engine()
    assert unread(engine, tmp_path) == []
    (tmp_path / "eventRules.txt").write_text("a <- b.")
    (warning,) = unread(engine, tmp_path)
    assert warning.message == (
        f"{tmp_path}/eventRules.txt is not read: no goal in goalPredicates.txt calls "
        "compile_event_file('eventRules.txt')"
    )
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')")
    engine.load_program(tmp_path)
    assert unread(engine, tmp_path) == []
    (tmp_path / "eventRules.txt").write_text("a <- .")
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load_program(tmp_path)
    assert unread(engine, tmp_path) == []  # that they cannot be read is said already
