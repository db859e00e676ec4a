"""Terms that are meant as messages and are none."""

import pytest

from retalis._slots import misfits
from retalis.engine import Engine
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
    return [str(found) for found in misfits(engine, definitions, ["my_msgs/Warm", "my_msgs/Empty"])]


@pytest.mark.parametrize(
    ("rules", "warning"),
    [
        (
            "a <- my_msgs__0__Warm(_).",
            "my_msgs__0__Warm/1 is no message: my_msgs/Warm has 2 slots: header, warmth",
        ),
        (
            "a <- b where X = my_msgs__0__Warm(std_msgs__0__Header(_, _), 1).",
            "std_msgs__0__Header/2 is no message: std_msgs/Header has 3 slots: seq, stamp, frame_id",
        ),
        ("a <- my_msgs__0__Empty(_).", "my_msgs__0__Empty/1 is no message: my_msgs/Empty has 0 slots"),
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
        "memory m: my_msgs__0__Warm/1 is no message: my_msgs/Warm has 2 slots: header, warmth",
        "a subscription of topic out: my_msgs__0__Warm/3 is no message: my_msgs/Warm has 2 slots: header, warmth",
    ]


def test_right_and_foreign_terms_are_left_alone(definitions):
    rules = "a(X) <- my_msgs__0__Warm(std_msgs__0__Header(_, _, _), X)."
    assert warnings(definitions, f"{rules} b <- other__0__Thing(_) or my_msgs__0__Empty.") == []
