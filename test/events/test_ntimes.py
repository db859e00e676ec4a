"""``Q ntimes N`` is Q seq ... seq Q: named variables are shared, each ``_`` is fresh in each repetition."""

import random

import pytest
from events.stream_programs import ProgramRunner, format_events, outputs_of, term_text

from retalis import Engine
from retalis.events.network.repeat_node import RepeatNode

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


@pytest.mark.slow
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
        assert outputs_of(f"c(X) <- {short}.", text, policy, flags) == outputs_of(
            f"c(X) <- {long}.", text, policy, flags
        )


def test_a_named_variable_has_one_value_though_it_stands_once():
    assert outputs_of("c <- a(X) ntimes 2.", "a(1)@1 a(2)@2 a(1)@3") == "c@1-3"
    assert outputs_of("c <- a(_) ntimes 2.", "a(1)@1 a(2)@2 a(1)@3") == "c@1-2 c@2-3"


REPEATED = [
    "a(X,_)",
    "a(_,_)",
    "a(X,Y)",
    "(a(X,_) where X > 1)",
    "(a(X,_) or b(_,X))",
    "(a(X,_) or b(X,Y))",
    "(a(X,_) within 2)",
    "(a(X,_) check (t1(S), t2(E), E - S < 2))",
    "(a(_,_) or d)",
    "d",
]
AROUND = [
    "{}",
    "{}",
    "{}",
    "b(X,_) seq {}",
    "{} seq b(X,_)",
    "{} and b(X,_)",
    "{} or b(X,_)",
    "{} cnot b(_,2)",
    "{} fnot b(1,1)",
    "{} within 6",
    "{} where X > 1",
    "b(X,Y) seq aggregate(count,{},N)",
    "b(_,Y) seq ({} star_times)",
    "(b(X,_) seq b(X,_)) cnot {}",
    "b(X,Z) seq ({} where Z > 1)",
    "({} seq b(X,_)) ntimes 2",
    "{} forall_seq b(_,_)",
    "{} ntimes 2",
    "{} par b(_,X)",
]


def drawn_stream(rng, late, revised):
    """Return events: some touching or overlapping, some with variables, some late or taken back."""
    found, known, now = [], [], 10
    for _ in range(rng.choice([8, 12, 24])):
        now += rng.choice([0, 0, 1, 1, 1, 2])
        end = now - rng.choice([1, 2, 4]) if late and rng.random() < 0.3 else now
        start = end - rng.choice([0, 0, 0, 0, 1, 3])
        value = "Z" if rng.random() < 0.02 else rng.choice(["1", "1", "2", "f(1)"])
        event = rng.choice(["a({},{})"] * 5 + ["b({},{})", "d"]).format(value, rng.randrange(1, 4))
        if revised and known and rng.random() < 0.15:
            event, start = f"rev({rng.choice(known)})", end
        elif "Z" not in event:
            known.append(event)
        found.append(f"{event}@{start}-{end}")
    return found


def drawn_flags(rng, late, revised):
    flags = ["revision_flag"] * revised + ["out_of_order"] * (late and rng.random() < 0.7)
    flags += ["etalis_justification"] * (rng.random() < 0.2)
    if rng.random() < 0.15:
        window = rng.choice([2, 5])
        flags += [("garbage_control", "general"), ("garbage_window", window), ("garbage_window_step", 1)]
    return flags


def answer(rule, policy, flags, stream, changes):
    """Return what follows from each event, and how many partial matches wait in the end."""
    program = ProgramRunner(rule, flags, policy)
    found = []
    for at, event in enumerate(stream):
        for flag, value in changes.get(at, ()):
            program.set(flag, value)
        found.append(program.feed(event))
    return found, program.engine.rules.match_count


@pytest.mark.slow
@pytest.mark.parametrize("group", range(10))
def test_by_chance_it_is_the_sequence_written_out(group):
    for number in range(25):
        rng = random.Random(f"{group} {number}")
        policy, late, revised = rng.choice(POLICIES), rng.random() < 0.3, rng.random() < 0.3
        changes = {}
        if rng.random() < 0.25:
            for at in rng.sample(range(12), 2):
                changes[at] = [
                    rng.choice(
                        [
                            ("event_consumption_policy", rng.choice(POLICIES)),
                            ("out_of_order", rng.choice(["on", "off"])),
                        ]
                    )
                ]
        pattern, times, around = rng.choice(REPEATED), rng.randrange(1, 6), rng.choice(AROUND)
        label = f"r([property(event_rule_window,{rng.choice([2, 4, 8])})]) : " if rng.random() < 0.2 else ""
        head = rng.choice(["c(X,Y,N)", "c(X)", "c"])
        flags = drawn_flags(rng, late, revised)
        stream = drawn_stream(rng, late, revised)
        if policy == "unrestricted" or changes:
            stream = stream[:12]
        short, long = (
            f"{label}{head} <- {around.format(text)}."
            for text in (f"({pattern} ntimes {times})", f"({' seq '.join([pattern] * times)})")
        )
        given = (policy, flags, stream, changes)
        assert answer(short, *given) == answer(long, *given), (short, given)


