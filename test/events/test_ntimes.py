"""``Q ntimes N`` is Q seq ... seq Q: named variables are shared, each ``_`` is fresh in each repetition."""

import random

import pytest
from events.running import Program, fired

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")

CASES = [
    ("a(X,_) ntimes 3", "a(X,_) seq a(X,_) seq a(X,_)"),
    ("(a(X,_) or b(_,X)) ntimes 2", "(a(X,_) or b(_,X)) seq (a(X,_) or b(_,X))"),
    (
        "(a(X,_) where X > 1) ntimes 3",
        "(a(X,_) where X > 1) seq (a(X,_) where X > 1) seq (a(X,_) where X > 1)",
    ),
    ("(a(X,_) ntimes 2) ntimes 2", "(a(X,_) seq a(X,_)) seq (a(X,_) seq a(X,_))"),
    ("(a(X,_) seq b(X,_)) ntimes 2 within 6", "((a(X,_) seq b(X,_)) seq (a(X,_) seq b(X,_))) within 6"),
    ("(a(X,_) cnot b(_,_)) ntimes 2", "(a(X,_) cnot b(_,_)) seq (a(X,_) cnot b(_,_))"),
    (
        "(a(X,_) seq (b(X,_) star_times)) ntimes 2",
        "(a(X,_) seq (b(X,_) star_times)) seq (a(X,_) seq (b(X,_) star_times))",
    ),
    ("b(X,_) seq ((a(X,_) and b(_,X)) ntimes 2)", "b(X,_) seq ((a(X,_) and b(_,X)) seq (a(X,_) and b(_,X)))"),
]


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(("short", "long"), CASES)
@pytest.mark.parametrize("flags", [(), ("out_of_order",), ("etalis_justification",)], ids=str)
def test_it_is_the_sequence_written_out(short, long, policy, flags):
    rng = random.Random(f"{short} {policy}")
    for _ in range(4):
        stream = []
        for at in range(3, 17):
            start = at + rng.choice([0, 0, 0, -2]) if flags == ("out_of_order",) else at
            stamp = f"{start}-{start + rng.randrange(1, 4)}" if rng.random() < 0.3 else str(start)
            stream.append(f"{rng.choice('aab')}({rng.randrange(1, 3)},{rng.randrange(1, 4)})@{stamp}")
        text = " ".join(stream)
        assert fired(f"c(X) <- {short}.", text, policy, flags) == fired(
            f"c(X) <- {long}.", text, policy, flags
        )


def test_a_named_variable_has_one_value_though_it_stands_once():
    assert fired("c <- a(X) ntimes 2.", "a(1)@1 a(2)@2 a(1)@3") == "c@1-3"
    assert fired("c <- a(_) ntimes 2.", "a(1)@1 a(2)@2 a(1)@3") == "c@1-2 c@2-3"


@pytest.mark.parametrize("policy", POLICIES[:-1])
def test_a_thousand_times(policy):
    program = Program("c(X) <- a(X,_) ntimes 1000.", policy=policy)
    assert program.errors == []
    assert program.feed(" ".join(f"a(1,{at % 7})@{at}" for at in range(30))) == ""
    assert program.engine.rules.rules[0].waiting == 30
