"""``Q ntimes N`` is Q seq ... seq Q: named variables are shared, each ``_`` is fresh in each repetition."""

import random
from typing import Any, Dict, List, Optional, Tuple

import pytest
from events.program_runner import ProgramRunner, format_events, outputs_of, term_text
from nightly_round_numbers import round_numbers

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
def test_ntimes_equals_written_sequence(short: str, long: str, policy: str, flags: Tuple[Any, ...]) -> None:
    generator = random.Random(f"{short} {policy}")
    for _ in range(4):
        stream: List[Any] = []
        for second in range(3, 17):
            start = second + generator.choice([0, 0, 0, -2]) if flags == ("out_of_order",) else second
            interval = (
                f"{start}-{start + generator.randrange(1, 4)}" if generator.random() < 0.3 else str(start)
            )
            stream.append(
                f"{generator.choice('aab')}({generator.randrange(1, 3)},{generator.randrange(1, 4)})@{interval}"
            )
        text = " ".join(stream)
        assert outputs_of(f"c(X) <- {short}.", text, policy, flags) == outputs_of(
            f"c(X) <- {long}.", text, policy, flags
        )


def test_named_variable_is_shared_by_repetitions() -> None:
    assert outputs_of("c <- a(X) ntimes 2.", "a(1)@1 a(2)@2 a(1)@3") == "c@1-3"
    assert outputs_of("c <- a(_) ntimes 2.", "a(1)@1 a(2)@2 a(1)@3") == "c@1-2 c@2-3"