def test_what_waits_goes_on_when_the_policy_changes():
    program = ProgramRunner("c <- a(_) ntimes 5.")
    assert program.feed("a(1)@1 a(2)@2 a(3)@3") == ""
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("a(4)@4") == ""
    program.set("event_consumption_policy", "chronological")
    assert program.feed("a(5)@5") == "c@1-5"


def test_events_of_the_rule_itself_count_where_they_come():
    rules = "a(X,3) <- c(X). c(X) <- {}."
    stream = "a(1,1)@1 a(1,1)@2 a(1,2)@3 a(1,2)@4 a(1,1)@5 a(1,1)@6 a(1,1)@7"
    long = " seq ".join(["a(X,_)"] * 4)
    assert outputs_of(rules.format("a(X,_) ntimes 4"), stream) == outputs_of(rules.format(long), stream)


@pytest.mark.parametrize("policy", POLICIES)
def test_an_explanation_is_that_of_the_sequence_written_out(policy):
    stream = "a(1,1)@1 a(1,1)@2-3 a(1,2)@3 a(1,2)@4 a(1,1)@5 a(1,1)@6 a(1,1)@7"
    found = []
    for pattern in ("a(X,_) ntimes 4", "a(X,_) seq a(X,_) seq a(X,_) seq a(X,_)"):
        program = ProgramRunner(f"c(X) <- {pattern}.", ["etalis_justification"], policy)
        program.feed(stream)
        ask = "findall(E-J, (E = c(_), justify_event(E,_,J)), L)"
        found.append([term_text(solution["L"]) for solution in program.engine.query(ask)])
    assert found[0] == found[1]
    assert "seqf(seqf(seqf(" in found[0][0]


@pytest.mark.slow
@pytest.mark.parametrize("times", [1000, 10_000])
@pytest.mark.parametrize("policy", POLICIES[:-1])
def test_as_many_events_as_repetitions_cost_so_many_steps(policy, times):
    program = ProgramRunner(f"c(X) <- a(X,_) ntimes {times}.", policy=policy)
    assert program.errors == []
    rule = program.engine.rules.rules[0]
    assert len(rule.nodes) < 10
    for at in range(times - 1):
        program.engine.event(f"a(1,{at % 7})", at, at)
    assert rule.stored_match_count == times - 1
    assert program.feed(f"a(1,0)@{times}") == f"c(1)@0-{times}"
    assert program.feed(f"a(1,0)@{times + 1}") == f"c(1)@1-{times + 1}"
    (node,) = [node for node, _, _ in rule.nodes if isinstance(node, RepeatNode)]
    assert node.visit_count == times + 1


def test_a_window_removes_what_is_too_old_from_the_longest_on():
    program = ProgramRunner("c <- (a(_) ntimes 1000) within 10.", policy="chronological")
    for at in range(100):
        program.engine.event(f"a({at})", at, at)
    rule = program.engine.rules.rules[0]
    assert rule.stored_match_count == 10
    (node,) = [node for node, _, _ in rule.nodes if isinstance(node, RepeatNode)]
    assert node.visit_count == 100
    assert sum(len(group.cursors) for group in node.groups.values()) <= 12


def test_of_values_that_do_not_wait_nothing_is_kept():
    program = ProgramRunner("c(X) <- (a(X) ntimes 10) within 10.")
    for at in range(5000):
        program.engine.event(f"a({at})", at, at)
    (node,) = [node for node, _, _ in program.engine.rules.rules[0].nodes if isinstance(node, RepeatNode)]
    assert len(node.groups) <= 11


@pytest.mark.slow
def test_a_thousand_repetitions_of_a_sequence_are_loaded():
    engine = Engine()
    engine.load(rules="out <- (a seq b) ntimes 1000.")


@pytest.mark.parametrize(
    ("former_flag", "stream", "later_flag"),
    [
        (("event_consumption_policy", "unrestricted"), "", ("event_consumption_policy", "chronological")),
        (
            ("event_consumption_policy", "chronological"),
            "a(1)@1 a(1)@2 a(1)@3",
            ("event_consumption_policy", "unrestricted"),
        ),
        # An event with variables has the sequences joined like parts of a `seq`.
        (("event_consumption_policy", "chronological"), "a(1)@1 a(1)@2 a(1)@3 a(_)@4", None),
    ],
)
def test_snapshot_after_change_of_evaluation_is_restored(former_flag, stream, later_flag):
    program = ProgramRunner("out(X) <- (a(X) ntimes 5) and d.", [former_flag], "chronological")
    program.feed(stream)
    if later_flag is not None:
        program.set(*later_flag)
    program.feed("d@5")
    restored = Engine.restore(program.engine.snapshot())
    outputs = []
    restored.on_event(lambda term, start, end: outputs.append((term, start, end)))
    later_stream = [f"a(1)@{instant}" for instant in range(6, 11)]
    expected = program.feed(" ".join(later_stream))
    for event in later_stream:
        text, instant = event.split("@")
        restored.event(text, int(instant))
    assert "out(1)@" in expected
    assert format_events([event for event in outputs if term_text(event[0]) == "out(1)"]) == expected