REPEATED_PATTERNS = [
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
OUTER_PATTERNS = [
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


def random_stream(generator: Any, has_late_events: Any, has_retractions: Any) -> Any:
    """Return events: some touching or overlapping, some with variables, some late or retracted."""
    events: List[Any] = []
    retractable: List[Any] = []
    clock_time = 10
    for _ in range(generator.choice([8, 12, 24])):
        clock_time += generator.choice([0, 0, 1, 1, 1, 2])
        end = (
            clock_time - generator.choice([1, 2, 4])
            if has_late_events and generator.random() < 0.3
            else clock_time
        )
        start = end - generator.choice([0, 0, 0, 0, 1, 3])
        value = "Z" if generator.random() < 0.02 else generator.choice(["1", "1", "2", "f(1)"])
        event = generator.choice(["a({},{})"] * 5 + ["b({},{})", "d"]).format(
            value, generator.randrange(1, 4)
        )
        if has_retractions and retractable and generator.random() < 0.15:
            event, start = f"rev({generator.choice(retractable)})", end
        elif "Z" not in event:
            retractable.append(event)
        events.append(f"{event}@{start}-{end}")
    return events


def random_flags(generator: Any, has_late_events: Any, has_retractions: Any) -> Any:
    flags: List[Any] = ["revision_flag"] * has_retractions + ["out_of_order"] * (
        has_late_events and generator.random() < 0.7
    )
    flags += ["etalis_justification"] * (generator.random() < 0.2)
    if generator.random() < 0.15:
        window = generator.choice([2, 5])
        flags += [("garbage_control", "general"), ("garbage_window", window), ("garbage_window_step", 1)]
    return flags


def random_flag_changes(generator: random.Random) -> Dict[int, List[Tuple[str, str]]]:
    """Return the flags that are set before the event of a position, with their values."""
    changes: Dict[int, List[Tuple[str, str]]] = {}
    if generator.random() < 0.25:
        for position in generator.sample(range(12), 2):
            policy = ("event_consumption_policy", generator.choice(POLICIES))
            out_of_order = ("out_of_order", generator.choice(["on", "off"]))
            changes[position] = [generator.choice([policy, out_of_order])]
    return changes


def random_rules(generator: random.Random) -> Tuple[str, str]:
    """Return a rule with ``ntimes``, and the same rule with a written sequence."""
    pattern = generator.choice(REPEATED_PATTERNS)
    times = generator.randrange(1, 6)
    outer_pattern = generator.choice(OUTER_PATTERNS)
    window = generator.choice([2, 4, 8])
    label = f"r([property(event_rule_window,{window})]) : " if generator.random() < 0.2 else ""
    head = generator.choice(["c(X,Y,N)", "c(X)", "c"])
    short, long = f"({pattern} ntimes {times})", f"({' seq '.join([pattern] * times)})"
    return (
        f"{label}{head} <- {outer_pattern.format(short)}.",
        f"{label}{head} <- {outer_pattern.format(long)}.",
    )


def outputs_and_match_count(rule: Any, policy: Any, flags: Any, stream: Any, changes: Any) -> Tuple[Any, ...]:
    """Return the outputs for each event, and the number of partial matches at the end."""
    program = ProgramRunner(rule, flags, policy)
    outputs: List[Any] = []
    for number, event in enumerate(stream):
        for flag, value in changes.get(number, ()):
            program.set(flag, value)
        outputs.append(program.feed(event))
    return outputs, program.engine.rules.match_count


@pytest.mark.slow
@pytest.mark.parametrize("group", round_numbers(2, 10))
def test_random_ntimes_equal_written_sequences(group: Any) -> None:
    for number in range(25):
        generator = random.Random(f"{group} {number}")
        policy = generator.choice(POLICIES)
        has_late_events, has_retractions = generator.random() < 0.3, generator.random() < 0.3
        changes = random_flag_changes(generator)
        short, long = random_rules(generator)
        flags = random_flags(generator, has_late_events, has_retractions)
        stream = random_stream(generator, has_late_events, has_retractions)
        if policy == "unrestricted" or changes:
            stream = stream[:12]
        settings = (policy, flags, stream, changes)
        assert outputs_and_match_count(short, *settings) == outputs_and_match_count(long, *settings), (
            short,
            settings,
        )


def test_policy_change_keeps_partial_matches() -> None:
    program = ProgramRunner("c <- a(_) ntimes 5.")
    assert program.feed("a(1)@1 a(2)@2 a(3)@3") == ""
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("a(4)@4") == ""
    program.set("event_consumption_policy", "chronological")
    assert program.feed("a(5)@5") == "c@1-5"


def test_recursive_events_are_repetitions() -> None:
    rules = "a(X,3) <- c(X). c(X) <- {}."
    stream = "a(1,1)@1 a(1,1)@2 a(1,2)@3 a(1,2)@4 a(1,1)@5 a(1,1)@6 a(1,1)@7"
    long = " seq ".join(["a(X,_)"] * 4)
    assert outputs_of(rules.format("a(X,_) ntimes 4"), stream) == outputs_of(rules.format(long), stream)


@pytest.mark.parametrize("policy", POLICIES)
def test_explanation_equals_that_of_sequence(policy: str) -> None:
    stream = "a(1,1)@1 a(1,1)@2-3 a(1,2)@3 a(1,2)@4 a(1,1)@5 a(1,1)@6 a(1,1)@7"
    explanations: List[Any] = []
    for pattern in ("a(X,_) ntimes 4", "a(X,_) seq a(X,_) seq a(X,_) seq a(X,_)"):
        program = ProgramRunner(f"c(X) <- {pattern}.", ["etalis_justification"], policy)
        program.feed(stream)
        goal = "findall(E-J, (E = c(_), justify_event(E,_,J)), L)"
        explanations.append([term_text(solution["L"]) for solution in program.engine.query(goal)])
    assert explanations[0] == explanations[1]
    assert "seqf(seqf(seqf(" in explanations[0][0]


@pytest.mark.slow
@pytest.mark.parametrize("times", [1000, 10_000])
@pytest.mark.parametrize("policy", POLICIES[:-1])
def test_cost_of_repetitions_is_linear(policy: Any, times: int) -> None:
    program = ProgramRunner(f"c(X) <- a(X,_) ntimes {times}.", policy=policy)
    assert program.errors == []
    rule = program.engine.rules.rules[0]
    assert len(rule.nodes) < 10
    for second in range(times - 1):
        program.engine.event(f"a(1,{second % 7})", second, second)
    assert rule.stored_match_count == times - 1
    assert program.feed(f"a(1,0)@{times}") == f"c(1)@0-{times}"
    assert program.feed(f"a(1,0)@{times + 1}") == f"c(1)@1-{times + 1}"
    (node,) = [node for node in rule.nodes if isinstance(node, RepeatNode)]
    assert node.visit_count == times + 1


def test_window_removes_old_repetitions() -> None:
    program = ProgramRunner("c <- (a(_) ntimes 1000) within 10.", policy="chronological")
    for second in range(100):
        program.engine.event(f"a({second})", second, second)
    rule = program.engine.rules.rules[0]
    assert rule.stored_match_count == 10
    (node,) = [node for node in rule.nodes if isinstance(node, RepeatNode)]
    assert node.visit_count == 100
    assert sum(len(group.cursors) for group in node.groups.values()) <= 12


def test_groups_without_matches_are_removed() -> None:
    program = ProgramRunner("c(X) <- (a(X) ntimes 10) within 10.")
    for second in range(5000):
        program.engine.event(f"a({second})", second, second)
    (node,) = [node for node in program.engine.rules.rules[0].nodes if isinstance(node, RepeatNode)]
    assert len(node.groups) <= 11


@pytest.mark.slow
def test_thousand_repetitions_of_sequence_are_loaded() -> None:
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
def test_snapshot_of_other_evaluation_is_restored(
    former_flag: Tuple[Any, ...], stream: str, later_flag: Optional[Tuple[Any, ...]]
) -> None:
    program = ProgramRunner("out(X) <- (a(X) ntimes 5) and d.", [former_flag], "chronological")
    program.feed(stream)
    if later_flag is not None:
        program.set(*later_flag)
    program.feed("d@5")
    restored = Engine.restore(program.engine.snapshot())
    outputs: List[Any] = []
    restored.on_event(lambda term, start, end: outputs.append((term, start, end)))
    later_stream = [f"a(1)@{instant}" for instant in range(6, 11)]
    expected = program.feed(" ".join(later_stream))
    for event in later_stream:
        text, instant = event.split("@")
        restored.event(text, int(instant))
    assert "out(1)@" in expected
    assert format_events([event for event in outputs if term_text(event[0]) == "out(1)"]) == expected
